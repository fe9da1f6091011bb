"""Faults of frames, of a line's bytes and of a bus, each alone: windows, order, counts and chance."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.clock import LockstepClock
from hil.core.errors import LinkError
from hil.core.ports import Received
from hil.faults.kinds import link_faults
from hil.faults.link_faults import ErrorCounter
from hil.faults.rows import NEVER_NS, FaultRow, ScenarioTime
from hil.wire.byte_faults import BusFaults, FaultLine
from hil.wire.conditions import ConditionedLink
from tests.support.examples import share_of_examples
from tests.support.heard import everything
from tests.support.outside import outside_package

MS = 1_000_000
STEP = Frame(m.Step.ID, m.Step(0, 1).encode())
STEP_DONE = Frame(m.StepDone.ID, m.StepDone(1).encode())


class Wire:
    """The other end and the clock: keeps the sent data with their times, gives the data put into it."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, Frame]] = []
        self.to_give: list[Frame] = []
        self.written = b""
        self.to_read = b""
        self.now = 0
        self.reopened = self.closed = 0

    def now_ns(self) -> int:
        return self.now

    def send(self, frame: Frame) -> None:
        self.sent.append((self.now, frame))

    def receive(self, _timeout_ns: int) -> Received | None:
        return Received((self.to_give.pop(0),), self.now) if self.to_give else None

    def write(self, data: bytes) -> None:
        self.written += data

    def read(self, _timeout_ns: int) -> bytes:
        data, self.to_read = self.to_read, b""
        return data

    def rejected(self) -> dict[str, int]:
        return {}

    def reopen(self) -> None:
        self.to_give.clear()
        self.reopened += 1

    def close(self) -> None:
        self.closed += 1


def command(sequence: int) -> Frame:
    return Frame(m.WheelCommand.ID, m.WheelCommand(0, 0, 0, 0, sequence & 0xFF, 0).encode())


def row(kind: str, target: str = "command", start: int = 100 * MS, end: int = 200 * MS, value=1.0, burst=0.0):
    return FaultRow(kind, "link", target, start, end, value, burst)


def fault_link(*rows: FaultRow, seed: int = 1, begun: bool = True):
    wire = Wire()
    time = ScenarioTime(wire)
    if begun:
        time.begin(0)
    faults = link_faults(rows, seed)
    return wire, ConditionedLink(wire, wire, faults=faults, scenario_time=time), faults


