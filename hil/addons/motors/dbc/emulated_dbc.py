"""Emulated motor controllers that behave as a user's mapping describes; cantools codes their frames from the DBC.

They obey commands after the last step of ``enable``. When commands end they go on for ever, unless the mapping has a
watchdog. When switched off they brake until the wheels stand, and then release them.
"""

import math
from collections.abc import Iterator, Mapping

from firmware_protocol.framing import Frame
from hil.addons.motors.dbc.dbc_file import Signal
from hil.addons.motors.dbc.dbc_mapping import Bound, Condition, Step
from hil.addons.motors.dbc.dbc_settings import Settings, gains
from hil.addons.motors.emulated_motors import STILL, EmulatedMotors
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import FourWheels
from hil.robot.driver import clamp, four

_STANDING_RAD_S = 0.05


class EmulatedDbc(EmulatedMotors[Settings]):
    """See ``EmulatedMotors``.

    Attributes:
        is_on: whether they follow commands. is_stopped: by an e-stop that latches.
        overrides: raw values by signal, sent in place of the actual ones; errors among them end with ``clear``.
    """

    def power_on(self) -> None:
        settings = self.settings
        plan = self._plan = settings.plan
        self._received = {message.id: message for message in plan.sent.values()}
        self._sent = [
            (message, max(round(1000.0 * (message.period_s or 1.0 / plan.feedback_hz)), 1))
            for message in plan.received.values()
        ]
        self._enabled: set[str] = set()  # the messages of the last step of ``enable`` that have come
        self._commanded: dict[str, list[float]] = {name: [0.0] * len(q.bounds) for name, q in plan.commands.items()}
        self._commanded_tick = 0
        self._timeout_s = plan.watchdog.timeout_s
        self._radius_m = self.values["wheel_radius_m"]
        self._lever_m = self.values["half_length_m"] + self.values["half_width_m"]
        self._gain = gains(settings, self._radius_m, self.values["torque_constant_n_m_a"])
        self.is_on = False
        self.is_stopped = False
        self.overrides: dict[str, float] = {}

    @property
    def is_driving(self) -> bool:
        return self.is_on

    def fail(self, signal: str, raw: int) -> None:
        """Report an error, and switch off."""
        self.overrides[signal] = raw
        self._switch_off()

    # Received frames

    def receive(self, frame: Frame) -> None:
        message = self._received.get(frame.id)
        if message is None or len(frame.payload) < message.length:
            return
        name, payload = message.name, frame.payload[: message.length]
        raw = message.codec.decode(payload, decode_choices=False, scaling=False)
        physical = message.codec.decode(payload, decode_choices=False)
        if not all(map(math.isfinite, physical.values())):
            return
        timeout = self._plan.watchdog.set
        if timeout is not None and timeout.signal.message == name:
            self._timeout_s = self._gain(timeout) * physical[timeout.signal.name]
        if self._is_last(name, raw, "clear"):
            self.is_stopped = False
            for error in self._plan.errors:
                self.overrides.pop(str(error.signal), None)
        if self._is_last(name, raw, "estop"):
            self.is_stopped = self.settings.estop_latches
            self._switch_off()
        elif self._is_last(name, raw, "disable"):
            self._switch_off()
        else:
            self._enable(name, raw)
            self._command(name, physical)

    def _is_last(self, message: str, raw: Mapping[str, float], phase: str) -> bool:
        return any(_asks(step, message, raw) for step in self._plan.phases[phase][-1:])

    def _enable(self, message: str, raw: Mapping[str, float]) -> None:
        steps = self._plan.phases["enable"]
        if steps and not self.is_on and _asks(steps[-1], message, raw):
            self._enabled.add(message)
            if self._enabled == set(steps[-1]):
                self._switch_on()

    def _command(self, message: str, physical: Mapping[str, float]) -> None:
        commanded = [
            (name, index, bound)
            for name, quantity in self._plan.commands.items()
            for index, bound in enumerate(quantity.bounds)
            if bound.signal.message == message
        ]
        if not commanded:
            return
        if not self._plan.phases["enable"] and not self.is_on:
            self._switch_on()
        for name, index, bound in commanded:
            self._commanded[name][index] = self._gain(bound) * physical[bound.signal.name]
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
        self._enabled.clear()

    # Control

    def tick(self) -> FourWheels | None:
        late_s = (self.ticks - self._commanded_tick) * 1e-3
        if self.is_on and self._timeout_s is not None and late_s > self._timeout_s:
            self._switch_off()
        self._send_due_messages()
        if not self.is_on and all(abs(speed) < _STANDING_RAD_S for speed in self.speeds_rad_s):
            self.reset_loops()
            return None
        targets = torques = STILL
        if self.is_on and "torque" in self._commanded:
            limit = self.values["torque_limit_n_m"]
            return four(clamp(torque, limit) for torque in self._commanded["torque"])
        if self.is_on and "twist" in self._commanded:
            forward, left, yaw_rate = self._commanded["twist"]
            targets = wheel_speeds((forward, left, yaw_rate), self._radius_m, self._lever_m)
        elif self.is_on:
            targets, torques = four(self._commanded["speed"]), four(self._commanded.get("feedforward", STILL))
        return self.follow(targets, torques)

    # Sent frames

    def _send_due_messages(self) -> None:
        due = [message for message, period_ticks in self._sent if self.ticks % period_ticks == 0]
        if not due:
            return
        values = {str(signal): raw for signal, raw in self._values()} | self.overrides
        for message in due:
            at_rest = {name: one.low if one.initial is None else one.initial for name, one in message.signals.items()}
            raws = {name: values.get(str(one), at_rest[name]) for name, one in message.signals.items()}
            self.send(Frame(message.id, message.codec.encode(raws, scaling=False, strict=False)))

    def _values(self) -> Iterator[tuple[Signal, float]]:
        speeds = self.speeds_rad_s
        measured: Mapping[str, tuple[float, ...]] = {
            "speed": speeds,
            "twist": body_twist(speeds, self._radius_m, self._lever_m),
            "position": tuple(shaft.position_rad for shaft in self.shafts),
            "current": self.current_a,
            "temperature": self.temperature_degc,
            "battery_voltage": (self.battery_v,),
            "battery_current": (self.battery_a,),
            "yaw_rate": (self.gyro_rad_s[2],),
            "acceleration": self.acceleration_m_s2,
        }
        for name, quantity in self._plan.feedback.items():
            spans = quantity.spans or (None,) * len(quantity.bounds)
            for bound, value, span in zip(quantity.bounds, measured[name], spans, strict=True):
                yield bound.signal, self._raw(bound, value, span)
        for condition in self._plan.identity + self._plan.errors:
            yield condition.signal, min(condition.raws)
        for condition in self._plan.armed_when:
            yield condition.signal, min(condition.raws) if self.is_on else _another(condition)
        read = self._plan.watchdog.read
        if read is not None and self._timeout_s is not None:
            yield read.signal, self._raw(read, self._timeout_s)

    def _raw(self, bound: Bound, value: float, span: float | None = None) -> float:
        """Return the raw number of a value. A position begins again after ``span``: at 0 if that fits, else lower."""
        signal = bound.signal
        raw = (value / self._gain(bound) - signal.offset) / signal.factor
        if span:
            steps = span / abs(signal.factor)
            begin = 0.0 if signal.low <= 0.0 and steps - 1.0 <= signal.high else signal.low
            raw = begin + (raw - begin) % steps
        return raw if signal.is_float else round(clamp(raw, signal.high, signal.low))


def _asks(step: Step, message: str, raw: Mapping[str, float]) -> bool:
    return message in step and all(raw[name] == value for name, value in step[message].items())


def _another(condition: Condition) -> float:
    """Return a raw value that does not meet the condition, from the signal's value table if it has one."""
    signal = condition.signal
    some = [*signal.texts, *(int(signal.low) + i for i in range(len(condition.raws) + 1))]
    return next(value for value in some if value not in condition.raws)
