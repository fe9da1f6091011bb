"""The margin of our firmware's speed loop: against SciPy, and against a robot without friction that limit-cycles."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.cli.check import LEAST_MARGIN_RAD, yaw_margin
from hil.core.types import WHEEL_NAMES
from hil.scenario import load
from tests.examples import share_of_examples
from tests.processes import hil as typed

CIRCLE = load("compare_circle", set={"controller.command": "speed"})


@share_of_examples(0.5)
@given(st.floats(0.2, 5.0), st.floats(0.0, 60.0), st.floats(20.0, 500.0), st.floats(0.2, 5.0))
def test_the_margin_is_that_of_the_open_loop(kp: float, ki: float, band: float, inertia: float) -> None:
    robot = replace(CIRCLE.robot, inertia_kg_m2=inertia)
    firmware = replace(CIRCLE.firmware, speed_kp_n_m_s_rad=kp, speed_ki_n_m_rad=ki, tracking_bandwidth_rad_s=band)
    wheel = (inertia + 4 * robot.wheel_inertia_kg_m2 * (0.6 / 0.075) ** 2) * (0.075 / 1.2) ** 2

    def loop(w: float) -> complex:
        s = 1j * w
        return (kp + ki / s) / (wheel * s) * (band / (s + band)) ** 2 * np.exp(-1.5e-3 * s)

    crossover = scipy.optimize.brentq(lambda w: abs(loop(w)) - 1.0, 1e-3, 1e5)
    found = yaw_margin(robot, firmware)
    assert found.crossover_rad_s == pytest.approx(crossover, rel=1e-6)
    behind = math.remainder(found.phase_rad - (np.angle(loop(crossover)) + math.pi), math.tau)
    assert behind == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("ki", "is_cycling"), [(2.0, False), (60.0, True)])
def test_a_robot_without_friction_cycles_where_no_margin_is_left(ki: float, is_cycling: bool) -> None:
    margin = yaw_margin(CIRCLE.robot, replace(CIRCLE.firmware, speed_ki_n_m_rad=ki))
    assert (margin.phase_rad < LEAST_MARGIN_RAD) == is_cycling
    sets = {
        "controller.command": "speed",
        "controller.gains": {},
        "firmware.speed_ki_n_m_rad": ki,
        "plant.start.friction_coefficient": 0.0,
        "loop.duration_s": 5.0,
        "expect": [],
    }
    signals = hil.run("compare_circle", set=sets, lenient=True).signals
    late = signals["loop.t_s"] > 3.0
    current_a = np.array([signals[f"wheel.{wheel}.current_a"][late] for wheel in WHEEL_NAMES])
    assert (np.abs(np.diff(current_a)).mean() > 0.1) == is_cycling


def test_a_check_says_how_near_the_loop_is() -> None:
    good = typed("check", "circle_speed", "--set", "firmware.speed_ki_n_m_rad=12")
    assert "° of phase are left at 104 rad/s" in good.stdout
    assert "limit cycle" not in good.stdout
    bad = typed("check", "circle_speed", "--set", "firmware.speed_ki_n_m_rad=60")
    assert (bad.returncode, "lower firmware.speed_ki_n_m_rad = 60" in " ".join(bad.stdout.split())) == (0, True)
    other = typed("check", "circle_speed", "--set", "device.driver=odrive")
    assert "speed loop" not in other.stdout
