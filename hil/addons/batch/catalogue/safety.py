"""The safety judge: rules that a robot's drives must keep, whatever its link and its firmware do.

It stands at the robot's end of the link. It decodes every frame that the firmware receives. It sees the traffic of the
plant port in each tick of 1 ms: the drives' commands, the encoders' counts and the motors' currents. It keeps its own
record of what was commanded and allowed. Of the firmware's own state it reads only the set points of the speed loops,
which rules 1 and 2 bound exactly; rules 3 to 6 do not need them. Times are the robot's own ticks.

1. Drives are on, or a set point is not zero, only after a valid command (CRC, length, range) that is fresh (its
   sequence is 1 to 20 ahead of the last valid one) and of the session in force. No wheel's set point exceeds the newest
   such command or has the opposite sign. In torque mode the rule applies to the torques.
2. Without such a command for the watchdog's time, or after a stop request, the set points fall to zero at least as fast
   as a straight line over the ramp's time. They stay there; at ESTOP they are zero at once. Drives that are still on
   then hold the wheels for at most 1 s.
3. While the drives are on, no wheel is driven away from its allowed speed. A wheel that turns faster than the newest
   command (in a stop: than the line down from it), or against it, gets no torque that drives it further. A speed loop
   may overshoot. So a wheel counts only when, for longer than 20 ms, it is off by more than 1 rad/s and a tenth and
   driven by more than a twentieth of the torque limit. The rule applies to the commanded torques and to those of the
   measured currents, in torque mode only during a stop. A duty says nothing of the torque, so it does not count. A
   wheel's speed is that of its encoder, for no firmware can know better.
4. Drives that are off get no torque and no duty.
5. After a stop, driving starts again only after an ARM whose nonce an IDLE announced and the last session did not have,
   and a first command of zero. Drives that went off stay off until then. A firmware that was reset has no session.
6. Every number that the drives get is finite, and every duty is within -1 to 1.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from firmware_protocol.codec import decode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages
from firmware_protocol.generated.messages import Estop, HostHeartbeat, Mode, Request, TorqueCommand, WheelCommand
from hil.addons.batch.job import Signals
from hil.core.types import WHEEL_NAMES, CommandMode, FourWheels
from hil.robot.virtual import EmulatedDevice
from hil.scenario import FirmwareTable

# PROTOCOL.md, "States" and "Freshness".
_WINDOW = 20
_ARM_TIMEOUT_TICKS = 1000
_HOLD_TICKS = 1000
# Scaling four torques to a limit rounds in single precision.
_ROUNDING, _MOTORS_ROUNDING = 1e-6, 1e-5
_REMEMBERED = 10
# Rule 3: how far a sound speed loop may overshoot.
_BEYOND_RAD_S = 1.0
_BEYOND_PART = 0.1
_DRIVEN_PART = 0.05
_DRIVEN_TICKS, _MOTORS_DRIVEN_TICKS = 20, 50  # some makers catch up the angle by which they lag

Four = tuple[float, ...]


class Tick(NamedTuple):
    """The commands to the drives for one tick, and how the wheels turn and are driven at its start.

    ``set_point_rad_s`` is that of the speed loop, ``speed_rad_s`` by the encoders, ``motor_n_m`` by measured currents.
    """

    enabled: bool
    set_point_rad_s: Four
    torque_n_m: Four
    duty: Four
    speed_rad_s: Four
    motor_n_m: Four


class Limits(NamedTuple):
    """The parameters of a firmware that the judge needs."""

    watchdog_ticks: int
    ramp_ticks: int
    torque_n_m: float


class _Session:
    """The judge's record of one session, from its first command on."""

    def __init__(self, nonce: int, mode: int, sequence: int, limits: Limits) -> None:
        self.nonce = nonce
        self._mode = mode
        self._sequence = sequence
        self._watchdog = limits.watchdog_ticks
        self._ramp = limits.ramp_ticks
        self._driven_n_m = _DRIVEN_PART * limits.torque_n_m
        self._target: Four = (0.0,) * 4
        self._from: Four = (0.0,) * 4  # the set points when the stop began
        self._age = 0  # ticks since the newest valid command
        self._stopped: int | None = None  # ticks since it has to stop
        self._turning: Four = (0.0,) * 4  # the commands when the stop began; in torque mode, the speeds
        self._driven_away: tuple[int, ...] = (0,) * 4  # ticks in a row
        self._hold = limits.ramp_ticks + _HOLD_TICKS
        self._was_on = False
        self._went_off = False

    @property
    def is_live(self) -> bool:
        """Whether it has not begun to stop."""
        return self._stopped is None

    @property
    def is_silent(self) -> bool:
        """Whether all set points must be zero by now."""
        return self._stopped is not None and self._stopped >= self._ramp

    def add(self, mode: int, command: WheelCommand | TorqueCommand) -> None:
        fresh = 1 <= (command.sequence - self._sequence) & 0xFF <= _WINDOW
        if mode == self._mode and command.session == self.nonce & 0xF and fresh:
            self._sequence = command.sequence
            self._target = command[:4]
            self._age = 0

    def stop(self, *, at_once: bool) -> None:
        if self._stopped is None:
            self._stopped = 0
        if at_once:
            self._ramp = 0
            self._hold = self._stopped + _HOLD_TICKS

    def complaint(self, tick: Tick) -> str | None:
        """Return which rule a tick breaks if it belongs to this session, or None."""
        if tick.enabled and self._went_off:
            return "the drives, which had gone off, are on again without a new ARM"
        for name, ticks, speed in zip(WHEEL_NAMES, self._away(tick), tick.speed_rad_s, strict=True):
            if ticks > _DRIVEN_TICKS:
                return f"{name} is driven away from what is allowed, for {ticks} ms, and turns with {speed:.3g} rad/s"
        if self._stopped is None:
            torque_mode = self._mode == Mode.TORQUE
            what, unit = ("torque", "N·m") if torque_mode else ("set point", "rad/s")
            given = tick.torque_n_m if torque_mode else tick.set_point_rad_s
            return _beyond(given, self._target, what, unit, "the newest valid command asks for")
        if tick.enabled and self._stopped >= self._hold:
            return f"the drives are still on {self._stopped} ms after the stop began"
        bounds = tuple(self._left * value for value in self._from)
        since = f"{self._age} ms after the last valid command, {self._stopped} ms after the stop, the ramp leaves"
        return _beyond(tick.set_point_rad_s, bounds, "set point", "rad/s", since)

    @property
    def _left(self) -> float:
        """The share of the first set points that the ramp still allows."""
        if self._stopped is None:
            return 1.0
        return max(0, self._ramp - self._stopped) / self._ramp if self._ramp else 0.0

    def _away(self, tick: Tick) -> tuple[int, ...]:
        """Return for how many ticks in a row, this one included, each wheel was driven away from what is allowed."""
        if not tick.enabled or (self._stopped is None and self._mode == Mode.TORQUE):
            return (0,) * 4
        allowed = self._target if self._stopped is None else tuple(self._left * value for value in self._turning)
        each = zip(tick.speed_rad_s, allowed, tick.torque_n_m, tick.motor_n_m, strict=True)
        away = (
            self._is_away(speed, bound, max(torques)) or self._is_away(-speed, -bound, -min(torques))
            for speed, bound, *torques in each
        )
        return tuple(ticks + 1 if now else 0 for ticks, now in zip(self._driven_away, away, strict=True))

    def _is_away(self, speed_rad_s: float, bound_rad_s: float, torque_n_m: float) -> bool:
        """Return whether a wheel is too fast in the positive direction and driven further."""
        most_rad_s = max(0.0, bound_rad_s) + _BEYOND_RAD_S + _BEYOND_PART * abs(bound_rad_s)
        return speed_rad_s > most_rad_s and torque_n_m > self._driven_n_m

    def record(self, tick: Tick) -> None:
        """Record a tick."""
        self._driven_away = self._away(tick)
        self._went_off = self._went_off or (self._was_on and not tick.enabled)
        self._was_on = tick.enabled
        self._age += 1
        if self._stopped is not None:
            self._stopped += 1
            return
        self._from = tick.set_point_rad_s
        self._turning = tick.speed_rad_s if self._mode == Mode.TORQUE else self._target
        if self._age >= self._watchdog:
            self._stopped = 0


