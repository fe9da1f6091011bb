"""Makes the named tuples of a tick in the host library: a reference in an eighth of the time of calling its classes.

It is only for tuples that are made in each tick; elsewhere call the class. If the library cannot be loaded, each
call raises BadInputError with the reason: what needs no run, such as ``hil doctor``, works without it.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from firmware_protocol.built import BuildError
from firmware_protocol.fast_calls import fast_call
from firmware_protocol.fast_tuples import Argument, Object, Tuple, tuple_constructor
from hil.core.errors import BadInputError
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Applied,
    Axes,
    CommandMode,
    FourWheels,
    Pairs,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)

_Kind = TypeVar("_Kind")


def _constructor(what: Tuple) -> Callable[..., Any]:
    try:
        return tuple_constructor(what)
    except BuildError as error:
        return _refusing(str(error))


def _refusing(reason: str) -> Callable[..., Any]:
    def refuse(*_values: object) -> Any:
        raise BadInputError(reason)

    return refuse


def _function(name: str) -> Callable[..., Any]:
    try:
        return fast_call(name)
    except BuildError as error:
        return _refusing(str(error))


def constructor_of(kind: type[_Kind]) -> Callable[..., _Kind]:
    """Return a function that makes named tuples of a class, of a value for each field in their order."""
    return _constructor(Tuple(kind, (Argument(),) * len(kind._fields)))  # type: ignore[attr-defined]


_THREE, _FOUR = (Argument(),) * 3, (Argument(),) * 4
_MOTION = Tuple(Reference, (Tuple(Pose, _THREE), Tuple(Twist, _THREE), Tuple(Acceleration, _THREE)))
_SPEED = Tuple(WheelCommand, (Object(CommandMode.SPEED), Tuple(Wheels, _FOUR), Tuple(Wheels, _FOUR)))
_TORQUE = Tuple(WheelCommand, (Object(CommandMode.TORQUE), Object(ZERO_WHEELS), Tuple(Wheels, _FOUR)))

make_loop_signals: Callable[[float, int, float, float, int], LoopSignals] = constructor_of(LoopSignals)
make_wheels: Callable[[float, float, float, float], Wheels] = constructor_of(Wheels)
make_command: Callable[[CommandMode, Wheels, Wheels], WheelCommand] = constructor_of(WheelCommand)
make_state: Callable[[Pose, Twist], State] = constructor_of(State)
make_applied: Callable[[WheelCommand, bool, float], Applied] = constructor_of(Applied)
make_reference: Callable[..., Reference] = _constructor(_MOTION)
"""Of nine numbers: x, y, heading; their rates; their accelerations."""
make_speed_command: Callable[..., WheelCommand] = _constructor(_SPEED)
"""Of eight numbers: the four speeds [rad/s], and the torques [N·m] as feedforward."""
make_torque_command: Callable[[float, float, float, float], WheelCommand] = _constructor(_TORQUE)
difference: Callable[[State, Reference], tuple[Pairs, float, Twist, Twist]] = _function("difference")
"""Return state minus reference, with the heading in [-π, π]; the heading; the reference's twist, and the state's."""
wheel_torques: Callable[[Axes, tuple[float, float], Axes, Axes, float], FourWheels] = _function("wheel_torques")
"""Return ``RobotModel.wheel_torques`` without friction: of m + k, k and I + k L²; r and L; the rest as there."""
is_finite: Callable[[State], bool] = _function("finite")
"""Return whether all six numbers of a pose and its twist are finite."""
is_within: Callable[[FourWheels, float], bool] = _function("within")
"""Return whether every wheel is from minus the limit to the limit. NaN is not."""