def send_each_ms(wire: Wire, link: ConditionedLink, until_ms: int) -> list[tuple[int, int]]:
    """Send a command each millisecond; return when which sequence came out, in ms."""
    for n in range(until_ms):
        wire.now = n * MS
        link.service()
        link.send(command(n))
    while (due_ns := link.next_due_ns()) is not None:
        wire.now = due_ns
        link.service()
    return [(t // MS, m.WheelCommand.decode(frame.payload).sequence) for t, frame in wire.sent]


@pytest.mark.parametrize("kind", ["drop", "duplicate", "mute", "freeze", "delay", "jitter", "burst_loss"])
def test_nothing_happens_outside_the_window_nor_before_the_time_begins(kind) -> None:
    target = "WHEEL_COMMAND" if kind == "mute" else "command"
    rows = [row(kind, target, value=0.5, burst=5.0)]
    wire, link, _ = fault_link(*rows, begun=False)
    wire.now = 150 * MS
    link.send(command(1))
    assert wire.sent == [(150 * MS, command(1))]
    wire, link, faults = fault_link(*rows)
    out = send_each_ms(wire, link, 250)
    assert out[:100] == [(n, n) for n in range(100)]
    assert [number for _, number in out[-50:]] == list(range(200, 250))
    assert faults[0].applied > 0


@pytest.mark.parametrize(("kind", "copies"), [("drop", 0), ("duplicate", 2)])
def test_the_window_is_exact_at_both_edges(kind, copies) -> None:
    wire, link, faults = fault_link(row(kind))
    for wire.now in (0, 100 * MS - 1, 100 * MS, 200 * MS - 1, 200 * MS):
        link.send(command(0))
        link.send(STEP)
    times = [t for t, frame in wire.sent if frame.id == m.WheelCommand.ID]
    assert [times.count(t) for t in (0, 100 * MS - 1, 100 * MS, 200 * MS - 1, 200 * MS)] == [1, 1, copies, copies, 1]
    assert len(wire.sent) - len(times) == 5, "lockstep is spared"
    assert faults[0].applied == 2


def test_a_target_is_a_direction_or_one_message() -> None:
    for target, gone in (("feedback", False), ("WHEEL_COMMAND", True), ("ESTOP", False)):
        wire, link, faults = fault_link(row("drop", target))
        wire.now = 150 * MS
        link.send(command(1))
        assert (wire.sent == []) is gone
        assert faults[0].applied == gone


def test_feedback_is_hit_as_commands_are() -> None:
    wire, link, _ = fault_link(row("duplicate", "feedback"))
    wire.now = 150 * MS
    wire.to_give = [command(1), STEP_DONE, command(2)]
    heard = everything(link)
    assert heard == [command(1), command(1), STEP_DONE, command(2), command(2)]


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.06))
def test_delay_and_jitter_keep_the_order_and_lose_nothing(seed, value) -> None:
    wire, link, _ = fault_link(row("delay", value=value), row("jitter", value=value), seed=seed)
    out = send_each_ms(wire, link, 255)
    assert [number for _, number in out] == list(range(255))
    late = [t - number for t, number in out if 100 <= number < 200]
    longest = 2 * math.ceil(value * 1e3)
    assert min(late) >= math.ceil(value * 1e3)
    assert max(late) <= longest


def test_a_delay_is_exact() -> None:
    wire, link, faults = fault_link(row("delay", value=0.0042))
    out = send_each_ms(wire, link, 150)
    assert out == [(n if n < 100 else n + 5, n) for n in range(150)]
    assert faults[0].applied == 50


def test_reordering_swaps_neighbours_and_the_last_one_leaves_at_the_end() -> None:
    wire, link, faults = fault_link(row("reorder", end=105 * MS))
    out = send_each_ms(wire, link, 107)
    assert out[100:] == [(101, 101), (101, 100), (103, 103), (103, 102), (105, 104), (105, 105), (106, 106)]
    assert faults[0].applied == 2  # nobody overtook the one that the window's end let go


def test_in_lockstep_what_is_due_within_a_tick_is_sent_at_its_end() -> None:
    """A window may end between two ticks, and the clock shows whole ticks only."""
    wire, link, _ = fault_link(row("reorder", end=100_400_000))
    clock = LockstepClock()
    clock.step = lambda ticks: None
    wire.now = 100 * MS
    link.send(command(1))
    clock.wait_until(100 * MS)
    link.hand_over_until(clock, 101 * MS)
    clock.wait_until(101 * MS)
    wire.now = clock.now_ns()
    link.service()
    assert wire.sent == [(101 * MS, command(1))]


def test_a_frame_that_nobody_overtook_is_not_counted() -> None:
    wire, link, faults = fault_link(row("reorder", end=101 * MS))
    assert [number for _, number in send_each_ms(wire, link, 103)] == list(range(103))
    assert faults[0].applied == 0


@pytest.mark.parametrize("leaves", ["overtaken", "at the end of its window", "flushed"])
def test_what_was_reordered_meets_the_rows_behind_when_it_goes_on(leaves) -> None:
    wire, link, (_, mute) = fault_link(row("reorder", end=150 * MS), row("mute", "WHEEL_COMMAND", start=120 * MS))
    wire.now = 110 * MS
    link.send(command(1))
    wire.now = {"overtaken": 121 * MS, "at the end of its window": 150 * MS, "flushed": 140 * MS}[leaves]
    if leaves == "overtaken":
        link.send(Frame(m.Estop.ID, b""))
    elif leaves == "flushed":
        link.flush()
    else:
        link.service()
    assert [frame.id for _, frame in wire.sent] == ([m.Estop.ID] if leaves == "overtaken" else [])
    assert mute.applied == 1
    assert link.next_due_ns() is None


