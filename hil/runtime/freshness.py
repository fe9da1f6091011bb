"""The age of the robot's newest feedback and of the newest truth, and whether they are fresh enough to drive by.

``client/wheel_timing.h`` has the rules; this gives them the device's feedback, and says for a person what is wrong.
"""

from typing import TYPE_CHECKING

from firmware_protocol.extension import library, wheel
from firmware_protocol.generated.messages import State as RobotState
from hil.core.errors import HilError, LinkError, RobotLatchedError, RobotStoppedError
from hil.core.ports import Clock
from hil.core.types import PoseFix
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.sampling import Timing

if TYPE_CHECKING:
    from hil.runtime.signal_faults import SignalFaults

# Tolerance between a robot's clock and its expected time, beyond which it counts as reset: feedback in transit, and the
# HSI oscillator's accuracy.
_CLOCK_PERIODS = 4
_CLOCKS_APART_NS = 50_000_000
_CLOCK_SHARE = 50


class Freshness(wheel.Freshness):
    """Reads the robot's feedback once a tick, and notes the truth if the state estimate uses it.

    Attributes, as of the last ``poll``:
        silent_ns: time since new feedback last came.
        truth_ns: time of the newest truth by the robot's clock; None before any.
        is_stale: whether the feedback or the truth is too old to drive by: older than the firmware's watchdog time. A
            truth is too old by its time stamp, or if no new one came for that long.
    """

    def __init__(self, clock: Clock, device: Device, faults: "SignalFaults | None", timing: Timing) -> None:
        super().__init__(timing.stale_ns)
        ffi, self._lib = library()
        self._ages = ffi.cast("wheel_freshness *", self.address)
        self._clock = clock
        self._device = device
        self._is_lockstep = device.is_lockstep
        self._faults = faults
        self._timing = timing
        self._stale_ns = timing.stale_ns

    def poll(self, t_s: float, truth: PoseFix | None = None, active: bool = True) -> Feedback:
        """Return the newest feedback. ``t_s`` is the tick's time, for messages.

        ``truth`` is the true pose, if the state estimate uses it; one that is not finite does not count. Raises
        RobotStoppedError or RobotLatchedError if the robot is not ACTIVE, LinkError if it was silent for long or this
        process stalled. With ``active=False`` the robot may be in any state; RobotStoppedError then means that it was
        reset or sends no feedback.
        """
        feedback = self._device.poll()
        age_ns = 0 if self._is_lockstep else self._device.poll_age_ns
        if feedback is None:
            raise RobotStoppedError("the robot sends no feedback")
        if self._faults is not None:
            feedback = self._faults.feedback(feedback)
        if wrong := self.add(feedback, truth, age_ns, self._clock.now_ns(), active):
            raise self._problem(wrong, feedback.state, age_ns, t_s, active)
        return feedback

    def _problem(self, result: int, state: RobotState, age_ns: int, t_s: float, active: bool) -> HilError:
        if result == self._lib.WHEEL_FRESHNESS_STATE:
            return self._stop(state, t_s)
        if result == self._lib.WHEEL_FRESHNESS_RESET:
            return RobotStoppedError(f"the robot was reset at t = {t_s:.3f} s")
        if result == self._lib.WHEEL_FRESHNESS_UNREAD:
            return LinkError(
                f"feedback lay unread for {age_ns * 1e-6:.0f} ms at t = {t_s:.3f} s: this process stood still "
                "or is slower than the robot; what the link holds is too old to drive by"
            )
        # This process may have been suspended since it read. If the robot has been stopped meanwhile, report why.
        newest = self._device.poll()
        if active and newest is not None and newest.state is not RobotState.ACTIVE:
            return self._stop(newest.state, t_s)
        return LinkError(
            f"no feedback for {self.silent_ns * 1e-6:.0f} ms at t = {t_s:.3f} s: the link or the robot was lost"
        )

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

    def truth_has_aged(self) -> bool:
        """Real time: whether the truth has become too old since ``poll``, because this process stalled."""
        # C asks for a truth too; where none is used, this saves reading the clock in each tick.
        return self.truth_ns is not None and self.has_aged(self._clock.now_ns())

    def restart(self) -> bool:
        """Start again with a robot that came back; return whether it was reset.

        After a reset its clock and its encoder counts start again from zero.
        """
        was_reset = self._was_reset()
        self.begin_again(was_reset)
        return was_reset

    def _was_reset(self) -> bool:
        feedback, ages = self._device.feedback, self._ages
        if feedback is None or not ages.has_received:
            return True
        passed_ns = self._clock.now_ns() - int(ages.received_ns)
        robot_passed_ns = feedback.robot_time_ns - int(ages.newest_ns)
        apart_ns = _CLOCK_PERIODS * self._timing.period_ns + passed_ns // _CLOCK_SHARE
        return robot_passed_ns < 0 or abs(robot_passed_ns - passed_ns) > apart_ns

    def _stop(self, state: RobotState, t_s: float) -> RobotLatchedError | RobotStoppedError:
        report = self._device.report
        # A robot that stopped on its own passes through STOPPING and reports the reason; after a reset it knows none.
        was_reset = state in (RobotState.BOOT, RobotState.IDLE) and report.knows_no_reason
        reset = f"it was reset ({report.last_reset})" if report.last_reset else "it was reset"
        why = reset if was_reset else f"it is {state.name} because of {report.stop_reason()}"
        sentence = f"the robot left ACTIVE at t = {t_s:.3f} s: {why}"
        latched = state in (RobotState.FAULT, RobotState.ESTOP)
        return RobotLatchedError(sentence) if latched else RobotStoppedError(sentence)
