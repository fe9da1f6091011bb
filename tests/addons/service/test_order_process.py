"""The control side of a process that takes orders: when it counts as hung, and how it comes back; no process runs."""

import json
import os
import sys
from typing import Any

import pytest

from hil.addons.service import api_child
from hil.addons.service.api_child import OrderProcess
from hil.addons.service.messages import Action, Answer, ApiConfig, Motion, Order
from hil.core.errors import BadInputError
from tests.support.service_testbed import LIMITS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows reads pipes in a thread")

CONFIG = ApiConfig(title="here", device="a test", limits=LIMITS, port=0)
READY = {"ready": {"url": "http://127.0.0.1:8123", "token_file": "its/token"}}


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, _: float) -> None:
        self.now_s += 0.005


class Child:
    """In the place of a process: two pipes."""

    every: "list[Child]"

    def __init__(self, words: list[str], **options: Any) -> None:
        self.words, self.options = words, options
        self._heard, to_it = os.pipe()
        from_it, self._says = os.pipe()
        self.stdin, self.stdout = (os.fdopen(to_it, "wb", buffering=0), os.fdopen(from_it, "rb", buffering=0))
        os.set_blocking(self._heard, False)
        self.pid = 70 + len(self.every)
        self.returncode = 3
        self.is_killed = False
        self.every.append(self)

    def say(self, *records: dict[str, Any]) -> None:
        os.write(self._says, b"".join(json.dumps(record).encode() + b"\n" for record in records))

    def heard(self) -> list[dict[str, Any]]:
        try:
            return [json.loads(line) for line in os.read(self._heard, 1 << 20).splitlines()]
        except BlockingIOError:
            return []

    def kill(self) -> None:
        self.is_killed = True

    def end(self) -> None:
        os.close(self._says)

    def communicate(self, timeout: float | None = None) -> None:
        self.stdin.close()
        self.stdout.close()


class Waits:
    """No wait between attempts."""

    wait_ns = 0

    def next_ns(self) -> int:
        return 0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    Child.every = []
    one = Clock()
    monkeypatch.setattr(api_child, "time", one)
    monkeypatch.setattr(api_child.subprocess, "Popen", Child)
    monkeypatch.setattr(api_child, "start_children_as_ordinary", lambda: None)
    return one


def started() -> tuple[OrderProcess, Child]:
    process = OrderProcess("the.module", "API", CONFIG)
    process._waits = Waits()  # type: ignore[assignment]
    return process, Child.every[-1]


def test_a_process_is_alive_while_its_last_sign_is_less_than_a_second_old(clock: Clock) -> None:
    process, child = started()
    process.orders()
    assert not process.alive, "it does not listen yet"
    child.say(READY)
    process.orders()
    for after_s, alive in ((0.999, True), (0.001, False)):
        clock.now_s += after_s
        process.orders()
        assert process.alive is alive
    child.say({"motion_hz": 20.0})
    assert process.orders() == []
    assert (process.alive, process.motion_hz) == (True, 20.0)
    child.say({})
    process.orders()
    assert process.motion_hz == 20.0
    process.close()


@pytest.mark.parametrize(("is_ready", "limit_s"), [(True, 5.0), (False, 60.0)])
def test_what_is_silent_for_too_long_is_killed_once(
    clock: Clock, caplog: pytest.LogCaptureFixture, is_ready: bool, limit_s: float
) -> None:
    process, child = started()
    if is_ready:
        clock.now_s += 3.0
        child.say(READY)
        process.orders()
    clock.now_s += limit_s
    process.orders()
    process.kill_if_hung()
    assert not child.is_killed
    clock.now_s += 0.01
    process.kill_if_hung()
    assert not child.is_killed, "it was not listened to meanwhile"
    caplog.clear()
    process.orders()
    process.kill_if_hung()
    assert child.is_killed
    assert not process.alive
    process.kill_if_hung()
    ((hung,),) = ([vars(record)["fields"] for record in caplog.records],)
    assert hung == {"which": "API", "pid": 70, "silent_s": limit_s}
    process.close()


def test_one_that_ended_is_started_again_at_its_port_with_its_token(clock: Clock) -> None:
    process, first = started()
    child_config = first.heard()[0]["config"]
    assert (child_config["title"], child_config["port"], child_config["token_file"]) == ("here", 0, None)
    first.say(READY)
    assert process.wait_until_ready() == READY["ready"]
    first.say({"motion_hz": 50.0}, {"order": {"number": 4, "action": "estop", "arguments": {"a": 1}}})
    first.end()
    clock.now_s += 1.0
    assert process.orders() == [Order(4, Action.ESTOP, {"a": 1})]
    assert (process.restarts, process.motion_hz) == (0, 50.0)
    assert process.orders() == []  # the end comes after all that was sent
    assert process._starter is not None
    process._starter.join()
    assert (process.restarts, process.motion_hz, process.alive, process.pid) == (1, 0.0, False, 71)
    second = Child.every[1]
    assert second.words == first.words
    (again,) = second.heard()
    assert (again["config"]["port"], again["config"]["token_file"]) == (8123, "its/token")
    second.say({"order": {"number": 5, "action": "arm", "arguments": {}}}, READY)
    assert process.orders() == [Order(5, Action("arm"), {})]
    assert process.alive
    second.end()
    process.orders()
    assert process._starter is not None
    process._starter.join()
    assert process.restarts == 2
    process.close()
    process.close()


@pytest.mark.parametrize(("life_s", "is_forgotten"), [(60.0, False), (60.01, True)])
def test_the_waits_between_attempts_are_short_again_after_a_long_life(
    clock: Clock, life_s: float, is_forgotten: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    longest: list[int] = []

    def waits(longest_ns: int) -> Waits:
        longest.append(longest_ns)
        return Waits()

    process, child = started()
    monkeypatch.setattr(api_child, "BackOff", waits)
    child.end()
    clock.now_s += life_s
    process.orders()
    assert process._starter is not None
    process._starter.join()
    assert longest == ([5_000_000_000] if is_forgotten else [])
    process.close()


def test_only_what_listens_is_told_and_a_full_pipe_holds_back_all_but_answers(clock: Clock) -> None:
    process, child = started()
    child.heard()
    process.send(Answer(1))
    assert child.heard() == []
    child.say(READY)
    process.orders()
    motion = Motion(time_unix_s=1.0)
    process.send(motion)
    assert [list(record) for record in child.heard()] == [["motion"]]
    process._writer.flush = lambda: False  # type: ignore[method-assign]
    process.send(motion)
    assert process._writer._kept_back == b""
    process.send(Answer(7, "no"))
    assert json.loads(process._writer._kept_back)["answer"] == {"number": 7, "refused": "no", "result": {}}
    process.close()


def test_a_process_that_refuses_to_begin_is_bad_input(clock: Clock) -> None:
    process, child = started()
    child.say({"refused": "the port is taken"})
    with pytest.raises(BadInputError, match=r"^the port is taken$"):
        process.wait_until_ready()
    process.close()
