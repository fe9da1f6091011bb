"""One tick: sense, estimate, control, guard, command, and write the row. The caller decides when it is due."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from hil.core.errors import HilError
from hil.core.guard import Brake, Guard
from hil.core.ports import Clock, Controller, FixSource, Note, OwnSignals, PoseSource, Sink
from hil.core.signals import LoopSignals
from hil.core.tuples import is_finite
from hil.core.types import (
    DRIVEN,
    HELD,
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
from hil.references import ReferenceSource
from hil.robot.link_times import CommandLatency
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.events import Takings
from hil.runtime.freshness import Freshness
from hil.runtime.row import RowWriter
from hil.runtime.sampling import Timing
from hil.wire.link_statistics import LinkStatistics

if TYPE_CHECKING:
    from hil.runtime.signal_faults import SignalFaults


class TickParts(NamedTuple):
    """The parts that a tick uses.

    Attributes:
        note: writes a line of the event log, such as a loss.
        truth, fixes: sources of the true pose, and of a localisation's pose fixes; None without one.
        robot_failure: for a robot within this process: returns the error that ended it, or None.
        signals: the names of the values of a row, in their order.
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
    signals: Sequence[str]
    robot_failure: Callable[[], HilError | None]
    faults: "SignalFaults | None" = None
    extra: Sequence[OwnSignals] = ()


Sensed = tuple[Feedback, State | None]
"""The newest feedback, and the estimated state of the robot; None while the estimator has none."""


