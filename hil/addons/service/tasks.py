"""The tasks of an ACTIVE robot, one at a time; each starts and ends at rest. Pure: no clock, no input or output."""

import math
from collections.abc import Callable

from hil.addons.service.messages import Task
from hil.addons.service.motions import STILL, Follow, TwistMotion, frame_at, way_to
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist
from hil.core.ports import Controller
from hil.core.types import (
    NAN_POSE,
    ZERO_WHEELS,
    Applied,
    CommandMode,
    FourWheels,
    Pairs,
    Pose,
    Reference,
    State,
    WheelCommand,
    Wheels,
)
from hil.references import ReferenceSource
from hil.references.source import at_rest
from hil.scenario import ServiceTable

NOWHERE = at_rest(NAN_POSE)
"""The reference of a robot without a task."""

Motion = TwistMotion | Follow


class Tasks:
    """The tasks of a robot from ``begin`` to ``end``. Orders are given between two ticks.

    Attributes:
        task: the present task, or None outside ``begin`` to ``end``. reference: that of the last tick, None before the
            first. wheels: the command of a law elsewhere [rad/s or N·m], while the task is WHEELS.
        sequence: of the last wheel command, if it had one.
        gave_up: why a task was ended and the robot stopped; the reader sets it to None again.
    """

    def __init__(self, options: ServiceTable) -> None:
        self._options = options
        self._t_s = 0.0
        self._state: State | None = None
        self._motion: Motion | None = None
        self._after_rest: Callable[[Reference], Motion] | None = None
        self._until_s = -math.inf  # of the twist or the wheel command
        self._newest = -1  # sequence of wheel commands since ``begin``
        self.wheels: FourWheels | None = None
        self.sequence: int | None = None
        self.task: Task | None = None
        self.reference: Reference | None = None
        self.gave_up: str | None = None

    def begin(self) -> None:
        """Start with the task HOLD: the robot rests where it is."""
        self.end()
        self._newest = -1
        self.task = Task.HOLD

    def end(self) -> None:
        """End the task and forget the motion."""
        self._motion = self._after_rest = self._state = self.wheels = None
        self.task = self.reference = self.gave_up = None

    @property
    def twist_age_s(self) -> float | None:
        """Age of the twist in force; None if there is none."""
        if self.task is not Task.TWIST:
            return None
        return self._t_s - (self._until_s - self._options.twist_timeout_s)

    # Orders. Each raises BadInputError if the robot's pose is not known.

    def stop(self) -> None:
        """Ramp down to rest and hold."""
        self._rest()
        self.task = Task.HOLD

    def twist(self, twist: BodyTwist) -> BodyTwist:
        """Drive by a twist for ``twist_timeout_s``; return the twist, scaled to the limits."""
        drive = self._motion if self.task is Task.TWIST and isinstance(self._motion, TwistMotion) else self._rest()
        self.task = Task.TWIST
        self._until_s = self._t_s + self._options.twist_timeout_s
        return drive.set_target(twist)

    def command_wheels(self, wheels: FourWheels, sequence: int | None) -> None:
        """Command the wheels for ``twist_timeout_s`` as a law elsewhere asks for it.

        With a ``sequence`` number a command must be newer than all since ``begin``. Raises BadInputError for another.
        """
        if sequence is not None and sequence <= self._newest:
            raise BadInputError(
                f"sequence = {sequence}: it came after {self._newest}; count on, or disarm and arm to count anew"
            )
        if self.task is not Task.WHEELS:
            self._rest()
        self._newest = self._newest if sequence is None else sequence
        self.task, self.wheels, self.sequence = Task.WHEELS, wheels, sequence
        self._until_s = self._t_s + self._options.twist_timeout_s

    def track(self, path: ReferenceSource, *, here: bool) -> None:
        """Follow a path once the robot rests: shifted to its pose (``here``), or from the path's start in the world."""
        begin = path.at(0.0).pose

        def follow(at: Reference) -> Motion:
            if here:
                return Follow(path, self._t_s, frame=frame_at(at.pose, begin))
            return Follow(path, self._t_s, way_to(at.pose, begin, self._options))

        self._rest()
        self.task, self._after_rest = Task.TRACK, follow

    def go(self, pose: Pose) -> None:
        """Go to a pose in the world once the robot rests, and hold there."""

        def follow(at: Reference) -> Motion:
            way = way_to(at.pose, pose, self._options)
            return Follow(way, self._t_s) if way is not None else self._hold(at)

        self._rest()
        self.task, self._after_rest = Task.GO, follow

    # The tick

    def at(self, t_s: float, state: State | None) -> Reference:
        """Return the reference of this tick for the robot's state; NOWHERE as long as no state was ever known."""
        self._t_s, self._state = t_s, state
        pose = state.pose if state is not None else None
        self.reference = self._where(pose)
        limit_m = self._options.error_limit_m
        if pose is not None and math.dist(self.reference.pose[:2], pose[:2]) > limit_m:
            self.give_up(f"the robot is more than {limit_m:g} m from where it should be")
            self.reference = self._where(pose)
        return self.reference

    def held(self) -> None:
        """Give up the task, because the law was not called in this tick and the robot was stopped."""
        if self._motion is not None:
            self.give_up("the robot was stopped: its feedback or pose is too old, or the estimate not sure enough")

    def give_up(self, why: str) -> None:
        """End the task; the robot holds its position."""
        self.gave_up = why
        self._motion = self._after_rest = self.reference = self.wheels = None
        self.task = Task.HOLD

    def _where(self, pose: Pose | None) -> Reference:
        if self._motion is None:
            if pose is None:
                return NOWHERE
            self._motion = self._hold(at_rest(pose))
        if self.task in (Task.TWIST, Task.WHEELS) and self._t_s > self._until_s:
            self.stop()
        if self.task is Task.WHEELS and self._state is not None:
            # Nobody here knows where it should be; when the commands end it ramps down from its present motion.
            return Reference(*self._state, STILL)
        reference = self._motion.at(self._t_s, pose)
        if self._after_rest is not None and isinstance(self._motion, TwistMotion) and self._motion.rests:
            self._motion, self._after_rest = self._after_rest(reference), None
        return reference

    def _hold(self, at: Reference) -> TwistMotion:
        return TwistMotion(at, self._t_s, self._options)

    def _rest(self) -> TwistMotion:
        """Start to ramp down from the present motion, and return the motion that does so."""
        at = self.reference or NOWHERE
        if not math.isfinite(sum(at.pose)):
            if self._state is None:
                raise BadInputError("the robot's pose is not known; wait until the status has a pose")
            at = at_rest(self._state.pose)
        self._after_rest = self.wheels = None
        self._motion = drive = self._hold(at)
        return drive


class LawElsewhere:
    """A controller that returns the wheel commands of a law elsewhere while there are any, else those of ``law``."""

    def __init__(self, law: Controller, tasks: Tasks, mode: CommandMode) -> None:
        self._law = law
        self._tasks = tasks
        self._mode = mode
        self._was_elsewhere = False

    @property
    def gains(self) -> Pairs:
        """Gains of the law that is here."""
        return self._law.gains

    def reset(self, state: State, reference: Reference) -> None:
        """Reset the law that is here."""
        self._law.reset(state, reference)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick; the law that is here starts anew when it takes over."""
        if (wheels := self._tasks.wheels) is not None:
            self._was_elsewhere = True
            if self._mode is CommandMode.SPEED:
                return WheelCommand(self._mode, Wheels(*wheels), ZERO_WHEELS)
            return WheelCommand(self._mode, ZERO_WHEELS, Wheels(*wheels))
        if self._was_elsewhere:
            self._was_elsewhere = False
            self._law.reset(state, reference)
        return self._law.update(reference, state, applied, dt_s)
