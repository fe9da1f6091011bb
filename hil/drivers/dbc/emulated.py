"""Emulated motor controllers that behave as a user's mapping describes; cantools codes their frames from the DBC.

They obey commands only as the mapping sends them: after the steps of ``enable`` in their order, with the constants, and
with counters that advance. When commands end they go on for ever, unless the mapping has a watchdog. When switched off
they brake until the wheels stand, and then release them.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from firmware_protocol.framing import Frame
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import FourWheels
from hil.drivers.dbc.file import Signal, parse
from hil.drivers.dbc.mapping import Bound, Condition, Quantity, Step
from hil.drivers.dbc.robot import gains
from hil.drivers.dbc.settings import Settings
from hil.drivers.emulated import EmulatedMotors
from hil.drivers.port import EXTENDED, clamp, four

_STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)
_STANDING_RAD_S = 0.05


class EmulatedDbc(EmulatedMotors[Settings]):
    """See ``EmulatedMotors``.

    Attributes:
        is_on: whether they follow commands. is_stopped: by an e-stop that latches.
        overrides: raw values by signal, sent in place of the actual ones; errors among them end with ``clear``.
        ignored: number of frames that were not as the mapping sends them.
    """

    def power_on(self) -> None:
        settings = self.settings
        plan = self._plan = settings.plan
        database = parse(Path(settings.file))
        self._received = {_id(one): one for one in map(database.get_message_by_name, plan.sent())}
        self._sent = [(one, self._period_ticks(one)) for one in map(database.get_message_by_name, plan.received())]
        self._last_count: dict[str, int] = {}
        self._done: set[str] = set()
        self._step = 0
        self._commanded: dict[str, list[float]] = {name: [0.0] * len(q.bounds) for name, q in plan.commands.items()}
        self._commanded_tick = 0
        self._timeout_s = plan.watchdog.timeout_s
        self._gain = gains(settings, self.values["wheel_radius_m"], self.values["torque_constant_n_m_a"])
        self.is_on = False
        self.is_stopped = False
        self.overrides: dict[str, float] = {}
        self.ignored = 0
        self._loops = self.speed_loops()

    def _period_ticks(self, message: Any) -> int:
        return max(round(message.cycle_time or 1000.0 / self._plan.feedback_hz), 1)

    @property
    def _lever_m(self) -> float:
        return self.values["half_length_m"] + self.values["half_width_m"]

    @property
    def is_driving(self) -> bool:
        return self.is_on

    def fail(self, signal: str, raw: int) -> None:
        """Report an error, and switch off."""
        self.overrides[signal] = raw
        self._switch_off()

    # Received frames

    def take(self, frame: Frame) -> None:
        message = self._received.get(frame.id)
        if message is None or len(frame.payload) < message.length:
            return
        payload = frame.payload[: message.length]
        raw: Mapping[str, Any] = message.decode(payload, decode_choices=False, scaling=False)
        physical = message.decode(payload, decode_choices=False)
        if not all(math.isfinite(value) for value in physical.values()) or not self._counts_on(message.name, raw):
            self.ignored += 1
            return
        self._set_watchdog(message.name, physical)
        if self._is_last(message.name, raw, "clear"):
            self.is_stopped = False
            for error in self._plan.errors:
                self.overrides.pop(str(error.signal), None)
        if self._is_last(message.name, raw, "estop"):
            self.is_stopped = self.settings.estop_latches
            self._switch_off()
        elif self._is_last(message.name, raw, "disable"):
            begins = self._begins(message.name, raw)
            if self.is_on or not begins:
                self._switch_off()
            if begins:
                self._enable(message.name, raw)
        else:
            self._enable(message.name, raw)
            self._command(message.name, raw, physical)

    def _counts_on(self, message: str, raw: Mapping[str, Any]) -> bool:
        for signal in self._plan.counters:
            if signal.message == message:
                if self._last_count.get(str(signal)) == raw[signal.name]:
                    return False
                self._last_count[str(signal)] = raw[signal.name]
        return True

    def _is_last(self, message: str, raw: Mapping[str, Any], phase: str) -> bool:
        steps = self._plan.phases[phase]
        return bool(steps) and message in steps[-1] and _agrees(raw, steps[-1][message])

    def _begins(self, message: str, raw: Mapping[str, Any]) -> bool:
        """Return whether this is the first of several steps of ``enable``, which may also switch off (CiA 402)."""
        steps = self._plan.phases["enable"]
        return len(steps) > 1 and message in steps[0] and _agrees(raw, steps[0][message])

    def _set_watchdog(self, message: str, physical: Mapping[str, Any]) -> None:
        bound = self._plan.watchdog.set
        if bound is not None and bound.signal.message == message:
            self._timeout_s = self._gain(bound) * physical[bound.signal.name]

    def _enable(self, message: str, raw: Mapping[str, Any]) -> None:
        steps = self._plan.phases["enable"]
        if self.is_on or not steps:
            return
        first: Step = steps[0]
        if (
            self._step
            and message in first
            and _agrees(raw, first[message])
            and not _agrees(raw, steps[self._step].get(message, {}))
        ):
            self._step = 0  # the sequence begins again
            self._done.clear()
        step = steps[self._step]
        if message in step and _agrees(raw, step[message]):
            self._done.add(message)
            if self._done == set(step):
                self._done.clear()
                self._step = (self._step + 1) % len(steps)
                if self._step == 0:
                    self._switch_on()

    def _command(self, message: str, raw: Mapping[str, Any], physical: Mapping[str, Any]) -> None:
        mine = [
            (name, place, bound)
            for name, quantity in self._plan.commands.items()
            for place, bound in enumerate(quantity.bounds)
            if bound.signal.message == message
        ]
        if not mine:
            return
        if not _agrees(raw, self._plan.constants.get(message, {})):
            self.ignored += 1
            return
        if not self._plan.phases["enable"] and not self.is_on:
            self._switch_on()
        for name, place, bound in mine:
            self._commanded[name][place] = self._gain(bound) * physical[bound.signal.name]
        self._commanded_tick = self.ticks

    def _switch_on(self) -> None:
        if self.is_stopped or any(str(error.signal) in self.overrides for error in self._plan.errors):
            return
        self.is_on = True
        self._commanded_tick = self.ticks
        for values in self._commanded.values():
            values[:] = [0.0] * len(values)

    def _switch_off(self) -> None:
        self.is_on = False
        self._step = 0
        self._done.clear()

    # Control

    def tick(self) -> FourWheels | None:
        late_s = (self.ticks - self._commanded_tick) * 1e-3
        if self.is_on and self._timeout_s is not None and late_s > self._timeout_s:
            self._switch_off()
        self._send_due_messages()
        speeds = self._speeds()
        if not self.is_on and all(abs(speed) < _STANDING_RAD_S for speed in speeds):
            for loop in self._loops:
                loop.reset()
            return None
        if self.is_on and "torque" in self._commanded:
            limit = self.values["torque_limit_n_m"]
            return four(clamp(torque, limit) for torque in self._commanded["torque"])
        targets, torques = self._targets() if self.is_on else (_STILL, _STILL)
        wheels = zip(self._loops, targets, speeds, torques, strict=True)
        return four(loop.torque(target, speed, torque) for loop, target, speed, torque in wheels)

    def _speeds(self) -> FourWheels:
        return four(shaft.speed_rad_s for shaft in self.shafts)

    def _targets(self) -> tuple[FourWheels, FourWheels]:
        if "twist" in self._commanded:
            forward, left, yaw_rate = self._commanded["twist"]
            return wheel_speeds((forward, left, yaw_rate), self.values["wheel_radius_m"], self._lever_m), _STILL
        return four(self._commanded["speed"]), four(self._commanded.get("feedforward", _STILL))

    # Sent frames

    def _send_due_messages(self) -> None:
        due = [message for message, period_ticks in self._sent if self.ticks % period_ticks == 0]
        if not due:
            return
        values = {str(signal): raw for signal, raw in self._values()} | self.overrides
        for message in due:
            signals = self._plan.dbc.message(message.name).signals
            raws = {name: values.get(str(signal), signal.initial) for name, signal in signals.items()}
            self.say(Frame(_id(message), message.encode(raws, scaling=False, strict=False)))

    def _values(self) -> Iterator[tuple[Signal, float]]:
        """Yield each signal that the mapping reads, with its actual raw value."""
        measured = self._measured()
        for name, quantity in self._plan.feedback.items():
            for bound, value in zip(quantity.bounds, measured[name], strict=True):
                yield bound.signal, self._raw(quantity, bound, value, wraps=name == "position")
        for condition in self._plan.identity:
            yield condition.signal, min(condition.raws)
        for condition in self._plan.armed_when:
            yield condition.signal, min(condition.raws) if self.is_on else _another(condition)
        for error in self._plan.errors:
            yield error.signal, min(error.none)
        read = self._plan.watchdog.read
        if read is not None and self._timeout_s is not None:
            yield read.signal, self._raw(Quantity((read,)), read, self._timeout_s, wraps=False)

    def _measured(self) -> Mapping[str, tuple[float, ...]]:
        speeds = self._speeds()
        return {
            "speed": speeds,
            "twist": body_twist(speeds, self.values["wheel_radius_m"], self._lever_m),
            "position": tuple(shaft.position_rad for shaft in self.shafts),
            "current": self.current_a,
            "temperature": self.temperature_degc,
            "battery_voltage": (self.battery_v,),
            "battery_current": (self.battery_a,),
            "yaw_rate": (self.gyro_rad_s[2],),
            "acceleration": self.acceleration_m_s2,
        }

    def _raw(self, quantity: Quantity, bound: Bound, value: float, *, wraps: bool) -> float:
        signal = bound.signal
        physical = value / self._gain(bound)
        if wraps and quantity.wraps_at:
            physical %= quantity.wraps_at
        raw = (physical - signal.offset) / signal.factor
        if signal.is_float:
            return raw
        if wraps:
            return (round(raw) - int(signal.low)) % int(signal.high - signal.low + 1) + int(signal.low)
        return round(clamp(raw, signal.high, signal.low))


def _id(message: Any) -> int:
    number: int = message.frame_id
    return number | EXTENDED if message.is_extended_frame else number


def _agrees(raw: Mapping[str, Any], expected: Mapping[str, float]) -> bool:
    return all(raw[name] == value for name, value in expected.items())


def _another(condition: Condition) -> float:
    """Return a raw value that does not meet the condition, from the signal's value table if it has one."""
    signal = condition.signal
    some = [*signal.texts, *(int(signal.low) + i for i in range(len(condition.raws) + 1))]
    return next(value for value in some if value not in condition.raws)
