"""The pools of the API's connections: which are dropped and when, by a clock of the test's own."""

import asyncio
import contextlib
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from uvicorn.protocols.http.h11_impl import H11Protocol

from hil.addons.service import logs
from hil.addons.service.api import connections
from hil.addons.service.api.access import Access
from hil.addons.service.api.connections import ConnectionPools, HttpConnection
from tests.support.clocks import StandingClock


class One:
    def __init__(self, *, is_known: bool = False) -> None:
        self.is_known, self.transport = is_known, self
        self.is_aborted = self.is_ending = False

    def abort(self) -> None:
        self.is_aborted = True

    def is_closing(self) -> bool:
        return self.is_ending


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> StandingClock:
    one = StandingClock()
    monkeypatch.setattr(connections, "time", one)
    monkeypatch.setattr(connections, "_SWEEP_S", 0.0)
    return one


def pools_of(monkeypatch: pytest.MonkeyPatch, most_files: float = 704.0) -> ConnectionPools:
    monkeypatch.setattr(connections, "_most_files", lambda: most_files)
    return ConnectionPools(Access("t" * 16, {}))


def swept(pools: ConnectionPools, *steps: Callable[[], object]) -> None:
    """Sweep before each step and after the last one."""

    async def all_steps() -> None:
        task = asyncio.create_task(pools.sweep())
        for step in (lambda: None, *steps):
            step()
            for _ in range(5):
                await asyncio.sleep(0)
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    asyncio.run(all_steps())


def test_each_connection_has_the_time_of_its_pool_and_a_websocket_has_no_limit(
    monkeypatch: pytest.MonkeyPatch, clock: StandingClock
) -> None:
    pools = pools_of(monkeypatch)
    stranger, resting, asking, live, ending = One(), One(is_known=True), One(is_known=True), One(), One()
    for one, in_request in ((stranger, True), (resting, False), (asking, True)):
        pools.place(cast("HttpConnection", one), in_request=in_request)
    for one in (live, ending):
        pools.opened(cast("Any", one))
    every = (stranger, resting, asking, live, ending)
    told: list[tuple[bool, ...]] = []

    def at(s: float) -> Callable[[], None]:
        def step() -> None:
            told.append(tuple(one.is_aborted for one in every))
            clock.now_s = 100.0 + s

        return step

    def ends() -> None:
        ending.is_ending = True

    times_s = (2.0, 2.01, 10.0, 10.01, 40.0, 40.01, 1e6)
    swept(pools, *map(at, times_s[:3]), ends, *map(at, times_s[3:]), at(1e6))
    after = dict(zip(times_s, told[1:], strict=True))
    assert after[2.0] == (False,) * 5
    assert after[2.01] == (True, False, False, False, False)
    assert after[10.0] == after[2.01]
    assert after[10.01] == (True, True, False, False, False), "what began to end at 10 s has ten more"
    assert after[40.0] == (True, True, False, False, True)
    assert after[1e6] == (True, True, True, False, True)
    assert pools.dropped == {"late": 4}


@pytest.mark.parametrize(("files", "share"), [(704.0, 1.0), (10_000.0, 1.0), (352.0, 0.5)])
def test_of_a_full_pool_the_oldest_goes_and_pools_are_as_large_as_files_allow(
    monkeypatch: pytest.MonkeyPatch, clock: StandingClock, files: float, share: float
) -> None:
    pools = pools_of(monkeypatch, files)
    for most, is_known, in_request in ((256, False, True), (128, True, False), (128, True, True)):
        count = round(most * share)
        ones = [One(is_known=is_known) for _ in range(count)]
        for one in ones:
            pools.place(cast("HttpConnection", one), in_request=in_request)
        clock.now_s += 1.0
        pools.place(cast("HttpConnection", ones[0]), in_request=in_request)  # it stays where it is
        assert not any(one.is_aborted for one in ones)
        pools.place(cast("HttpConnection", One(is_known=is_known)), in_request=in_request)
        assert [one.is_aborted for one in ones] == [True] + [False] * (count - 1)
    assert pools.dropped == {"crowded": 3}


def test_a_connection_that_has_its_answer_waits_anew(monkeypatch: pytest.MonkeyPatch, clock: StandingClock) -> None:
    monkeypatch.setattr(H11Protocol, "on_response_complete", lambda _: None)
    monkeypatch.setattr(H11Protocol, "connection_lost", lambda *_: None)
    pools = pools_of(monkeypatch)
    http, _ = pools.protocols()
    one: Any = http.__new__(http)
    one.is_known, one.transport = True, One()
    pools.place(one, in_request=True)
    clock.now_s += 39.0
    one.on_response_complete()
    clock.now_s += 10.0
    swept(pools)
    assert not one.transport.is_aborted
    clock.now_s += 0.01
    swept(pools)
    assert one.transport.is_aborted
    pools.place(one, in_request=False)
    one.connection_lost(None)
    clock.now_s += 1e6
    swept(pools)
    assert pools.dropped == {"late": 1}, "what has gone is not dropped"


