"""The steps back to a lost robot, on a clock and with a driver that the test sets."""

from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.errors import HilError, LinkError, RobotStoppedError
from hil.runtime.loop import Warned
from hil.runtime.recovery import Recovery

MS = 1_000_000


class Robot:
    """A driver that notes what it is told, and answers as the test says; it is its own clock."""

    def __init__(self) -> None:
        self.now = 0
        self.calls: list[str] = []
        self.answers: dict[str, Any] = {}
        self.warned = 0

    def now_ns(self) -> int:
        return self.now

    def warn(self) -> None:
        self.warned += 1

    def why_not_active(self) -> str:
        return "it is tired"

    def __getattr__(self, name: str) -> Any:
        def call() -> Any:
            self.calls.append(name)
            answer = self.answers.get(name)
            if isinstance(answer, HilError):
                raise answer
            return answer

        return call

    def recovery(self, why: HilError, *, arm: bool = True) -> Recovery:
        return Recovery(self, self, why, 1.5, self.warn, arm=arm)  # type: ignore[arg-type]

    def advance(self, recovery: Recovery, at_ms: float) -> tuple[bool, list[str]]:
        """Take a step at this time; return whether it was the last, and what the driver was told."""
        self.now = round(at_ms * MS)
        self.calls.clear()
        return recovery.advance(), list(self.calls)


def test_a_lost_link_is_opened_after_waits_that_double_up_to_two_seconds() -> None:
    robot = Robot()
    recovery = robot.recovery(LinkError("cut"))
    assert (recovery.why, recovery.lost_s, robot.calls) == ("cut", 1.5, ["leave"])
    robot.answers["reopen"] = LinkError("still cut")
    at_ms = 0.0
    for wait_ms in (100, 200, 400, 800, 1600, 2000, 2000):
        assert robot.advance(recovery, at_ms + wait_ms - 0.001) == (False, [])
        at_ms += wait_ms
        assert robot.advance(recovery, at_ms) == (False, ["reopen", "leave"])
    assert (recovery.why, recovery.problem) == ("cut", "still cut")


@pytest.mark.parametrize(("arm", "last"), [(True, "armed"), (False, "poll")])
def test_a_robot_that_stopped_is_greeted_and_armed_and_warns_after_each(arm: bool, last: str) -> None:
    robot = Robot()
    recovery = robot.recovery(RobotStoppedError("gone"), arm=arm)
    assert robot.advance(recovery, 0.0) == (False, ["begin_again"])
    assert robot.advance(recovery, 5.0) == (False, ["greeted"])
    robot.answers["greeted"] = True
    assert robot.warned == 0
    assert robot.advance(recovery, 10.0) == (False, ["greeted"])
    assert robot.warned == 1
    assert robot.advance(recovery, 15.0) == (False, [last])
    robot.answers[last] = 0 if last == "poll" else True
    assert robot.advance(recovery, 20.0) == (True, [last])
    assert robot.warned == 2


@pytest.mark.parametrize(("arm", "last"), [(True, "armed"), (False, "poll")])
def test_a_robot_that_does_not_answer_or_arm_in_time_is_begun_anew_from_its_link(arm: bool, last: str) -> None:
    robot = Robot()
    recovery = robot.recovery(RobotStoppedError("gone"), arm=arm)
    robot.advance(recovery, 0.0)
    assert robot.advance(recovery, 2000.0) == (False, ["greeted"])
    assert robot.advance(recovery, 2000.001) == (False, ["greeted", "leave"])
    assert recovery.problem == "the robot did not answer within 2 s"
    assert robot.advance(recovery, 2100.0) == (False, [])
    assert robot.advance(recovery, 2100.001) == (False, ["reopen", "begin_again"])
    robot.answers["greeted"] = True
    assert robot.advance(recovery, 3000.0) == (False, ["greeted"])
    assert robot.advance(recovery, 7000.0) == (False, [last])
    assert robot.advance(recovery, 7000.001) == (False, [last, "leave"])
    assert recovery.problem == "it is tired"


def test_in_lockstep_a_lost_robot_is_begun_again_at_once() -> None:
    robot = Robot()
    recovery = robot.recovery(LinkError("cut"))
    robot.calls.clear()
    recovery.begin_now()
    assert robot.calls == ["begin_again"]
    assert robot.advance(recovery, 0.0) == (False, ["greeted"])


def test_a_warning_is_passed_on_once_and_again_when_it_is_new() -> None:
    robot, told = SimpleNamespace(warnings=["hot", "slow"]), list[str]()
    warned = Warned(robot, told.append, ["slow"])
    warned()
    warned()
    robot.warnings = ["slow"]
    warned()
    robot.warnings = ["slow", "hot"]
    warned()
    assert told == ["hot", "hot"]
