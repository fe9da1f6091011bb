"""The host's session in C, held against a twin of it in Python."""

import itertools
import math
from collections import deque
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.client import NO_TIME, Client
from firmware_protocol.extension import library
from firmware_protocol.framing import pack
from firmware_protocol.generated import messages as m
from tests.support.bare_node import core
from tests.support.client_rig import digest, new_client, sent, take
from tests.support.examples import share_of_examples
from tests.support.session_twin import SessionTwin, hello_pages

MS = 1_000_000
pages = list(hello_pages())
statuses = st.builds(
    m.Status,
    state=st.sampled_from(m.State),
    mode=st.just(m.Mode.SPEED),
    fault=st.just(m.Fault.NONE),
    fault_wheel=st.just(0),
    stop_reason=st.just(m.StopReason.NONE),
    reset_cause=st.just(m.ResetCause.POWER_ON),
    nonce=st.integers(1, 4),
    arm_refusal=st.sampled_from(m.ArmRefusal),
    limited=st.just(0),
)
nonces = st.integers(1, 4)
events = st.one_of(
    st.tuples(st.just("page"), st.integers(0, len(pages) - 1)),
    st.tuples(st.just("pages"), st.just(None)),
    st.tuples(st.just("state"), st.sampled_from(m.State)),
    st.tuples(st.just("status"), statuses),
    st.tuples(st.just("poll"), st.integers(0, 250)),
    *[st.tuples(st.just("arm"), st.booleans())] * 3,
    st.tuples(st.just("request"), st.sampled_from(m.Request)),
    st.tuples(st.sampled_from(["begin", "renew"]), nonces),
    st.tuples(st.sampled_from(["leave", "estop"]), st.just(None)),
)


@pytest.mark.proves("R-BEAT-1", "R-BEAT-2")
@share_of_examples(3.0)
@given(mode=st.sampled_from(m.Mode), history=st.lists(events, max_size=60))
def test_the_session_goes_as_its_twin_does(mode: m.Mode, history: list) -> None:
    client, twin = new_client(mode), SessionTwin(mode, 0x5A, 1)
    now_ns, number, hellos, seen = 0, 0, 0, set()
    _, lib = library()
    steps = {getattr(lib, f"WHEEL_ARMING_{name}"): name for name in ("DONE", "WAIT", "HOLD", "ASKED")}
    steps |= {getattr(lib, f"WHEEL_ARMING_{name}"): name for name in ("NEW_NONCE", "STRANGER", "REFUSED", "LATCHED")}
    for event, what in history:
        if event in ("page", "pages"):
            heard = pages if event == "pages" else [pages[what]]
            assert take(client, map(codec.encode, heard)) == [page.ID for page in heard]
            seen |= {page.ID for page in heard}
            twin.is_greeted = twin.is_greeted or len(seen) == len(pages)
        elif event == "state":
            number += 1
            tick = m.Tick(number * 1000, 0, 0, what, 1, number & 0xFF)
            assert take(client, map(codec.encode, (tick, m.Encoders(0, 0, 0, 0)))) == []
            twin.state = what
        elif event == "status":
            assert take(client, [codec.encode(what)]) == [m.Status.ID]
            twin.status = what
        elif event == "poll":
            now_ns += what * MS
            assert client.poll(now_ns) == bool(client.view.out_bytes)
            twin.poll(now_ns)
        elif event == "arm":
            at_ns = now_ns if what else -1
            assert steps[client.arm(at_ns if what else NO_TIME)] == twin.arm(at_ns)
        elif event == "request":
            client.request(what, now_ns)
            twin.send(what, now_ns)
        elif event in ("begin", "renew"):
            getattr(client, event)(what)
            getattr(twin, event)(what)
        else:
            getattr(client, event)()
            getattr(twin, event)()
        if event in ("begin", "leave"):
            seen = set()
        messages = sent(client)
        hellos += sum(isinstance(message, m.HelloRequest) for message in messages)
        assert [message for message in messages if not isinstance(message, m.HelloRequest)] == twin.out
        twin.out.clear()
        view = client.view
        assert (view.is_greeted, view.request, view.nonce) == (twin.is_greeted, twin.request, twin.nonce)
        assert hellos == twin.hellos


