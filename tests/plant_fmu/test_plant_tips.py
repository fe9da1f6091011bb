"""A robot that tips: how near it is, by moments about its wheels; how it tips, by a pendulum; that it says so."""

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from hypothesis import given
from hypothesis import strategies as st

import hil
from tests.support.examples import share_of_examples
from tests.support.plant_oracle import G
from tests.support.plant_testbed import DEFAULTS, LOADS, MESSAGES, POSE, RIGID, SLIP, robot

M, R, L1, L2, J = (
    DEFAULTS[name] for name in ("mass_kg", "wheel_radius_m", "half_length_m", "half_width_m", "wheel_inertia_kg_m2")
)
STEEP = {"friction_coefficient": 2.0, "slope_rad": 0.5, "com_height_m": 0.8, "start_heading_rad": 0.3}


@pytest.mark.parametrize("torque", [2.0, -2.0])
@pytest.mark.parametrize("height", [0.1, 0.7])
def test_the_margin_is_that_of_the_moments_about_the_centre(torque: float, height: float) -> None:
    """Forward at a: the weight at cx against m a at its height, and against what turns the wheels; 1 in the middle."""
    start = {"com_x_m": 0.05, "com_height_m": height}
    a = 4 * torque / (R * (M + 4 * J / R**2))
    with robot(start) as plant:
        assert plant["tip_margin"] == pytest.approx(1 - 0.05 / L1)
        plant.torque([torque] * 4)
        plant.step(1e-3)
        moment = M * G * 0.05 - height * M * a - 4 * J * a / R
        assert plant["tip_margin"] == pytest.approx(1 - abs(moment) / (M * G * L1), rel=1e-6)
        assert (plant["tip_margin"] < 0) == (plant["tip_rad"] > 0)


@share_of_examples(0.1)
@given(
    torque=st.tuples(*[st.floats(-0.6, 0.6)] * 4),
    com=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.0, 0.3)),
    yaw_rate=st.floats(-1.0, 1.0),
)
def test_the_margin_is_where_the_loads_of_the_wheels_press(
    torque: tuple[float, ...], com: tuple[float, float, float], yaw_rate: float
) -> None:
    """On rollers that slip, whose loads are the plant's own: their middle, over the half distances of the wheels."""
    start = dict(zip(("com_x_m", "com_y_m", "com_height_m"), com, strict=True)) | {"start_yaw_rate_rad_s": yaw_rate}
    with robot(start, contact=SLIP, start_vx_m_s=0.5, slope_rad=0.1) as plant:
        plant.torque(torque)
        plant.step(1e-3, 60)
        loads, margins = np.zeros(4), []
        for _ in range(40):  # over what is left of the rollers' ringing
            plant.step(1e-3)
            loads += plant.read(LOADS)
            margins.append(plant["tip_margin"])
    x, y = (np.array(signs) @ loads / loads.sum() for signs in ((1, 1, -1, -1), (1, -1, -1, 1)))
    assert np.mean(margins) == pytest.approx(1 - max(abs(x), abs(y)), abs=0.02)


@pytest.mark.parametrize("contact", [RIGID, SLIP], ids=["rigid", "slip"])
def test_a_robot_that_stands_too_steep_tips_over_and_says_so(contact: int) -> None:
    """A pendulum on the lower wheels' line: l (1 - h tan(slope) cos / l) / h (cosh(k t) - 1), until h phi is l."""
    h, along = STEEP["com_height_m"], math.cos(STEEP["start_heading_rad"])
    beyond = h * math.tan(STEEP["slope_rad"]) * along - L1
    rate = math.sqrt(G * math.cos(STEEP["slope_rad"]) * h / (L1**2 + h**2))
    over_s = math.acosh(1 + L1 / beyond) / rate
    with robot(STEEP, contact=contact, grip_coefficient=5.0, roller_friction_coefficient=5.0) as plant:
        assert plant["tip_margin"] == pytest.approx(-beyond / L1, rel=1e-9)
        for share in (0.3, 0.6, 0.9):
            plant.step(1e-3, round(share * over_s * 1000) - round(plant.time_s * 1000))
            expected = beyond / h * (math.cosh(rate * plant.time_s) - 1)
            assert plant["tip_rad"] == pytest.approx(expected, rel=0.05 if contact == SLIP else 0.01)
        pose = plant.read(POSE)
        with pytest.raises(FMICallException):
            plant.step(1e-3, 1000)
        assert MESSAGES[-1].startswith("doStep: after ")
        assert MESSAGES[-1].endswith(
            " s the robot tips over: its centre of mass is beyond its wheels; look at com_height_m, com_x_m and "
            "com_y_m, the torques and pushes"
        )
        at_s = float(MESSAGES[-1].split()[2])
        assert at_s == pytest.approx(over_s, rel=0.05 if contact == SLIP else 0.01)
        assert plant.read(POSE) == pytest.approx(pose, abs=0.01)


def test_a_robot_that_lifts_two_wheels_for_a_moment_comes_back_and_goes_on() -> None:
    with robot(com_height_m=0.5) as plant:
        plant.torque([3.0] * 4)
        plant.step(1e-3, 40)
        lifted = plant["tip_rad"]
        assert plant["tip_margin"] < 0 < lifted
        plant.torque([0.0] * 4)
        plant.step(1e-3, 300)
        assert plant["tip_rad"] == 0.0
        assert plant["tip_margin"] == pytest.approx(1.0, abs=1e-9)


PUSHED = """
extends = "circle_speed"
[plant.start]
com_height_m = 1.2
[loop]
duration_s = 2.0
[[fault]]
kind = "push"
target = "force_y_n"
value = -75.0
start_s = 1.0
"""


def test_a_tall_robot_that_is_pushed_while_it_drives_ends_its_run_with_the_reason(tmp_path: Path) -> None:
    """Its control holds against the push at the ground, and the push acts at the height of the centre of mass."""
    path = tmp_path / "pushed.hil.toml"
    path.write_text(PUSHED, encoding="utf-8")
    run = hil.run(path, lenient=True)
    assert run.exit_code == 3
    assert "the robot tips over: its centre of mass is beyond its wheels" in str(run.failure)
    assert 1.05 < run.signals["loop.t_s"][-1] < 1.5
    path.write_text(PUSHED.replace("1.2", "0.1"), encoding="utf-8")
    assert hil.run(path, lenient=True).exit_code != 3