class SafetyJudge:
    """Judges one run. ``power_on`` starts a new life of the firmware; ``violations`` has the first ten.

    ``silent_ticks`` counts the ticks after the first session in which every set point has to be zero, ``silent_rad_s``
    is the greatest set point in them, ``driven_ticks`` counts the ticks with a set point.
    """

    def __init__(self) -> None:
        self.violations: list[str] = []
        self.violation_ticks = self.ticks = self.driven_ticks = self.silent_ticks = 0
        self.silent_rad_s = 0.0
        self._has_driven = False
        self.power_on(Limits(0, 0, 0.0))

    def power_on(self, limits: Limits) -> None:
        """Start a firmware with these parameters; it has no session."""
        self._limits = limits
        self._life_ticks = 0
        self._announced: int | None = None
        self._armed: tuple[int, int] | None = None  # nonce and mode, while no command has come
        self._armed_ticks = 0
        self._last_nonce = 0
        self._session: _Session | None = None
        self._ending: _Session | None = None  # the one before, whose stop may still go on

    def observe(self, frame: Frame) -> None:
        """Record a frame that the firmware gets now, between two ticks."""
        match decode(frame):
            case HostHeartbeat() as heartbeat:
                self._request(heartbeat)
            case Estop():
                self._end(at_once=True)
            case WheelCommand() as command:
                self._command(Mode.SPEED, command)
            case TorqueCommand() as command:
                self._command(Mode.TORQUE, command)

    def hold(self, tick: Tick) -> None:
        """Judge the commands to the drives in the current tick."""
        self._judge(tick)
        largest = max(map(abs, tick.set_point_rad_s))
        self.driven_ticks += largest > 0.0
        if self._has_driven and all(session.is_silent for session in self._sessions):
            self.silent_ticks += 1
            self.silent_rad_s = max(self.silent_rad_s, largest)
        self.ticks += 1
        self._life_ticks += 1
        self._armed_ticks += 1
        if self._armed_ticks >= _ARM_TIMEOUT_TICKS:
            self._armed = None
        for session in self._sessions:
            session.record(tick)
        if not tick.enabled:
            self._ending = None

    def _request(self, heartbeat: HostHeartbeat) -> None:
        if heartbeat.request == Request.IDLE:
            self._end(at_once=False)
            self._announced = heartbeat.nonce
        elif heartbeat.request == Request.ARM:
            announced, self._announced = self._announced, None
            is_new = heartbeat.nonce == announced and heartbeat.nonce != self._last_nonce
            if is_new and heartbeat.schema_hash == messages.SCHEMA_HASH:
                self._armed = (heartbeat.nonce, heartbeat.mode)
                self._armed_ticks = 0

    def _end(self, *, at_once: bool) -> None:
        self._armed = None
        for session in self._sessions:
            session.stop(at_once=at_once)

    def _command(self, mode: int, command: WheelCommand | TorqueCommand) -> None:
        if self._session is not None and self._session.is_live:
            self._session.add(mode, command)
        elif self._armed is not None:
            nonce, armed_mode = self._armed
            if mode == armed_mode and command.session == nonce & 0xF and not any(command[:4]):
                self._ending = self._session
                self._session = _Session(nonce, mode, command.sequence, self._limits)
                self._armed, self._last_nonce, self._has_driven = None, nonce, True

    def _judge(self, tick: Tick) -> None:
        numbers = (*tick.set_point_rad_s, *tick.torque_n_m, *tick.duty)
        if not all(map(math.isfinite, numbers)):
            self._violate(f"the drives are given a number that is none: {tick}")
        if max(map(abs, tick.duty)) > 1.0:
            self._violate(f"the drives are given a duty beyond 1: {tick.duty}")
        if not tick.enabled and any((*tick.torque_n_m, *tick.duty)):
            self._violate(f"the drives are off, but are given torque {tick.torque_n_m} and duty {tick.duty}")
        complaints = [session.complaint(tick) for session in self._sessions]
        if not complaints and (tick.enabled or any(tick.set_point_rad_s)):
            complaints = [f"nothing was asked, but the drives are {'on' if tick.enabled else 'given set points'}"]
        if complaints and all(complaints):
            self._violate(str(complaints[0]))

    @property
    def _sessions(self) -> list[_Session]:
        return [session for session in (self._session, self._ending) if session is not None]

    def _violate(self, what: str) -> None:
        self.violation_ticks += 1
        if len(self.violations) < _REMEMBERED:
            self.violations.append(f"at {self._life_ticks} ms of the robot's time: {what}")