def test_what_was_dropped_is_one_line_in_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, clock: StandingClock, caplog: pytest.LogCaptureFixture
) -> None:
    pools = pools_of(monkeypatch)

    def drop(after_s: float, number: int) -> Callable[[], None]:
        def step() -> None:
            clock.now_s += after_s
            pools.dropped.update({"crowded": number, "flood": 1})

        return step

    swept(pools, drop(0.0, 3), drop(9.99, 4), drop(0.01, 5), drop(10.0, 0))
    fields = [vars(record)["fields"] for record in caplog.records]
    assert fields == [{"crowded": 3, "flood": 1}, {"crowded": 9, "flood": 2}, {"flood": 1}]


def test_a_connection_that_cannot_be_accepted_is_counted_and_other_errors_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pools = pools_of(monkeypatch)
    told: list[dict[str, Any]] = []
    loop = cast("asyncio.AbstractEventLoop", SimpleNamespace(default_exception_handler=told.append))
    others: list[dict[str, Any]] = [
        {"exception": OSError(), "message": "no socket"},
        {"exception": ValueError(), "socket": "one"},
        {"socket": "one"},
    ]
    for context in ({"exception": OSError(24, "too many"), "socket": "one"}, *others):
        pools._on_exception(loop, context)
    assert (pools.dropped, told) == ({"not_accepted": 1}, others)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
@pytest.mark.parametrize(
    ("limits", "found", "is_set"),
    [
        ((703, 5000), 704, (704, 5000)),
        ((64, 500), 500, (500, 500)),
        ((704, 5000), 704, None),
        ((1024, 5000), 1024, None),
    ],
)
def test_as_many_files_are_opened_as_may_be_up_to_what_is_needed(
    monkeypatch: pytest.MonkeyPatch, limits: tuple[int, int], found: int, is_set: tuple[int, int] | None
) -> None:
    set_: list[tuple[int, int]] = []
    monkeypatch.setattr("resource.getrlimit", lambda _: limits)
    monkeypatch.setattr("resource.setrlimit", lambda _, new: set_.append(new))
    assert connections._most_files() == found
    assert set_ == ([] if is_set is None else [is_set])


@pytest.mark.parametrize(
    ("token", "more_body", "limit_s"),
    [("t" * 16, False, 40.0), ("t" * 16, True, 10.0), ("u" * 16, False, 2.0), ("u" * 16, True, 2.0)],
)
def test_a_request_has_the_time_of_its_token_and_a_whole_one_that_of_its_answer(
    monkeypatch: pytest.MonkeyPatch, clock: StandingClock, token: str, more_body: bool, limit_s: float
) -> None:
    def begun(self: Any) -> None:
        self.cycle = SimpleNamespace(response_complete=False, more_body=more_body)

    monkeypatch.setattr(H11Protocol, "handle_events", begun)
    pools = pools_of(monkeypatch)
    http, _ = pools.protocols()
    one: Any = http.__new__(http)
    one.cycle, one.transport = None, One()
    one.headers = [(b"authorization", f"Bearer {token}".encode())]
    one.handle_events()
    clock.now_s += limit_s
    swept(pools)
    assert not one.transport.is_aborted
    clock.now_s += 0.01
    swept(pools)
    assert one.transport.is_aborted


def test_a_websocket_with_a_token_is_known_and_has_its_own_share_and_that_of_the_token(
    monkeypatch: pytest.MonkeyPatch, clock: StandingClock
) -> None:
    monkeypatch.setattr(logs, "time", clock)
    pools = pools_of(monkeypatch)
    _, websocket = pools.protocols()
    one: Any = websocket.__new__(websocket)
    one.transport = One()
    pools.place(one, in_request=True)
    clock.now_s += 1.0
    of_token = connections.Rate(1000.0, 2000.0)
    one.know(of_token)
    pools.place(one, in_request=True)
    clock.now_s += 39.0
    swept(pools)
    assert not one.transport.is_aborted, "it has the time of a client that is known"
    own, shared = one._frames
    assert shared is of_token
    assert (own.take(600), own.take(1)) == (True, False), "twice as many as in a second, after a pause"
