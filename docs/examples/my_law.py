"""A control law of one's own: proportional to the error, on top of the reference's speed."""

import sys

import hil
from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Reference, State, WheelCommand


class MyLaw:
    """Wheel speeds for the twist q̇_d - k (q - q_d). It sees no clock, no link and no plant."""

    def __init__(self, model: RobotModel, mode: CommandMode) -> None:
        if mode is not CommandMode.SPEED:
            raise ValueError("it commands wheel speeds; set controller.command to speed")
        self._model = model
        self._k_1_s = 4.0

    def reset(self, state: State, reference: Reference) -> None:
        """Forget what was before; this law remembers nothing."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick."""
        errors = [is_ - should for is_, should in zip(state.pose, reference.pose, strict=True)]
        vx, vy, yaw_rate = (speed - self._k_1_s * error for speed, error in zip(reference.twist, errors, strict=True))
        speeds = self._model.wheel_speeds((vx, vy, yaw_rate), state.pose.heading_rad)
        return WheelCommand(CommandMode.SPEED, speeds, ZERO_WHEELS)


def main(duration_s: float = 15.0) -> None:
    """Compare it with the scenario's own law."""
    short = {"loop.duration_s": duration_s, "expect": []}
    for name, result in (
        ("dsc", hil.run("circle_speed", set=short)),
        ("mine", hil.run("circle_speed", law=MyLaw, set=short)),
    ):
        print(f"{name:5} to 10 mm after {result.metrics['t10_s']} s, then {result.metrics['steady_rms_m']} m rms")


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
