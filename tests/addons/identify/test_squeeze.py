"""The grip from a squeeze, against a balance of powers by plain sums: one wheel slides, and the rollers of all turn."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.addons.identify.drives import Drive
from hil.addons.identify.squeeze import grip_of
from hil.core.kinematics import wheel_speeds
from tests.support.formula_drives import PERIOD_S, ROBOT, formula_drive

CONSTANT, GRIP, BIAS_RAD_S = 1.3, 0.62, 0.01
GRAVITY_M_S2 = 9.81
PLACES = ((0.24, 0.17), (0.24, -0.17), (-0.24, -0.17), (-0.24, 0.17))  # of FL, FR, RR, RL [m]
ALONG = (-1.0, 1.0, -1.0, 1.0)  # a roller's axis is (1, this) / √2
VALUES = {
    "mass_kg": 14.5, "wheel_radius_m": 0.0615, "friction_coefficient": 0.03, "viscous_n_m_s_rad": 0.02,
    "roller_friction_coefficient": 0.015, "gyro_bias_rad_s": BIAS_RAD_S, "com_x_m": 0.0, "com_y_m": 0.0,
}  # fmt: skip


def loads_n(com_x_m: float, com_y_m: float) -> list[float]:
    """Return the loads by the balance of moments about both axes: half of each goes to either side."""
    weight = VALUES["mass_kg"] * GRAVITY_M_S2
    return [weight / 4.0 * (1.0 + com_x_m / x + com_y_m / y) for x, y in PLACES]


def squeezed(
    body: tuple[float, float, float], shares: dict[int, float], com: tuple[float, float], seconds: float = 2.0
) -> Drive:
    """Return a squeeze in which wheels slide for these shares of the time; the body moves forward, left and round."""
    radius = VALUES["wheel_radius_m"]
    speeds = list(wheel_speeds(body, radius, ROBOT.lever_m))
    loads, spent_w = loads_n(*com), 0.0
    for wheel, share in shares.items():
        speeds[wheel] += 0.8 * share * (1.0, 1.0, -1.0, -1.0)[wheel]
        spent_w += GRIP * share * loads[wheel] * radius * 0.8 / math.sqrt(2.0)
    for speed, load, (x, y), along in zip(speeds, loads, PLACES, ALONG, strict=True):
        ahead = body[0] - body[2] * y - radius * speed
        aside = body[1] + body[2] * x
        across = (aside - along * ahead) / math.sqrt(2.0)
        spent_w += VALUES["roller_friction_coefficient"] * load * across * math.tanh(across / 0.01)
        spent_w += VALUES["friction_coefficient"] * sum(loads) * radius / 4.0 * abs(speed)
        spent_w += VALUES["viscous_n_m_s_rad"] * speed**2
    time_s = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    first = spent_w / CONSTANT - 0.3 * speeds[1] + 0.2 * speeds[2]  # the others draw 0.3, -0.2 and 0 A
    currents = np.tile([first / speeds[0], 0.3, -0.2, 0.0], (len(time_s), 1))
    yaw_rate = np.full(len(time_s), body[2] + BIAS_RAD_S)
    # A stand before and after counts for nothing.
    angle = np.outer(np.clip(time_s, 0.5, seconds - 0.3), speeds)
    return formula_drive(angle, current_a=currents, yaw_rate_rad_s=yaw_rate, path=Path("squeeze.rrd"))


@pytest.mark.parametrize(
    ("com", "wheel"),
    [((-0.02, -0.03), 0), ((-0.02, 0.03), 1), ((0.02, 0.03), 2), ((0.02, -0.03), 3)],
    ids=["fl", "fr", "rr", "rl"],
)
def test_the_grip_is_what_the_motors_power_leaves_when_the_lightest_wheel_slides(
    com: tuple[float, float], wheel: int
) -> None:
    values = VALUES | {"com_x_m": com[0], "com_y_m": com[1]}
    found = grip_of(squeezed((0.013, -0.008, 0.06), {wheel: 1.0}, com), ROBOT, values, CONSTANT)
    assert found.grip == pytest.approx(GRIP, rel=1e-3)
    assert found.sentence == f"squeeze.rrd: the wheels slid at a grip of {found.grip:.3f}"


@pytest.mark.parametrize("shares", [{1: 0.3, 2: 0.7}, {1: 0.8, 2: 0.2}])
def test_wheels_that_slide_in_turns_share_the_time_as_the_gyro_says(shares: dict[int, float]) -> None:
    com = (0.004, 0.02)
    values = VALUES | {"com_x_m": com[0], "com_y_m": com[1]}
    found = grip_of(squeezed((0.004, -0.003, 0.04), shares, com), ROBOT, values, CONSTANT)
    assert found.grip == pytest.approx(GRIP, rel=1e-3)


def test_wheels_that_slide_for_less_than_a_second_tell_the_least_grip() -> None:
    com = (-0.02, -0.03)
    values = VALUES | {"com_x_m": com[0], "com_y_m": com[1]}
    short = squeezed((0.013, -0.008, 0.06), {0: 1.0}, com, 1.795)
    found = grip_of(short, ROBOT, values, CONSTANT)
    assert found.grip is None
    pushed = CONSTANT * float(np.abs(short.current_a).sum(axis=1).max()) / VALUES["wheel_radius_m"]
    held = VALUES["friction_coefficient"] * VALUES["mass_kg"] * GRAVITY_M_S2
    least = math.sqrt(2.0) * (pushed - held) / (4.0 * min(loads_n(*com)))
    assert found.sentence == (
        f"squeeze.rrd: the wheels slid for 0.995 s; expected 1 s. The grip is more than {least:.2f}, as far as the "
        "torque went; it was not found"
    )
    long = grip_of(squeezed((0.013, -0.008, 0.06), {0: 1.0}, com, 1.81), ROBOT, values, CONSTANT)
    assert long.grip == pytest.approx(GRIP, rel=0.01)


@pytest.mark.parametrize(("fastest_rad_s", "is_calm"), [(1.48, True), (1.53, False)])
def test_wheels_that_swing_are_no_squeeze(fastest_rad_s: float, is_calm: bool) -> None:
    drive = squeezed((0.0, 0.0, 0.0), {0: 1.0}, (0.0, 0.0))
    angle = drive.angle_rad.copy()
    angle[:60, 2] += fastest_rad_s * PERIOD_S * np.arange(60)
    angle[60:, 2] += angle[59, 2] - drive.angle_rad[59, 2]
    found = grip_of(replace(drive, angle_rad=angle), ROBOT, VALUES, CONSTANT)
    assert (found.grip is not None) is is_calm
    if not is_calm:
        assert found.sentence.startswith("squeeze.rrd: the wheels swung at up to 1.53 rad/s; expected at most 1.5. Low")


def test_wheels_without_ground_have_no_grip() -> None:
    drive = squeezed((0.0, 0.0, 0.0), {0: 1.0}, (0.0, 0.0))
    free = replace(drive, current_a=0.0 * drive.current_a + [0.01, 0.0, 0.0, 0.0])
    found = grip_of(free, ROBOT, VALUES | {"friction_coefficient": 0.0, "viscous_n_m_s_rad": 0.0}, CONSTANT)
    assert (found.grip, "squeeze.rrd: the wheels turned without grip; the robot was not on the floor") == tuple(found)


@pytest.mark.parametrize(("grip", "is_grip"), [(0.022, True), (0.018, False)])
def test_a_grip_of_two_percent_is_the_least(grip: float, is_grip: bool) -> None:
    drive = squeezed((0.0, 0.0, 0.0), {0: 1.0}, (0.0, 0.0))
    smooth = VALUES | {"friction_coefficient": 0.0, "viscous_n_m_s_rad": 0.0, "roller_friction_coefficient": 0.0}
    sliding_w = grip * VALUES["mass_kg"] * GRAVITY_M_S2 / 4.0 * VALUES["wheel_radius_m"] * 0.8 / math.sqrt(2.0)
    weak = replace(drive, current_a=0.0 * drive.current_a + [sliding_w / 0.8 / CONSTANT, 0.0, 0.0, 0.0])
    found = grip_of(weak, ROBOT, smooth, CONSTANT)
    assert (found.grip == pytest.approx(grip, rel=0.01)) if is_grip else found.grip is None


def test_a_wheel_bears_at_least_a_fifth_of_its_share() -> None:
    """However far out the centre of mass is believed to be."""
    short = squeezed((0.0, 0.0, 0.0), {0: 1.0}, (0.0, 0.0), 1.0)
    found = grip_of(short, ROBOT, VALUES | {"com_x_m": -0.2, "com_y_m": -0.1}, CONSTANT)
    pushed = CONSTANT * float(np.abs(short.current_a).sum(axis=1).max()) / VALUES["wheel_radius_m"]
    weight = VALUES["mass_kg"] * GRAVITY_M_S2
    least = math.sqrt(2.0) * (pushed - VALUES["friction_coefficient"] * weight) / (0.2 * weight)
    assert f"The grip is more than {least:.2f}, as" in found.sentence
