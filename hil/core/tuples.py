"""Makes the named tuples of a tick in C: a reference in an eighth of the time of calling its classes.

It is only for tuples that are made in each tick; elsewhere call the class. If the extension module cannot be loaded,
each call raises BadInputError with the reason: what needs no run, such as ``hil doctor``, works without it.
"""

from collections.abc import Callable
from typing import Any

from firmware_protocol.built import BuildError
from firmware_protocol.extension import wheel
from hil.core.errors import BadInputError
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Axes,
    CommandMode,
    FourWheels,
    Pairs,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)

_CLASSES = (Pose, Twist, Acceleration, Reference, PoseFix, State, Wheels, WheelCommand, LoopSignals)


class _Refusing:
    def __init__(self, reason: str) -> None:
        self._reason = reason

    def __getattr__(self, _name: str) -> Callable[..., Any]:
        def refuse(*_values: object) -> Any:
            raise BadInputError(self._reason)

        return refuse


def _tuples() -> Any:
    try:
        return wheel.Tuples(*_CLASSES, CommandMode.SPEED, CommandMode.TORQUE, ZERO_WHEELS)
    except BuildError as error:
        return _Refusing(str(error))


_made = _tuples()
make_loop_signals: Callable[[float, int, float, float, int], LoopSignals] = _made.loop_signals
make_wheels: Callable[[float, float, float, float], Wheels] = _made.wheels
make_command: Callable[[CommandMode, Wheels, Wheels], WheelCommand] = _made.command
make_state: Callable[[Pose, Twist], State] = _made.state
make_pose_fix: Callable[[Any], PoseFix] = _made.pose_fix
"""Of memory: the time [ns] in an int of 64 bits, and six doubles, x, y, heading and their rates."""
make_reference: Callable[..., Reference] = _made.reference
"""Of nine numbers: x, y, heading; their rates; their accelerations."""
make_speed_command: Callable[..., WheelCommand] = _made.speed_command
"""Of eight numbers: the four speeds [rad/s], and the torques [N·m] as feedforward."""
make_torque_command: Callable[[float, float, float, float], WheelCommand] = _made.torque_command
difference: Callable[[State, Reference], tuple[Pairs, float, Twist, Twist]] = wheel.difference
"""Return state minus reference, with the heading in [-π, π]; the heading; the reference's twist, and the state's."""
is_finite: Callable[[State], bool] = wheel.is_finite
"""Return whether all six numbers of a pose and its twist are finite."""
is_within: Callable[[FourWheels, float], bool] = wheel.is_within
"""Return whether every wheel is from minus the limit to the limit. NaN is not."""
wheel_torques: Callable[[Axes, tuple[float, float], Axes, Axes, float], FourWheels] = wheel.wheel_torques
"""Return ``RobotModel.wheel_torques`` without friction: of m + k, k and I + k L²; r and L; the rest as there."""