class Tick:
    """Does one tick after another, and writes a row for each.

    A tick is ``sense``, then ``drive``. If the robot must not be driven, ``record_away`` replaces ``drive``; if it is
    not connected, it replaces both. ``fix`` is everywhere the sampled true pose, not a pose fix of a localisation.

    The law gets the latency. It is measured by the robot's acknowledgement of commands, so it includes faults. Before
    the first measurement, and for a robot that sends none, it is the sum of the scenario's ``[link]`` latencies.

    Attributes:
        count: ticks that have a row.
        is_stale: whether the last tick stopped the robot because its feedback, or the true pose that the estimate uses,
            was too old. In TORQUE mode the brake then needs the wheel speeds; if these are too old as well, no torque
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
        self._latency_s = timing.latency_s
        self._applied = Applied(self._rest, False, timing.latency_s)
        self._before: int | None = None  # the law's last tick; None before its first and before a reset
        self.count = self._restarts = 0
        self.is_stale = False
        self.is_held = True

    def sense(self, t_s: float, fix: PoseFix | None, active: bool = True) -> Sensed:
        """Read the newest feedback and update the estimate; ``fix`` is None where no true pose was sampled.

        Raises RobotStoppedError or RobotLatchedError for a robot that is not ACTIVE, LinkError for one that is lost.
        With ``active=False`` any state is allowed; RobotStoppedError then means a reset or no feedback.
        """
        fixes = self._fixes
        feedback = self._freshness.poll(t_s, fix if self._uses_truth else None, active)
        measured = fixes.poll(self._freshness.robot_now_ns(feedback), fix) if fixes is not None else ()
        return feedback, self._estimator.update(feedback, fix, measured)

    def drive(self, now: LoopSignals, fix: PoseFix | None, sensed: Sensed, reference: Reference) -> None:
        """Call the law, guard and send its command, and write the row. Raises LinkError when the link is lost."""
        feedback, state = sensed
        faults, status, tick = self._faults, self._estimator.status, now.tick
        if status.fix_restarts > self._restarts:
            self._restarts = int(status.fix_restarts)
            words = f"the estimate began again from pose fixes that it had rejected: restart {self._restarts}"
            self._parts.note(now.t_s, "warning", words)
        if faults is not None:
            state, reference = faults.state(state), faults.reference(reference)
        if state is not None and not is_finite(state):
            state = None  # a law that integrates it would return NaN from then on
        freshness = self._freshness
        self.is_stale = is_stale = freshness.is_stale or (not self._is_lockstep and freshness.truth_has_aged())
        # The state is as old as the truth if the estimate uses it, otherwise as old as the feedback.
        truth_ns, at_ns = freshness.truth_ns, feedback.robot_time_ns
        sampled_ns = at_ns if truth_ns is None else truth_ns
        is_held = state is None or status.health == LOST or is_stale
        if state is None or is_held:
            measured = None if freshness.is_silent() else feedback.speed_rad_s
            command, saturated = self._parts.brake.command(measured)
            guarded = HELD
            self._before = None  # the law is reset after a stop: its integrated state is out of date
        else:
            dt_s, begins = self._period_s, False
            if self._before != tick - 1:
                dt_s, begins = self._since_the_law(tick)
                if begins:
                    self._controller.reset(state, reference)
            requested = self._controller.update(reference, state, self._applied, dt_s)
            self._before = tick
            if faults is not None:
                requested = faults.command(requested)
            command, saturated = self._guard.apply(requested)
            guarded = DRIVEN
            if self._fades:
                older_s = 1e-9 * (sampled_ns - at_ns) if sampled_ns > at_ns else 0.0
                command, saturated, guarded = self._guard.fade(
                    command, saturated, feedback.speed_rad_s, at_ns, state, self._latency_s, older_s
                )
                if guarded is not DRIVEN:
                    self._takings.add(now.t_s, guarded)
        sequence = self._device.send(command)
        self._applied = applied = self._latency.applied(feedback, sequence, sampled_ns, command, saturated)
        self._latency_s = applied.latency_s
        self.is_held = is_held
        self._rows.write(now, feedback, freshness.silent_ns, fix, state, reference, applied, status, guarded)
        self.count += 1

    def _since_the_law(self, tick: int) -> tuple[float, bool]:
        """Return the time since the law's last tick [s], and whether the law begins anew and has to be reset."""
        before = self._before
        if before is None or (tick - before) * self._timing.period_ns > self._timing.stale_ns:
            return self._period_s, True  # after this time without a command the law must not integrate over it
        return (tick - before) * self._timing.period_ns * 1e-9, False

    def record_away(
        self, now: LoopSignals, fix: PoseFix | None, reference: Reference, state: State | None = None
    ) -> None:
        """Write the row of a tick in which nothing is commanded, with the newest feedback, if any."""
        parts = self._parts
        self.is_stale, self.is_held = False, True
        applied = Applied(self._nothing, False, self._latency_s)
        status, silent_ns = parts.estimator.status, self._freshness.silent_ns
        self._rows.write(now, parts.device.feedback, silent_ns, fix, state, reference, applied, status, HELD)
        self.count += 1
        self._before = None

    @property
    def parts(self) -> TickParts:
        return self._parts

    @property
    def feedback_age_ms(self) -> float:
        """Age of the newest feedback at the last tick: time since it arrived, plus the link's feedback latency."""
        return (self._freshness.silent_ns + self._timing.feedback_latency_ns) * 1e-6

    def keep_armed(self) -> None:
        """Command zeros once, in place of a tick, before the first feedback; write no row. Raises LinkError."""
        self._parts.device.poll()
        self._parts.device.send(self._rest)

    def begin(self) -> None:
        """Reset the law for a robot that has just become ACTIVE."""
        self._before = None
        self._update_limits()
        self._latency.restart()
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
        """Continue with other parts, such as another law, which is reset."""
        self._set_parts(parts)
        self._rows = self._make_rows()
        self._before = None

    def raise_robot_failure(self) -> None:
        """Raise the error that ended a robot in this process: after a plant failure it cannot come back."""
        if (failure := self._parts.robot_failure()) is not None:
            raise failure

    def skip_fixes(self) -> None:
        """Drop the pose fixes of this tick: it cannot use them (``FixSource.skip``)."""
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
        self._takings = Takings(parts.note, parts.guard.why)
        self._faults = parts.faults
        self._uses_truth = parts.estimator.uses_truth
        self._update_limits()

    def _update_limits(self) -> None:
        """Limit commands to the wheel speed that the robot accepts; after a reconnection it may be another robot."""
        limit_rad_s = self._device.speed_limit_rad_s
        self._guard.limit_to(limit_rad_s, self._device.overspeed_rad_s)
        self._fades = self._mode is CommandMode.TORQUE and self._guard.follows

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
