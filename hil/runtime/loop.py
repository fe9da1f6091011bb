"""The schedule of a run: when each tick is due, in lockstep and in real time, and the recovery of a lost robot."""

import contextlib
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

from hil.core.errors import DeviceError, HilError, LinkError, OverdueError, RobotLatchedError, RobotStoppedError
from hil.core.tick_watch import TickOverdue, TickWatch
from hil.core.tuples import make_loop_signals
from hil.core.types import NAN, CommandMode
from hil.faults.rows import FaultRow
from hil.judge.expectations import Count, Stop
from hil.judge.judged_run import Recovered
from hil.robot.port import Device
from hil.runtime.lateness import Lateness
from hil.runtime.sampling import Sampling, Timing
from hil.runtime.tick import Tick, TickParts
from hil.runtime.unexplained import NotDriven

_STOP_LIMIT_NS = 5_000_000_000

if TYPE_CHECKING:
    from hil.runtime.recovery import Recovery


class Warned:
    """Passes on each warning of a device once, and again if it is new after a reconnection.

    ``reported`` are warnings that were passed on before.
    """

    def __init__(self, device: Device, report: Callable[[str], None], reported: Sequence[str] = ()) -> None:
        self._device = device
        self._report = report
        self._reported = reported

    def __call__(self) -> None:
        """Pass on new warnings; call it after the device has answered."""
        warnings = tuple(self._device.warnings)
        for sentence in warnings:
            if sentence not in self._reported:
                self._report(sentence)
        self._reported = warnings


class Report(NamedTuple):
    """The result of the loop.

    Attributes:
        not_driven: number of ticks that were not driven, by the keys of ``[allow]``.
        robot_s, wall_s: the duration in robot time and in wall-clock time.
        stopped: whether the robot came to rest at the end.
        failure: what ended the loop early, or None.
        recoveries: the losses that it recovered from.
        stops: each time that the robot left ACTIVE on its own.
    """

    ticks: int
    deadline_misses: int
    not_driven: dict[str, Count]
    robot_s: float
    wall_s: float
    stopped: bool
    failure: HilError | None
    recoveries: tuple[Recovered, ...]
    stops: tuple[Stop, ...]