@pytest.mark.proves("R-ARM-4")
def test_every_row_of_the_table_of_arming_is_the_twins() -> None:
    _, lib = library()
    found = set()
    refusals = [None, *((refusal, nonce) for refusal in m.ArmRefusal for nonce in (1, 2))]
    for state, is_greeted, request, refused, in_status in itertools.product(
        [None, *m.State], (False, True), m.Request, refusals, (m.State.IDLE, m.State.FAULT, m.State.ESTOP)
    ):
        client, twin = new_client(), SessionTwin(m.Mode.SPEED, 0x5A, 1)
        if is_greeted:
            take(client, map(codec.encode, pages))
            twin.is_greeted = True
        if state is not None:
            take(client, map(codec.encode, (m.Tick(0, 0, 0, state, 1, 0), m.Encoders(0, 0, 0, 0))))
            twin.state = state
        if refused is not None:
            refusal, nonce = refused
            twin.status = m.Status(in_status, 0, 0, 0, 0, 0, nonce, refusal, 0)
            take(client, [codec.encode(twin.status)])
        client.request(request, 0)
        twin.send(request, 0)
        step = twin.arm(0)
        found.add(step)
        assert client.arm(0) == getattr(lib, f"WHEEL_ARMING_{step}")
        assert sent(client) == twin.out
    assert found == {"DONE", "WAIT", "HOLD", "ASKED", "NEW_NONCE", "STRANGER", "REFUSED", "LATCHED"}


@pytest.mark.proves("R-ARM-6")
def test_a_refusal_is_answered_by_one_new_nonce() -> None:
    """It is of the nonce before: what the robot says of the new one is waited for."""
    client, lib = new_client(), library()[1]
    idle = (m.Tick(0, 0, 0, m.State.IDLE, 1, 0), m.Encoders(0, 0, 0, 0))
    take(client, map(codec.encode, (*pages, *idle)))
    client.request(m.Request.ARM, 0)
    take(client, [codec.encode(m.Status(m.State.IDLE, 0, 0, 0, 0, 0, 7, m.ArmRefusal.SESSION_USED, 0))])
    assert client.arm(0) == lib.WHEEL_ARMING_NEW_NONCE
    client.renew(2)
    assert client.arm(0) == lib.WHEEL_ARMING_ASKED
    assert client.arm(0) == lib.WHEEL_ARMING_WAIT


@pytest.mark.proves("R-STOP-2")
def test_an_estop_is_sent_whatever_waits() -> None:
    client = full()
    with pytest.raises(ValueError, match="cannot be sent"):
        client.add(m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION]))
    client.estop()
    assert (client.view.sent, sent(client)) == (1, [m.Estop(1, 0)])
    client.request(m.Request.IDLE, 0)
    assert len(sent(client)) == 1


def test_a_request_and_a_step_that_the_protocol_lacks_change_nothing() -> None:
    client, lib = new_client(), library()[1]
    assert not lib.wheel_client_request(client.handle, 9, 0)
    with pytest.raises(ValueError, match="expected at most 1000"):
        client.step(1001)
    client.poll(10**12)
    assert (sent(client), client.view.request) == ([], m.Request.IDLE)


def test_a_request_without_a_time_is_sent_once() -> None:
    client = new_client()
    client.request(m.Request.IDLE, NO_TIME)
    assert len(sent(client)) == 1
    assert not client.poll(10**12)


@pytest.mark.proves("R-BEAT-1")
def test_hello_and_heartbeats_are_due_to_the_nanosecond() -> None:
    client, hello = new_client(), m.HelloRequest(m.PROTOCOL_VERSION)
    assert not client.poll(0), "nobody was asked for"
    for _ in range(2):
        client.begin(2)
        for now_ns, expected in ((0, [hello]), (200 * MS - 1, []), (200 * MS, [hello]), (401 * MS, [hello])):
            assert client.poll(now_ns) == bool(expected)
            assert (client.view.sent, sent(client)) == (0, expected), now_ns
    take(client, map(codec.encode, pages))
    assert not client.poll(1000 * MS)
    beat = m.HostHeartbeat(2, m.SCHEMA_HASH, m.Request.IDLE, m.Mode.SPEED, 0x5A)
    client.request(m.Request.IDLE, 0)
    sent(client)
    for now_ns, expected in ((100 * MS - 1, []), (100 * MS, [beat]), (250 * MS, [beat]), (350 * MS - 1, [])):
        assert client.poll(now_ns) == bool(expected)
        assert sent(client) == expected, now_ns


@pytest.mark.parametrize("absent", pages, ids=lambda page: type(page).__name__)
def test_a_robot_is_greeted_with_all_pages_and_again_after_it_was_left(absent: m.Message) -> None:
    client = new_client()
    for _ in range(2):
        take(client, [codec.encode(page) for page in pages if page is not absent])
        assert not client.view.is_greeted
        take(client, [codec.encode(absent)])
        assert client.view.is_greeted
        client.leave()
        assert not client.view.is_greeted


