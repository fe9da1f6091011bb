"""A robot with another maker's motor controllers: the session that joins a driver of ``hil.addons.motors`` to a link.

The controllers do not know our states, so they are kept here. Before arming only questions are sent. The ramp down is
commanded from here. An error of one controller, or one that leaves closed loop by itself, stops all of them. A stop is
pending, and repeated, until it was sent whole twice after all wheels were seen at rest (``MotorStop``). Its state is
reported earlier: ESTOP once it was sent whole; IDLE when the wheels also rest, at the latest a second later.
"""

import contextlib
import math
from collections.abc import Sequence

from firmware_protocol.generated.messages import State
from hil.addons.motors.guardian import HostWatch, watch_over
from hil.addons.motors.makers_feedback import MakersReport, MotorsInfo
from hil.addons.motors.motor_stop import REPEAT_NS, REST, MotorLine, MotorStop, SessionTerms
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.core.guard import Brake, Guard
from hil.core.ports import Clock
from hil.core.types import CommandMode, FourWheels, WheelCommand
from hil.core.wheel_map import ImuMount, WheelMap
from hil.robot.driver import Driver, DriverError
from hil.robot.driver_registry import dialect
from hil.robot.handshake import SILENCE_NS
from hil.robot.port import Device
from hil.robot.snapshot import Feedback
from hil.runtime.bench import RobotHere
from hil.runtime.robots import link_of, wheel_map
from hil.scenario import Scenario
from hil.scenario.motor_checks import make_driver
from hil.wire.conditions import ConditionedLink

_AT_REST = (State.IDLE, State.FAULT, State.ESTOP)
_QUESTION_NS = 1_000_000  # between two looks for answers while connecting
_SETTLE_NS = 300_000_000  # until reports are new: some makers send heartbeats with errors only ten times a second
_LINGER = 10  # repetitions of a stop that is still pending at the end


