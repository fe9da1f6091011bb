"""A control law of your own: it turns where the robot is, and should be, into wheel speeds.

It sees no clock, no link and no plant, so it runs unchanged on the virtual robot and on the real one.
"""

from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Reference, State, WheelCommand, Wheels

GAIN_1_S = 4.0  # an error of 1 m is answered with 4 m/s


class MyLaw:
    """Drives with the twist of the reference, minus the gain times the error."""

    def __init__(self, model: RobotModel, mode: CommandMode) -> None:
        if mode is not CommandMode.SPEED:
            raise ValueError("it commands wheel speeds; set controller.command to speed")
        self._model = model  # mass, lengths and limits, as robot.toml has them

    def reset(self, state: State, reference: Reference) -> None:
        """Forget what was before; called once before the first tick. This law remembers nothing."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick.

        state.pose, state.twist: where the robot is: x [m], y [m], heading [rad], and their rates, in the world frame.
        reference.pose, .twist, .acceleration: where it should be, in the same units.
        applied: the command that was really sent last, and the latency; dt_s: the time between two ticks.
        """
        errors = [is_ - should for is_, should in zip(state.pose, reference.pose, strict=True)]
        wish = [speed - GAIN_1_S * error for speed, error in zip(reference.twist, errors, strict=True)]
        # A twist becomes four wheel speeds [rad/s], in the order FL, FR, RR, RL, by the robot's geometry.
        speeds = Wheels(*self._model.wheel_speeds((wish[0], wish[1], wish[2]), state.pose.heading_rad))
        return WheelCommand(CommandMode.SPEED, speeds, ZERO_WHEELS)
