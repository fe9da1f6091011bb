"""How old feedback is told to be, what became of a robot that left ACTIVE, and the robot's time now."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.generated import messages as m
from hil.core.errors import HilError, LinkError, RobotLatchedError, RobotStoppedError
from hil.core.types import Wheels
from hil.core.wheel_map import WheelMap
from hil.robot.robot_report import RobotReport
from hil.robot.snapshot import Feedback
from hil.runtime.freshness import Freshness
from hil.runtime.sampling import Timing

MS = 1_000_000
ZERO = Wheels(0.0, 0.0, 0.0, 0.0)
STATUS = m.Status(*([0] * len(m.Status._fields)))


class Robot:
    """A driver in real time with the feedback that the test gives it; it is its own clock."""

    is_lockstep = False
    poll_age_ns = 0

    def __init__(self) -> None:
        self.now = 0
        self.feedback: Feedback | None = None
        self.report = RobotReport(WheelMap())
        self.clock_sync = SimpleNamespace(offset_us=math.nan)
        self.freshness = Freshness(self, self, None, Timing(5 * MS, 0, 2 * MS, 50 * MS))  # type: ignore[arg-type]

    def now_ns(self) -> int:
        return self.now

    def poll(self) -> Feedback | None:
        return self.feedback

    def says(self, at_ms: int, *, now_ms: int | None = None, state: m.State = m.State.ACTIVE) -> "Robot":
        self.feedback = Feedback(at_ms * MS, state, 0, 0, (0, 0, 0, 0), ZERO, ZERO, (0.0, 0.0, 0.0), 0.0)
        self.now = (at_ms if now_ms is None else now_ms) * MS
        return self

    def looked(self, t_s: float = 1.5) -> "Robot":
        self.freshness.poll(t_s)
        return self

    def refusal(self, t_s: float = 1.5) -> HilError:
        with pytest.raises(HilError) as raised:
            self.looked(t_s)
        return raised.value


def test_a_robot_without_feedback_and_one_that_falls_silent() -> None:
    assert str(Robot().refusal()) == "the robot sends no feedback"
    robot = Robot().says(100).looked()
    robot.now = 150 * MS
    robot.looked()
    assert (robot.freshness.silent_ns, robot.freshness.is_silent(), robot.freshness.is_stale) == (50 * MS, False, False)
    robot.now += 1
    robot.looked()
    assert (robot.freshness.is_silent(), robot.freshness.is_stale) == (True, True)
    robot.now = 2000 * MS
    why = robot.refusal(1.2345)
    assert isinstance(why, LinkError)
    assert str(why) == "no feedback for 1900 ms at t = 1.234 s: the link or the robot was lost"


@pytest.mark.parametrize(
    ("state", "status", "kind", "why"),
    [
        (m.State.IDLE, {}, RobotStoppedError, "it was reset (it was powered on)"),
        (m.State.BOOT, None, RobotStoppedError, "it is BOOT because of a reason that it has not reported yet"),
        (
            m.State.IDLE,
            {"stop_reason": m.StopReason.COMMAND_TIMEOUT},
            RobotStoppedError,
            "it is IDLE because of COMMAND_TIMEOUT",
        ),
        (m.State.STOPPING, {}, RobotStoppedError, "it is STOPPING because of NONE"),
        (
            m.State.FAULT,
            {"stop_reason": m.StopReason.COMMAND_TIMEOUT, "fault": m.Fault.OVERSPEED, "fault_wheel": m.FaultWheel.FR},
            RobotLatchedError,
            "it is FAULT because of COMMAND_TIMEOUT (OVERSPEED of wheel fr)",
        ),
        (m.State.ESTOP, {}, RobotLatchedError, "it is ESTOP because of NONE"),
    ],
)  # fmt: skip
def test_a_robot_that_left_active_is_told_with_its_reason(
    state: m.State, status: dict[str, Any] | None, kind: type[HilError], why: str
) -> None:
    robot = Robot().says(100).looked()
    if status is not None:
        robot.report.feed(STATUS._replace(reset_cause=m.ResetCause.POWER_ON, **status))
    refusal = robot.says(105, state=state).refusal(2.0)
    assert type(refusal) is kind
    assert str(refusal) == f"the robot left ACTIVE at t = 2.000 s: {why}"


def test_the_robots_time_now_is_by_time_sync_if_that_is_of_its_present_clock() -> None:
    robot = Robot().says(100, now_ms=500).looked()
    robot.now = 510 * MS
    feedback = robot.looked().feedback
    assert feedback is not None
    by_feedback = (100 + 2 + 10) * MS
    assert robot.freshness.robot_now_ns(feedback) == by_feedback
    for offset_us, expected in (
        (-400_000.0, 110 * MS),
        (-398_000.0 + 49_999.5, by_feedback + 49_999_500),
        (-398_000.0 + 50_000.0, by_feedback),
        (-398_000.0 - 49_999.5, by_feedback - 49_999_500),
        (-398_000.0 - 50_000.0, by_feedback),
    ):
        robot.clock_sync.offset_us = offset_us
        assert robot.freshness.robot_now_ns(feedback) == expected


@pytest.mark.parametrize(
    ("robot_ms", "passed_ms", "was_reset"),
    [(200, 100, False), (221, 100, False), (223, 100, True), (178, 100, False), (177, 100, True), (99, 0, True),
     (1140, 1000, False), (1141, 1000, True), (1060, 1000, False), (1059, 1000, True)],
)  # fmt: skip
def test_a_robot_whose_clock_went_on_with_ours_was_not_reset(robot_ms: int, passed_ms: int, was_reset: bool) -> None:
    """Apart by at most four periods of 5 ms and a fiftieth of the time that has passed."""
    robot = Robot().says(100, now_ms=1000).looked()
    robot.says(robot_ms, now_ms=1000 + passed_ms)
    assert robot.freshness.restart() is was_reset
