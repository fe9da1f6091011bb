"""The grip of the floor from a squeeze: wheels turned against one another until one of them slides.

Speeds +, +, -, - on FL, FR, RR, RL are no motion of the body, so a wheel must slide: the one with the least load. Where
two have nearly the least they slide in turns, and N below is the mean over the time of each. The other three roll, and
their speeds give the motion of the body. It is steady, so what the motors give is spent by friction alone:

    Σ κ i ω = μ_grip N |v| + Σ μ_roller N_j v_j tanh(v_j / 0.01 m/s) + μ_Coulomb m g r / 4 Σ |ω| + b Σ ω²

κ is the torque constant, b the viscous friction of a wheel, r its radius; sums are over all four wheels. N_j = m g / 4
(1 + com_x x / l1² + com_y y / l2²) is the load of a wheel at (x, y) = (±l1, ±l2). N is the load of the sliding wheel,
v its speed over the floor along its roller's axis, and v_j a wheel's speed across that axis. Only μ_grip is unknown.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.addons.identify.drives import Array, Drive
from hil.addons.identify.windows import GYRO_BIAS
from hil.core.errors import apart
from hil.core.kinematics import body_twist
from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import Wheels

PATTERN = (1.0, 1.0, -1.0, -1.0)
_SLOWEST_RAD_S = 0.1
_FASTEST_RAD_S = 1.5
_LEAST_S = 1.0
_ROLLERS = np.array([-1.0, 1.0, -1.0, 1.0])  # s: a roller's axis is (1, s) / √2
_ROLLER_SPEED_M_S = 0.01  # below it a roller of the plant resists less: MECANUM_RESISTANCE_SPEED_M_S
SHARE_SIGMA = 0.001  # of the grip, on 40 random robots with known values
_LEAST_GRIP = 0.02
_LEAST_LOAD = 0.2  # of a quarter of the weight


class Squeeze(NamedTuple):
    """What a squeeze found: the grip coefficient, or None, and a sentence that says so."""

    grip: float | None
    sentence: str


def grip_of(drive: Drive, robot: RobotModel, values: Mapping[str, float], torque_constant_n_m_a: float) -> Squeeze:
    """Return the grip; ``values`` are those of a fitted model with slip, ``robot`` has the lengths."""
    sliding = drive.speed_rad_s @ PATTERN / 4.0 > _SLOWEST_RAD_S
    count = int(sliding.sum())
    if count * drive.period_s < _LEAST_S:
        most = torque_constant_n_m_a * float(np.abs(drive.current_a).sum(axis=1).max())
        weight_n_m = values["mass_kg"] * GRAVITY_M_S2 * values["wheel_radius_m"]
        push = most / weight_n_m - values["friction_coefficient"]
        least = math.sqrt(2.0) * push / (4.0 * _load_shares(values, robot).min())
        return Squeeze(
            None,
            f"{drive.path.name}: the wheels slid for {apart(count * drive.period_s, _LEAST_S)} s; expected "
            f"{_LEAST_S:g} s. The grip is more than {least:.2f}, as far as the torque went; it was not found",
        )
    fastest = float(np.abs(drive.speed_rad_s).max())
    if fastest > _FASTEST_RAD_S:
        return Squeeze(
            None,
            f"{drive.path.name}: the wheels swung at up to {apart(fastest, _FASTEST_RAD_S)} rad/s; expected at most "
            f"{_FASTEST_RAD_S:g}. Lower firmware.speed_kp_n_m_s_rad and speed_ki_n_m_rad for the squeeze; the grip "
            "was not found",
        )
    grip = _grip(drive, sliding, robot, values, torque_constant_n_m_a)
    if grip <= _LEAST_GRIP:
        return Squeeze(None, f"{drive.path.name}: the wheels turned without grip; the robot was not on the floor")
    return Squeeze(grip, f"{drive.path.name}: the wheels slid at a grip of {grip:.3f}")


def _load_shares(values: Mapping[str, float], robot: RobotModel) -> Array:
    """Return the part of the weight on each wheel."""
    x, y = _places(robot)
    uneven = values["com_x_m"] * x / robot.half_length_m**2 + values["com_y_m"] * y / robot.half_width_m**2
    return np.maximum((1.0 + uneven) / 4.0, _LEAST_LOAD / 4.0)


def _places(robot: RobotModel) -> tuple[Array, Array]:
    x, y = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    return robot.half_length_m * x, robot.half_width_m * y


def _grip(
    drive: Drive,
    sliding: npt.NDArray[np.bool_],
    robot: RobotModel,
    values: Mapping[str, float],
    torque_constant_n_m_a: float,
) -> float:
    """Return the grip by the mean powers while wheels are ``sliding`` (n,)."""
    # Means first: products of single samples would have the sensors' noise in them.
    speed_rad_s, current_a = drive.speed_rad_s[sliding].mean(axis=0), drive.current_a[sliding].mean(axis=0)
    radius_m, (x, y) = values["wheel_radius_m"], _places(robot)
    load_n = values["mass_kg"] * GRAVITY_M_S2 * _load_shares(values, robot)
    apart_rad_s = float(speed_rad_s @ PATTERN)
    lightest = np.argsort(load_n)[:2]
    # The motion of the body while one of the two lightest wheels slides alone: as if it rolled with the other three.
    rolling_rad_s = speed_rad_s - apart_rad_s * np.diag(PATTERN)[lightest]
    one, other = np.stack(body_twist(Wheels(*rolling_rad_s.T), radius_m, robot.lever_m), axis=1)
    # The gyro says how they take turns.
    yaw_rate_rad_s = float(drive.yaw_rate_rad_s[sliding].mean()) - values[GYRO_BIAS.name]
    share = float(np.clip((yaw_rate_rad_s - one[2]) / (other[2] - one[2]), 0.0, 1.0))
    forward_m_s, left_m_s, yaw_rate_rad_s = one + share * (other - one)
    ahead_m_s, aside_m_s = forward_m_s - yaw_rate_rad_s * y - radius_m * speed_rad_s, left_m_s + yaw_rate_rad_s * x
    turning_m_s = (aside_m_s - _ROLLERS * ahead_m_s) / math.sqrt(2.0)
    sliding_m_s = radius_m * abs(apart_rad_s) / math.sqrt(2.0)
    resisted_n = values["roller_friction_coefficient"] * load_n * np.tanh(turning_m_s / _ROLLER_SPEED_M_S)
    coulomb_n_m = values["friction_coefficient"] * load_n.sum() * radius_m / 4.0
    spent_w = resisted_n * turning_m_s + coulomb_n_m * np.abs(speed_rad_s)
    spent_w += values["viscous_n_m_s_rad"] * speed_rad_s**2
    given_w = torque_constant_n_m_a * float(current_a @ speed_rad_s)
    return float((given_w - spent_w.sum()) / (sliding_m_s * ([1.0 - share, share] @ load_n[lightest])))
