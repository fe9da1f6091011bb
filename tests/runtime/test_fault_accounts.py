"""How often each fault of a run was applied: by its row in the scenario, whichever part applies it."""

import pytest

from hil.core.errors import BadInputError, DeviceError
from hil.core.signals import SIGNAL_NAMES
from hil.faults.rows import NEVER_NS, FaultRow
from hil.judge.expectations import Count
from hil.robot.link_times import PollAge, RoundTrip
from hil.runtime.fault_injection import RunFaults
from hil.runtime.sampling import Timing
from hil.runtime.unexplained import NotDriven

MS = 1_000_000
ROWS = (
    FaultRow("gyro_bias", "device", "gyro", 0, NEVER_NS, 0.5),
    FaultRow("bias", "signal", "pose.x_m", 0, NEVER_NS, 0.5),
    FaultRow("drop", "link", "feedback", 0, NEVER_NS, 1.0),
    FaultRow("push", "plant", "force_x_n", 0, NEVER_NS, 1.0),
    FaultRow("override", "signal", "pose.y_m", 0, NEVER_NS, 2.0),
)


class Clock:
    def now_ns(self) -> int:
        return 0

    def wait_until(self, t_ns: int) -> int:
        return 0


class Robot:
    """Takes faults, and says how often each was applied."""

    def __init__(self, counts: list[int]) -> None:
        self.counts = counts
        self.rows: list[FaultRow] = []
        self.began: list[int] = []

    def arm(self, rows: list[FaultRow]) -> None:
        self.rows = list(rows)

    def begin(self, tick: int) -> None:
        self.began.append(tick)

    def applied(self) -> list[int]:
        if not self.counts:
            raise DeviceError("it is gone")
        return self.counts


@pytest.mark.parametrize(
    ("counts", "expected"),
    [([7, 9], [7, 0, 0, 9, 0]), ([7], [None, 0, 0, None, 0]), ([], [None, 0, 0, None, 0])],
)
def test_each_row_has_the_count_of_the_part_that_applies_it(counts: list[int], expected: list[int | None]) -> None:
    faults, robot = RunFaults(ROWS, 1, Clock(), SIGNAL_NAMES), Robot(counts)
    faults.arm(robot)
    assert robot.rows == [ROWS[0], ROWS[3]]
    faults.begin(3 * MS, 17)
    assert (robot.began, faults.time.offset_ns, faults.time.now_ns()) == ([17], 3 * MS, -3 * MS)
    assert faults.applied() == expected
    for fault, count in zip(faults.of_frames, [5], strict=True):
        fault.applied = count
    assert faults.applied()[2] == 5


def test_faults_of_a_robot_that_nothing_reaches_into_are_refused_by_name() -> None:
    with pytest.raises(BadInputError, match=r"^fault gyro_bias gyro: it acts inside a virtual robot, and nothing"):
        RunFaults(ROWS, 1, Clock(), SIGNAL_NAMES).arm(None)
    faults = RunFaults(ROWS[1:3], 1, Clock(), SIGNAL_NAMES)
    faults.arm(None)
    faults.begin(0, 0)
    assert faults.applied() == [0, 0]


def test_the_age_of_what_was_polled_grows_until_a_poll_has_emptied_the_link() -> None:
    age = PollAge()
    told = []
    for now_ms, everything in ((100, False), (110, False), (125, True), (130, False), (145, True), (150, True)):
        age.record_poll(now_ms * MS, everything=everything)
        told.append(age.ns // MS)
    assert told == [0, 10, 25, 5, 20, 5]
    age.restart()
    age.record_poll(900 * MS, everything=True)
    assert age.ns == 0


def test_round_trips_are_told_in_milliseconds_with_their_number() -> None:
    trips = RoundTrip()
    assert trips.figures() is None
    trips.add([2 * MS, 4 * MS])
    trips.add([9 * MS])
    figures = trips.figures()
    assert figures is not None
    assert (figures["p50"], figures["count"]) == (pytest.approx(4.0), 3)
    assert 4.0 < figures["p99"] <= 9.0


@pytest.mark.parametrize(
    ("kind", "acts_on", "target", "value", "last_ms", "delay_ms"),
    [
        ("drop", "link", "feedback", 1.0, 1100, 0),
        ("delay", "link", "feedback", 0.02, 1100, 20),
        ("jitter", "link", "command", 0.007, 1100, 7),
        ("reset", "device", "robot", 0.0, 1000, 0),
    ],
)
def test_a_fault_explains_what_it_can_have_affected_to_the_nanosecond(
    kind: str, acts_on: str, target: str, value: float, last_ms: int, delay_ms: int
) -> None:
    """From a feedback latency before it, to both latencies, the age of stale feedback and two periods behind it."""
    row = FaultRow(kind, acts_on, target, 1000 * MS, 1100 * MS, value)
    first, last = (1000 - 2) * MS, (last_ms + 3 + 2 + 25 + 2 * 5 + delay_ms) * MS
    for t_ns, is_explained in ((first - 1, False), (first, True), (last, True), (last + 1, False)):
        counted = NotDriven([row], Timing(5 * MS, 3 * MS, 2 * MS, 25 * MS))
        counted.hold(t_ns, is_stale=True)
        assert counted.is_explained is is_explained
    elsewhere = NotDriven([FaultRow("push", "plant", "force_x_n", 0, NEVER_NS, 1.0)], Timing(MS, 0, 0, 25 * MS))
    elsewhere.hold(500 * MS, is_stale=True)
    assert not elsewhere.is_explained, "a push cuts nothing off"


def test_stale_and_held_ticks_are_counted_apart_and_explained_by_the_streak() -> None:
    row = FaultRow("drop", "link", "feedback", 1000 * MS, 1100 * MS, 1.0)
    counted = NotDriven([row], Timing(5 * MS, 3 * MS, 2 * MS, 25 * MS))
    streaks = ([(500, True)], [(1050, True), (1055, False), (1500, True)], [(2000, False), (2005, True)])
    explained = []
    for streak in streaks:
        for t_ms, is_stale in streak:
            counted.hold(t_ms * MS, is_stale=is_stale)
            explained.append(counted.is_explained)
        counted.drive()
        assert not counted.is_explained
    assert explained == [False, True, True, True, False, False]
    assert counted.counts(100) == {"stale_ticks": Count(4, 2), "held_ticks": Count(2, 1)}
    assert counted.counts(6) == {"stale_ticks": Count(4, 4), "held_ticks": Count(2, 2)}, "the law was never tried"