class MakersRobot(Device):
    """A robot with another maker's motors at the other end of a link.

    ``watch`` stops the robot when this process dies or hangs. Nothing is sent before ``connect``.
    """

    report: MakersReport
    keeps_counts = False  # a controller that was reset counts from zero, and does not report the reset
    _clock: Clock
    _line: MotorLine

    def __init__(
        self,
        link: ConditionedLink,
        clock: Clock,
        driver: Driver,
        wiring: tuple[WheelMap, ImuMount],
        terms: SessionTerms,
        watch: HostWatch,
    ) -> None:
        super().__init__(link, is_lockstep=terms.advance is not None)
        self._line = MotorLine(link, driver, self._poll_age, is_lockstep=self.is_lockstep)
        self._clock, self._driver, (self._map, imu) = clock, driver, wiring
        self._terms, self._watch = terms, watch
        self._state = State.IDLE
        self._commanded: FourWheels = REST
        self._stop = MotorStop(driver, terms, self._line)
        self._has_armed = self._has_lingered = False  # ever armed; the stop at the end was repeated
        self._settled_ns = 0
        self._awaits_watch = False  # whether arming waits for the guardian's answer
        self.report = MakersReport(driver, self._map, imu, terms.counts_per_revolution, terms.stale_s)

    # Connecting

    def connect(self) -> MotorsInfo:
        begin_ns = self._clock.now_ns()
        for t_ns in range(begin_ns, begin_ns + SILENCE_NS + 1, _QUESTION_NS):
            self.wait_until(t_ns)
            if self.greeted() and self._line.info is not None:
                return self._line.info
        missing = self._line.explain(self._driver.missing, self._clock.now_ns())
        raise DeviceError(f"{missing} ({self.describe_link()})")

    @property
    def info(self) -> MotorsInfo | None:
        return self._line.info

    @property
    def warnings(self) -> Sequence[str]:
        unwatched = self._watch.warning if self._driver.capabilities.watchdog == "none" else None
        rearms = (
            "with loop.rearm a robot that comes back is armed and driven on at once, also one whose power was cut by "
            "somebody for a reason"
        )
        return [*self._driver.warnings, *filter(None, (unwatched, rearms if self._terms.rearm else None))]

    # Coming back after a loss

    def leave(self) -> None:
        self._awaits_watch = False
        if self._stop.is_needed:
            self._drop(State.STOPPING)
            if self._stop.is_sent:  # else the guardian, which opens the port itself, tries to stop it too
                self._watch.hold()
        else:
            self._watch.rest()
        self.report.newest = None  # until the next sample
        self._discard()

    def begin_again(self) -> None:
        self.report.restart()
        self._driver.restart()  # before the stop: its frames must not depend on frames from before the loss
        if self._stop.is_needed:  # the controllers may still follow the last command from before the loss
            self._drop(State.STOPPING)
            self._stop.wait_ns = _SETTLE_NS  # rolling wheels come to rest sooner when they are driven
        self._line.restart(self._clock.now_ns())

    def greeted(self) -> bool:
        if not self._terms.allow_motion:
            raise BadInputError(
                "the robot has motor controllers: real motors would move; add --allow-motion when it may move"
            )
        now_ns = self._clock.now_ns()
        self._line.take(self._clock)
        self._repeat_stop(now_ns)
        return self._line.identify(now_ns)

    # The way to ACTIVE and back

    def armed(self) -> bool:
        self._take()
        if self._state is State.ACTIVE:
            return True
        if self._state in (State.FAULT, State.ESTOP):
            raise DeviceError(self.why_not_active())
        if self._line.info is None or self._state is State.STOPPING:
            self._report_to_watch()
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
        if not self._driver.is_armed or not self.report.is_fresh(now_ns):
            return False
        self._line.send(self._driver.command(REST, REST, now_ns))
        self._commanded = REST
        self.report.why = None
        self._state = State.ACTIVE
        self._renew()
        return self.report.newest is not None

    def why_not_active(self) -> str:
        if self._awaits_watch:
            return "the guardian, without which nothing is armed, has not answered within 4 s (GUARDIAN.md)"
        return self.report.why_not_active(self._state, self._clock.now_ns(), self._line.explain)

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
                self._watch.rest()  # it may have been asked to watch, but the robot will not be armed now
            self._drop(State.ESTOP)
            self._renew()

    def clear(self) -> None:
        self._line.send(self._driver.clear())
        if self._state in (State.ESTOP, State.FAULT):
            self._stop.is_latched = False
            # Until then reports may be from before; after that, errors that remain make it FAULT again.
            self._settled_ns = self._clock.now_ns() + _SETTLE_NS
            self._state = State.STOPPING

    def stop(self, period_ns: int, limit_ns: int) -> bool:
        self.disarm()
        begin_ns = self._clock.now_ns()
        try:
            for t_ns in range(begin_ns + period_ns, begin_ns + limit_ns + 1, period_ns):
                self.wait_until(t_ns)
                if self.poll() is not None and self._state in _AT_REST and self._stop.is_sent:
                    self.wait_until(t_ns + period_ns)  # so that the last frames arrive
                    return True
            if self.report.trouble is not None:
                raise LinkError(self.report.trouble)
            return False
        finally:
            self.close()

    # One tick

    def poll(self) -> Feedback | None:
        self._take()
        self._report_to_watch()
        return self.report.newest

    def _take(self) -> None:
        try:
            self._line.take(self._clock)
            self._supervise()
        except Exception as error:
            if isinstance(error, DriverError) or not isinstance(error, HilError):
                self.report.why = "a failure of its driver"  # what it would send next is unknown
                self._drop(State.FAULT)
            raise
        now_ns = self._clock.now_ns()
        self._repeat_stop(now_ns)
        self._stop.raise_lost(now_ns)
        if self._state not in (State.ARMED, State.ACTIVE) and not self._stop.is_ramping:
            # A pending stop uses the same link, and reports its failure.
            with contextlib.suppress(*(LinkError,) if self._stop.is_pending else ()):
                self._line.ask_state(now_ns)
        self._renew()

    def _report_to_watch(self) -> None:
        """Tell the guardian whether it has to stop anything; while ACTIVE each command does that (``send``)."""
        if self._stop.is_needed:
            if self._state is not State.ACTIVE:
                self._watch.beat()
        elif not self._awaits_watch:
            self._watch.rest()

    def _supervise(self) -> None:
        """Stop the motors where something ends the session, and go on with a stop that has begun."""
        now_ns = self._clock.now_ns()
        if self._state is State.STOPPING and now_ns < self._settled_ns:
            return
        if errors := self._driver.errors:
            if self._state is not State.ESTOP:
                self.report.why = "; ".join(errors)  # each time: an error's name may come later than the error
            if self._state is not State.FAULT and self._state is not State.ESTOP:
                self._drop(State.FAULT)
        elif self._state is State.ACTIVE and not self._driver.is_armed:
            self.report.why = "a motor controller left closed loop by itself"
            self._drop(State.STOPPING)
        elif (self._state in (State.ARMED, State.ACTIVE) or self._stop.is_ramping) and not self._may_drive():
            return
        elif self._state is State.STOPPING and self._stop.go_on(now_ns):
            self._state = State.IDLE

    def _repeat_stop(self, now_ns: int) -> None:
        self._stop.repeat(now_ns)
        self._report_trouble()

    def _report_trouble(self) -> None:
        is_strange = self._state is State.IDLE and not self._has_armed and self._driver.capabilities.watchdog == "none"
        self.report.set_trouble(self._stop.problem, self._driver.sample if is_strange else None)

    @property
    def feedback(self) -> Feedback | None:
        return self.report.newest

    def send(self, command: WheelCommand) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        if self._state is State.ACTIVE and self._may_drive():
            is_torque = self._terms.mode is CommandMode.TORQUE
            speed_rad_s = REST if is_torque else self._map.to_wire(command.speed_rad_s)
            torque_n_m = self._map.to_wire(command.torque_n_m)
            if not all(map(math.isfinite, (*speed_rad_s, *torque_n_m))):
                raise ValueError(f"speeds {speed_rad_s} rad/s, torques {torque_n_m} N·m: expected finite numbers")
            self._commanded = speed_rad_s
            self._line.send(self._driver.command(speed_rad_s, torque_n_m, self._clock.now_ns()))
            self._watch.beat()
            self._may_drive()  # if this process hung just before, the stop follows this command
        return self._sequence

    def _may_drive(self) -> bool:
        """Return whether the guardian watches and has not stopped the robot; if not, stop the robot."""
        if (failure := self._watch.failure) is not None:
            self.report.why = failure
            self._drop(State.STOPPING)
        return failure is None

    def step(self, ticks: int) -> None:
        assert self._terms.advance is not None
        self._terms.advance(ticks)
        self._tick += ticks

    def _drop(self, state: State) -> None:
        """Enter ``state`` and make the motors leave closed loop, at best effort; a latched state stays.

        Motors that were not armed from here get only an e-stop: another program may be driving them.
        """
        self._commanded = REST
        self._awaits_watch = False
        if self._state is not State.ESTOP and (self._state is not State.FAULT or state is State.ESTOP):
            self._state = state
        if state is State.ESTOP or self._stop.is_needed:
            self._stop.leave_loop(self._clock.now_ns(), latched=self._state is State.ESTOP)
            self._report_trouble()

    def _renew(self) -> None:
        """Make feedback of the newest sample. State ESTOP is reported once the e-stop was sent whole."""
        is_pending = self._state is State.ESTOP and not self._stop.is_sent
        self.report.renew(self._clock.now_ns(), State.STOPPING if is_pending else self._state, self._sequence)

    def close(self) -> None:
        if self._stop.is_needed:
            self._drop(State.STOPPING)
            if not self._has_lingered:
                self._has_lingered = True
                self._linger()
        if self._stop.is_sent:  # else the guardian is left to stop the robot
            self._watch.rest()

    def _linger(self) -> None:
        """Repeat the stop until it is no longer pending, for half a second at most."""
        begin_ns = self._clock.now_ns()
        for n in range(1, _LINGER + 1):  # a single stop may be lost, and nothing is sent after this
            with contextlib.suppress(HilError):
                self.wait_until(begin_ns + n * REPEAT_NS)
            with contextlib.suppress(HilError):
                self.poll()
            with contextlib.suppress(DriverError):
                self._repeat_stop(self._clock.now_ns())  # also if ``poll`` did not get that far
            if not self._stop.is_pending:
                return


