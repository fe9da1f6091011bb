"""The state machine of a served robot: reconnect, arm, drive, stop. It moves only when armed and by an order.

It has no clock and does not depend on HTTP: orders are method calls between two ticks, and an order that is not
possible in the present phase is refused with a sentence.
"""

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service.messages import Phase
from hil.addons.service.tasks import NOWHERE, LawElsewhere, Tasks
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, OverdueError, RobotStoppedError
from hil.core.extensions import failure
from hil.core.motion_limits import BodyLimits
from hil.core.ports import Controller
from hil.core.signals import LoopSignals
from hil.core.tick_watch import TickOverdue
from hil.core.types import NAN, NO_GAINS, Applied, CommandMode, PoseFix, Reference, State, WheelCommand
from hil.runtime.loop import Warned
from hil.runtime.recovery import Recovery
from hil.runtime.sampling import Timing
from hil.runtime.tick import Tick, TickParts
from hil.scenario import ServiceTable
from hil.scenario.laws import Laws

_ARMING_LIMIT_S = 4.0
_STOPPING_LIMIT_S = 5.0
_CLEARING_LIMIT_S = 2.0
_LATCHED = {RobotState.FAULT: Phase.FAULT, RobotState.ESTOP: Phase.ESTOP}

_REPEAT_S = 0.3


class EmergencyStop:
    """An e-stop is pending from ``request`` until the robot's feedback confirms it; it cannot be cleared before.

    It is sent for at least 0.3 s, because feedback under way may show an earlier ESTOP.

    Attributes:
        pending: whether the robot has yet to confirm it.
    """

    def __init__(self) -> None:
        self._requested_s = -math.inf
        self._clear_next = False
        self.pending = False

    def request(self, t_s: float) -> None:
        """Order an e-stop; an earlier request to clear it is dropped."""
        self.pending, self._requested_s, self._clear_next = True, t_s, False

    def may_clear(self) -> bool:
        """Return whether it may be cleared now. If not, the request is kept, and ``pop_clear`` returns it later."""
        self._clear_next = self.pending
        return not self.pending

    def drop_clear(self) -> None:
        """Drop a request to clear."""
        self._clear_next = False

    def must_send(self, robot: RobotState, t_s: float) -> bool:
        """Return whether to send it again to a robot whose feedback has this state."""
        if robot is RobotState.ESTOP and t_s >= self._requested_s + _REPEAT_S:
            self.pending = False
        return self.pending

    def pop_clear(self) -> bool:
        """Return True once when a request to clear that came while the e-stop was pending can be carried out."""
        clear, self._clear_next = self._clear_next and not self.pending, False
        return clear