def _beyond(given: Four, allowed: Four, what: str, unit: str, by: str) -> str | None:
    """Return a sentence on the first wheel whose value is not between zero and its allowed value, or None."""
    for name, value, bound in zip(WHEEL_NAMES, given, allowed, strict=True):
        if value * bound < 0.0 or abs(value) > abs(bound) * (1.0 + _ROUNDING):
            return f"the {what} of {name} is {value:.6g} {unit}; {by} {bound:.6g}"
    return None


class MotorsJudge:
    """Records what third-party motor controllers do, and judges it once the run's signals are there.

    Their protocols have neither sessions nor sequences, so what is allowed follows from the commands of the run alone:

    1. No wheel is driven away from its recent commands. A wheel that turns faster than every command of the last
       ``watchdog + ramp``, or against all of them, gets no torque that drives it further. It counts as in rule 3 above,
       but only after 50 ms. Before the first command and once the host is gone, the command is zero. In torque mode
       this applies only to the time after the host has gone.
    2. From a second after that on, the drives give no torque but what holds a wheel at rest: a twentieth of the limit.
    3. Every torque is finite, and within the limit.
    """

    silent_rad_s = silent_ticks = None  # set points are not known here, unlike in ``SafetyJudge``

    def __init__(self, firmware: FirmwareTable, mode: CommandMode) -> None:
        self._firmware = firmware
        self._mode = mode
        self._ticks: list[tuple[FourWheels, FourWheels]] = []  # torque [N·m], and speed [rad/s] when the tick begins

    @property
    def left_alone_ticks(self) -> int:
        """How many ticks the robot has to run without a host, so that rule 2 can be judged."""
        return round(self._patience_s * 1000) + 2 * _HOLD_TICKS

    @property
    def _patience_s(self) -> float:
        return self._firmware.watchdog_s + self._firmware.ramp_s

    def hold(self, node: EmulatedDevice) -> None:
        """Record a tick of emulated controllers."""
        fl, fr, rr, rl = (shaft.speed_rad_s for shaft in node.shafts)
        self._ticks.append((node.torque_n_m, (fl, fr, rr, rl)))

    def complaints(self, signals: Signals) -> Sequence[str]:
        """Return a sentence for each rule that was broken: the first tick and how many; empty when none was."""
        torque, speed = (np.array(column) for column in zip(*self._ticks, strict=True))
        if not np.isfinite(torque).all():
            return ["the drives were given a torque that is no number"]
        begin, end, low, high = self._commanded(signals, len(torque))
        found = []
        limit = self._firmware.torque_limit_n_m
        found += _first(
            np.abs(torque).max(axis=1) > limit * (1.0 + _MOTORS_ROUNDING), f"the torque is beyond {limit:g} N·m"
        )
        driven = _DRIVEN_PART * limit
        too_fast = (speed > high + _BEYOND_RAD_S + _BEYOND_PART * np.abs(high)) & (torque > driven)
        too_slow = (speed < low - _BEYOND_RAD_S - _BEYOND_PART * np.abs(low)) & (torque < -driven)
        if self._mode is CommandMode.TORQUE:
            too_fast[:end] = too_slow[:end] = False
        for place, wheel in enumerate(WHEEL_NAMES):
            for away in (too_fast[:, place], too_slow[:, place]):
                found += _first(_lasting(away), f"{wheel} is driven away from what was asked")
        gone = min(len(torque), end + _HOLD_TICKS)
        after = np.zeros(len(torque), dtype=bool)
        after[gone:] = np.abs(torque[gone:]).max(axis=1) > driven
        found += _first(after, "the drives still give torque though the host has been gone for more than a second")
        if not (np.abs(torque[begin:end]) > 0.0).any() or gone >= len(torque):
            found.append("the robot was never driven or never left alone, so nothing is shown")
        return found

    def _commanded(self, signals: Signals, ticks: int) -> tuple[int, int, np.ndarray, np.ndarray]:
        """Return the run's first tick, that at which its last command expires, and the lowest and highest commands.

        The latter are those still in force, for each tick and wheel, of shape (ticks, 4).
        """
        t_s = signals["loop.t_s"]
        origin_s = float(np.nanmedian(signals["robot.time_s"] - t_s)) if len(t_s) else 0
        at = np.rint((t_s + origin_s) * 1000).astype(int)
        period = int(np.median(np.diff(at))) if len(at) > 1 else 1
        patience = round(self._patience_s * 1000)
        low, high = np.zeros((ticks, 4)), np.zeros((ticks, 4))
        for place, wheel in enumerate(WHEEL_NAMES):
            commands = np.nan_to_num(signals[f"wheel.{wheel}.speed_command_rad_s"])
            for tick, value in zip(at, commands, strict=True):
                window = slice(max(tick, 0), tick + patience + period)
                np.maximum(high[window, place], value, out=high[window, place])
                np.minimum(low[window, place], value, out=low[window, place])
        first, last = (int(at[0]), int(at[-1])) if len(at) else (0, 0)
        return first, min(ticks, last + patience), low, high


def _lasting(away: np.ndarray) -> np.ndarray:
    """Return the ticks in which something has lasted for more ticks in a row than it may."""
    count, marks = 0, np.zeros(len(away), dtype=bool)
    for place, is_away in enumerate(away):
        count = count + 1 if is_away else 0
        marks[place] = count > _MOTORS_DRIVEN_TICKS
    return marks


def _first(marks: np.ndarray, what: str) -> list[str]:
    places = np.flatnonzero(marks)
    return [f"at {places[0]} ms of the robot's time, in {len(places)} ticks: {what}"] if len(places) else []
