"""The age of the robot's newest feedback and of the newest truth, and whether they are fresh enough to drive by."""

from math import isfinite

from firmware_protocol.generated.messages import State as RobotState
from hil.core.errors import LinkError, RobotLatchedError, RobotStoppedError
from hil.core.ports import Clock
from hil.core.types import PoseFix
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import SignalFaults

_ACTIVE = RobotState.ACTIVE
_LOST_NS = 250_000_000  # silence that ends the run, and the greatest age of unread feedback while driving
# Tolerance between a robot's clock and its expected time, beyond which it counts as reset: feedback in transit, and the
# HSI oscillator's accuracy.
_CLOCK_PERIODS = 4
_CLOCKS_APART_NS = 50_000_000
_CLOCK_SHARE = 50
# A jump of the clock by more than this is a reset: no stall of this machine or of a virtual robot lasts that long with
# the link intact.
_LEAP_NS = 1_000_000_000


class Freshness:
    """Reads the robot's feedback once a tick, and notes the truth if the state estimate uses it.

    Attributes, as of the last ``poll``:
        silent_ns: time since new feedback last came.
        truth_ns: time of the newest truth by the robot's clock; None before any.
        is_stale: whether the feedback or the truth is too old to drive by: older than the firmware's watchdog time. A
            truth is too old by its time stamp, or if no new one came for that long.
    """

    def __init__(self, clock: Clock, device: Device, faults: SignalFaults | None, timing: Timing) -> None:
        self._clock = clock
        self._device = device
        self._is_lockstep = device.is_lockstep
        self._faults = faults
        self._timing = timing
        self._stale_ns = timing.stale_ns
        self._newest_ns = 0
        self._received_ns: int | None = None
        self._stamp_ns: int | None = None  # of the newest truth, by its own clock
        self._truth_received_ns = 0
        self._ahead_ns: int | None = 0  # the robot's clock minus the truth's; None until both are received again
        self.silent_ns = 0
        self.truth_ns: int | None = None
        self.is_stale = False

    def poll(self, t_s: float, truth: PoseFix | None = None, active: bool = True) -> Feedback:
        """Return the newest feedback. ``t_s`` is the tick's time, for messages.

        ``truth`` is the true pose, if the state estimate uses it. Raises RobotStoppedError or RobotLatchedError if the
        robot is not ACTIVE, LinkError if it was silent for long or this process stalled. With ``active=False`` the
        robot may be in any state; RobotStoppedError then means that it was reset or sends no feedback.
        """
        feedback = self._device.poll()
        age_ns = 0 if self._is_lockstep else self._device.poll_age_ns
        now_ns = self._clock.now_ns()
        if feedback is None:
            raise RobotStoppedError("the robot sends no feedback")
        if self._faults is not None:
            feedback = self._faults.feedback(feedback)
        robot_time_ns, stale_ns = feedback.robot_time_ns, self._stale_ns
        # After a stall of this process, the feedback may be as old as the stall. It does not count as new, and the
        # robot's clock is not judged by it; the next feedback is fresh.
        if self._received_ns is None or (robot_time_ns != self._newest_ns and age_ns <= stale_ns):
            if not active and self._received_ns is not None and self._began_anew(feedback, now_ns - self._received_ns):
                raise RobotStoppedError(f"the robot was reset at t = {t_s:.3f} s")
            self._newest_ns, self._received_ns = robot_time_ns, now_ns
        self.silent_ns = silent_ns = now_ns - self._received_ns
        if active and feedback.state is not _ACTIVE:
            raise self._stop(feedback.state, t_s)
        if age_ns > stale_ns or silent_ns > _LOST_NS:
            self._check_not_lost(age_ns, _LOST_NS if active else _LEAP_NS, t_s)
        if truth is not None:
            self._update_truth(truth, robot_time_ns, now_ns)
        truth_ns = self.truth_ns
        self.is_stale = silent_ns > stale_ns or (
            truth_ns is not None
            and (robot_time_ns - truth_ns > stale_ns or now_ns - self._truth_received_ns > stale_ns)
        )
        return feedback

    def _check_not_lost(self, age_ns: int, longest_ns: int, t_s: float) -> None:
        """Raise LinkError after a long silence: a stall of this process, or no feedback from the robot."""
        if age_ns > longest_ns:
            raise LinkError(
                f"feedback lay unread for {age_ns * 1e-6:.0f} ms at t = {t_s:.3f} s: this process stood still "
                "or is slower than the robot; what the link holds is too old to drive by"
            )
        if age_ns <= self._stale_ns:
            raise LinkError(
                f"no feedback for {self.silent_ns * 1e-6:.0f} ms at t = {t_s:.3f} s: the link or the robot was lost"
            )

    def _update_truth(self, truth: PoseFix, robot_time_ns: int, now_ns: int) -> None:
        """Note when a truth was sampled and received; a pose with NaN or infinity does not count as new.

        The truth has the plant's clock, which a reset of the robot does not change. The first sample after a reset, or
        after the truth's own clock jumped back, is taken to be as old as the feedback.
        """
        time_ns, (x, y, heading), _ = truth
        if not isfinite(x + y + heading):
            return
        stamp_ns = self._stamp_ns
        if self._ahead_ns is None or (stamp_ns is not None and time_ns < stamp_ns - self._stale_ns):
            self._ahead_ns = robot_time_ns - time_ns
        if time_ns != stamp_ns:
            self._stamp_ns, self._truth_received_ns = time_ns, now_ns
        self.truth_ns = time_ns + self._ahead_ns

    def robot_now_ns(self, feedback: Feedback) -> int:
        """Return the present robot time, in real time by TIME_SYNC once that is known, else by the newest feedback.

        By feedback it is exact only to a tick, because its age on the link is not known. A TIME_SYNC offset that
        differs by 50 ms or more belongs to the clock before a reset and is not used.
        """
        now_ns = feedback.robot_time_ns + self._timing.feedback_latency_ns + self.silent_ns
        offset_us = self._device.clock_sync.offset_us
        if self._is_lockstep or offset_us != offset_us:
            return now_ns
        synced_ns = self._clock.now_ns() + round(offset_us * 1e3)
        return synced_ns if abs(synced_ns - now_ns) < _CLOCKS_APART_NS else now_ns

    def is_silent(self) -> bool:
        """Whether the feedback itself is too old to drive by."""
        return self.silent_ns > self._stale_ns

    def has_aged(self) -> bool:
        """Real time: whether the truth has become too old since ``poll``, because this process stalled."""
        return self.truth_ns is not None and self._clock.now_ns() - self._truth_received_ns > self._stale_ns

    def restart(self) -> bool:
        """Start again with a robot that came back; return whether it was reset.

        After a reset its clock and its encoder counts start again from zero.
        """
        was_reset = self._was_reset()
        self._received_ns = None
        if was_reset:
            self._ahead_ns = self.truth_ns = None
        return was_reset

    def _began_anew(self, feedback: Feedback, passed_ns: int) -> bool:
        """Whether the robot's clock jumped by 1 s or more since the last feedback. A restart looks like that."""
        return not -_LEAP_NS < feedback.robot_time_ns - self._newest_ns - passed_ns < _LEAP_NS

    def _was_reset(self) -> bool:
        feedback = self._device.feedback
        if feedback is None or self._received_ns is None:
            return True
        passed_ns = self._clock.now_ns() - self._received_ns
        robot_passed_ns = feedback.robot_time_ns - self._newest_ns
        apart_ns = _CLOCK_PERIODS * self._timing.period_ns + passed_ns // _CLOCK_SHARE
        return robot_passed_ns < 0 or abs(robot_passed_ns - passed_ns) > apart_ns

    def _stop(self, state: RobotState, t_s: float) -> RobotLatchedError | RobotStoppedError:
        """Return the error for a robot that is not ACTIVE."""
        report = self._device.report
        # A robot that stopped by itself passes through STOPPING and reports the reason; one that was reset knows none.
        was_reset = state in (RobotState.BOOT, RobotState.IDLE) and report.knows_no_reason
        reset = f"it was reset ({report.last_reset})" if report.last_reset else "it was reset"
        why = reset if was_reset else f"it is {state.name} because of {report.stop_reason()}"
        sentence = f"the robot left ACTIVE at t = {t_s:.3f} s: {why}"
        latched = state in (RobotState.FAULT, RobotState.ESTOP)
        return RobotLatchedError(sentence) if latched else RobotStoppedError(sentence)
