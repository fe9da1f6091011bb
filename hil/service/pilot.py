"""What a served robot does, tick by tick: reconnected, armed, driven, stopped. Moves only for who asks, and when armed.

It has no clock of its own and knows nothing of HTTP: orders are method calls between two ticks, and one that makes no
sense in the present phase is refused with a sentence.
"""

import contextlib
import math
from collections.abc import Callable

from firmware_protocol.generated.messages import State as RobotState
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, OverdueError, RobotStoppedError
from hil.core.kinematics import BodyTwist
from hil.core.signals import LoopSignals
from hil.core.tick_watch import TickOverdue
from hil.core.types import CommandMode, Pose, PoseFix, Reference, State
from hil.references import ReferenceSource
from hil.runtime.recovery import Recovery, Warned
from hil.runtime.sampling import Timing
from hil.runtime.tick import Parts, Tick
from hil.scenario.laws import Laws
from hil.service.conduct import NOWHERE, Conduct, Rules
from hil.service.emergency import EmergencyStop
from hil.service.messages import Phase, Task
from hil.service.muted import muted

_ARMING_LIMIT_S = 4.0
_STOPPING_LIMIT_S = 5.0
_CLEARING_LIMIT_S = 2.0


class Pilot:
    """The state machine of a service. ``tick`` is called once a tick; it raises only for what ends the service.

    A robot that was lost is reconnected for ever, and is disarmed then: only ``arm`` arms. What ends ACTIVE from
    outside ends the task with it.

    ``motions_asked`` counts the orders that changed what the robot is to do, and the phases: an order that takes its
    time is outdated by any other.
    """

    def __init__(self, parts: Parts, mode: CommandMode, timing: Timing, rules: Rules) -> None:
        self._parts = parts
        self._rules = rules
        self._doing = Tick(parts, mode, timing)
        self._t_s = 0.0
        self._deadline_s = math.inf
        self._emergency = EmergencyStop(rules.estop_repeat_s)
        self._why: str | None = None
        self._trouble: str | None = None
        self._law_failed = False
        self._conduct = Conduct(rules)
        self.phase = Phase.AWAY
        self.motions_asked = 0
        self.state: State | None = None
        self.recoveries = 0
        self._was_connected = False
        parts.device.attend(parts.clock)
        self._warned = Warned(parts.device, lambda sentence: self._parts.note(self._t_s, "warning", sentence))
        self._recovery = self._way_back(RobotStoppedError("not connected yet"))
        self._steps: dict[Phase, Callable[[LoopSignals, PoseFix | None], None]] = {
            Phase.AWAY: self._come_back,
            Phase.DISARMED: self._wait,
            Phase.ARMING: self._arm,
            Phase.ACTIVE: self._drive,
            Phase.STOPPING: self._ramp_down,
            Phase.FAULT: self._be_latched,
            Phase.ESTOP: self._be_latched,
        }

    @property
    def why(self) -> str | None:
        """What went wrong last, as a sentence, in AWAY what keeps the robot from coming back, and what is wrong now."""
        problem = self._recovery.problem if self.phase is Phase.AWAY else None
        said = filter(None, (self._why, problem, self._parts.device.report.trouble))
        return "; ".join(dict.fromkeys(said)) or None

    @property
    def estop_owed(self) -> bool:
        """Whether an e-stop was asked for that the robot has not confirmed yet."""
        return self._emergency.owed

    @property
    def parts(self) -> Parts:
        """What the ticks are made of; the law in command among them."""
        return self._doing.parts

    @property
    def feedback_age_ms(self) -> float | None:
        """Age of the newest feedback; None while there is none."""
        return None if self.phase is Phase.AWAY else self._doing.feedback_age_ms

    @property
    def task(self) -> Task | None:
        """What an ACTIVE robot is doing; else None."""
        return self._conduct.task

    @property
    def reference(self) -> Reference | None:
        """Where an ACTIVE robot should be; else None."""
        return self._conduct.reference

    @property
    def twist_age_s(self) -> float | None:
        """Age of the twist in force; None where none is."""
        return self._conduct.twist_age_s

    # Orders

    def arm(self) -> None:
        """Arm the robot, which is then held where it is. Raises BadInputError unless it is DISARMED."""
        if self.phase is not Phase.DISARMED:
            raise BadInputError(f"the robot is {self.phase}; it can be armed when it is disarmed{self._because()}")
        self._why = None
        if self._law_failed:
            self._law_failed = False
            self._doing.use(self._parts)
        self._enter(Phase.ARMING, _ARMING_LIMIT_S)

    def disarm(self) -> None:
        """Ramp down and go to IDLE; also what ends arming and clearing. Changes nothing where nothing is armed."""
        self.motions_asked += 1
        if self.phase in (Phase.ARMING, Phase.ACTIVE):
            self._parts.device.disarm()
            self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)
        elif self.phase in (Phase.FAULT, Phase.ESTOP):
            self._parts.device.disarm()
            self._emergency.keep()
            self._deadline_s = math.inf

    def disarm_because(self, why: str) -> None:
        """Do the same for a reason that the status tells."""
        self._why = why
        self.disarm()

    def estop(self) -> None:
        """Stop at once and latch that. A robot that is away gets it as soon as it is back."""
        self._emergency.ask(self._t_s)
        self._why = "an e-stop was asked for"
        if self.phase is Phase.AWAY:
            self._why += "; the robot is away: it is sent blindly now, and again as soon as it is back"
            self.motions_asked += 1
        else:
            self._enter(Phase.ESTOP)
        with contextlib.suppress(LinkError):  # it is repeated at every tick, and when the robot is back
            self._parts.device.estop()

    def clear(self) -> None:
        """Leave FAULT or ESTOP, which arms nothing. Raises BadInputError where nothing is latched."""
        if self.phase not in (Phase.FAULT, Phase.ESTOP):
            raise BadInputError(f"the robot is {self.phase}; there is nothing to clear")
        if not self._emergency.may_clear():
            return  # it is done when the robot has confirmed the e-stop
        self._parts.device.clear()
        self._deadline_s = self._t_s + _CLEARING_LIMIT_S

    def stop(self) -> None:
        """Ramp down to rest and hold. Raises BadInputError unless the robot is ACTIVE, and its pose known."""
        self._active_conduct().stop()

    def twist(self, twist: BodyTwist) -> BodyTwist:
        """Drive by this for ``twist_timeout_s``; return what the limits leave of it. Raises as ``stop``."""
        return self._active_conduct().twist(twist)

    def track(self, path: ReferenceSource, *, here: bool) -> None:
        """Follow a path once the robot rests; see ``Conduct``. Raises as ``stop``."""
        self._active_conduct().track(path, here=here)

    def go(self, pose: Pose) -> None:
        """Go to a pose in the world and hold there. Raises as ``stop``."""
        self._active_conduct().go(pose)

    def _active_conduct(self) -> Conduct:
        self.need_active()
        self.motions_asked += 1
        return self._conduct

    def use(self, laws: Laws) -> None:
        """Control by other laws from the next tick on, as with other gains; they begin anew there."""
        self._parts = self._parts._replace(controller=laws.controller, shadows=laws.shadows, extra=laws.extra)
        self._law_failed = False
        self._doing.use(self._parts)

    # The tick

    def tick(self, now: LoopSignals, fix: PoseFix | None) -> None:
        """Do one tick, and tell of it once. Raises what ended a robot in this process, which cannot come back."""
        self._t_s = now.t_s
        try:
            self._do(now, fix)
        except TickOverdue as overdue:  # in what is not the law's, as a log whose reader stalls
            self.lose(OverdueError(str(overdue)))

    def _do(self, now: LoopSignals, fix: PoseFix | None) -> None:
        faults = self._parts.faults
        if faults is not None:
            faults.at(round(now.t_s * 1e9))
            fix = faults.truth(fix)
        count = self._doing.count
        self._attempt(lambda: self._steps[self.phase](now, fix))
        if self._doing.count == count:  # only a tick that was driven has been told of
            self._attempt(lambda: self._doing.tell_away(now, fix, NOWHERE, self.state))
        if self._doing.count == count:  # the law's own signals failed, and it is asked for none any more
            self._doing.tell_away(now, fix, NOWHERE, self.state)
        self._note_trouble()

    def _attempt(self, part: Callable[[], None]) -> None:
        """Do a part of a tick, and take what goes wrong in it. Raises as ``tick``."""
        try:
            part()
        except HilError as error:
            self._take_failure(error)
        except TickOverdue as overdue:
            self._take_failure(BadInputError(str(overdue)))
        except (ArithmeticError, ValueError) as error:  # a law or a path beyond what numbers can do
            self._take_failure(BadInputError(f"the law or the path failed: {type(error).__name__}: {error}"))

    def _take_failure(self, error: HilError) -> None:
        if isinstance(error, BadInputError):
            self._law_failed = True
            self._doing.use(muted(self._parts))
        self.lose(error)

    def _note_trouble(self) -> None:
        trouble = self._parts.device.report.trouble
        if trouble is not None and trouble != self._trouble:
            self._parts.note(self._t_s, "warning", trouble)
        self._trouble = trouble

    def lose(self, error: HilError) -> None:
        """Take what went wrong, in a tick or while waiting for it. Raises as ``tick``."""
        self._doing.raise_robot_failure()
        if self.phase is Phase.AWAY:
            # Whatever it is, another robot among it: the way back begins again, and never ends in an armed one.
            self._recovery.fail(error)
            return
        # What follows a law that failed, such as feedback that lay unread meanwhile, does not take its place.
        if not self._law_failed or isinstance(error, BadInputError):
            self._why = str(error)
        latched = {RobotState.FAULT: Phase.FAULT, RobotState.ESTOP: Phase.ESTOP}
        feedback = self._parts.device.feedback
        if isinstance(error, LinkError | RobotStoppedError):
            if self.phase is Phase.ESTOP:
                self._emergency.ask(self._t_s)  # one that was reset meanwhile knows nothing of it
            self._enter(Phase.AWAY)
            self._recovery = self._way_back(error)
        elif isinstance(error, DeviceError) and feedback is not None and feedback.state in latched:
            self._parts.device.disarm()
            self._enter(latched[feedback.state])
        else:  # the law, or a robot that refuses
            self._parts.device.disarm()
            if self._emergency.owed:
                self._enter(Phase.ESTOP)
            else:
                self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)

    def _way_back(self, error: HilError) -> Recovery:
        return Recovery(self._parts.device, self._parts.clock, error, self._t_s, self._warned, arm=False)

    def _come_back(self, now: LoopSignals, fix: PoseFix | None) -> None:
        self._doing.raise_robot_failure()
        self._doing.skip_fixes()
        try:
            is_back = self._recovery.advance()
        except (BadInputError, DeviceError) as error:  # another robot, or one that refuses: it may be exchanged
            self._recovery.fail(error)
            is_back = False
        if not is_back:
            return
        self._doing.restart()
        self.recoveries += self._was_connected
        if not self._was_connected:
            self._was_connected, self._why = True, self._why if self._emergency.owed else None
        if self._emergency.owed:
            self._emergency.ask(now.t_s)
            self._enter(Phase.ESTOP)
            self._parts.device.estop()
        else:
            self._enter(Phase.STOPPING, _STOPPING_LIMIT_S)  # until its feedback says that it is none

    def _wait(self, now: LoopSignals, fix: PoseFix | None) -> None:
        robot = self._look(now, fix)
        if robot in (RobotState.FAULT, RobotState.ESTOP):
            self._latch(robot)
        elif robot in (RobotState.ARMED, RobotState.ACTIVE):
            self._why = "another host has armed the robot; stop that one first"

    def _arm(self, now: LoopSignals, fix: PoseFix | None) -> None:
        device = self._parts.device
        if not device.armed():
            self._look(now, fix)
            if now.t_s > self._deadline_s:
                raise DeviceError(device.why_not_active())
            return
        self._doing.begin()
        self._enter(Phase.ACTIVE)
        self._conduct.begin()
        self._drive(now, fix)

    def _drive(self, now: LoopSignals, fix: PoseFix | None) -> None:
        sensed = self._doing.sense(now.t_s, fix)
        _, self.state = sensed
        self._doing.drive(now, fix, sensed, self._conduct.at(now.t_s, self.state))
        if self._doing.is_held:
            self._conduct.held()
        if self._conduct.gave_up is not None:
            self._why, self._conduct.gave_up = self._conduct.gave_up, None

    def _ramp_down(self, now: LoopSignals, fix: PoseFix | None) -> None:
        robot = self._look(now, fix)
        if robot is RobotState.IDLE:
            self._enter(Phase.DISARMED)
        elif robot in (RobotState.FAULT, RobotState.ESTOP):
            self._latch(robot)
        elif now.t_s > self._deadline_s:
            self._why = f"the robot did not come to rest within {_STOPPING_LIMIT_S:g} s: it is {robot.name}"

    def _be_latched(self, now: LoopSignals, fix: PoseFix | None) -> None:
        device = self._parts.device
        robot = self._look(now, fix)
        if self._emergency.is_sent(robot, now.t_s):
            device.estop()
            return
        if self._emergency.take_clear():
            self.clear()
            return
        if robot is RobotState.IDLE:
            device.disarm()
            self._why = None
            self._enter(Phase.DISARMED)
        elif now.t_s > self._deadline_s:
            device.disarm()
            self._deadline_s = math.inf
            self._why = f"clearing was refused: {device.why_not_active()}"

    def _look(self, now: LoopSignals, fix: PoseFix | None) -> RobotState:
        """Sense without driving; return the robot's own state."""
        feedback, self.state = self._doing.sense(now.t_s, fix, active=False)
        return feedback.state

    # Changes

    def _enter(self, phase: Phase, limit_s: float = math.inf) -> None:
        if phase is Phase.ACTIVE:
            self._warned()  # since it was armed the robot has told more
        self.phase = phase
        self.motions_asked += 1
        self._deadline_s = self._t_s + limit_s
        self._conduct.end()
        if phase is Phase.AWAY:
            self.state = None

    def _latch(self, robot: RobotState) -> None:
        if not self._parts.device.report.explains(robot):
            return  # STATUS says why, and comes a little later
        self._why = self._parts.device.why_not_active()
        self._enter(Phase.FAULT if robot is RobotState.FAULT else Phase.ESTOP)

    def need_active(self) -> None:
        """Raise BadInputError unless the robot is ACTIVE."""
        if self.phase is not Phase.ACTIVE:
            raise BadInputError(f"the robot is {self.phase}; arm it first{self._because()}")

    def _because(self) -> str:
        return f" ({self.why})" if self.why else ""
