"""The grip of the floor from a squeeze: wheels turned against one another until one of them slides.

Speeds +, +, -, - on FL, FR, RR, RL are no motion of the body, so a wheel must slide: the one with the least load N. The
others hold it: all four rollers then push with the same force, as any other forces would move the robot. So

    Σ |κ i| = 4 r N (μ_grip + μ_roller) / √2 + μ_Coulomb m g r + b Σ |ω|

with N = m g / 4 (1 - |com_x| / l1 - |com_y| / l2).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.identify.recorded import Drive

PATTERN = (1.0, 1.0, -1.0, -1.0)
_SLOWEST_RAD_S = 0.1
_FASTEST_RAD_S = 1.5
_LEAST_S = 1.0
_SHARE_SIGMA = 0.008  # of the grip: the wheels' loads shift a little while they slide
_LEAST_GRIP = 0.02
_LEAST_LOAD = 0.2  # of a quarter of the weight


class Squeeze(NamedTuple):
    """What a squeeze found: the grip coefficient with its standard deviation for these values, or None and why."""

    grip: tuple[float, float] | None
    sentence: str


def grip_of(drive: Drive, robot: RobotModel, values: Mapping[str, float], torque_constant_n_m_a: float) -> Squeeze:
    """Return the grip; ``values`` are those of a fitted model with slip, ``robot`` has the lengths."""
    sliding = drive.speed_rad_s @ np.array(PATTERN) / 4.0 > _SLOWEST_RAD_S
    count = int(sliding.sum())
    if count * drive.period_s < _LEAST_S:
        most = torque_constant_n_m_a * float(np.abs(drive.current_a).sum(axis=1).max())
        least = _grip(most, 0.0, values, robot)
        return Squeeze(
            None,
            f"{drive.path.name}: the wheels slid for {count * drive.period_s:.1f} s; expected {_LEAST_S:g} s. The "
            f"grip is more than {least:.2f}, as far as the torque went; it was not found",
        )
    fastest = float(np.abs(drive.speed_rad_s).max())
    if fastest > _FASTEST_RAD_S:
        return Squeeze(
            None,
            f"{drive.path.name}: the wheels swung at up to {fastest:.1f} rad/s; expected at most {_FASTEST_RAD_S:g}. "
            "Lower firmware.speed_kp_n_m_s_rad and speed_ki_n_m_rad for the squeeze; the grip was not found",
        )
    torque = torque_constant_n_m_a * float(np.abs(drive.current_a[sliding]).sum(axis=1).mean())
    speed = float(np.abs(drive.speed_rad_s[sliding]).sum(axis=1).mean())
    grip = _grip(torque, speed, values, robot)
    if grip <= _LEAST_GRIP:
        return Squeeze(None, f"{drive.path.name}: the wheels turned without grip; the robot was not on the floor")
    return Squeeze(
        (float(grip), float(_SHARE_SIGMA * grip)), f"{drive.path.name}: the wheels slid at a grip of {grip:.3f}"
    )


def _grip(torque_n_m: float, speed_rad_s: float, values: Mapping[str, float], robot: RobotModel) -> float:
    weight_n_m = values["mass_kg"] * GRAVITY_M_S2 * values["wheel_radius_m"]
    least = 1.0 - abs(values["com_x_m"]) / robot.half_length_m - abs(values["com_y_m"]) / robot.half_width_m
    net = torque_n_m - values["viscous_n_m_s_rad"] * speed_rad_s
    push = net / weight_n_m - values["friction_coefficient"]
    return math.sqrt(2.0) * push / max(least, _LEAST_LOAD) - values["roller_friction_coefficient"]
