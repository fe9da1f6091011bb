"""Dynamic surface control of the robot's pose: what DSC and AFDSC have in common.

With S1 = q - q_d, the virtual control x̄2 = q̇_d - K1 S1, its first-order filter ς ẋ2d + x2d = x̄2 and
S2 = q̇ - x2d, the acceleration asked for is u = ẋ2d - K2 S2 (Nguyen Minh et al. 2023, AFDSC, equations 16 to
18; the paper never states x̄2, and prints x2 for it in u). K1 and K2 are diagonal: one gain an axis.

The filter makes the robot lag: on a circle of radius r0 at rate ω the steady error is ς ω² r0 / K1.
"""

import math
from typing import NamedTuple

from hil.controllers.wheel_commands import speed_command, torque_command
from hil.kinematics import wrap_angle
from hil.model import RobotModel
from hil.types import (
    NAN,
    Axes,
    CommandMode,
    Gains,
    Reference,
    State,
    Twist,
    WheelCommand,
)


class TrackingError(NamedTuple):
    """State minus reference in the world frame, the heading wrapped to [-π, π], and its rate."""

    x_m: float
    y_m: float
    heading_rad: float
    vx_m_s: float
    vy_m_s: float
    yaw_rate_rad_s: float


def tracking_error(reference: Reference, state: State) -> TrackingError:
    """Return S1 and its rate."""
    (x, y, heading), (vx, vy, yaw_rate) = state
    (x_d, y_d, heading_d), (vx_d, vy_d, yaw_rate_d), _ = reference
    return TrackingError(x - x_d, y - y_d, wrap_angle(heading - heading_d), vx - vx_d, vy - vy_d, yaw_rate - yaw_rate_d)


class DynamicSurface:
    """Surface, filter and wheel map. The gains come from outside at every tick. The guard limits the command.

    In TORQUE mode: τ = B⁺ (M u + C) + ξ (equation 18 with the model's C). In SPEED mode the firmware's speed
    loop takes the place of the inner surface: the set points are ω = H Rᵀ x̄2 / r, unfiltered because a
    filter would only add lag, with the torque feedforward B⁺ (M q̈_d + C) + ξ of the reference. K2 and ς have
    no part in it.
    """

    __slots__ = ("_filter_s", "_model", "_torque", "_virtual")

    def __init__(self, model: RobotModel, mode: CommandMode, filter_s: float) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._filter_s = filter_s
        self._virtual: Axes = (0.0, 0.0, 0.0)

    def reset(self, reference: Reference, error: TrackingError, gains: Gains) -> None:
        """Start the filter at rest on its input: x2d(0) = x̄2(0) (equation 17)."""
        self._virtual = _virtual_control(reference.twist, error, gains)

    def command(
        self, reference: Reference, state: State, error: TrackingError, gains: Gains, dt_s: float
    ) -> WheelCommand:
        """Return the command of this tick, of ``dt_s`` [s]."""
        heading, moving = state.pose.heading_rad, reference.twist
        wanted = _virtual_control(moving, error, gains)
        if not self._torque:
            return speed_command(self._model, wanted, heading, moving, reference.acceleration)
        acceleration = self._inner_surface(wanted, state.twist, gains, dt_s)
        return torque_command(self._model, acceleration, heading, state.twist, moving)

    def _inner_surface(self, wanted: Axes, twist: Twist, gains: Gains, dt_s: float) -> Axes:
        """Return u = ẋ2d - K2 S2, and advance the filter."""
        x, y, heading = self._virtual
        self._virtual, (slope_x, slope_y, slope_heading) = filter_step(self._virtual, wanted, self._filter_s, dt_s)
        vx, vy, yaw_rate = twist
        _, _, _, k2_x, k2_y, k2_heading = gains
        return (
            slope_x - k2_x * (vx - x),
            slope_y - k2_y * (vy - y),
            slope_heading - k2_heading * (yaw_rate - heading),
        )


def filter_step(value: Axes, wanted: Axes, filter_s: float, dt_s: float) -> tuple[Axes, Axes]:
    """Return a first-order filter ``dt_s`` [s] later, and its mean slope on the way.

    Exact for an input held over the tick: a plant that holds its acceleration over the tick too keeps to the filter
    exactly. With the slope at its beginning, (x̄2 - x2d) / ς, it would not.
    """
    step = -math.expm1(-dt_s / filter_s)
    x, y, heading = value
    wanted_x, wanted_y, wanted_heading = wanted
    dx, dy, dh = step * (wanted_x - x), step * (wanted_y - y), step * (wanted_heading - heading)
    return (x + dx, y + dy, heading + dh), (dx / dt_s, dy / dt_s, dh / dt_s)


def without_inner(gains: Gains) -> Gains:
    """Return the gains with no K2: what is in force in SPEED mode."""
    return gains._replace(k2_x_1_s=NAN, k2_y_1_s=NAN, k2_heading_1_s=NAN)


def _virtual_control(moving: Twist, error: TrackingError, gains: Gains) -> Axes:
    """Return x̄2 = q̇_d - K1 S1."""
    x, y, heading, _, _, _ = error
    vx, vy, yaw_rate = moving
    k1_x, k1_y, k1_heading, _, _, _ = gains
    return vx - k1_x * x, vy - k1_y * y, yaw_rate - k1_heading * heading
