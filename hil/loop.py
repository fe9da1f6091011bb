"""The tick: sense, estimate, refer, control, guard, command, tell. The same loop in lockstep and in real time."""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hil.brake import Brake
from hil.devices.link_times import CommandLatency
from hil.devices.snapshot import Feedback
from hil.devices.stm32 import Stm32
from hil.errors import DeviceError, HilError, LinkError, RobotStoppedError
from hil.estimator import LOST, Estimator
from hil.faults.signals import SignalFaults
from hil.freshness import Freshness
from hil.guard import Guard
from hil.lateness import Lateness
from hil.links.statistics import Statistics
from hil.ports import Clock, Controller, FixSource, OwnSignals, PoseSource, Sink
from hil.recovery import Recovered, Recovery
from hil.references import ReferenceSource
from hil.rows import Beliefs, Rows
from hil.sampling import Sampling, Timing
from hil.shadows import Shadows
from hil.signals import LoopSignals
from hil.types import NAN, NAN_WHEELS, ZERO_WHEELS, Applied, CommandMode, PoseFix, Reference, State, WheelCommand

_STOP_LIMIT_NS = 5_000_000_000


class Parts(NamedTuple):
    """What a tick is made of.

    ``robot_failure`` tells what has ended a robot in this process, None for any other. ``extra`` has the signals that
    are recorded behind those of the vocabulary.
    """

    clock: Clock
    device: Stm32
    wire: Statistics
    truth: PoseSource | None
    fixes: FixSource | None
    estimator: Estimator
    reference: ReferenceSource
    controller: Controller
    guard: Guard
    brake: Brake
    sink: Sink
    robot_failure: Callable[[], HilError | None]
    faults: SignalFaults | None = None
    shadows: Shadows | None = None
    extra: Sequence[OwnSignals] = ()


class Report(NamedTuple):
    """How the loop went. ``failure`` is what ended it, ``recoveries`` are the losses that were recovered from.

    ``stale`` counts ticks in which the robot was held at rest: for old feedback, an old truth where the state rests on
    it, or an estimator that is lost. In TORQUE mode it is braked by its wheel speeds; while they too are old, no torque
    holds it, and it coasts.
    """

    ticks: int
    deadline_misses: int
    stale: int
    robot_s: float
    wall_s: float
    stopped: bool
    failure: HilError | None
    recoveries: tuple[Recovered, ...]


class _Asked(NamedTuple):
    """With what a law is asked; ``begins`` where it was reset for this tick."""

    state: State
    dt_s: float
    begins: bool