def fields(block: Any, message: m.Message) -> tuple[Any, ...]:
    return tuple(getattr(block, name) for name in message._fields)


def test_hello_and_status_are_kept_as_they_came() -> None:
    ffi, lib = core()
    client = ffi.new("wheel_client *")
    lib.wheel_client_init(client, m.Mode.SPEED, 0x5A, 1)
    status = m.Status(m.State.FAULT, 1, m.Fault.ENCODER_STUCK, 2, 5, 3, 4, 1, 6)
    kept = ("identity", "firmware", "parameters", "geometry", "limits")
    for order in (1, -1):
        packed, at = pack(map(codec.encode, [*pages, status][::order])), 0
        while at < len(packed):
            at = lib.wheel_client_take(client, packed, at, len(packed), 0)
        for name, page in zip(kept, pages, strict=False):
            assert fields(getattr(client.robot, name), page) == codec.decode(codec.encode(page))
        assert fields(client.status, status) == status


def test_a_client_begins_the_same_whatever_its_memory_held() -> None:
    ffi, lib = library()
    size = lib.wheel_client_size()
    expected = ffi.new("wheel_view *", {"yaw_rate_rad_s": math.nan, "nonce": 7})
    expected.speed_rad_s = expected.current_a = [math.nan] * 4
    expected.acceleration_m_s2 = [math.nan] * 3
    found = set()
    for held in (b"\0", b"\xa5"):
        memory = ffi.new("uint64_t[]", size // 8)
        ffi.memmove(memory, held * size, size)
        client = ffi.cast("wheel_client *", memory)
        lib.wheel_client_init(client, m.Mode.TORQUE, 0x5A, 7)
        assert bytes(ffi.buffer(lib.wheel_client_view(client))) == bytes(ffi.buffer(expected))
        found.add(bytes(ffi.buffer(memory)))
    assert len(found) == 1


def full() -> Client:
    """Return a client in which nothing more has room."""
    client, lib = new_client(), library()[1]
    while lib.wheel_client_add(client.handle, m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION]), 1):
        pass
    return client


def test_a_stop_takes_the_place_of_what_waits_and_another_request_has_to_wait() -> None:
    client, lib = full(), library()[1]
    assert not lib.wheel_client_request(client.handle, m.Request.ARM, 0)
    assert not lib.wheel_client_step(client.handle, 1)
    assert (client.view.request, client.view.step) == (m.Request.IDLE, lib.WHEEL_STEP_NONE)
    assert lib.wheel_client_request(client.handle, m.Request.IDLE, 0)
    assert sent(client) == [m.HostHeartbeat(1, m.SCHEMA_HASH, m.Request.IDLE, m.Mode.SPEED, 0x5A)]


def test_an_estop_is_sent_though_the_log_is_full() -> None:
    client, (ffi, lib) = new_client(), library()
    logs = [ffi.new("uint8_t[]", 14) for _ in range(2)]
    lib.wheel_client_log(client.handle, *logs, 14)
    assert lib.wheel_client_request(client.handle, m.Request.IDLE, 0)
    client.sent()
    assert not lib.wheel_client_request(client.handle, m.Request.ARM, 0)
    client.estop()
    assert sent(client) == [m.Estop(1, 0)]


def test_the_expected_parameters_may_be_known_late() -> None:
    client, lib = new_client(), library()[1]
    lib.wheel_client_expect(client.handle, 0xA5)
    client.request(m.Request.IDLE, 0)
    assert sent(client) == [m.HostHeartbeat(1, m.SCHEMA_HASH, m.Request.IDLE, m.Mode.SPEED, 0xA5)]


@pytest.mark.proves("R-HELLO-6")
@pytest.mark.parametrize(("version", "schema"), [(1, m.SCHEMA_HASH), (m.PROTOCOL_VERSION, 1)])
def test_a_robot_with_another_protocol_is_never_greeted(version: int, schema: int) -> None:
    client = new_client()
    take(client, map(codec.encode, hello_pages(version, schema)))
    assert not client.view.is_greeted
    take(client, map(codec.encode, hello_pages()))
    assert client.view.is_greeted


# Lockstep

NONE, AWAITED, DONE, ELSEWHERE = range(4)


