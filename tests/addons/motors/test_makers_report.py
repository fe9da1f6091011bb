"""What is reported of motors behind a wiring where no wheel, sign or axis is at its own place; and why they stopped."""

import math
from typing import Any

import pytest

from firmware_protocol.generated.messages import State
from hil.addons.motors.makers_feedback import MakersReport
from hil.core.types import Wheels
from hil.core.wheel_map import ImuMount, WheelMap
from hil.robot.driver import Sample
from hil.robot.robot_report import Health

S, MS = 1_000_000_000, 1_000_000


class Heard:
    """A driver of which only the newest sample is asked for."""

    missing = ""

    def __init__(self, sample: Sample | None = None) -> None:
        self.sample = sample


def report_of(driver: Any) -> MakersReport:
    wiring = WheelMap(("rl", "fl", "fr", "rr"), ("fl", "rr"))
    return MakersReport(driver, wiring, ImuMount(("-y", "x", "z")), 1000, 0.1)


def test_each_value_is_of_its_wheel_in_its_sign_and_along_its_axis() -> None:
    """The channels turn RL, FL (reversed), FR and RR (reversed); the IMU's first axis points to the right."""
    driver = Heard()
    report = report_of(driver)
    report.renew(0, State.IDLE, 1)
    assert report.newest is None
    turn = math.tau
    first = Sample(5 * MS, (1.0, 2.0, 3.0, 4.0), (0.0,) * 4)
    driver.sample = first
    report.renew(6 * MS, State.ARMED, 2)
    driver.sample = Sample(
        15 * MS, (1.0, 2.0, 3.0, 4.0), (0.1 * turn, 0.2 * turn, 0.3 * turn, 0.4 * turn), (5.0, 6.0, 7.0, 8.0),
        (31.0, 32.0, 33.0, 34.0), 24.5, 3.25, (0.5, 0.25, 9.0), -0.75,
    )  # fmt: skip
    report.renew(16 * MS, State.ACTIVE, 7)
    assert report.newest is not None
    assert report.newest == (
        15 * MS, State.ACTIVE, 7, 255, (65536 - 200, 300, 65536 - 400, 100), (-2.0, 3.0, -4.0, 1.0),
        (-6.0, 7.0, -8.0, 5.0), (0.25, -0.5, 9.0), -0.75,
    )  # fmt: skip
    assert report.health == Health(24.5, 3.25, Wheels(32.0, 33.0, 34.0, 31.0))


def test_the_first_feedback_is_no_older_than_the_watchdog_and_later_ones_may_be() -> None:
    report = report_of(Heard(Sample(0, (0.0,) * 4)))
    assert report.is_fresh(100 * MS)
    assert not report.is_fresh(100 * MS + 1)
    report.renew(100 * MS + 1, State.IDLE, 0)
    assert report.newest is None
    report.renew(100 * MS, State.IDLE, 0)
    report.renew(S, State.ACTIVE, 9)
    assert report.newest is not None
    assert (report.newest.state, report.newest.command_sequence) == (State.ACTIVE, 9)
    report.restart()
    assert report.newest is None


def test_wheels_that_others_turn_are_told_after_half_a_second() -> None:
    report = report_of(Heard())
    turns = "the wheels turn, but this program has not armed them: an e-stop stops them"
    for t_ms, speeds, told in (
        (0, (0.0, 0.0, -0.5, 0.0), None),
        (500, (0.0, 0.0, -0.5, 0.0), None),
        (501, (0.0, 0.0, -0.5, 0.0), turns),
        (600, (0.4, 0.4, -0.4, 0.4), None),
        (700, (0.5, 0.0, 0.0, 0.0), None),
        (1201, (0.5, 0.0, 0.0, 0.0), turns),
    ):
        report.set_trouble(None, Sample(t_ms * MS, speeds))
        assert report.trouble == told, t_ms
    report.set_trouble("the queue is full", Sample(1300 * MS, (9.0,) * 4))
    assert report.trouble == "the stop could not be sent: the queue is full"
    report.set_trouble(None, None)
    assert report.trouble is None


@pytest.mark.parametrize(
    ("state", "missing", "words"),
    [
        (State.ESTOP, "", "an e-stop is latched; clear it when the robot may be armed again"),
        (State.FAULT, "", "the motor controllers reported heat; find the cause, then clear it with their maker's tool"),
        (State.ARMED, "no answer from 2", "no answer from 2 at 200000001"),
        (
            State.ARMED,
            "",
            "the motor controllers send no feedback of all four wheels that is younger than the 0.1 s of",
        ),
    ],
)
def test_why_they_cannot_be_driven(state: State, missing: str, words: str) -> None:
    driver = Heard(Sample(100 * MS, (0.0,) * 4))
    driver.missing = missing
    report = report_of(driver)
    assert not report.explains(State.FAULT)
    assert report.stop_reason() == "no error that it reports"
    report.why = "heat"
    assert report.explains(State.FAULT)
    assert report.stop_reason() == "this: heat"
    assert report.why_not_active(state, 200 * MS + 1, lambda what, now_ns: f"{what} at {now_ns}").startswith(words)
    late = report.why_not_active(State.ARMED, 200 * MS, lambda what, _: what)
    assert late.startswith("the motor controllers did not go into closed loop within 4 s")
