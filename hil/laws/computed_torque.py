"""Computed torque: the model cancels the known dynamics, and a linear law controls the error that is left."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.types import NO_GAINS, Applied, CommandMode, Reference, State, WheelCommand
from hil.laws.prediction import DelayPredictor, require_torque


class ComputedTorque:
    """Computed torque with feedforward: u = q̈_d - 2 ζ ωn ė - ωn² e, with latency compensation.

    The error of each axis then decays as a second-order system (B. Siciliano et al., Robotics, 2009, section
    8.5.2). It does not remove a steady error, such as that of unmodelled friction. It computes torques, so it
    refuses SPEED mode with BadInputError.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Natural frequency ωn [rad/s] and damping ratio ζ [1] of all three axes."""

        frequency_rad_s: Annotated[float, RATE] = 14.0
        damping: Annotated[float, Range(gt=0, le=100)] = 1.0

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        require_torque("computed_torque", mode, "lqi")
        self._to_error = options.frequency_rad_s**2
        self._to_rate = 2.0 * options.damping * options.frequency_rad_s
        self._predictor = DelayPredictor(model)

    def reset(self, state: State, reference: Reference) -> None:
        """Discard the commands that do not act yet."""
        self._predictor.reset(state)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        predicted = self._predictor.predict(reference, state, applied, dt_s)
        (x, y, heading, vx, vy, yaw_rate), *_ = predicted
        ax, ay, ah = reference.acceleration
        kp, kd = self._to_error, self._to_rate
        desired = ax - kp * x - kd * vx, ay - kp * y - kd * vy, ah - kp * heading - kd * yaw_rate
        return self._predictor.command(desired, predicted)