def test_a_step_is_done_by_its_answer_alone_and_a_second_answer_is_not_logged() -> None:
    client = new_client()
    assert client.view.step == NONE
    client.step(0)
    take(client, [codec.encode(m.StepDone(40))])
    assert (client.view.step, client.view.tick) == (DONE, 40)
    client.step(5)
    client.step_again()
    assert sent(client) == [m.Step(0, 0), m.Step(40, 5), m.Step(40, 5)]
    take(client, [codec.encode(m.StepDone(40))])  # the step before, which was sent twice
    assert client.view.step == AWAITED
    take(client, [codec.encode(m.StepDone(45))] * 2)
    assert (client.view.step, client.view.tick) == (DONE, 45)
    assert (client.view.sent, client.view.received) == (2, 4)
    assert client.hexdigest() == digest([m.Step(0, 0), m.Step(40, 5)], [m.StepDone(40), m.StepDone(45)])


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 3)), max_size=12))
def test_steps_that_a_slow_robot_gets_several_times_change_nothing(steps: list[tuple[int, int]]) -> None:
    """It answers each, and what else it says comes before the first answer, also of a step of no ticks."""
    client, arriving, tick = new_client(), deque[codec.Message](), 0
    asked: list[codec.Message] = []
    told: list[codec.Message] = []
    for number, (ticks, repeats) in enumerate(steps):
        asked.append(m.Step(tick, ticks))
        tick += ticks
        told += [m.TimeSyncResponse(number, 0, 0), m.StepDone(tick)]
        arriving += [*told[-2:], *[m.StepDone(tick)] * repeats]
        client.step(ticks)
        for _ in range(repeats):
            client.step_again()
        assert sent(client) == [asked[-1]] * (1 + repeats)
        while client.view.step == AWAITED:
            take(client, [codec.encode(arriving.popleft())])
        assert (client.view.step, client.view.tick) == (DONE, tick)
    assert client.hexdigest() == digest(asked, told)


def test_a_second_answer_that_never_comes_is_waited_for_once() -> None:
    client = new_client()
    for ticks, tick, is_waited_for in ((1, 1, False), (0, 1, True), (1, 2, False), (0, 2, False)):
        client.step(ticks)
        if ticks and tick == 1:
            client.step_again()
        take(client, [codec.encode(m.StepDone(tick))])
        assert client.view.step == (AWAITED if is_waited_for else DONE)
        if is_waited_for:
            client.step_again()
            take(client, [codec.encode(m.StepDone(tick))])
        assert client.view.step == DONE


def test_an_answer_ends_a_step_or_is_that_of_the_step_before_or_tells_of_another_tick() -> None:
    for begin, ticks, answer in itertools.product((0, 40), range(4), range(46)):
        client = new_client()
        if begin:
            client.step(begin)
            take(client, [codec.encode(m.StepDone(begin))])
        client.step(ticks)
        expected = DONE if ticks == 0 or answer == begin + ticks else AWAITED if answer == begin else ELSEWHERE
        first, *others = (codec.encode(one) for one in (m.StepDone(answer), m.StepDone(answer), m.Encoders(1, 2, 3, 4)))
        packed = pack([first, *others])
        at = client.take(packed, 0, 0)
        assert at == (len(pack([first])) if expected == ELSEWHERE else len(packed)), "it stops behind each"
        view = client.view
        assert (view.step, view.step_done_tick, view.step_target) == (expected, answer, begin + ticks)
        assert view.tick == (answer if expected == DONE else begin)
        steps = [m.Step(0, begin), m.Step(begin, ticks)][not begin :]
        done = [m.StepDone(begin)] * bool(begin) + [m.StepDone(answer)] * (expected == DONE)
        assert client.hexdigest() == digest(steps, [*done, m.Encoders(1, 2, 3, 4)][: -1 if at < len(packed) else None])


def test_the_tick_of_a_robot_that_may_be_another_is_asked_for_as_the_first_time() -> None:
    client = new_client()
    client.step(5)
    take(client, [codec.encode(m.StepDone(5))])
    assert (client.view.tick, sent(client)) == (5, [m.Step(0, 5)])
    client.begin(2)
    assert client.view.step == NONE
    client.step(0)
    assert sent(client) == [m.Step(0, 0)]


def test_what_the_protocol_does_not_have_is_not_sent() -> None:
    client = new_client()
    for call, said in (
        (lambda: client.add(m.Step.ID, b"123"), "message 0x300 of 3 bytes cannot be sent"),
        (lambda: client.add(0x7FF, bytes(9)), "message 0x7ff of 9 bytes cannot be sent"),
        (lambda: client.step(1001), "STEP of 1001 ticks cannot be sent; expected at most 1000"),
    ):
        with pytest.raises(ValueError, match=f"^{said}$"):
            call()
    assert sent(client) == []
