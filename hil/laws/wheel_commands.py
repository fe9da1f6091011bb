"""Turns an acceleration or a twist in the world frame into set points of the four wheels."""

from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Axes, CommandMode, WheelCommand, make_command

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
