"""What happens to frames on the way: latency, and each kind of fault in its window, with its share, order and count.

FAULTS.md says what each kind does; both ends of the links are real.
"""

import itertools
import math
from collections import Counter
from collections.abc import Sequence

import pytest

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import LinkError
from hil.faults.kinds import link_faults
from hil.faults.link_faults import LinkFault
from hil.faults.rows import FaultRow, ScenarioTime
from hil.wire.conditions import ConditionedLink
from hil.wire.streams import memory_bus
from tests.suite import link_bench as bench
from tests.suite.link_bench import BEAT, MS, STEP, STEP_DONE, Clock, command, heard

BEGIN_MS = 40  # when the scenario's time begins on the clock
FROM_MS, TO_MS, END_MS = 100, 200, 260  # the window of a fault, and the end, in the scenario's time


def number_of(frame: Frame) -> int:
    message = m.WheelCommand.decode(frame.payload)
    assert message is not None
    return message.sequence | message.session << 8


def row(kind: str, target: str = "command", value: float = 1.0, burst: float = 0.0, **window: int) -> FaultRow:
    return bench.row(kind, target, value, **{"from_ms": FROM_MS, "to_ms": TO_MS} | window, burst_frames=burst)


class Line:
    """A link with faults, the bus's other end, and the clock of both."""

    def __init__(self, *rows: FaultRow, command_ms: int = 0, feedback_ms: int = 0, seed: int = 1) -> None:
        self.clock = Clock()
        self.time = ScenarioTime(self.clock)
        self.here, self.there = memory_bus()
        self.here.now_ns = self.there.now_ns = self.clock.now_ns
        self.faults: list[LinkFault] = link_faults(rows, seed)
        self.link = ConditionedLink(
            self.here,
            self.clock,
            command_latency_ns=command_ms * MS,
            feedback_latency_ns=feedback_ms * MS,
            faults=self.faults,
            scenario_time=self.time,
        )

    def at(self, ms: float) -> None:
        """Go to this time of the scenario."""
        self.clock.now = round((BEGIN_MS + ms) * MS)
        if ms >= 0 and self.time.now_ns() is None:
            self.time.begin(BEGIN_MS * MS)

    def run(self, direction: str = "command", end_ms: int = END_MS) -> list[tuple[int, int]]:
        """Send a frame each millisecond, number n at n ms; return when each came, until nothing is on the way."""
        sender, end = (self.link, self.there) if direction == "command" else (self.there, self.link)
        out = []
        for ms in range(2 * end_ms):
            self.at(ms)
            self.link.service()
            if ms < end_ms:
                sender.send(command(ms))
            out += [(ms, number_of(frame)) for frame in heard(end)]
        return out


BOTH = pytest.mark.parametrize("direction", ["command", "feedback"])
ALL = list(range(END_MS))
BEFORE, IN, AFTER = list(range(FROM_MS)), list(range(FROM_MS, TO_MS)), list(range(TO_MS, END_MS))


def late(numbers: Sequence[int], by_ms: int) -> list[tuple[int, int]]:
    return [(number + by_ms, number) for number in numbers]


