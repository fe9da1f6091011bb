"""One tick: sense, estimate, control, guard, command, and write the row. The caller decides when it is due."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hil.core.errors import HilError
from hil.core.guard import Brake, Guard
from hil.core.model import RobotModel
from hil.core.ports import Clock, Controller, FixSource, Note, OwnSignals, PoseSource, Sink
from hil.core.signals import LoopSignals
from hil.core.tuples import is_finite, make_applied
from hil.core.types import (
    NAN_WHEELS,
    ZERO_WHEELS,
    Applied,
    CommandMode,
    PoseFix,
    Reference,
    State,
    WheelCommand,
)
from hil.estimation.measurement import LOST, Estimator
from hil.laws.shadows import Shadows
from hil.references import ReferenceSource
from hil.robot.link_times import CommandLatency
from hil.robot.motion_echo import MotionEcho
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.freshness import Freshness
from hil.runtime.row import RowWriter
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import SignalFaults
from hil.wire.statistics import LinkStatistics


class TickParts(NamedTuple):
    """The parts that a tick uses.

    Attributes:
        note: writes a line of the event log, such as a loss.
        robot_failure: returns the error that ended the robot in this process, or None.
        signals: the names of what a row has, in their order.
        extra: parts with signals of their own, besides those of ``hil.core.signals``.
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
    model: RobotModel
    signals: Sequence[str]
    robot_failure: Callable[[], HilError | None]
    faults: SignalFaults | None = None
    shadows: Shadows | None = None
    extra: Sequence[OwnSignals] = ()


Sensed = tuple[Feedback, State | None]
"""The newest feedback, and the state of the robot; None where the estimator has none."""
_LawInputs = tuple[State, float, bool]
"""The arguments of a law: the state, dt [s], and whether it was reset for this tick."""


