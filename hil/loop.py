"""The tick: sense, estimate, refer, control, guard, command, tell. The same loop in lockstep and in real time."""

import math
import time
from typing import NamedTuple

from firmware_protocol.generated.messages import State as RobotState
from hil.devices.snapshot import Feedback
from hil.devices.stm32 import Stm32
from hil.errors import DeviceError, HilError, LinkError
from hil.estimator import Estimator
from hil.guard import Guard
from hil.ports import Clock, Controller, PoseSource, Sink
from hil.references import ReferenceSource
from hil.signals import (
    ErrorSignals,
    GuardSignals,
    LinkSignals,
    LoopSignals,
    ReferenceSignals,
    RobotSignals,
    Sample,
)
from hil.types import (
    NAN,
    NAN_POSE,
    NAN_WHEELS,
    ZERO_WHEELS,
    Applied,
    CommandMode,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
)

_NAN_TWIST = Twist(NAN, NAN, NAN)
_STALE_NS = 250_000_000  # feedback older than this is no feedback
_STOP_LIMIT_NS = 5_000_000_000


class Parts(NamedTuple):
    """What a tick is made of."""

    clock: Clock
    device: Stm32
    truth: PoseSource | None
    estimator: Estimator
    reference: ReferenceSource
    controller: Controller
    guard: Guard
    sink: Sink


class Report(NamedTuple):
    """How the loop went. ``failure`` is what ended it early, or None."""

    ticks: int
    deadline_misses: int
    robot_s: float
    wall_s: float
    stopped: bool
    failure: HilError | None


class Loop:
    """Runs the tick at a fixed period for a given time.

    ``t`` = 0 is the first ACTIVE tick. A tick that would begin after the next one is due is skipped and counted,
    never made up in a burst.
    """

    def __init__(self, parts: Parts, mode: CommandMode, period_ns: int, latency_s: float) -> None:
        self._parts = parts
        self._mode = mode
        self._period_ns = period_ns
        self._dt_s = period_ns * 1e-9
        self._latency_s = latency_s
        self._misses = 0
        self._ticks = 0
        self._tick_us = NAN
        self._robot_offset_ns: int | None = None
        self._age_ms = 0.0
        self._rejected = 0
        self.t_s = 0.0

    def run(self, origin_ns: int, duration_ns: int) -> Report:
        """Run from the first ACTIVE tick at ``origin_ns`` on the clock, then stop the robot.

        What ends the run early is reported: a lost link or device, or a law that fails. Whatever it is, the robot is
        stopped while it can be reached.
        """
        begin = time.perf_counter()
        failure: HilError | None = None
        try:
            self._run(origin_ns, duration_ns)
        except HilError as error:
            failure = error
        except BaseException:
            self._stop()
            raise
        wall_s = time.perf_counter() - begin
        stopped = not isinstance(failure, DeviceError | LinkError) and self._stop()
        robot_s = self.t_s + self._dt_s if self._ticks else 0.0
        return Report(self._ticks, self._misses, robot_s, wall_s, stopped, failure)

    @property
    def commands_refused(self) -> int:
        """Commands of the law that were no numbers, each replaced by a stop."""
        return self._parts.guard.refused

    def _stop(self) -> bool:
        return self._parts.device.stop(self._period_ns, _STOP_LIMIT_NS)

    def _run(self, origin_ns: int, duration_ns: int) -> None:
        clock, device = self._parts.clock, self._parts.device
        rest = WheelCommand(self._mode, ZERO_WHEELS, ZERO_WHEELS)
        applied = Applied(rest, False, self._latency_s)
        started = False
        number = 0
        while number * self._period_ns < duration_ns:
            late_ns = device.wait_until(origin_ns + number * self._period_ns)
            begin_ns = time.perf_counter_ns()
            self.t_s = number * self._dt_s
            feedback = self._feedback()
            fix = self._parts.truth.poll() if self._parts.truth is not None else None
            state = self._parts.estimator.update(feedback, fix)
            reference = self._parts.reference.at(self.t_s)
            if state is None:
                command, saturated = rest, False
            else:
                if not started:
                    self._parts.controller.reset(state, reference)
                    started = True
                wanted = self._parts.controller.update(reference, state, applied, self._dt_s)
                command, saturated = self._parts.guard.apply(wanted)
            device.send(command)
            applied = Applied(command, saturated, self._latency_s)
            self._ticks += 1
            self._tell(number, late_ns, feedback, fix, state, reference, applied)
            self._tick_us = (time.perf_counter_ns() - begin_ns) * 1e-3
            number = self._next(number, clock.now_ns() - origin_ns)

    def _next(self, number: int, elapsed_ns: int) -> int:
        """Return the next tick that can still begin on time."""
        following = max(number + 1, -(-elapsed_ns // self._period_ns))
        self._misses += following - number - 1
        return following

    def _feedback(self) -> Feedback:
        feedback = self._parts.device.poll()
        now_ns = self._parts.clock.now_ns()
        if feedback is None:
            raise DeviceError("the robot sends no feedback")
        # The quickest way seen so far stands for no delay: the age is relative to it.
        offset_ns = now_ns - feedback.robot_time_ns
        if self._robot_offset_ns is None or offset_ns < self._robot_offset_ns:
            self._robot_offset_ns = offset_ns
        age_ns = offset_ns - self._robot_offset_ns
        self._age_ms = age_ns * 1e-6
        if feedback.state is not RobotState.ACTIVE:
            raise DeviceError(self._why_stopped(feedback.state))
        if age_ns > _STALE_NS:
            raise LinkError(
                f"no feedback for {self._age_ms:.0f} ms at t = {self.t_s:.3f} s: the link or the robot was lost"
            )
        return feedback

    def _why_stopped(self, state: RobotState) -> str:
        reason = self._parts.device.stop_reason()
        return f"the robot left ACTIVE at t = {self.t_s:.3f} s: it is {state.name} because of {reason}"

    def _tell(
        self,
        number: int,
        late_ns: int,
        feedback: Feedback,
        fix: PoseFix | None,
        state: State | None,
        reference: Reference,
        applied: Applied,
    ) -> None:
        device = self._parts.device
        if number % 100 == 0:
            self._rejected = sum(device.rejected().values())
        command = applied.command
        truth = fix.pose if fix is not None else NAN_POSE
        self._parts.sink.put(
            Sample(
                LoopSignals(self.t_s, number, late_ns * 1e-3, self._tick_us, self._misses),
                ReferenceSignals(*reference.pose, *reference.twist),
                state.pose if state is not None else NAN_POSE,
                state.twist if state is not None else _NAN_TWIST,
                truth,
                _error(truth, reference.pose),
                self._parts.controller.gains,
                feedback.speed_rad_s,
                command.speed_rad_s if command.mode is CommandMode.SPEED else NAN_WHEELS,
                command.torque_n_m,
                feedback.current_a,
                RobotSignals(
                    feedback.robot_time_ns * 1e-9,
                    feedback.state,
                    feedback.command_age_ms,
                    feedback.yaw_rate_rad_s,
                ),
                GuardSignals(applied.saturated),
                LinkSignals(device.sent, device.received, self._rejected, self._age_ms),
            ).row()
        )


def _error(truth: Pose, reference: Pose) -> ErrorSignals:
    x_m, y_m = truth.x_m - reference.x_m, truth.y_m - reference.y_m
    heading_rad = math.remainder(truth.heading_rad - reference.heading_rad, math.tau)
    return ErrorSignals(x_m, y_m, heading_rad, math.hypot(x_m, y_m))
