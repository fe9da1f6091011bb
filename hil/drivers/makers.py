"""A robot with motor controllers of other makers: a driver of ``hil.drivers`` joined to a link, a clock and a session.

The controllers know none of our states, so the session is kept here: nothing is sent but questions before the robot is
armed, ramping down is done here, and an error, or a controller that leaves closed loop by itself, stops all of them. A
stop is owed until it went out whole and all wheels were seen at rest: until then it is repeated, and no state is told
that it has not brought about.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.core.ports import Clock
from hil.core.types import CommandMode, FourWheels, WheelCommand
from hil.drivers.host_watch import HostWatch
from hil.drivers.makers_feedback import MakersReport, MotorFeedback, MotorsInfo
from hil.drivers.motor_line import MotorLine
from hil.drivers.motor_stop import REPEAT_NS, REST, MotorStop, StopTerms
from hil.drivers.port import Driver
from hil.robot.handshake import RETRY_NS, SILENCE_NS
from hil.robot.link_times import ClockSync, RoundTrip
from hil.robot.snapshot import Feedback
from hil.robot.wheel_map import WheelMap
from hil.wire.conditions import ConditionedLink

_START_LIMIT_NS = 4_000_000_000
_QUESTION_NS = 1_000_000
_ASK_NS = 20_000_000  # those that speak only when spoken to are lost after 250 ms, and some are asked in turn
_SETTLE_NS = 300_000_000  # heartbeats with errors come ten times a second, as some makers set them
_LINGER = 10  # repetitions of a stop that is owed at the end


class Terms(NamedTuple):
    """What the session rests on.

    ``advance`` lets ticks of 1 ms pass of an emulated robot in this process: lockstep. ``rearm`` says that the loop
    arms anew a robot that comes back. ``watch`` is who stops the robot when this process dies or hangs.
    """

    stop: StopTerms
    counts_per_revolution: int
    allow_motion: bool
    rearm: bool
    advance: Callable[[int], None] | None
    watch: HostWatch


class MakersRobot:
    """See ``hil.robot.port.Device``. Raises nothing when it is made; ``connect`` is the first to speak."""

    def __init__(self, link: ConditionedLink, clock: Clock, driver: Driver, wheel_map: WheelMap, terms: Terms) -> None:
        self._line = MotorLine(link, driver, is_lockstep=terms.advance is not None)
        self._clock = clock
        self._driver = driver
        self._map = wheel_map
        self._terms = terms
        self._info: MotorsInfo | None = None
        self._state = State.IDLE
        self._sequence = 0
        self._commanded: FourWheels = REST
        self._feedback = MotorFeedback(driver, wheel_map, terms.counts_per_revolution, terms.stop.stale_s)
        self._stop = MotorStop(driver, terms.stop, self._line)
        self._is_greeted = False
        self._has_armed = False  # ever
        self._has_lingered = False
        self._ask_again_ns = 0
        self._settled_ns = 0
        self._watch = terms.watch
        self._awaits_watch = False  # to be armed
        self.report = MakersReport(self._feedback)
        self.round_trip = RoundTrip()
        self.clock_sync = ClockSync()
        self.tick = 0

    # Connecting

    @property
    def is_lockstep(self) -> bool:
        return self._terms.advance is not None

    def connect(self) -> MotorsInfo:
        begin_ns = self._clock.now_ns()
        n = 0
        while not self.greeted():
            n += 1
            if n * _QUESTION_NS > SILENCE_NS:
                raise DeviceError(f"{self._driver.missing} ({self._line.describe()})")
            self.wait_until(begin_ns + n * _QUESTION_NS)
        assert self._info is not None
        return self._info

    @property
    def info(self) -> MotorsInfo | None:
        return self._info

    @property
    def speed_limit_rad_s(self) -> float:
        """Infinite: what makers' controllers keep their motors to is in their own settings."""
        return math.inf

    @property
    def warnings(self) -> Sequence[str]:
        """What has to be said before anything moves."""
        said = [*self._driver.warnings]
        if self._driver.capabilities.watchdog == "none" and self._watch.warning is not None:
            said.append(self._watch.warning)
        if self._terms.rearm:
            said.append(
                "with loop.rearm a robot that comes back is armed and driven on at once, also one whose power was cut "
                "by somebody for a reason"
            )
        return said

    def describe_link(self) -> str:
        return self._line.describe()

    # Coming back after a loss

    @property
    def keeps_counts(self) -> bool:
        return False  # a controller that was reset counts from zero, and nothing tells which were

    def leave(self) -> None:
        self._awaits_watch = False
        if self._stop.is_needed:
            self._drop(State.STOPPING)
            if self._stop.is_told:  # else the guardian, which has a way of its own to the port, is to try it too
                self._watch.hold()
        else:
            self._watch.rest()
        self._feedback.forget()
        self._line.discard()

    def reopen(self) -> None:
        self._line.reopen()

    def begin_again(self) -> None:
        self._is_greeted = False
        self._feedback.restart()
        self._driver.restart()  # first, for what was heard before says nothing of what a stop may do now
        if self._stop.is_needed:  # whoever is there may be driving still, on the last command of before the loss
            self._drop(State.STOPPING)
            self._stop.wait_no_longer_than(_SETTLE_NS)  # wheels that roll are sooner at rest when they are driven
        self._ask_again_ns = self._clock.now_ns()

    def greeted(self) -> bool:
        if not self._terms.allow_motion:
            raise BadInputError(
                "the robot has motor controllers: real motors would move; add --allow-motion when it may move"
            )
        now_ns = self._clock.now_ns()
        self._line.take(self._clock)
        self._repeat_stop(now_ns)
        words = self._driver.identity
        if words is None:
            if now_ns >= self._ask_again_ns:
                self._ask_again_ns = now_ns + RETRY_NS
                self._line.send(self._driver.ask())
            return False
        if self._info is not None and self._info.words != words:
            raise BadInputError(
                f"another robot answers on the link: {words}; the run began with {self._info.words}; plug in the first "
                "one, or start a new run"
            )
        self._info = MotorsInfo(words)
        self._is_greeted = True
        return True

    # The way to ACTIVE and back

    def attend(self, clock: Clock) -> None:
        self._clock = clock

    def start(self, clock: Clock, period_ns: int) -> int:
        self.attend(clock)
        try:
            begin_ns = clock.now_ns()
            n = 0
            while n * period_ns <= _START_LIMIT_NS:
                self.wait_until(begin_ns + n * period_ns)
                if self.armed():
                    return begin_ns + n * period_ns
                n += 1
            raise DeviceError(self.why_not_active())
        except BaseException:
            self.close()
            raise

    def armed(self) -> bool:
        self._take()
        if self._state is State.ACTIVE:
            return True
        if self._state in (State.FAULT, State.ESTOP):
            raise DeviceError(self.why_not_active())
        if self._info is None or self._state is State.STOPPING:
            self._tell_watch()
            return False
        self._awaits_watch = not self._watch.begin()
        if self._awaits_watch:
            return False
        now_ns = self._clock.now_ns()
        self._state = State.ARMED
        self._has_armed = True
        self._has_lingered = False
        self._stop.armed()
        self._line.send(self._driver.arm(now_ns))
        self._watch.beat()
        if not self._driver.is_armed or not self._feedback.is_fresh(now_ns):
            return False
        self._line.send(self._driver.command(REST, REST, now_ns))
        self._commanded = REST
        self.report.why = None
        self._state = State.ACTIVE
        self._renew()
        return self._feedback.newest is not None

    def why_not_active(self) -> str:
        if self._state is State.ESTOP:
            return "an e-stop is latched; clear it when the robot may be armed again"
        if self._state is State.FAULT:
            return (
                f"the motor controllers reported {self.report.why}; find the cause, then clear it with their maker's "
                "tool, or with hil serve and hil ctl clear"
            )
        if self._awaits_watch:
            return "the guardian, without which nothing is armed, has not answered within 4 s (GUARDIAN.md)"
        if not self._feedback.is_fresh(self._clock.now_ns()):
            return self._driver.missing or (
                "the motor controllers send no feedback of all four wheels that is younger than the "
                f"{self._terms.stop.stale_s:g} s of firmware.watchdog_s; look at its rate, and whether all four send it"
            )
        return "the motor controllers did not go into closed loop within 4 s; look at them with their maker's tool"

    def disarm(self) -> None:
        self._awaits_watch = False
        if self._state is State.ACTIVE:
            self._state = State.STOPPING
            self._stop.ramp_down(self._clock.now_ns(), self._commanded)
        elif self._state is State.ARMED:
            self._drop(State.STOPPING)

    def estop(self) -> None:
        if self._terms.allow_motion:
            if not self._stop.is_needed:
                self._watch.rest()  # it may have been asked, for an arming that does not come
            self._drop(State.ESTOP)
            self._renew()

    def clear(self) -> None:
        self._line.send(self._driver.clear())
        if self._state in (State.ESTOP, State.FAULT):
            self._stop.clear()
            # What is heard before this has passed may be of before; errors that are still there make it FAULT again.
            self._settled_ns = self._clock.now_ns() + _SETTLE_NS
            self._state = State.STOPPING

    def stop(self, period_ns: int, limit_ns: int) -> bool:
        self.disarm()
        begin_ns = self._clock.now_ns()
        n = 1
        try:
            while n * period_ns <= limit_ns:
                self.wait_until(begin_ns + n * period_ns)
                feedback = self.poll()
                is_over = self._state in (State.IDLE, State.FAULT, State.ESTOP) and self._stop.is_told
                if feedback is not None and is_over:
                    self.wait_until(begin_ns + (n + 1) * period_ns)  # so that the last frames get there
                    return True
                n += 1
            if self.report.trouble is not None:
                raise LinkError(self.report.trouble)
            return False
        finally:
            self.close()

    # One tick

    def wait_until(self, t_ns: int) -> int:
        return self._line.wait_until(self._clock, t_ns)

    def poll(self) -> Feedback | None:
        self._take()
        self._tell_watch()
        return self._feedback.newest

    def _take(self) -> None:
        """Take what has arrived, and go on with what it asks for."""
        try:
            self._line.take(self._clock)
            self._supervise()
        except HilError:
            raise
        except Exception:  # a driver's own: nobody knows what it would send next
            self.report.why = "a failure of its driver"
            self._drop(State.FAULT)
            raise
        now_ns = self._clock.now_ns()
        self._repeat_stop(now_ns)
        self._stop.raise_lost(now_ns)
        self._ask(now_ns)
        self._renew()

    def _tell_watch(self) -> None:
        """Tell the guardian whether there is anything to be stopped; while ACTIVE it is each command that tells it."""
        if self._stop.is_needed:
            if self._state is not State.ACTIVE:
                self._watch.beat()
        elif not self._awaits_watch:
            self._watch.rest()

    def _supervise(self) -> None:
        """Find out what ends the session, and go on with a stop."""
        now_ns = self._clock.now_ns()
        if self._state is State.STOPPING and now_ns < self._settled_ns:
            return
        is_active = self._state is State.ACTIVE
        if errors := self._driver.errors:
            if self._state is not State.ESTOP:
                self.report.why = "; ".join(errors)  # a name may come later than the error
            if self._state is not State.FAULT and self._state is not State.ESTOP:
                self._drop(State.FAULT)
        elif is_active and not self._driver.is_armed:
            self.report.why = "a motor controller left closed loop by itself"
            self._drop(State.STOPPING)
        elif (is_active or self._state is State.ARMED or self._stop.is_ramping) and not self._may_drive():
            return
        elif self._state is State.STOPPING and self._stop.go_on(now_ns):
            self._state = State.IDLE

    def _repeat_stop(self, now_ns: int) -> None:
        """Repeat a stop that is owed."""
        self._stop.repeat(now_ns)
        self._look()

    def _look(self) -> None:
        """Tell what a person has to know."""
        is_strange = self._state is State.IDLE and not self._has_armed and self._driver.capabilities.watchdog == "none"
        self.report.look(self._stop.problem, self._driver.sample if is_strange else None)

    def _ask(self, now_ns: int) -> None:
        """Ask for the state while nothing is commanded: many speak only when they are spoken to."""
        is_commanded = self._state in (State.ARMED, State.ACTIVE) or self._stop.is_ramping
        if not self._is_greeted or is_commanded or now_ns < self._ask_again_ns:
            return
        self._ask_again_ns = now_ns + _ASK_NS
        # While a stop is owed it goes the same way, and tells what became of it.
        with contextlib.suppress(*(LinkError,) if self._stop.is_owed else ()):
            self._line.send(self._driver.ask())

    @property
    def poll_age_ns(self) -> int:
        return self._line.poll_age_ns

    @property
    def feedback(self) -> Feedback | None:
        return self._feedback.newest

    def send(self, command: WheelCommand) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        if self._state is State.ACTIVE and self._may_drive():
            speed = self._map.to_wire(command.speed_rad_s)
            self._command(speed, self._map.to_wire(command.torque_n_m))
            self._watch.beat()
            self._may_drive()  # this process may have stood still just before: that command is followed by the stop
        return self._sequence

    def _may_drive(self) -> bool:
        """Tell whether the guardian watches, and has not stopped the robot; stop it here too where that is not so."""
        why = self._watch.failure
        if why is None:
            return True
        self.report.why = why
        self._drop(State.STOPPING)
        return False

    def step(self, ticks: int) -> None:
        assert self._terms.advance is not None
        self._terms.advance(ticks)
        self.tick += ticks

    def _command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels) -> None:
        if not all(map(math.isfinite, torque_n_m)):
            raise ValueError(f"torques {torque_n_m} N·m: expected finite numbers")
        if self._terms.stop.mode is CommandMode.TORQUE:
            speed_rad_s = REST
        elif not all(map(math.isfinite, speed_rad_s)):
            raise ValueError(f"speeds {speed_rad_s} rad/s: expected finite numbers")
        self._commanded = speed_rad_s
        self._line.send(self._driver.command(speed_rad_s, torque_n_m, self._clock.now_ns()))

    def _drop(self, state: State) -> None:
        """Leave closed loop, at best effort; what is latched stays so.

        But for an e-stop nothing is sent to motors that were not armed from here: others may be driving them.
        """
        self._commanded = REST
        self._awaits_watch = False
        if self._state is not State.ESTOP and (self._state is not State.FAULT or state is State.ESTOP):
            self._state = state
        if state is State.ESTOP or self._stop.is_needed:
            self._stop.leave_loop(self._clock.now_ns(), latched=self._state is State.ESTOP)
            self._look()

    def _renew(self) -> None:
        """Make feedback of what was heard. An e-stop is told when it went out whole: that is what confirms it."""
        is_out = self._state is not State.ESTOP or self._stop.is_told
        self._feedback.renew(self._clock.now_ns(), self._state if is_out else State.STOPPING, self._sequence)

    # Accounts

    @property
    def sent(self) -> int:
        return self._line.sent

    @property
    def received(self) -> int:
        return self._line.received

    def wire_sha256(self) -> str:
        return self._line.wire_sha256()

    @property
    def snapshots_lost(self) -> int:
        return 0

    def rejected(self) -> dict[str, int]:
        return self._line.rejected()

    def close(self) -> None:
        if self._stop.is_needed:
            self._drop(State.STOPPING)
            if not self._has_lingered:
                self._has_lingered = True
                self._linger()
        if self._stop.is_told:  # else the guardian is left to stop the robot
            self._watch.rest()

    def _linger(self) -> None:
        """Repeat the stop until it is owed no more, for half a second."""
        begin_ns = self._clock.now_ns()
        for n in range(1, _LINGER + 1):  # the only one may be lost, and nobody comes after us
            with contextlib.suppress(HilError):
                self.wait_until(begin_ns + n * REPEAT_NS)
            with contextlib.suppress(HilError):
                self.poll()
            self._repeat_stop(self._clock.now_ns())  # whatever kept the others from it
            if not self._stop.is_owed:
                return