def open_session(
    scenario: Scenario,
    link: ConditionedLink,
    clock: Clock,
    local: RobotHere | None,
    guarding: contextlib.ExitStack,
    *,
    allow_motion: bool,
) -> MakersRobot:
    """Open the session with a scenario's motor controllers; see ``hil.runtime.bench.OpenSession``."""
    firmware, device, mode, driver = scenario.firmware, scenario.device, scenario.controller.mode, make_driver(scenario)
    watch = HostWatch()
    if local is None:
        made, priority = dialect(device.driver), scenario.realtime.priority
        watch = watch_over(made, driver, link_of(scenario), device.guardian_s, priority)
        guarding.callback(watch.release)
    torque_limit_n_m = min(firmware.torque_limit_n_m, scenario.robot.torque_limit_n_m)
    guard = Guard(scenario.robot.speed_limit_rad_s, torque_limit_n_m)
    terms = SessionTerms(
        mode,
        firmware.ramp_s,
        firmware.watchdog_s,
        Brake(mode, guard, firmware.speed_kp_n_m_s_rad),
        firmware.counts_per_revolution,
        allow_motion or local is not None,
        scenario.loop.rearm,
        local.advance if local is not None else None,
    )
    return MakersRobot(link, clock, driver, (wheel_map(device), ImuMount(device.imu)), terms, watch)