class Tick:
    """Does one tick after another, and writes a row for each.

    A tick is ``sense``, then ``drive``. If the robot must not be driven, ``record_away`` replaces ``drive``; if it is
    not connected, it replaces both.

    The law is told the latency. It is measured, so it includes faults: by the robot's word on commands or, in TORQUE
    mode of a robot that acknowledges none, by its motion. Until it is, it is the sum of the scenario's ``[link]``
    latencies.

    Attributes:
        count: ticks that have a row.
        is_stale: whether the last tick stopped the robot because its feedback was too old, or the true pose that the
            estimate uses. In TORQUE mode the brake then needs the wheel speeds; if these are too old as well, no torque
            is commanded and the robot coasts.
        is_held: whether the last tick did not call the law: the robot was stopped, or only recorded.
    """

    def __init__(self, parts: TickParts, mode: CommandMode, timing: Timing) -> None:
        self._mode = mode
        self._set_parts(parts)
        self._timing = timing
        self._period_s = timing.period_ns * 1e-9
        self._is_lockstep = parts.device.is_lockstep
        self._rows = self._make_rows()
        self._freshness = Freshness(parts.clock, parts.device, parts.faults, timing)
        self._rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self._nothing = WheelCommand(mode, NAN_WHEELS, NAN_WHEELS)
        self._latency = CommandLatency(timing.latency_s, timing.stale_ns)
        self._measure_latency = self._latency.measure
        self._latency_s = timing.latency_s
        self._echo: MotionEcho | None = None
        if mode is CommandMode.TORQUE and not parts.device.acknowledges:
            self._echo = MotionEcho(parts.model, timing.latency_s)
        self._applied = Applied(self._rest, False, timing.latency_s)
        self._before: int | None = None  # the law's last tick; None before its first and before a reset
        self.count = 0
        self.is_stale = False
        self.is_held = True

    def sense(self, t_s: float, fix: PoseFix | None, active: bool = True) -> Sensed:
        """Read the newest feedback and update the estimate; ``fix`` is the true pose when sampled, or None.

        Raises RobotStoppedError or DeviceError for a robot that is not ACTIVE, LinkError for one that is lost. With
        ``active=False`` any state is allowed; RobotStoppedError then means a reset or no feedback.
        """
        fixes = self._fixes
        feedback = self._freshness.poll(t_s, fix if self._uses_truth else None, active)
        measured = fixes.poll(self._freshness.robot_now_ns(feedback), fix) if fixes is not None else ()
        return feedback, self._estimator.update(feedback, fix, measured)

    def drive(self, now: LoopSignals, fix: PoseFix | None, sensed: Sensed, reference: Reference) -> None:
        """Call the law, guard and send its command, and write the row. Raises LinkError when the link is lost."""
        feedback, state = sensed
        faults, status, tick = self._faults, self._estimator.status, now.tick
        if faults is not None:
            state, reference = faults.state(state), faults.reference(reference)
        if state is not None and not is_finite(state):
            state = None  # a law that integrates it would return NaN from then on
        freshness, measure_latency = self._freshness, self._measure_latency
        self.is_stale = is_stale = freshness.is_stale or (not self._is_lockstep and freshness.has_aged())
        # The state is as old as the truth if the estimate uses it, otherwise as old as the feedback.
        truth_ns, at_ns = freshness.truth_ns, feedback.robot_time_ns
        sampled_ns = at_ns if truth_ns is None else truth_ns
        if state is None or status.health == LOST or is_stale:
            inputs = None
            measured = None if freshness.is_silent() else feedback.speed_rad_s
            command, saturated = self._parts.brake.command(measured)
            self._before = None  # the law is reset after a stop: its integrated state is out of date
        else:
            dt_s, begins = self._period_s, False
            if self._before != tick - 1:
                dt_s, begins = self._since_the_law(tick)
                if begins:
                    self._controller.reset(state, reference)
            inputs = state, dt_s, begins
            requested = self._controller.update(reference, state, self._applied, dt_s)
            self._before = tick
            if faults is not None:
                requested = faults.command(requested)
            command, saturated = self._guard.apply(requested)
            if self._fades:
                older_s = 1e-9 * (sampled_ns - at_ns) if sampled_ns > at_ns else 0.0
                command, saturated = self._guard.fade(
                    command, saturated, feedback.speed_rad_s, at_ns, state, self._latency_s, older_s
                )
        sequence = self._device.send(command)
        latency_s = measure_latency(feedback, sequence, sampled_ns)
        if self._echo is not None and inputs is not None:
            latency_s = self._echo.update(command.torque_n_m, inputs[0], sampled_ns, is_limited=saturated)
        self._latency_s = latency_s
        if self._shadows is not None:
            self._update_shadows(self._shadows, now.t_s, reference, inputs)
        self._applied = applied = make_applied(command, saturated, latency_s)
        self.is_held = is_held = inputs is None
        self._rows.write(now, feedback, freshness.silent_ns, fix, state, reference, applied, status, is_held)
        self.count += 1

    def _since_the_law(self, tick: int) -> tuple[float, bool]:
        """Return the time since the law's last tick [s], and whether it begins: it is to be reset then."""
        before = self._before
        if before is None or (tick - before) * self._timing.period_ns > self._timing.stale_ns:
            return self._period_s, True  # after no command for so long the law must not integrate over the gap
        return (tick - before) * self._timing.period_ns * 1e-9, False

    def record_away(
        self, now: LoopSignals, fix: PoseFix | None, reference: Reference, state: State | None = None
    ) -> None:
        """Write the row of a tick in which nothing is commanded, with the newest feedback, if any."""
        parts = self._parts
        self.is_stale, self.is_held = False, True
        if parts.shadows is not None:
            parts.shadows.hold()
        applied = Applied(self._nothing, False, self._latency_s)
        status, silent_ns = parts.estimator.status, self._freshness.silent_ns
        self._rows.write(now, parts.device.feedback, silent_ns, fix, state, reference, applied, status, True)
        self.count += 1
        self._before = None

    @property
    def parts(self) -> TickParts:
        """The parts that the ticks use."""
        return self._parts

    @property
    def feedback_age_ms(self) -> float:
        """Age of the newest feedback at the last tick: time since it arrived, plus the link's feedback latency."""
        return (self._freshness.silent_ns + self._timing.feedback_latency_ns) * 1e-6

    def keep_armed(self) -> None:
        """Command zeros until the first feedback arrives; write no row. Raises LinkError when the link is lost."""
        self._parts.device.poll()
        self._parts.device.send(self._rest)

    def begin(self) -> None:
        """Reset the law for a robot that has just become ACTIVE."""
        self._before = None
        self._update_limits()
        self._latency.restart()
        if self._echo is not None:
            self._echo.restart()
        self._applied = Applied(self._rest, False, self._latency_s)

    def restart(self) -> None:
        """Start again with a robot that was lost or stopped and answers again."""
        self.begin()
        was_reset = self._freshness.restart()
        if was_reset or not self._device.keeps_counts:
            self._estimator.restart()
        if was_reset and self._fixes is not None:
            self._fixes.restart()

    def use(self, parts: TickParts) -> None:
        """Continue with other laws."""
        self._set_parts(parts)
        self._rows = self._make_rows()
        self._before = None

    def raise_robot_failure(self) -> None:
        """Raise the error that ended a robot in this process: after a plant failure it cannot come back."""
        if (failure := self._parts.robot_failure()) is not None:
            raise failure

    def skip_fixes(self) -> None:
        """Drop the pose fixes of this tick, which cannot be used without the robot."""
        if self._parts.fixes is not None:
            self._parts.fixes.skip()

    def pose_fixes(self) -> dict[str, Any] | None:
        """Return the counts of pose fixes, from the source to the filter; None if none are used."""
        fixes = self._parts.fixes
        return None if fixes is None else {**fixes.figures(), **self._parts.estimator.fix_figures()}

    def _set_parts(self, parts: TickParts) -> None:
        self._parts = parts
        self._device, self._fixes, self._estimator = parts.device, parts.fixes, parts.estimator
        self._controller, self._guard = parts.controller, parts.guard
        self._faults, self._shadows = parts.faults, parts.shadows
        self._uses_truth = parts.estimator.uses_truth
        self._update_limits()

    def _update_limits(self) -> None:
        """Limit commands to the wheel speed that the robot accepts; after a reconnection it may be another robot."""
        limit_rad_s = self._device.speed_limit_rad_s
        self._guard.limit_to(limit_rad_s, self._device.overspeed_rad_s)
        self._fades = self._mode is CommandMode.TORQUE and self._guard.follows
        if self._shadows is not None:
            self._shadows.limit_to(limit_rad_s)

    def _make_rows(self) -> RowWriter:
        parts = self._parts
        latency_ns = self._timing.feedback_latency_ns
        return RowWriter(
            parts.signals,
            parts.device,
            parts.wire,
            parts.controller,
            self._mode,
            parts.extra,
            parts.sinks,
            latency_ns,
            parts.faults,
        )

    def _update_shadows(self, shadows: Shadows, t_s: float, reference: Reference, inputs: _LawInputs | None) -> None:
        """Compute the shadow laws from the same arguments, after the command was sent."""
        if inputs is None:
            shadows.hold()
        else:
            state, dt_s, begins = inputs
            for sentence in shadows.update(t_s, reference, state, self._applied, dt_s, begins=begins):
                self._parts.note(t_s, "warning", sentence)