@pytest.mark.parametrize("kind", ["drop", "duplicate", "freeze", "delay", "reorder"])
@share_of_examples(0.1)
@given(st.integers(0, 2**32 - 1))
def test_every_kind_behind_a_reorder_acts_on_all_frames(kind, seed) -> None:
    behind = row(kind, start=90 * MS, end=NEVER_NS, value=0.01 if kind == "delay" else 1.0)
    wire, link, faults = fault_link(row("reorder", value=0.3), behind, seed=seed)
    out = send_each_ms(wire, link, 200)
    times = {number: t for t, number in out}
    match kind:
        case "drop":
            assert [number for _, number in out] == list(range(90))
        case "duplicate":
            assert sorted(number for _, number in out[90:]) == sorted([*range(90, 200)] * 2)
        case "freeze":
            assert [number for _, number in out[90:]] == [89] * 110
        case "delay":
            assert all(times[number] >= number + 10 for number in range(90, 200))
        case "reorder":
            assert sorted(times) == list(range(200)), "none is lost"
    assert faults[1].applied > 0


def test_freezing_repeats_what_was_newest_before() -> None:
    wire, link, faults = fault_link(row("freeze"))
    out = send_each_ms(wire, link, 250)
    assert [number for _, number in out] == [*range(100), *[99] * 100, *range(200, 250)]
    assert faults[0].applied == 100


@given(st.integers(0, 2**32 - 1), st.sampled_from([(0.1, 2.0), (0.3, 5.0), (0.5, 10.0)]))
def test_bursts_have_the_share_and_the_length_that_they_are_given(seed, case) -> None:
    share, length = case
    wire, link, faults = fault_link(row("burst_loss", start=0, end=NEVER_NS, value=share, burst=length), seed=seed)
    total = 4_000
    for n in range(total):
        wire.now = n
        link.send(command(0))
    came = {t for t, _ in wire.sent}
    bursts = [len(list(run)) for lost, run in itertools.groupby(t not in came for t in range(total)) if lost]
    assert sum(bursts) == faults[0].applied
    # Standard errors of a two-state chain of so many steps, times six.
    assert sum(bursts) / total == pytest.approx(share, abs=6 * math.sqrt(2 * length * share * (1 - share) / total))
    assert sum(bursts) / len(bursts) == pytest.approx(length, abs=6 * length / math.sqrt(len(bursts)))


EVERY_OTHER = """
    from hil.faults.kinds import Kind

    def every_other(row, chance):
        count = 0
        def effect(direction, frames):
            nonlocal count
            count += 1
            return [] if count % 2 else frames
        return effect

    KIND = Kind("every_other", "link", ("command", "feedback"), "a direction", "Every other frame is lost.",
                "frames lost", {"target": "command"}, on_frames=every_other)
"""


def test_another_package_s_kind_acts_on_frames(tmp_path, monkeypatch) -> None:
    outside_package(tmp_path, monkeypatch, EVERY_OTHER, {"hil.faults": {"every_other": "outside_package:KIND"}})
    wire, link, faults = fault_link(row("every_other"))
    out = send_each_ms(wire, link, 250)
    assert [number for _, number in out] == [*range(100), *range(101, 200, 2), *range(200, 250)]
    assert faults[0].applied == 50


@given(st.integers(0, 2**32 - 1))
def test_chance_repeats_and_a_row_does_not_change_another(seed) -> None:
    def out(*rows: FaultRow) -> list[tuple[int, int]]:
        wire, link, _ = fault_link(*rows, seed=seed)
        return send_each_ms(wire, link, 200)

    one, other = row("drop", value=0.3), row("jitter", "feedback", value=0.01)
    assert out(one) == out(one) == out(other, one)