class Loop:
    """Runs the tick at a fixed period for a given time.

    ``t`` = 0 is the first ACTIVE tick, and a tick's ``t`` is its sampling instant: with a feedback latency it is
    worked out so much later, when what was sampled then has arrived. A tick that would begin after the next one is
    due is skipped and counted, never made up in a burst.

    With ``rearm`` a lost link or a stopped robot does not end the run: it is brought back while the ticks go on, with
    nothing commanded, and the law begins anew at the reference of the present ``t``.

    The law is told the latency: in lockstep that of the scenario's ``[link]``, so that a fault that delays
    frames is unknown to it there; in real time what the link is measured to have, faults and all.
    """

    def __init__(self, parts: Parts, mode: CommandMode, timing: Timing, *, rearm: bool = False) -> None:
        self._parts = parts
        self._timing = timing
        self._rearm = rearm
        self._rows = Rows(
            parts.device, parts.wire, parts.controller, parts.extra, parts.sink, timing.feedback_latency_ns
        )
        self._sampling = Sampling(parts.clock, parts.device, parts.truth, timing)
        self._freshness = Freshness(parts.clock, parts.device, parts.faults, timing)
        self._recovery: Recovery | None = None
        self._recoveries: list[Recovered] = []
        self._rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self._nothing = WheelCommand(mode, NAN_WHEELS, NAN_WHEELS)
        self._latency = CommandLatency(timing.latency_s, timing.stale_ns)
        self._applied = Applied(self._rest, False, timing.latency_s)
        self._before: int | None = None  # the tick before, of this session of the law; None where it has not begun
        self._misses = 0
        self._ticks = 0
        self._stale = 0
        self._tick_us = NAN
        self.lateness = Lateness()
        self.t_s = 0.0

    def run(self, origin_ns: int, duration_ns: int) -> Report:
        """Run from the first ACTIVE tick at ``origin_ns`` on the clock, then stop the robot.

        What ends the run early is reported: a lost link or device, or a law that fails. Whatever it is, the robot is
        told to stop while it can be reached.
        """
        begin = time.perf_counter()
        failure: HilError | None = None
        try:
            self._run(origin_ns, duration_ns)
        except HilError as error:
            failure = error
        except BaseException:
            self._parts.device.disarm()
            with contextlib.suppress(HilError):
                self._stop()
            raise
        wall_s = time.perf_counter() - begin
        stopped = False
        try:
            # One that has not come back is not waited for, and may be somebody else's.
            if isinstance(failure, DeviceError | LinkError) or self._recovery is not None:
                self._parts.device.disarm()
            else:
                stopped = self._stop()
                failure = failure or (None if stopped else DeviceError("the robot did not come to rest within 5 s"))
        except HilError as error:
            failure = failure or error
        robot_s = self.t_s + self._timing.period_ns * 1e-9 if self._ticks else 0.0
        recoveries = tuple(self._recoveries)
        return Report(self._ticks, self._misses, self._stale, robot_s, wall_s, stopped, failure, recoveries)

    @property
    def commands_refused(self) -> int:
        """Commands of the law that were no numbers, each replaced by a stop."""
        return self._parts.guard.refused

    def pose_fixes(self) -> dict[str, Any] | None:
        """Return where pose fixes were lost, from the source to the filter; None where none are taken."""
        fixes = self._parts.fixes
        return None if fixes is None else {**fixes.figures(), **self._parts.estimator.fix_figures()}

    def _stop(self) -> bool:
        return self._parts.device.stop(self._timing.period_ns, _STOP_LIMIT_NS)

    def _run(self, origin_ns: int, duration_ns: int) -> None:
        timing = self._timing
        ticks = -(-duration_ns // timing.period_ns)
        number = self._sampling.begin(origin_ns)
        self._skip_fixes()
        in_vain: set[bool] = set()  # since time has passed: waits that ended with a lost link, and a stopped robot
        while number < ticks:
            try:
                late_ns = self._sampling.wait(number)
            except (LinkError, RobotStoppedError) as error:
                self._wait_again(error, in_vain)
                continue
            in_vain.clear()
            if number < 0:
                self._keep_armed()
            else:
                self._tick(number, late_ns)
            following = self._sampling.following(number)
            # Those of the run alone, also where none comes after them to be recorded.
            self._misses += max(0, min(following, ticks) - max(number, -1) - 1)
            number = following
        if self._recovery is not None:
            raise LinkError(f"{self._recovery.why}; it did not come back until the end: {self._recovery.problem}")

    def _wait_again(self, error: HilError, in_vain: set[bool]) -> None:
        """Make another wait for the same tick possible after one that failed."""
        recovery = self._lose(error)
        is_stopped = isinstance(error, RobotStoppedError)
        if self._parts.device.is_lockstep:
            if is_stopped in in_vain:
                # No held command can be the cause any more, so it is STEP: time stands still without the robot.
                recovery.revive()
            elif is_stopped:
                # A robot that was reset counts its ticks from 0, and is asked for them first.
                recovery.begin_now()
        in_vain.add(is_stopped)

    def _keep_armed(self) -> None:
        """Command zeros until the first feedback is here; no tick of the run."""
        self._skip_fixes()
        if self._recovery is not None:
            self._come_back(self._recovery)
            return
        try:
            self._parts.device.poll()
            self._parts.device.send(self._rest)
        except (LinkError, RobotStoppedError) as error:
            self._lose(error)

    def _tick(self, number: int, late_ns: int) -> None:
        """Do one tick of the run: drive, or come back, and tell."""
        begin_ns = time.perf_counter_ns()
        faults = self._parts.faults
        self.t_s = number * self._timing.period_ns * 1e-9
        fix = self._sampling.fix_of(number)
        if faults is not None:
            faults.at(number * self._timing.period_ns)
            fix = faults.truth(fix)
        if self._recovery is None:
            try:
                self._drive(number, late_ns, fix)
            except (LinkError, RobotStoppedError) as error:
                self._lose(error)
                self._tell_away(number, late_ns, fix)
        else:
            self._skip_fixes()
            self._come_back(self._recovery)
            self._tell_away(number, late_ns, fix)
        self._tick_us = (time.perf_counter_ns() - begin_ns) * 1e-3

    def _drive(self, number: int, late_ns: int, fix: PoseFix | None) -> None:
        """Sense, estimate, refer, control, guard, command, tell."""
        parts = self._parts
        faults, estimator, fixes = parts.faults, parts.estimator, parts.fixes
        feedback = self._freshness.poll(self.t_s)
        measured = fixes.poll(self._freshness.robot_now_ns(feedback), fix) if fixes is not None else ()
        truth_ns = self._freshness.take_truth(feedback, fix if estimator.uses_truth else None)
        state = estimator.update(feedback, fix, measured)
        reference = self._parts.reference.at(self.t_s)
        if faults is not None:
            state, reference = faults.state(state), faults.reference(reference)
        if state is not None and not math.isfinite(sum(state.pose) + sum(state.twist)):
            state = None  # no law is asked with it: what it integrates would be no number for ever
        if state is None or estimator.status.health == LOST or self._freshness.is_stale(feedback, truth_ns):
            asked = None
            command, saturated = parts.brake.command(None if self._freshness.is_silent() else feedback.speed_rad_s)
            self._stale += state is not None
        else:
            begins = self._before is None
            if self._before is None:
                self._parts.controller.reset(state, reference)
                self._before = number - 1
            dt_s = (number - self._before) * self._timing.period_ns * 1e-9
            asked = _Asked(state, dt_s, begins)
            wanted = self._parts.controller.update(reference, state, self._applied, dt_s)
            if faults is not None:
                wanted = faults.command(wanted)
            command, saturated = self._parts.guard.apply(wanted)
        sequence = self._parts.device.send(command)
        self._measure_latency(sequence, feedback, truth_ns)
        self._ask_shadows(reference, asked)
        self._applied = Applied(command, saturated, self._latency.s)
        beliefs = Beliefs(fix, state, reference, self._applied, estimator.status, asked is None)
        self._tell(number, late_ns, feedback, beliefs)
        # After a hold the law begins anew: what it has integrated and awaits is of before it.
        self._before = None if asked is None else number

    def _ask_shadows(self, reference: Reference, asked: "_Asked | None") -> None:
        """Compute the shadows: after the command has gone, from what the law in command was told."""
        shadows = self._parts.shadows
        if shadows is None:
            return
        if asked is None:
            shadows.hold()
        else:
            state, dt_s, begins = asked
            shadows.update(self.t_s, reference, state, self._applied, dt_s, begins=begins)

    def _measure_latency(self, sequence: int, feedback: Feedback, truth_ns: int | None) -> None:
        """Note on what the command rests, and how late the one acted that the robot says is in force.

        A state that rests on the truth is as old as that, else as the feedback.
        """
        if self._parts.device.is_lockstep:
            return
        self._latency.acted(feedback.command_sequence, feedback.robot_time_ns, feedback.command_age_ms)
        self._latency.sent(sequence, feedback.robot_time_ns if truth_ns is None else truth_ns)

    def _lose(self, error: HilError) -> Recovery:
        """Begin to bring the robot back, or begin that again; without ``rearm`` the run ends."""
        self._raise_robot_failure()
        if not self._rearm:
            raise type(error)(f"{error}; to reconnect and arm anew in such a case, set loop.rearm = true") from error
        if self._recovery is None:
            self._recovery = Recovery(self._parts.device, self._parts.clock, error, self.t_s)
        else:
            self._recovery.fail(error)
        return self._recovery

    def _raise_robot_failure(self) -> None:
        """A robot in this process whose plant has failed is not waited for: it cannot come back."""
        failure = self._parts.robot_failure()
        if failure is not None:
            raise failure

    def _come_back(self, recovery: Recovery) -> None:
        self._raise_robot_failure()
        if not recovery.advance():
            return
        self._recoveries.append(Recovered(recovery.lost_s, self.t_s, recovery.why))
        self._recovery = None
        self._before = None
        self._latency.restart()
        self._applied = Applied(self._rest, False, self._latency.s)
        if self._freshness.restart():
            self._parts.estimator.restart()
            if self._parts.fixes is not None:
                self._parts.fixes.restart()

    def _skip_fixes(self) -> None:
        if self._parts.fixes is not None:
            self._parts.fixes.skip()

    def _tell_away(self, number: int, late_ns: int, fix: PoseFix | None) -> None:
        """Tell of a tick in which nothing is commanded: what is heard of the robot, which may be nothing."""
        applied = Applied(self._nothing, False, self._latency.s)
        feedback, reference = self._parts.device.feedback, self._parts.reference.at(self.t_s)
        self._ask_shadows(reference, None)
        beliefs = Beliefs(fix, None, reference, applied, self._parts.estimator.status, True)
        self._tell(number, late_ns, feedback, beliefs)

    def _tell(self, number: int, late_ns: int, feedback: Feedback | None, beliefs: Beliefs) -> None:
        self._ticks += 1
        self.lateness.add(late_ns)
        tick = LoopSignals(self.t_s, number, late_ns * 1e-3, self._tick_us, self._misses)
        self._rows.tell(tick, feedback, self._freshness.silent_ns, beliefs)