class Loop:
    """Runs the tick at a fixed period for a given time.

    ``t`` = 0 is the first ACTIVE tick. A tick's ``t`` is its sampling instant; the tick is computed one feedback
    latency later, when the samples have arrived. A tick that would begin after the next one is due is skipped and
    counted as a deadline miss; missed ticks are not caught up.

    With ``rearm`` a lost link or a stopped robot does not end the run. The robot is brought back while the ticks go
    on without commands; then the law is reset at the reference of the present ``t``. With ``watches`` a robot that
    stops on its own does not end the run: unless ``rearm`` brings it back, the ticks go on without commands, to the
    end. A lost link still ends the run. ``warn`` is called with each new warning of the device. ``faults`` are
    the scenario's faults, which may explain ticks that are not driven. A tick of more than ``tick_limit_s`` of
    wall-clock time ends the run (``TickWatch``; 0 for no limit).
    """

    def __init__(
        self,
        parts: TickParts,
        mode: CommandMode,
        timing: Timing,
        *,
        faults: Sequence[FaultRow] = (),
        rearm: bool = False,
        watches: bool = False,
        warn: Callable[[str], None] | None = None,
        tick_limit_s: float = 0.0,
        last_words: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._parts = parts
        self._faults = parts.faults
        self._reference_at = parts.reference.at
        self._timing = timing
        self._period_ns = timing.period_ns
        self._rearm = rearm
        self._ticker = Tick(parts, mode, timing)
        self._sampling = Sampling(parts.clock, parts.device, parts.truth, timing)
        self._warn = warn
        self._warned = Warned(parts.device, self._on_warning, reported=tuple(parts.device.warnings))
        self._not_driven = NotDriven(faults, timing)
        self._recovery: Recovery | None = None
        self._recoveries: list[Recovered] = []
        self._watches = watches
        self._stops: list[Stop] = []
        self._is_watching = False
        self._misses = 0
        self._tick_us = NAN
        self.lateness = Lateness()
        self.t_s = 0.0
        self._watch = TickWatch(tick_limit_s, lambda: self.t_s, last_words)

    def run(self, origin_ns: int, duration_ns: int) -> Report:
        """Run from the first ACTIVE tick at ``origin_ns`` on the clock, then stop the robot.

        A failure that ends the run early is returned in the report: a lost link or device, or a law that fails or does
        not return. The robot is then commanded to stop, if it can be reached.
        """
        begin = perf_counter()
        failure: HilError | None = None
        self._warned()  # warnings that the robot sent since it was armed
        try:
            with self._watch:
                self._run(origin_ns, duration_ns)
        except HilError as error:
            failure = error
        except TickOverdue as overdue:
            failure = OverdueError(str(overdue))
        except BaseException:
            self._parts.device.disarm()
            with contextlib.suppress(HilError):
                self._stop()
            self._parts.device.close()
            raise
        wall_s = perf_counter() - begin
        stopped = False
        try:
            # Do not stop a robot that has not come back: another host may control it by now.
            if isinstance(failure, DeviceError | LinkError) or self._recovery is not None:
                failure = self._give_up(failure)
            else:
                stopped = self._stop()
                failure = failure or (None if stopped else DeviceError("the robot did not come to rest within 5 s"))
        except HilError as error:
            failure = self._give_up(failure or error)
        ticks = self._ticker.count
        if self._parts.device.is_lockstep:
            self.lateness.add(0, ticks)
        robot_s = self.t_s + self._timing.period_ns * 1e-9 if ticks else 0.0
        recoveries = tuple(self._recoveries)
        not_driven = self._not_driven.counts(ticks)
        stops = tuple(self._stops)
        return Report(ticks, self._misses, not_driven, robot_s, wall_s, stopped, failure, recoveries, stops)

    @property
    def commands_refused(self) -> int:
        """Number of the law's commands that held NaN or infinity; each was replaced by a stop."""
        return self._parts.guard.refused

    def pose_fixes(self) -> dict[str, Any] | None:
        """Return the counts of pose fixes, from the source to the filter; None if the estimator uses none."""
        return self._ticker.pose_fixes()

    def _stop(self) -> bool:
        return self._parts.device.stop(self._timing.period_ns, _STOP_LIMIT_NS)

    def _give_up(self, failure: HilError | None) -> HilError | None:
        """Close the device. Return the failure; if closing did not stop the robot, with the device's own trouble."""
        device = self._parts.device
        device.close()
        trouble = device.report.trouble
        if failure is None or trouble is None or trouble in str(failure):
            return failure
        return type(failure)(f"{failure}; {trouble}")

    def _run(self, origin_ns: int, duration_ns: int) -> None:
        timing = self._timing
        ticks = -(-duration_ns // timing.period_ns)
        number = self._sampling.begin(origin_ns)
        is_lockstep = self._parts.device.is_lockstep
        self._ticker.skip_fixes()
        # How waits have failed since robot time last advanced: False for a lost link, True for a stopped robot.
        in_vain: set[bool] = set()
        while number < ticks:
            try:
                late_ns = self._sampling.wait(number)
            except (LinkError, RobotStoppedError) as error:
                self._wait_again(error, in_vain)
                continue
            if in_vain:
                in_vain.clear()
            if number < 0:
                self._keep_armed()
            else:
                self._tick(number, late_ns)
            if is_lockstep:  # no tick is late in lockstep
                number += 1
                continue
            if number >= 0:
                self.lateness.add(late_ns)
            following = self._sampling.following(number)
            if following != number + 1:
                # Count only ticks of this run; the last misses appear in no later row.
                self._misses += max(0, min(following, ticks) - max(number, -1) - 1)
            number = following
        if self._recovery is not None:
            raise LinkError(f"{self._recovery.why}; it did not come back until the end: {self._recovery.problem}")

    def _wait_again(self, error: HilError, in_vain: set[bool]) -> None:
        """After a failed wait, prepare another wait for the same tick."""
        recovery = self._lose(error)
        is_stopped = isinstance(error, RobotStoppedError)
        if self._parts.device.is_lockstep:
            if is_stopped in in_vain:
                # It failed twice in the same way, so no queued command is the cause: STEP itself is lost, and robot
                # time stands still.
                raise error
            if is_stopped:
                # After a reset the robot counts its ticks from 0: ask it for the present one.
                recovery.begin_now()
        in_vain.add(is_stopped)

    def _keep_armed(self) -> None:
        """Command zeros before the first feedback arrives. These ticks are not counted in the run."""
        self._ticker.skip_fixes()
        if self._recovery is not None:
            self._come_back(self._recovery)
            return
        try:
            self._ticker.keep_armed()
        except (LinkError, RobotStoppedError) as error:
            self._lose(error)

    def _tick(self, number: int, late_ns: int) -> None:
        """Do one tick of the run: drive the robot or go on with its recovery, and write the row."""
        begin_s = perf_counter()
        watch = self._watch
        watch.turn += 1
        ticker, faults, reference_at, t_ns = self._ticker, self._faults, self._reference_at, number * self._period_ns
        self.t_s = t_s = t_ns * 1e-9
        now = make_loop_signals(t_s, number, late_ns * 1e-3, self._tick_us, self._misses)
        fix = self._sampling.fix_of(number)
        if faults is not None:
            faults.at(t_ns)
            fix = faults.truth(fix)
        if self._is_watching:
            ticker.raise_robot_failure()
            ticker.skip_fixes()
            self._parts.device.poll()
            ticker.record_away(now, fix, reference_at(t_s))
        elif self._recovery is None:
            count = ticker.count
            try:
                ticker.drive(now, fix, ticker.sense(t_s, fix), reference_at(t_s))
            except (LinkError, RobotStoppedError, RobotLatchedError) as error:
                self._leave(error)
                if ticker.count == count:
                    ticker.record_away(now, fix, reference_at(t_s))
        else:
            ticker.skip_fixes()
            self._come_back(self._recovery)
            ticker.record_away(now, fix, reference_at(t_s))
        if ticker.is_held and not self._is_watching:
            self._not_driven.hold(t_ns, is_stale=ticker.is_stale)
        elif self._not_driven.is_explained:
            self._not_driven.drive()
        watch.turn += 1
        self._tick_us = (perf_counter() - begin_s) * 1e6

    def _leave(self, error: LinkError | RobotStoppedError | RobotLatchedError) -> None:
        """After the robot was lost or left ACTIVE, begin its recovery, go on to watch it, or raise the error."""
        is_latched = isinstance(error, RobotLatchedError)
        if not isinstance(error, LinkError):
            self._stops.append(Stop(self.t_s, str(error)))
            if self._watches and (is_latched or not self._rearm):
                self._is_watching = True
                self._parts.device.disarm()
                self._parts.note(self.t_s, "warning", f"{error}; it is watched to the end, without commands")
                return
        if is_latched:
            raise error
        self._lose(error)

    def _lose(self, error: HilError) -> "Recovery":
        """Begin the recovery of the robot, or restart it; without ``rearm`` raise the error, which ends the run."""
        self._ticker.raise_robot_failure()
        if not self._rearm:
            raise type(error)(f"{error}; to reconnect and arm anew in such a case, set loop.rearm = true") from error
        if self._recovery is None:
            from hil.runtime.recovery import Recovery  # only for a robot that was lost

            self._recovery = Recovery(self._parts.device, self._parts.clock, error, self.t_s, self._warned)
            self._parts.note(self.t_s, "warning", f"{error}; it is being brought back")
        else:
            self._recovery.fail(error)
        return self._recovery

    def _on_warning(self, sentence: str) -> None:
        self._parts.note(self.t_s, "warning", sentence)
        if self._warn is not None:
            self._warn(sentence)

    def _come_back(self, recovery: "Recovery") -> None:
        self._ticker.raise_robot_failure()
        if not recovery.advance():
            return
        self._recoveries.append(Recovered(recovery.lost_s, self.t_s, recovery.why))
        away_s = self.t_s - recovery.lost_s
        self._parts.note(self.t_s, "info", f"ACTIVE again after {away_s:.3f} s: {recovery.why}")
        self._recovery = None
        self._ticker.restart()