def test_a_disconnected_link_is_lost_until_it_is_opened_again() -> None:
    wire, link, faults = fault_link(row("disconnect", "link"))
    wire.now = 150 * MS
    with pytest.raises(LinkError, match="disconnect"):
        link.send(command(1))
    link.send(STEP)
    wire.to_give = [command(1), STEP_DONE]
    assert everything(link) == [STEP_DONE]
    with pytest.raises(LinkError, match="disconnect"):
        link.reopen()
    wire.now = 200 * MS
    with pytest.raises(LinkError, match="disconnect"):
        link.send(command(2))
    link.reopen()
    link.send(command(3))
    assert [frame for _, frame in wire.sent] == [STEP, command(3)]
    assert faults[0].applied == 3


def line(*rows: FaultRow, seed: int = 1):
    wire = Wire()
    time = ScenarioTime(wire)
    time.begin(0)
    faults = link_faults(rows, seed)
    return wire, FaultLine(wire, time, faults), faults


@pytest.mark.proves("R-STEP-9")
@given(st.integers(0, 2**32 - 1), st.sampled_from(["bit_errors", "truncation", "babble"]), st.floats(0.001, 0.2))
def test_spoilt_bytes_never_make_a_wrong_frame_and_never_touch_lockstep(seed, kind, value) -> None:
    babbles = kind == "babble"
    wire, faulty, faults = line(row(kind, start=0, value=value * 5e3 if babbles else value), seed=seed)
    framer, deframer = Framer(), Deframer()
    for n in range(200):
        wire.now = n * MS
        faulty.write(framer.encode(command(n)))
        faulty.write(framer.encode(STEP))
    frames = deframer.feed(wire.written)
    assert frames.count(STEP) == 200
    commands = [frame for frame in frames if frame.id == m.WheelCommand.ID]
    assert len(commands) + 200 == len(frames)
    numbers = [m.WheelCommand.decode(frame.payload).sequence for frame in commands]
    assert numbers == sorted(set(numbers))
    assert commands == [command(n) for n in numbers]
    assert sum(deframer.rejected.values()) > 0 or faults[0].applied < 2
    assert len(commands) >= 200 - 2 * faults[0].applied


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 40), min_size=1, max_size=40))
def test_what_is_read_does_not_depend_on_how_the_bytes_come_in(seed, sizes) -> None:
    framer = Framer()
    data = b"".join(framer.encode(command(n)) for n in range(30))

    def read(sizes: list[int]) -> bytes:
        wire, faulty, _ = line(row("bit_errors", "feedback", start=0, value=0.01), seed=seed)
        left, heard, lengths = data, b"", itertools.cycle(sizes)
        while left:
            size = next(lengths)
            wire.to_read, left = left[:size], left[size:]
            heard += faulty.read(0)
        return heard

    assert read(sizes) == read([len(data)])


def test_the_beginning_of_a_frame_is_gone_with_the_line_that_was_lost() -> None:
    wire, faulty, _ = line(row("bit_errors", "feedback", start=MS, value=0.01))
    data = Framer().encode(command(0))
    wire.to_read = data[:5]
    assert faulty.read(0) == b""
    faulty.reopen()
    wire.to_read = data
    assert faulty.read(0) == data


def test_the_bit_error_rate_is_what_it_says() -> None:
    wire, faulty, faults = line(row("bit_errors", start=0, value=0.01))
    framer = Framer()
    sent = b"".join(framer.encode(command(n)) for n in range(2000))
    faulty.write(sent)
    wrong = sum((a ^ b).bit_count() for a, b in zip(sent, wire.written, strict=True))
    bits = 8 * len(sent)
    assert wrong == pytest.approx(0.01 * bits, abs=6 * math.sqrt(0.01 * bits))
    assert 0 < faults[0].applied < 2000