@BOTH
@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("drop", late([*BEFORE, *AFTER], 0)),
        ("duplicate", sorted(late([*BEFORE, *IN, *IN, *AFTER], 0))),
        ("freeze", [*late(BEFORE, 0), *((ms, FROM_MS - 1) for ms in IN), *late(AFTER, 0)]),
        ("reorder", [*late(BEFORE, 0), *((odd, odd - i) for odd in IN[1::2] for i in (0, 1)), *late(AFTER, 0)]),
    ],
)
def test_a_fault_acts_in_its_window_alone_and_counts_what_it_hits(
    direction: str, kind: str, expected: list[tuple[int, int]]
) -> None:
    line = Line(row(kind, direction))
    assert line.run(direction) == expected
    assert line.faults[0].applied == (len(IN) // 2 if kind == "reorder" else len(IN))


@BOTH
@pytest.mark.parametrize(("seconds", "ms"), [(0.004, 4), (0.0042, 5)])
def test_a_delay_is_of_whole_milliseconds_and_nothing_overtakes(direction: str, seconds: float, ms: int) -> None:
    line = Line(row("delay", direction, seconds))
    behind = [(max(number, TO_MS - 1 + ms), number) for number in AFTER]
    assert line.run(direction) == [*late(BEFORE, 0), *late(IN, ms), *behind]
    assert line.faults[0].applied == len(IN)


@BOTH
def test_jitter_is_even_from_nothing_to_the_longest_and_keeps_the_order(direction: str) -> None:
    line = Line(row("jitter", direction, 0.0095, to_ms=1600))
    out = line.run(direction, 1500)
    assert [number for _, number in out] == list(range(1500))
    delays = [ms - number for ms, number in out if number >= FROM_MS]
    assert set(delays) <= set(range(1, 11))
    assert max(delays) == 10
    assert min(delays) < 6, "it is not always the longest"
    # Each frame draws evenly from 0 to 9.5 ms. A later one waits for those before it: the mean is that of the largest.
    expected = sum(1.0 - math.prod(min(max(t + back, 0) / 9.5, 1.0) for back in range(20)) for t in range(10))
    assert sum(delays) / len(delays) == pytest.approx(expected, abs=0.7)


@BOTH
@pytest.mark.parametrize("kind", ["drop", "duplicate"])
def test_a_share_of_the_frames_is_hit_in_no_pattern(direction: str, kind: str) -> None:
    line = Line(row(kind, direction, 0.3, from_ms=0, to_ms=2000))
    out = Counter(number for _, number in line.run(direction, 2000))
    hit = [out[number] != 1 for number in range(2000)]
    assert sum(hit) == line.faults[0].applied
    assert sum(hit) / 2000 == pytest.approx(0.3, abs=6 * math.sqrt(0.3 * 0.7 / 2000))
    both = sum(a and b for a, b in itertools.pairwise(hit)) / 2000
    assert both == pytest.approx(0.09, abs=6 * math.sqrt(0.09 * 0.91 / 2000))


@BOTH
@pytest.mark.parametrize(("share", "length"), [(0.3, 5.0), (0.5, 10.0), (0.2, 1.0)])
def test_bursts_have_their_share_and_length(direction: str, share: float, length: float) -> None:
    total = 2500
    line = Line(row("burst_loss", direction, share, length, from_ms=0, to_ms=total))
    came = {number for _, number in line.run(direction, total)}
    bursts = [len(list(run)) for lost, run in itertools.groupby(n not in came for n in range(total)) if lost]
    assert sum(bursts) == line.faults[0].applied
    # Standard errors of a chain of two states, times six.
    assert sum(bursts) / total == pytest.approx(share, abs=6 * math.sqrt(2 * length * share * (1 - share) / total))
    assert sum(bursts) / len(bursts) == pytest.approx(length, abs=6 * max(length - 1.0, 1e-9) / math.sqrt(len(bursts)))


def test_chance_is_of_the_seed_and_of_the_row_alone() -> None:
    one, other = row("drop", value=0.3), row("drop", "feedback", value=0.3)
    assert Line(one).run() == Line(one).run() == Line(other, one).run()
    assert Line(one).run() != Line(one, seed=2).run()
    twice = Line(one, one)
    assert len(twice.run()) < len(Line(one).run()), "equal rows draw apart"


def test_a_fault_of_one_message_spares_the_others_and_all_spare_lockstep() -> None:
    for target, kept in (("WHEEL_COMMAND", [BEAT, STEP]), ("command", [STEP]), ("feedback", [command(1), BEAT, STEP])):
        line = Line(row("drop", target))
        line.at(150)
        line.link.send_all([command(1), BEAT, STEP])
        assert heard(line.there) == kept
    line = Line(row("drop", "feedback"), row("mute", "TICK"))
    line.at(150)
    line.there.send(command(1))
    line.there.send(STEP_DONE)
    assert heard(line.link) == [STEP_DONE]


def test_nothing_happens_before_the_scenario_has_begun() -> None:
    line = Line(row("drop", from_ms=0), row("drop", "feedback", from_ms=0))
    for ms, kept in ((-1.0, 1), (0.0, 0)):
        line.at(ms)
        line.link.send(command(1))
        line.there.send(command(2))
        assert (len(heard(line.there)), len(heard(line.link))) == (kept, kept)


@BOTH
@pytest.mark.parametrize("latency_ms", [1, 7])
def test_latency_moves_frames_and_windows_by_its_time(direction: str, latency_ms: int) -> None:
    """A command passes the latency before the faults, feedback behind them; lockstep waits for nothing."""
    line = Line(row("drop", direction), command_ms=latency_ms, feedback_ms=latency_ms)
    before = -latency_ms if direction == "command" else 0
    lost = range(FROM_MS + before, TO_MS + before)
    assert line.run(direction) == late([number for number in ALL if number not in lost], latency_ms)
    line.link.send(STEP)
    line.there.send(STEP_DONE)
    assert (heard(line.there), heard(line.link)) == ([STEP], [STEP_DONE])


def test_feedback_is_stamped_when_it_was_due_and_all_can_be_sent_at_once() -> None:
    line = Line(command_ms=5, feedback_ms=3)
    line.at(10)
    line.there.send(command(1))
    line.link.send(command(2))
    assert line.link.receive(0) is None
    assert line.link.next_due_ns() == (BEGIN_MS + 15) * MS
    line.at(18)
    received = line.link.receive(0)
    assert received is not None
    assert received.stamp_ns == (BEGIN_MS + 13) * MS
    line.at(12)
    line.link.flush()
    assert heard(line.there) == [command(2)]
    assert line.link.next_due_ns() is None
    line.link.send(command(3))
    line.link.hand_over_until(line.clock, (BEGIN_MS + 17) * MS)
    assert line.clock.now == (BEGIN_MS + 12) * MS, "it is due then, and not before"
    line.link.hand_over_until(line.clock, (BEGIN_MS + 30) * MS)
    assert line.clock.now == (BEGIN_MS + 17) * MS
    assert heard(line.there) == [command(3)]


BEHIND = [("drop", 1.0, 20), ("duplicate", 1.0, 180), ("delay", 0.01, 100), ("reorder", 0.4, 100)]


@pytest.mark.parametrize(("kind", "value", "expected"), BEHIND)
def test_rows_act_one_after_the_other_on_overtaken_frames_too(kind: str, value: float, expected: int) -> None:
    behind = row(kind, value=value, from_ms=100 if kind == "reorder" else 120)
    line = Line(row("reorder", value=0.5), behind)
    out = [(ms, number) for ms, number in line.run() if FROM_MS <= number < TO_MS]
    assert len(out) == expected
    if kind == "delay":
        assert all(ms >= number + 10 for ms, number in out if number >= 120)
    assert all(fault.applied for fault in line.faults)


def test_what_was_overtaken_by_none_leaves_at_the_end_of_its_window() -> None:
    line = Line(row("reorder", to_ms=101), row("mute", "HOST_HEARTBEAT"))
    line.at(100)
    line.link.send(command(1))
    assert line.link.next_due_ns() == (BEGIN_MS + 101) * MS
    line.at(101)
    line.link.service()
    assert heard(line.there) == [command(1)]
    assert line.faults[0].applied == 0


def test_a_cut_link_is_lost_until_it_is_opened_again_and_forgets_what_waited() -> None:
    line = Line(row("disconnect", "link"), row("delay", value=0.03, from_ms=50), feedback_ms=8)
    line.at(90)
    line.link.send(command(1))
    line.at(110)
    with pytest.raises(LinkError, match="disconnect"):
        line.link.send(command(2))
    line.link.send(STEP)
    line.there.send(command(3))
    line.there.send(STEP_DONE)
    assert heard(line.link) == [STEP_DONE]
    line.at(140)
    line.link.service()
    assert (heard(line.there), heard(line.link)) == ([STEP], [])
    with pytest.raises(LinkError):
        line.link.reopen()
    line.at(210)
    with pytest.raises(LinkError, match="disconnect"):
        line.link.send(command(4))
    line.there.send(command(5))
    line.link.reopen()
    line.there.send(command(6))
    line.link.send(command(7))
    assert (heard(line.there), heard(line.link)) == ([command(7)], [])
    line.at(230)
    assert heard(line.link) == [command(6)]
    assert line.faults[0].applied == 3


def test_what_is_on_its_way_when_a_link_is_opened_again_never_comes() -> None:
    line = Line(command_ms=5, feedback_ms=8)
    line.at(10)
    line.link.send(command(1))
    line.there.send(command(2))
    assert heard(line.link) == []
    line.link.reopen()
    line.at(50)
    line.link.service()
    assert (heard(line.there), heard(line.link)) == ([], [])
    assert line.link.next_due_ns() is None
