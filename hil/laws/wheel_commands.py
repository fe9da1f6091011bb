"""From what a law asks for, in the world frame, to set points of the four wheels."""

from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Axes, CommandMode, WheelCommand, make_command

# A member of an enumeration takes longer to look up than a global name.
_SPEED, _TORQUE = CommandMode.SPEED, CommandMode.TORQUE


def torque_command(
    model: RobotModel, acceleration: Axes, heading_rad: float, twist: Axes, moving: Axes
) -> WheelCommand:
    """Return the torques for a world acceleration: τ = B⁺ (M u + C) + ξ (equation 18 with the model's C).

    Friction is that of wheels that turn as the reference is ``moving``: known beforehand, so no noise comes back.
    """
    return make_command((_TORQUE, ZERO_WHEELS, model.wheel_torques(acceleration, twist, heading_rad, moving)))


def speed_command(
    model: RobotModel, wanted: Axes, heading_rad: float, moving: Axes, acceleration: Axes
) -> WheelCommand:
    """Return the set points of the firmware's speed loop for a world twist: ω = H Rᵀ x̄2 / r.

    The torque feedforward is that of the reference alone, its twist ``moving`` and its ``acceleration``.
    """
    feedforward = model.wheel_torques(acceleration, moving, heading_rad, moving)
    return make_command((_SPEED, model.wheel_speeds(wanted, heading_rad), feedforward))
