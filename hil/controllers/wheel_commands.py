"""From what a law asks for, in the world frame, to set points of the four wheels."""

from hil.model import RobotModel
from hil.types import ZERO_WHEELS, Axes, CommandMode, WheelCommand


def torque_command(
    model: RobotModel, acceleration: Axes, heading_rad: float, twist: Axes, moving: Axes
) -> WheelCommand:
    """Return the torques for a world acceleration: τ = B⁺ (M u + C) + ξ (equation 18 with the model's C).

    Friction is that of wheels that turn as the reference is ``moving``: known beforehand, so no noise comes back.
    """
    friction_at = model.wheel_speeds(moving, heading_rad) if model.wheel_friction_n_m > 0.0 else ZERO_WHEELS
    torque = model.wheel_torques(acceleration, twist, heading_rad, friction_at)
    return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)


def speed_command(
    model: RobotModel, wanted: Axes, heading_rad: float, moving: Axes, acceleration: Axes
) -> WheelCommand:
    """Return the set points of the firmware's speed loop for a world twist: ω = H Rᵀ x̄2 / r.

    The torque feedforward is that of the reference alone, its twist ``moving`` and its ``acceleration``.
    """
    friction_at = model.wheel_speeds(moving, heading_rad) if model.wheel_friction_n_m > 0.0 else ZERO_WHEELS
    feedforward = model.wheel_torques(acceleration, moving, heading_rad, friction_at)
    return WheelCommand(CommandMode.SPEED, model.wheel_speeds(wanted, heading_rad), feedforward)
