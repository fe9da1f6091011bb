"""Dynamic surface control of the robot's pose, shared by DSC and AFDSC.

With S1 = q - q_d, the virtual control x̄2 = q̇_d - K1 S1, its first-order filter ς ẋ2d + x2d = x̄2 and
S2 = q̇ - x2d, the commanded acceleration is u = ẋ2d - K2 S2 (Nguyen Minh et al. 2023, AFDSC, equations 16 to
18; the paper never states x̄2, and prints x2 for it in u). K1 and K2 are diagonal: one gain per axis.

The filter makes the robot lag: on a circle of radius r0 at rate ω the steady error is ς ω² r0 / K1.
"""

import math

from hil.core.model import RobotModel
from hil.core.types import (
    NAN,
    ZERO_WHEELS,
    Axes,
    CommandMode,
    Gains,
    Pairs,
    Reference,
    State,
    WheelCommand,
    make_command,
)

# A member of an enumeration takes longer to look up than a global name.
_SPEED, _TORQUE = CommandMode.SPEED, CommandMode.TORQUE


def torque_command(
    model: RobotModel, acceleration: Axes, heading_rad: float, twist: Axes, reference_twist: Axes
) -> WheelCommand:
    """Return the torques for a world acceleration: τ = B⁺ (M u + C) + ξ (equation 18 with the model's C).

    Friction is computed at the reference's twist and not at the measured one, so measurement noise does not enter.
    """
    return make_command((_TORQUE, ZERO_WHEELS, model.wheel_torques(acceleration, twist, heading_rad, reference_twist)))


def speed_command(
    model: RobotModel, desired: Axes, heading_rad: float, reference_twist: Axes, acceleration: Axes
) -> WheelCommand:
    """Return the set points of the firmware's speed loop for a world twist: ω = H Rᵀ x̄2 / r.

    ``desired`` is the twist [m/s, m/s, rad/s]. The torque feedforward follows from ``reference_twist`` and
    ``acceleration``, both the reference's.
    """
    feedforward = model.wheel_torques(acceleration, reference_twist, heading_rad, reference_twist)
    return make_command((_SPEED, model.wheel_speeds(desired, heading_rad), feedforward))


def tracking_error(reference: Reference, state: State) -> Pairs:
    """Return S1, state minus reference in the world frame [m, rad], and its rate. The heading is in [-π, π]."""
    (x, y, heading), (vx, vy, yaw_rate) = state
    (x_d, y_d, heading_d), (vx_d, vy_d, yaw_rate_d), _ = reference
    heading_error = math.remainder(heading - heading_d, math.tau)
    return x - x_d, y - y_d, heading_error, vx - vx_d, vy - vy_d, yaw_rate - yaw_rate_d


class DynamicSurface:
    """Surface, filter and map to the wheels. The caller gives the gains at every tick. The guard limits the command.

    In TORQUE mode the command is τ = B⁺ (M u + C) + ξ (equation 18 with the model's C). In SPEED mode the firmware's
    speed loop replaces the inner surface: the set points are ω = H Rᵀ x̄2 / r with the torque feedforward
    B⁺ (M q̈_d + C) + ξ of the reference. x̄2 is not filtered there, because a filter would only add lag. K2 and ς are
    not used.
    """

    __slots__ = ("_filter", "_model", "_torque")

    def __init__(self, model: RobotModel, mode: CommandMode, filter_s: float) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._filter = FirstOrderFilter(filter_s)

    def reset(self, reference: Reference, error: Pairs, gains: Pairs) -> None:
        """Start the filter at rest on its input: x2d(0) = x̄2(0) (equation 17)."""
        self._filter.value = _virtual_control(reference.twist, error, gains)

    def command(self, reference: Reference, state: State, error: Pairs, gains: Pairs, dt_s: float) -> WheelCommand:
        """Return the command of this tick, of ``dt_s`` [s]; ``gains`` are K1 and K2 [1/s]."""
        _, reference_twist, acceleration = reference
        (_, _, heading_rad), twist = state
        desired = _virtual_control(reference_twist, error, gains)
        if not self._torque:
            return speed_command(self._model, desired, heading_rad, reference_twist, acceleration)
        x, y, heading = self._filter.value
        slope_x, slope_y, slope_heading = self._filter.step(desired, dt_s)
        vx, vy, yaw_rate = twist
        _, _, _, k2_x, k2_y, k2_heading = gains
        commanded = (
            slope_x - k2_x * (vx - x),
            slope_y - k2_y * (vy - y),
            slope_heading - k2_heading * (yaw_rate - heading),
        )
        return torque_command(self._model, commanded, heading_rad, twist, reference_twist)


class FirstOrderFilter:
    """The filter ς ẋ + x = u along three axes; ``value`` is x and ``filter_s`` is ς [s].

    The step is exact for an input that is held over the tick. So a plant that holds its acceleration over the tick
    follows the filter exactly. With the slope at the beginning of the tick, (u - x) / ς, it would not.
    """

    __slots__ = ("_dt_s", "_filter_s", "_rate_1_s", "value")

    def __init__(self, filter_s: float) -> None:
        self._filter_s = filter_s
        self._dt_s = self._rate_1_s = 0.0
        self.value: Axes = (0.0, 0.0, 0.0)

    def step(self, desired: Axes, dt_s: float) -> Axes:
        """Advance by ``dt_s`` [s] with this input, and return the mean slope over the step."""
        if dt_s != self._dt_s:
            self._dt_s, self._rate_1_s = dt_s, -math.expm1(-dt_s / self._filter_s) / dt_s
        rate = self._rate_1_s
        x, y, heading = self.value
        to_x, to_y, to_heading = desired
        slope_x, slope_y, slope_heading = rate * (to_x - x), rate * (to_y - y), rate * (to_heading - heading)
        self.value = x + dt_s * slope_x, y + dt_s * slope_y, heading + dt_s * slope_heading
        return slope_x, slope_y, slope_heading


def without_k2(gains: Gains) -> Gains:
    """Return the gains without K2 (NaN), as they are in force in SPEED mode."""
    return gains._replace(k2_x_1_s=NAN, k2_y_1_s=NAN, k2_heading_1_s=NAN)


def _virtual_control(reference_twist: Axes, error: Pairs, gains: Pairs) -> Axes:
    """Return x̄2 = q̇_d - K1 S1."""
    x, y, heading, _, _, _ = error
    vx, vy, yaw_rate = reference_twist
    k1_x, k1_y, k1_heading, _, _, _ = gains
    return vx - k1_x * x, vy - k1_y * y, yaw_rate - k1_heading * heading