class Pilot:
    """The state machine of a service. ``tick`` is called once a tick; it raises only errors that end the service.

    A lost robot is reconnected to, however long that takes. It comes back disarmed, and only ``arm`` arms it. When the
    phase ACTIVE ends, the task ends too.

    Attributes:
        phase: the robot's phase.
        state: the estimated state; None while the robot is away.
        tasks: the tasks of an ACTIVE robot, for reading; to give it an order, use ``active``.
        emergency: the e-stop.
        motion_requests: grows with each change of phase and each order for a motion. An order that takes long compares
            it to find out whether it is outdated.
        recoveries: how often a lost robot came back.
    """

    def __init__(self, parts: TickParts, mode: CommandMode, timing: Timing, options: ServiceTable) -> None:
        self.tasks = Tasks(options)
        self._mode = mode
        self._parts = parts = parts._replace(controller=self._with_law_elsewhere(parts.controller))
        parts.guard.keep_body(BodyLimits(options.speed_m_s, options.yaw_rate_rad_s))
        self._tick = Tick(parts, mode, timing)
        self._t_s = 0.0
        self._deadline_s = math.inf
        self.emergency = EmergencyStop()
        self._why: str | None = None
        self._trouble: str | None = None
        self._law_failed = False
        self.phase = Phase.AWAY
        self.motion_requests = 0
        self.state: State | None = None
        self.recoveries = 0
        self._was_connected = False
        parts.device.attend(parts.clock)
        self._warned = Warned(parts.device, lambda sentence: self._parts.note(self._t_s, "warning", sentence))
        self._recovery = self._new_recovery(RobotStoppedError("not connected yet"))

    @property
    def why(self) -> str | None:
        """The last problem, what keeps an AWAY robot away, and trouble that the robot reports now; None without any."""
        problem = self._recovery.problem if self.phase is Phase.AWAY else None
        sentences = filter(None, (self._why, problem, self._parts.device.report.trouble))
        return "; ".join(dict.fromkeys(sentences)) or None

    @property
    def parts(self) -> TickParts:
        """The parts of the ticks, with the law in use."""
        return self._tick.parts

    @property
    def feedback_age_ms(self) -> float | None:
        """Age of the newest feedback; None while there is none."""
        return None if self.phase is Phase.AWAY else self._tick.feedback_age_ms

    # Orders

    def arm(self) -> None:
        """Arm the robot, which then rests where it is. Raises BadInputError unless it is DISARMED."""
        if self.phase is not Phase.DISARMED:
            raise BadInputError(f"the robot is {self.phase}; it can be armed when it is disarmed{self._because()}")
        self._why = None
        if self._law_failed:
            self._law_failed = False
            self._tick.use(self._parts)
        self._enter(Phase.ARMING, _ARMING_LIMIT_S)

    def disarm(self, why: str | None = None) -> None:
        """Ramp down and disarm. Also ends arming and clearing; does nothing to a robot that is not armed.

        ``why`` is a sentence for the status.
        """
        self._why = why or self._why
        self.motion_requests += 1
        if self.phase in (Phase.ARMING, Phase.ACTIVE):
            self._parts.device.disarm()
            self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)
        elif self.phase in (Phase.FAULT, Phase.ESTOP):
            self._parts.device.disarm()
            self.emergency.drop_clear()
            self._deadline_s = math.inf

    def estop(self) -> None:
        """Stop at once, and latch it. A robot that is away is also stopped as soon as it is back."""
        self.emergency.request(self._t_s)
        self._why = "an e-stop was asked for"
        if self.phase is Phase.AWAY:
            self._why += "; the robot is away: it is sent now without an answer, and again as soon as it is back"
            self.motion_requests += 1
        else:
            self._enter(Phase.ESTOP)
        with contextlib.suppress(LinkError):  # it is repeated at every tick, and when the robot is back
            self._parts.device.estop()

    def clear(self) -> None:
        """Leave FAULT or ESTOP, without arming. Raises BadInputError in other phases."""
        if self.phase not in (Phase.FAULT, Phase.ESTOP):
            raise BadInputError(f"the robot is {self.phase}; there is nothing to clear")
        if not self.emergency.may_clear():
            return  # it is done when the robot has confirmed the e-stop
        self._parts.device.clear()
        self._deadline_s = self._t_s + _CLEARING_LIMIT_S

    def active(self) -> Tasks:
        """Return the tasks of an ACTIVE robot, to give it a new motion. Raises BadInputError in other phases."""
        self.need_active()
        self.motion_requests += 1
        return self.tasks

    def need_active(self) -> None:
        """Raise BadInputError unless the robot is ACTIVE."""
        if self.phase is not Phase.ACTIVE:
            raise BadInputError(f"the robot is {self.phase}; arm it first{self._because()}")

    def use(self, laws: Laws) -> None:
        """Use other laws, or the same with other gains, from the next tick on; they start from their reset state."""
        self._parts = self._parts._replace(controller=self._with_law_elsewhere(laws.controller), extra=laws.extra)
        self._law_failed = False
        self._tick.use(self._parts)

    def _with_law_elsewhere(self, law: Controller) -> Controller:
        return LawElsewhere(law, self.tasks, self._mode)

    # The tick

    def tick(self, now: LoopSignals, fix: PoseFix | None) -> None:
        """Do one tick and write its row. Raises the error that ended a robot in this process for good."""
        self._t_s = now.t_s
        try:
            if (faults := self._parts.faults) is not None:
                faults.at(round(now.t_s * 1e9))
                fix = faults.truth(fix)
            count = self._tick.count
            self._attempt(lambda: self._step(now, fix))
            if self._tick.count == count:  # only a driven tick has written its row
                self._attempt(lambda: self._tick.record_away(now, fix, NOWHERE, self.state))
            if self._tick.count == count:  # the law's own signals failed; from now on they are NaN
                self._tick.record_away(now, fix, NOWHERE, self.state)
            before, self._trouble = self._trouble, self._parts.device.report.trouble
            if self._trouble is not None and self._trouble != before:
                self._parts.note(self._t_s, "warning", self._trouble)
        except TickOverdue as overdue:  # not raised in the law but, for example, in a log whose reader stalls
            self.lose(OverdueError(str(overdue)))

    def _step(self, now: LoopSignals, fix: PoseFix | None) -> None:
        """Do what the phase asks for."""
        device, phase = self._parts.device, self.phase
        if phase is Phase.AWAY:
            self._reconnect(now.t_s)
            return
        if phase is Phase.ARMING and device.armed():
            self._tick.begin()
            phase = Phase.ACTIVE
            self._enter(phase)
            self.tasks.begin()
        if phase is Phase.ACTIVE:
            self._drive(now, fix)
            return
        feedback, self.state = self._tick.sense(now.t_s, fix, active=False)
        robot, is_late = feedback.state, now.t_s > self._deadline_s
        if phase is Phase.ARMING:
            if is_late:
                raise DeviceError(device.why_not_active())
        elif phase in (Phase.FAULT, Phase.ESTOP):
            self._be_latched(robot, now.t_s)
        elif robot in _LATCHED:
            if device.report.explains(robot):  # else STATUS, which has the reason, arrives a little later
                self._why = device.why_not_active()
                self._enter(_LATCHED[robot])
        elif phase is Phase.DISARMED:
            if robot in (RobotState.ARMED, RobotState.ACTIVE):
                self._why = "another host has armed the robot; stop that host first"
        elif robot is RobotState.IDLE:
            self._enter(Phase.DISARMED)
        elif is_late:
            self._why = f"the robot did not come to rest within {_STOPPING_LIMIT_S:g} s: it is {robot.name}"

    def _attempt(self, action: Callable[[], None]) -> None:
        """Do a part of a tick and handle its errors. Raises as ``tick``."""
        error: HilError
        try:
            action()
            return
        except HilError as raised:
            error = raised
        except TickOverdue as overdue:
            error = BadInputError(str(overdue))
        except (ArithmeticError, ValueError) as raised:  # by a law or a path, for example an overflow
            error = failure("the law or the path", "a tick", raised)
        if isinstance(error, BadInputError):
            self._law_failed = True
            self._tick.use(_without_law(self._parts))
        self.lose(error)

    def lose(self, error: HilError) -> None:
        """Handle an error of a tick or of waiting for one. Raises as ``tick``."""
        self._tick.raise_robot_failure()
        if self.phase is Phase.AWAY:
            # Also when another robot answers: recovery starts again; it never ends with an armed robot.
            self._recovery.fail(error)
            return
        # A failed law can cause further errors, such as unread feedback; they must not replace the law's own error.
        if not self._law_failed or isinstance(error, BadInputError):
            self._why = str(error)
        feedback = self._parts.device.feedback
        if isinstance(error, LinkError | RobotStoppedError):
            if self.phase is Phase.ESTOP:
                self.emergency.request(self._t_s)  # a robot that was reset meanwhile does not know of it
            self._enter(Phase.AWAY)
            self._recovery = self._new_recovery(error)
            if self._parts.device.is_lockstep and isinstance(error, RobotStoppedError):
                self._recovery.begin_now()  # no time passes before the tick of a robot that was reset is known
            return
        self._parts.device.disarm()
        if isinstance(error, DeviceError) and feedback is not None and feedback.state in _LATCHED:
            self._enter(_LATCHED[feedback.state])
        elif self.emergency.pending:
            self._enter(Phase.ESTOP)
        else:  # the law failed, or the robot refuses
            self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)

    def _new_recovery(self, error: HilError) -> Recovery:
        return Recovery(self._parts.device, self._parts.clock, error, self._t_s, self._warned, arm=False)

    def _reconnect(self, t_s: float) -> None:
        self._tick.raise_robot_failure()
        self._tick.skip_fixes()
        try:
            if not self._recovery.advance():
                return
        except (BadInputError, DeviceError) as error:  # another robot, or one that refuses: it may be replaced
            self._recovery.fail(error)
            return
        self._tick.restart()
        self.recoveries += self._was_connected
        if not self._was_connected and not self.emergency.pending:
            self._why = None
        self._was_connected = True
        if self.emergency.pending:
            self.emergency.request(t_s)
            self._enter(Phase.ESTOP)
            self._parts.device.estop()
        else:
            self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)  # until its feedback shows that it is at rest

    def _drive(self, now: LoopSignals, fix: PoseFix | None) -> None:
        sensed = _, self.state = self._tick.sense(now.t_s, fix)
        self._tick.drive(now, fix, sensed, self.tasks.at(now.t_s, self.state))
        if self._tick.is_held:
            self.tasks.held()
        if self.tasks.gave_up is not None:
            self._why, self.tasks.gave_up = self.tasks.gave_up, None

    def _be_latched(self, robot: RobotState, t_s: float) -> None:
        device = self._parts.device
        if self.emergency.must_send(robot, t_s):
            device.estop()
        elif self.emergency.pop_clear():
            self.clear()
        elif robot is RobotState.IDLE:
            device.disarm()
            self._why = None
            self._enter(Phase.DISARMED)
        elif t_s > self._deadline_s:
            device.disarm()
            self._deadline_s = math.inf
            self._why = f"clearing was refused: {device.why_not_active()}"

    def _enter(self, phase: Phase, limit_s: float = math.inf) -> None:
        if phase is Phase.ACTIVE:
            self._warned()  # warnings that the robot has sent since it was armed
        self.phase = phase
        self.motion_requests += 1
        self._deadline_s = self._t_s + limit_s
        self.tasks.end()
        if phase is Phase.AWAY:
            self.state = None

    def _because(self) -> str:
        return f" ({self.why})" if self.why else ""


class _NoLaw:
    """Replaces a law that has failed; it is never asked for a command."""

    gains = NO_GAINS

    def reset(self, state: State, reference: Reference) -> None:
        raise AssertionError

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        raise AssertionError


class _NoSignals(NamedTuple):
    """Replaces the own signals of a law that has failed: the same names, NaN for each."""

    signals: tuple[str, ...]
    telemetry: tuple[float, ...]


def _without_law(parts: TickParts) -> TickParts:
    """Return the parts without their law, for a robot that is not driven until it is armed again."""
    silent = tuple(_NoSignals(tuple(own.signals), (NAN,) * len(own.signals)) for own in parts.extra)
    return parts._replace(controller=_NoLaw(), extra=silent)
