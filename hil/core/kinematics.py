"""Kinematics and statics of four Mecanum wheels: wheels <-> body <-> world. Pure functions of plain floats.

H = [[1, -1, -L], [1, 1, L], [1, -1, L], [1, 1, -L]] has a row for each of FL, FR, RR, RL. L = ``lever_m`` is half the
length plus half the width between the wheel centres. (Nguyen Minh et al. 2023, AFDSC, equations 3 to 9. The third row
of equation 7 is printed with an entry missing. It is (-1, 1, 1, -1) / L.)

- wheel speeds    ω = H v / r                     v = (r / 4) diag(1, 1, 1 / L²) Hᵀ ω
- wheel torques   τ = (r / 4) H diag(1, 1, 1 / L²) F    F = Hᵀ τ / r

The second line is the dual of the first: the power τ·ω of the wheels is the power F·v of the body. Four
wheels drive three degrees of freedom, so many torques give the same wrench F; the map gives those with the
least sum of squares (``hil.core.model.RobotModel.wheel_torques``).
"""

import math
from typing import NamedTuple

from hil.core.types import Axes, FourWheels, Twist


class BodyTwist(NamedTuple):
    """Velocity of the robot's centre in the body frame (x forward, y left), and yaw rate."""

    forward_m_s: float
    left_m_s: float
    yaw_rate_rad_s: float


class BodyWrench(NamedTuple):
    """Force on the robot's centre in the body frame (x forward, y left), and torque about the vertical."""

    forward_n: float
    left_n: float
    yaw_n_m: float


def wrap_angle(angle_rad: float) -> float:
    """Return the angle wrapped to [-π, π]. Raises ValueError for an infinite angle; NaN stays NaN."""
    return math.remainder(angle_rad, math.tau)


def to_body(twist: Twist, heading_rad: float) -> BodyTwist:
    """Return a world twist in the body frame of a robot with this heading (equation 9)."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return BodyTwist(c * twist.vx_m_s + s * twist.vy_m_s, c * twist.vy_m_s - s * twist.vx_m_s, twist.yaw_rate_rad_s)


def to_world(body: BodyTwist, heading_rad: float) -> Twist:
    """Return a body twist in the world frame (equation 8; the paper calls it inverse, but it is the forward map)."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return Twist(
        c * body.forward_m_s - s * body.left_m_s, s * body.forward_m_s + c * body.left_m_s, body.yaw_rate_rad_s
    )


def wheel_speeds(body: Axes, wheel_radius_m: float, lever_m: float) -> FourWheels:
    """Return the wheel speeds [rad/s] for a body twist (forward, left, yaw rate): ω = H v / r."""
    forward, left, yaw_rate = body
    turn = lever_m * yaw_rate
    minus, plus = forward - left, forward + left
    return (
        (minus - turn) / wheel_radius_m,
        (plus + turn) / wheel_radius_m,
        (minus + turn) / wheel_radius_m,
        (plus - turn) / wheel_radius_m,
    )


def body_twist(wheel_speed_rad_s: FourWheels, wheel_radius_m: float, lever_m: float) -> BodyTwist:
    """Return the body twist of four wheel speeds [rad/s], as a least-squares fit: it has only three velocities.

    ``lever_m`` is half the length plus half the width between the wheel centres. The map is linear: wheel angles [rad]
    in place of speeds give a displacement [m, m, rad] in the body frame.
    """
    fl, fr, rr, rl = wheel_speed_rad_s
    quarter = wheel_radius_m / 4.0
    return BodyTwist(
        quarter * (fl + fr + rr + rl), quarter * (fr - fl + rl - rr), quarter * (fr - fl + rr - rl) / lever_m
    )


def body_wrench(wheel_torque_n_m: FourWheels, wheel_radius_m: float, lever_m: float) -> BodyWrench:
    """Return the wrench of these wheel torques [N·m] on the body, in the body frame: F = Hᵀ τ / r."""
    fl, fr, rr, rl = wheel_torque_n_m
    return BodyWrench(
        (fl + fr + rr + rl) / wheel_radius_m,
        (fr - fl + rl - rr) / wheel_radius_m,
        lever_m * (fr - fl + rr - rl) / wheel_radius_m,
    )
