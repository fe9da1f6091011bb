"""One tick: sense, estimate, refer, control, guard, command, tell. When it is due, its caller knows."""

from collections.abc import Callable, Sequence
from math import dist, isfinite
from typing import Any, NamedTuple

from hil.core.errors import HilError
from hil.core.guard import Brake, Guard
from hil.core.ports import Clock, Controller, FixSource, Note, OwnSignals, PoseSource, Sink
from hil.core.signals import LoopSignals
from hil.core.types import (
    NAN_WHEELS,
    ZERO_WHEELS,
    Applied,
    CommandMode,
    PoseFix,
    Reference,
    State,
    WheelCommand,
    make_applied,
)
from hil.estimation import LOST, Estimator
from hil.laws.shadows import Shadows
from hil.references import ReferenceSource
from hil.robot.link_times import CommandLatency
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.freshness import Freshness
from hil.runtime.row import RowWriter
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import SignalFaults
from hil.wire.statistics import LinkStatistics


class TickParts(NamedTuple):
    """What a tick is made of.

    ``note`` is told of losses and of what follows. ``robot_failure`` tells what has ended a robot in this process, None
    for any other. ``extra`` has the signals that are recorded behind those of the vocabulary.
    """

    clock: Clock
    device: Device
    wire: LinkStatistics
    truth: PoseSource | None
    fixes: FixSource | None
    estimator: Estimator
    reference: ReferenceSource
    controller: Controller
    guard: Guard
    brake: Brake
    sinks: Sequence[Sink]
    note: Note
    robot_failure: Callable[[], HilError | None]
    faults: SignalFaults | None = None
    shadows: Shadows | None = None
    extra: Sequence[OwnSignals] = ()


Sensed = tuple[Feedback, State | None]
"""What a tick knows of the robot; the state is None where nothing sure is known."""
_Asked = tuple[State, float, bool]
"""With what a law is asked: the state, dt [s], and whether it was reset for this tick."""


