"""Make the named tuples of a tick in the host library: a reference in an eighth of the time of calling its classes.

Only what is made in each tick is made so; elsewhere call the class. The import raises BadInputError when the library
cannot be built or loaded.
"""

from collections.abc import Callable

from firmware_protocol.built import BuildError
from firmware_protocol.fast_tuples import Argument, Object, Tuple, tuple_maker
from hil.core.errors import BadInputError
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)

_THREE, _FOUR = (Argument(),) * 3, (Argument(),) * 4
_MOTION = Tuple(Reference, (Tuple(Pose, _THREE), Tuple(Twist, _THREE), Tuple(Acceleration, _THREE)))
_SPEED = Tuple(WheelCommand, (Object(CommandMode.SPEED), Tuple(Wheels, _FOUR), Tuple(Wheels, _FOUR)))
_TORQUE = Tuple(WheelCommand, (Object(CommandMode.TORQUE), Object(ZERO_WHEELS), Tuple(Wheels, _FOUR)))

try:
    make_loop_signals: Callable[[float, int, float, float, int], LoopSignals] = tuple_maker(
        Tuple(LoopSignals, (Argument(),) * 5)
    )
    make_state: Callable[[Pose, Twist], State] = tuple_maker(Tuple(State, (Argument(),) * 2))
    make_applied: Callable[[WheelCommand, bool, float], Applied] = tuple_maker(Tuple(Applied, _THREE))
    make_reference: Callable[..., Reference] = tuple_maker(_MOTION)
    """Of nine numbers: x, y, heading; their rates; their accelerations."""
    make_speed_command: Callable[..., WheelCommand] = tuple_maker(_SPEED)
    """Of eight numbers: the four speeds [rad/s], and the torques [N·m] as feedforward."""
    make_torque_command: Callable[[float, float, float, float], WheelCommand] = tuple_maker(_TORQUE)
except BuildError as error:
    raise BadInputError(str(error)) from error
