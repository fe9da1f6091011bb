"""A robot that takes less speed than its scenario allows: nothing is commanded beyond it, and it is said, once."""

from typing import Any

import numpy as np
import pytest

from hil.addons.service.messages import Phase
from hil.core.types import WHEEL_NAMES
from hil.runtime.assembly import RunOptions, RunResult, run_scenario
from hil.scenario import load
from tests.support.pilot_bench import PilotBench

# The circle asks for up to 10 rad/s at its beginning; 5.5 are a fault here, and 0.8 of that is accepted.
SLOW = {"robot.speed_limit_rad_s": 5.0, "firmware.overspeed_rad_s": 5.5, "loop.rate_hz": 200, "expect": []}
TAKEN_RAD_S = 4.390625
SAYS = "the robot accepts wheel speeds of at most 4.391 rad/s, because 5.5 rad/s are a fault there"


def run(scenario: str, changes: dict[str, Any], said: list[str]) -> RunResult:
    return run_scenario(load(scenario, set=changes), RunOptions(keep_signals=True, warn=said.append))


@pytest.mark.proves("R-LIM-5")
def test_a_run_keeps_within_what_the_robot_takes_and_says_so_once():
    said: list[str] = []
    result = run("circle_speed", SLOW | {"loop.duration_s": 2.0}, said)
    assert result.failure is None
    asked = np.array([result.signals[f"wheel.{wheel}.speed_command_rad_s"] for wheel in WHEEL_NAMES])
    assert np.abs(asked).max() == pytest.approx(TAKEN_RAD_S)
    assert result.signals["guard.saturated"].any()
    assert [sentence.startswith(SAYS) for sentence in said].count(True) == 1


def test_a_robot_that_takes_more_says_nothing():
    said: list[str] = []
    run("circle_speed", {"loop.duration_s": 0.1, "expect": []}, said)
    assert not [sentence for sentence in said if "takes wheel speeds" in sentence]


def test_by_torque_no_speed_is_commanded_and_nothing_is_said():
    said: list[str] = []
    run("paper_circle", SLOW | {"loop.duration_s": 0.1}, said)
    assert not [sentence for sentence in said if "takes wheel speeds" in sentence]


@pytest.mark.proves("R-LIM-5")
def test_a_service_keeps_within_what_the_robot_takes_and_says_so_once():
    with PilotBench("circle_speed", **SLOW) as bench:
        bench.run_until(Phase.DISARMED)
        for _ in range(2):
            bench.pilot.arm()
            bench.run_until(Phase.ACTIVE)
            bench.pilot.disarm()
            bench.run_until(Phase.DISARMED)
        assert bench.pilot.parts.guard.speed_limit_rad_s == TAKEN_RAD_S
        assert [note.startswith(SAYS) for note in bench.notes].count(True) == 1