class Tick:
    """Does one tick after another of a robot that is driven, and tells of each in one row.

    Either ``sense`` and then ``drive``, or, for a robot that is not to be driven or not there, ``record_away``.

    The law is told the latency: in lockstep that of the scenario's ``[link]``, so that a fault that delays
    frames is unknown to it there; in real time what the link is measured to have, faults and all.

    Attributes:
        count: ticks that were told of.
        is_stale: whether the last tick held the robot at rest because its feedback was too old, or a truth on which
            the state rests. In TORQUE mode it is braked by its wheel speeds; while they too are old, no torque holds
            it, and it coasts.
    """

    def __init__(self, parts: TickParts, mode: CommandMode, timing: Timing) -> None:
        self._take(parts)
        self._timing = timing
        self._period_ns = timing.period_ns
        self._is_lockstep = parts.device.is_lockstep
        self._rows = self._make_rows()
        self._freshness = Freshness(parts.clock, parts.device, parts.faults, timing)
        self._rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self._nothing = WheelCommand(mode, NAN_WHEELS, NAN_WHEELS)
        self._latency = CommandLatency(timing.latency_s, timing.stale_ns)
        self._applied = Applied(self._rest, False, timing.latency_s)
        self._before: int | None = None  # the tick before, of this session of the law; None where it has not begun
        self.count = 0
        self.is_stale = False

    def sense(self, t_s: float, fix: PoseFix | None, active: bool = True) -> Sensed:
        """Take what has arrived and estimate; ``fix`` is the truth of the sampling instant.

        Raises RobotStoppedError or DeviceError for a robot that is not ACTIVE, LinkError for one that is lost. One that
        need not be ``active`` is only stopped when it was reset.
        """
        fixes = self._fixes
        feedback = self._freshness.poll(t_s, fix if self._uses_truth else None, active)
        measured = fixes.poll(self._freshness.robot_now_ns(feedback), fix) if fixes is not None else ()
        return feedback, self._estimator.update(feedback, fix, measured)

    def drive(self, now: LoopSignals, fix: PoseFix | None, sensed: Sensed, reference: Reference) -> None:
        """Control, guard, command, tell. Raises LinkError when the link is lost."""
        feedback, state = sensed
        faults, status, tick = self._faults, self._estimator.status, now.tick
        if faults is not None:
            state, reference = faults.state(state), faults.reference(reference)
        if state is not None:
            pose, twist = state
            if not isfinite(dist(pose, twist)):  # one call for all six: a distance between what is no number is none
                state = None  # no law is asked with it: what it integrates would be no number for ever
        self.is_stale = is_stale = self._freshness.is_stale or (not self._is_lockstep and self._freshness.has_aged())
        if state is None or status.health == LOST or is_stale:
            asked = None
            measured = None if self._freshness.is_silent() else feedback.speed_rad_s
            command, saturated = self._parts.brake.command(measured)
            self._before = None  # after a hold the law begins anew: what it has integrated and awaits is of before it
        else:
            before = self._before
            if before is not None and (tick - before) * self._period_ns > self._timing.stale_ns:
                before = None  # nothing was commanded for so long, and no law integrates over it
            begins = before is None
            if before is None:
                self._controller.reset(state, reference)
                self._before = before = tick - 1
            dt_s = (tick - before) * self._period_ns * 1e-9
            asked = state, dt_s, begins
            wanted = self._controller.update(reference, state, self._applied, dt_s)
            self._before = tick
            if faults is not None:
                wanted = faults.command(wanted)
            command, saturated = self._guard.apply(wanted)
        sequence = self._device.send(command)
        if not self._is_lockstep:
            self._measure_latency(sequence, feedback)
        if self._shadows is not None:
            self._ask_shadows(self._shadows, now.t_s, reference, asked)
        self._applied = applied = make_applied((command, saturated, self._latency.s))
        silent_ns, is_held = self._freshness.silent_ns, asked is None
        self._rows.write(
            tick=now,
            feedback=feedback,
            silent_ns=silent_ns,
            fix=fix,
            state=state,
            reference=reference,
            applied=applied,
            estimator=status,
            is_held=is_held,
        )
        self.count += 1

    def record_away(
        self, now: LoopSignals, fix: PoseFix | None, reference: Reference, state: State | None = None
    ) -> None:
        """Tell of a tick in which nothing is commanded: what is heard of the robot, which may be nothing."""
        parts = self._parts
        self.is_stale = False
        if parts.shadows is not None:
            parts.shadows.hold()
        applied = Applied(self._nothing, False, self._latency.s)
        status, silent_ns = parts.estimator.status, self._freshness.silent_ns
        self._rows.write(
            tick=now,
            feedback=parts.device.feedback,
            silent_ns=silent_ns,
            fix=fix,
            state=state,
            reference=reference,
            applied=applied,
            estimator=status,
            is_held=True,
        )
        self.count += 1
        self._before = None

    @property
    def parts(self) -> TickParts:
        """What the ticks are made of."""
        return self._parts

    @property
    def is_held(self) -> bool:
        """Whether the last tick held the robot at rest, or was told of without driving it."""
        return self._before is None

    @property
    def feedback_age_ms(self) -> float:
        """How long the newest feedback had been the newest at the last tick, and on its way before."""
        return (self._freshness.silent_ns + self._timing.feedback_latency_ns) * 1e-6

    def keep_armed(self) -> None:
        """Command zeros until the first feedback is here; no tick that is told of. Raises as ``sense``."""
        self._parts.device.poll()
        self._parts.device.send(self._rest)

    def begin(self) -> None:
        """Let the law begin anew, with a robot that has just become ACTIVE."""
        self._before = None
        self._heed_limits()
        self._latency.restart()
        self._applied = Applied(self._rest, False, self._latency.s)

    def restart(self) -> None:
        """Begin anew with a robot that was lost or stopped and is heard again."""
        self.begin()
        was_reset = self._freshness.restart()
        if was_reset or not self._device.keeps_counts:
            self._estimator.restart()
        if was_reset and self._fixes is not None:
            self._fixes.restart()

    def use(self, parts: TickParts) -> None:
        """Go on with other laws."""
        self._take(parts)
        self._rows = self._make_rows()
        self._before = None

    def raise_robot_failure(self) -> None:
        """Raise what ended a robot in this process: one whose plant has failed cannot come back."""
        if (failure := self._parts.robot_failure()) is not None:
            raise failure

    def skip_fixes(self) -> None:
        """Let go of pose fixes that nothing can be made of, without a robot."""
        if self._parts.fixes is not None:
            self._parts.fixes.skip()

    def pose_fixes(self) -> dict[str, Any] | None:
        """Return where pose fixes were lost, from the source to the filter; None where none are taken."""
        fixes = self._parts.fixes
        return None if fixes is None else {**fixes.figures(), **self._parts.estimator.fix_figures()}

    def _take(self, parts: TickParts) -> None:
        self._parts = parts
        # What every tick asks: an attribute takes less time than a field of a tuple.
        self._device, self._fixes, self._estimator = parts.device, parts.fixes, parts.estimator
        self._controller, self._guard = parts.controller, parts.guard
        self._faults, self._shadows = parts.faults, parts.shadows
        self._uses_truth = parts.estimator.uses_truth
        self._heed_limits()

    def _heed_limits(self) -> None:
        """Limit commands to what the robot, which may have just answered, says that it takes."""
        limit_rad_s = self._device.speed_limit_rad_s
        self._guard.heed(limit_rad_s)
        if self._shadows is not None:
            self._shadows.heed(limit_rad_s)

    def _make_rows(self) -> RowWriter:
        parts = self._parts
        latency_ns = self._timing.feedback_latency_ns
        return RowWriter(parts.device, parts.wire, parts.controller, parts.extra, parts.sinks, latency_ns, parts.faults)

    def _ask_shadows(self, shadows: Shadows, t_s: float, reference: Reference, asked: _Asked | None) -> None:
        """Compute the shadows: after the command has gone, from what the law in command was told."""
        if asked is None:
            shadows.hold()
        else:
            state, dt_s, begins = asked
            for sentence in shadows.update(t_s, reference, state, self._applied, dt_s, begins=begins):
                self._parts.note(t_s, "warning", sentence)

    def _measure_latency(self, sequence: int, feedback: Feedback) -> None:
        """Real time: note on what the command rests, and how late the one acted that the robot says is in force.

        A state that rests on the truth is as old as that, else as the feedback.
        """
        truth_ns = self._freshness.truth_ns
        self._latency.acted(feedback.command_sequence, feedback.robot_time_ns, feedback.command_age_ms)
        self._latency.sent(sequence, feedback.robot_time_ns if truth_ns is None else truth_ns)
