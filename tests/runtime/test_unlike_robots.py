"""Runs of robots that differ from the belief: what wheels, gyro, battery and currents tell, by own equations."""

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.judge.result import RunResult

R, LEVER = 0.075, 0.6
SIGNS = np.array([[1, -1, -1], [1, 1, 1], [1, -1, 1], [1, 1, -1]], dtype=float)  # forward, left, turn
SAID = (SIGNS * [1, 1, LEVER]) / R
"""Wheel speeds for a body twist of the robot that odometry believes in."""


def run(folder: Path, text: str) -> RunResult:
    path = folder / "unlike.hil.toml"
    path.write_text(text, encoding="utf-8")
    return hil.run(path, lenient=True)


def columns(found: RunResult, *names: str) -> np.ndarray:
    return np.column_stack([found.signals[name] for name in names])


def poses(found: RunResult, of: str) -> np.ndarray:
    return columns(found, f"{of}.x_m", f"{of}.y_m", f"{of}.heading_rad")


def odometry(true: np.ndarray, wheels: np.ndarray, gyro_scale: float) -> np.ndarray:
    """Sum up what wheels of these rows and a gyro read on the way of a true pose, from its start."""
    dx, dy, turn = np.diff(np.column_stack([true[:, :2], np.unwrap(true[:, 2])]), axis=0).T
    middle = true[:-1, 2] + turn / 2
    forward, left = np.cos(middle) * dx + np.sin(middle) * dy, np.cos(middle) * dy - np.sin(middle) * dx
    rolled = np.column_stack([forward, left, turn]) @ wheels.T
    ahead, aside, _ = np.linalg.pinv(SAID) @ rolled.T
    heading = true[0, 2] + gyro_scale * (np.concatenate([[0.0], np.cumsum(turn)]))
    middle = heading[:-1] + gyro_scale * turn / 2
    x = true[0, 0] + np.cumsum(np.cos(middle) * ahead - np.sin(middle) * aside)
    y = true[0, 1] + np.cumsum(np.sin(middle) * ahead + np.cos(middle) * aside)
    return np.column_stack([x, y, heading[1:]])


@pytest.mark.parametrize(
    ("start", "radii", "loss", "scale"),
    [
        ("sideways_loss = 0.05", (1, 1, 1, 1), 0.05, 1.0),
        ('"wheel.fr.radius_factor" = 1.02', (1, 1.02, 1, 1), 0.0, 1.0),
        ('gyro_scale = 0.99\ncontact = "slip"\nsideways_loss = -0.05', (1, 1, 1, 1), -0.05, 0.99),
    ],
)
def test_odometry_errs_by_what_kinematics_says_of_the_true_way(
    tmp_path: Path, start: str, radii: tuple[float, ...], loss: float, scale: float
) -> None:
    text = (
        f'extends = "circle_speed"\n[loop]\nduration_s = 4\n[estimator]\nsource = "odometry"\n[plant.start]\n{start}\n'
    )
    found = run(tmp_path, text)
    true, believed = poses(found, "truth"), poses(found, "pose")
    wheels = SIGNS * [1, 1 / (1 - loss), 0.3 / (1 - loss) + 0.3] / (R * np.array(radii)[:, None])
    expected = odometry(true, wheels, scale)
    off_m = np.hypot(*(true[-1] - expected[-1])[:2])
    assert off_m > 0.008
    apart = believed[1:] - expected
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.15 * off_m
    assert np.abs(np.angle(np.exp(1j * apart[:, 2]))).max() < 2e-3


BATTERY = """
extends = "circle_slip"
[loop]
duration_s = 3
[plant.start]
battery_fall_v_c = 2.0
viscous_n_m_s_rad = 0.03
"""


def test_the_battery_of_a_run_falls_by_the_charge_that_its_currents_took(tmp_path: Path) -> None:
    rows = columns(run(tmp_path, BATTERY), "loop.t_s", "battery.voltage_v", "battery.current_a")
    t_s, voltage, current = rows[rows[:, 0] > 1.0].T  # later than the start, whose currents last less than a STATUS
    charge_c = np.trapezoid(current, t_s)
    fallen_v = 2.0 * charge_c + 0.05 * (current[-1] - current[0])
    assert voltage[0] - voltage[-1] == pytest.approx(fallen_v, abs=0.05)
    assert fallen_v > 1.0


SLOPE = """
extends = "circle_speed"
[plant.start]
slope_rad = 0.05
friction_coefficient = 0.0
viscous_n_m_s_rad = 0.0
start_x_m = 0.0
start_heading_rad = 0.0
[reference]
kind = "hold"
[loop]
duration_s = 4.0
[[fault]]
kind = "payload"
value = 8.0
x_m = 0.1
start_s = 1.0
end_s = 2.0
[[fault]]
kind = "payload"
value = 8.0
x_m = -0.1
start_s = 2.0
end_s = 3.0
"""


def test_a_robot_that_holds_on_a_slope_holds_its_payload_too(tmp_path: Path) -> None:
    """Uphill is ahead: four currents carry (m + p) g sin(slope) r, whether the payload lies in front or behind."""
    found = run(tmp_path, SLOPE)
    t_s = found.signals["loop.t_s"]
    total = columns(found, *(f"wheel.{wheel}.current_a" for wheel in ("fl", "fr", "rr", "rl"))).sum(axis=1)
    for begin, mass in ((0.6, 20.0), (1.6, 28.0), (2.6, 28.0), (3.6, 20.0)):
        held = total[(t_s > begin) & (t_s < begin + 0.3)].mean()
        assert held * 1.25 == pytest.approx(mass * 9.81 * np.sin(0.05) * R, rel=0.03)


def test_a_robot_whose_wheel_lifts_for_a_while_keeps_its_path(tmp_path: Path) -> None:
    """Three wheels steer it meanwhile; the one in the air turns at what its own torque gives it."""
    text = """
extends = "circle_slip"
[plant.start]
com_x_m = -0.05
[controller]
law = "pid"
[loop]
duration_s = 3.5
[limiter]
slip_m_s = inf
[[fault]]
kind = "lifted_wheel"
target = "fl"
start_s = 1.5
end_s = 2.2
"""
    found = run(tmp_path, text)
    t_s, error_m = columns(found, "loop.t_s", "error.planar_m").T
    wheel, other = columns(found, "wheel.fl.speed_rad_s", "wheel.rr.speed_rad_s").T
    during = (t_s > 1.9) & (t_s < 2.2)
    assert np.abs(wheel - other)[during].min() > 5.0
    assert error_m[t_s > 3.0].max() < 0.005
