"""Dynamic surface control of the robot's pose: what DSC and AFDSC have in common.

With S1 = q - q_d, the virtual control x̄2 = q̇_d - K1 S1, its first-order filter ς ẋ2d + x2d = x̄2 and
S2 = q̇ - x2d, the acceleration asked for is u = ẋ2d - K2 S2 (Nguyen Minh et al. 2023, AFDSC, equations 16 to
18; the paper never states x̄2, and prints x2 for it in u). K1 and K2 are diagonal: one gain an axis.

The filter makes the robot lag: on a circle of radius r0 at rate ω the steady error is ς ω² r0 / K1.
"""

import math
from typing import NamedTuple

from hil.kinematics import wrap_angle
from hil.model import RobotModel
from hil.types import (
    NAN,
    ZERO_WHEELS,
    Acceleration,
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
    pose, twist = state
    wanted, moving, _ = reference
    return TrackingError(
        pose.x_m - wanted.x_m,
        pose.y_m - wanted.y_m,
        wrap_angle(pose.heading_rad - wanted.heading_rad),
        twist.vx_m_s - moving.vx_m_s,
        twist.vy_m_s - moving.vy_m_s,
        twist.yaw_rate_rad_s - moving.yaw_rate_rad_s,
    )


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
        self._virtual = Twist(0.0, 0.0, 0.0)

    def reset(self, reference: Reference, error: TrackingError, gains: Gains) -> None:
        """Start the filter at rest on its input: x2d(0) = x̄2(0) (equation 17)."""
        self._virtual = _virtual_control(reference.twist, error, gains)

    def command(
        self, reference: Reference, state: State, error: TrackingError, gains: Gains, dt_s: float
    ) -> WheelCommand:
        """Return the command of this tick, of ``dt_s`` [s]."""
        model = self._model
        heading = state.pose.heading_rad
        wanted = _virtual_control(reference.twist, error, gains)
        # Friction at the speeds of the reference: known beforehand, so no noise comes back through it.
        friction_at = model.wheel_speeds(reference.twist, heading) if model.wheel_friction_n_m > 0.0 else ZERO_WHEELS
        if not self._torque:
            feedforward = model.wheel_torques(reference.acceleration, reference.twist, heading, friction_at)
            return WheelCommand(CommandMode.SPEED, model.wheel_speeds(wanted, heading), feedforward)
        acceleration = self._inner_surface(wanted, state.twist, gains, dt_s)
        torque = model.wheel_torques(acceleration, state.twist, heading, friction_at)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)

    def _inner_surface(self, wanted: Twist, twist: Twist, gains: Gains, dt_s: float) -> Acceleration:
        """Return u = ẋ2d - K2 S2, and advance the filter.

        The filter's step is exact for an input held over the tick, and ẋ2d is the mean slope over it: a plant
        that holds u over the tick too keeps q̇ on x2d exactly. With (x̄2 - x2d) / ς it would not.
        """
        step = -math.expm1(-dt_s / self._filter_s)
        x, y, heading = self._virtual
        dx = step * (wanted.vx_m_s - x)
        dy = step * (wanted.vy_m_s - y)
        dh = step * (wanted.yaw_rate_rad_s - heading)
        self._virtual = Twist(x + dx, y + dy, heading + dh)
        return Acceleration(
            dx / dt_s - gains.k2_x_1_s * (twist.vx_m_s - x),
            dy / dt_s - gains.k2_y_1_s * (twist.vy_m_s - y),
            dh / dt_s - gains.k2_heading_1_s * (twist.yaw_rate_rad_s - heading),
        )


def without_inner(gains: Gains) -> Gains:
    """Return the gains with no K2: what is in force in SPEED mode."""
    return gains._replace(k2_x_1_s=NAN, k2_y_1_s=NAN, k2_heading_1_s=NAN)


def _virtual_control(moving: Twist, error: TrackingError, gains: Gains) -> Twist:
    """Return x̄2 = q̇_d - K1 S1."""
    return Twist(
        moving.vx_m_s - gains.k1_x_1_s * error.x_m,
        moving.vy_m_s - gains.k1_y_1_s * error.y_m,
        moving.yaw_rate_rad_s - gains.k1_heading_1_s * error.heading_rad,
    )