def bus(*rows: FaultRow):
    wire, babbler = Wire(), Wire()
    time = ScenarioTime(wire)
    time.begin(0)
    faults = link_faults(rows, 1)
    link = ConditionedLink(wire, wire, bus=BusFaults(faults, babbler), scenario_time=time)
    return wire, link, faults, babbler


def test_on_can_a_destroyed_frame_is_sent_again_until_it_is_whole() -> None:
    wire, link, faults, _ = bus(row("bit_errors", start=0, value=0.0008))
    for n in range(1000):
        link.send(command(n))
    assert [frame for _, frame in wire.sent] == [command(n) for n in range(1000)]
    spoilt = 1.0 - 0.9992 ** (47 + 64)
    assert faults[0].applied == link.rejected()["error_bit"]
    assert faults[0].applied == pytest.approx(1000 * spoilt / (1 - spoilt), rel=0.4)


def test_on_can_a_bus_that_destroys_all_is_off_after_32_frames() -> None:
    wire, link, faults, _ = bus(row("bit_errors", start=0, value=0.5))
    with pytest.raises(LinkError, match="is bus-off: the fault bit_errors destroyed too many frames in a row"):
        link.send(command(1))
    assert faults[0].applied == 32
    assert wire.sent == []


def test_on_can_a_frame_that_is_cut_has_a_wrong_length() -> None:
    wire, link, faults, _ = bus(row("truncation", start=0), row("truncation", "feedback", start=0))
    link.send(command(1))
    link.send(STEP)
    assert [len(frame.payload) < 8 for _, frame in wire.sent[:1]] == [True]
    assert wire.sent[1][1] == STEP
    wire.to_give = [command(1), STEP_DONE]
    assert everything(link) == [STEP_DONE]
    assert link.rejected()["length"] == 1
    assert [fault.applied for fault in faults] == [1, 1]


def test_a_babbler_that_nobody_let_speak_in_its_window_is_silent_behind_it() -> None:
    wire, link, faults, babbler = bus(row("babble", value=500.0))
    wire.now = 110 * MS
    link.send(command(1))
    wire.now = 200 * MS
    link.send(command(2))
    assert faults[0].applied == len(babbler.sent) == 5


def test_a_bus_that_is_opened_anew_or_closed_is_so_for_its_babbler() -> None:
    wire, link, _, babbler = bus(row("babble", value=500.0))
    link.reopen()
    assert wire.reopened == babbler.reopened == 1
    assert wire.closed == babbler.closed == 0
    link.close()
    assert wire.closed == babbler.closed == 1


def test_a_controller_is_bus_off_at_256_counts_and_begins_at_0_again() -> None:
    """A destroyed frame counts 8 and a whole one takes 1 off, but not below 0 (ISO 11898-1)."""
    counter = ErrorCounter()
    counter.succeeded()
    assert [counter.failed() for _ in range(64)] == ([False] * 31 + [True]) * 2
    assert [counter.failed() for _ in range(31)] == [False] * 31
    for _ in range(8):
        counter.succeeded()
    assert [counter.failed(), counter.failed()] == [False, True]
    for _ in range(31):
        counter.failed()
    for _ in range(9):
        counter.succeeded()
    assert [counter.failed() for _ in range(3)] == [False, False, True]
    assert counter.destroyed == 64 + 31 + 2 + 31 + 3


def test_on_can_a_babbling_node_keeps_its_rate_with_foreign_ids() -> None:
    wire, link, faults, babbler = bus(row("babble", value=500.0))
    for n in range(300):
        wire.now = n * MS
        link.send(command(n))
    assert faults[0].applied == len(babbler.sent) == 49  # the last one would be due when the window is over
    assert all(frame.id not in m.LENGTHS for _, frame in babbler.sent)
    assert len(wire.sent) == 300
