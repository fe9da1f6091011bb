"""Four moteus as their firmware is described: modes, the watchdog of each command, and a position loop at its gains.

``servo.max_position_slip`` is set, as hil/dialects/MOTEUS.md asks for; ``servo.timeout_mode`` is 12, as delivered:
after a timeout the wheel is braked by the loop's derivative term. Modes of a bench (PWM, voltage, current, ...) are
answered with an error.
"""

import math
import struct
from collections.abc import Iterator

from firmware_protocol.framing import Frame
from hil.devices.emulated.motors import EmulatedMotors, Shaft
from hil.dialects.moteus import Settings
from hil.types import FourWheels

_TICK_S = 0.001
_STOPPED, _FAULT, _ENABLING, _CALIBRATING, _READY, _POSITION, _TIMEOUT, _ZERO_VELOCITY = 0, 1, 2, 3, 4, 10, 11, 12
_PREPARING_TICKS = {_ENABLING: 2, _CALIBRATING: 9, _READY: 1}
_FORMATS = ("<b", "<h", "<i", "<f")
_SCALES = {
    "position": (1e-2, 1e-4, 1e-5),
    "velocity": (1e-1, 2.5e-4, 1e-5),
    "acceleration": (5e-2, 1e-3, 1e-5),
    "torque": (5e-1, 1e-2, 1e-3),
    "share": (1 / 127, 1 / 32767, 1 / 2147483647),
    "time": (1e-2, 1e-3, 1e-6),
    "current": (1.0, 1e-1, 1e-3),
    "voltage": (5e-1, 1e-1, 1e-3),
    "temperature": (1.0, 1e-1, 1e-3),
}
_COMMAND = {  # register: quantity and what holds when a command does not write it
    0x20: ("position", 0.0),
    0x21: ("velocity", 0.0),
    0x22: ("torque", 0.0),
    0x23: ("share", 1.0),
    0x24: ("share", 1.0),
    0x25: ("torque", math.nan),
    0x26: ("position", math.nan),
    0x27: ("time", 0.0),
    0x28: ("velocity", math.nan),
    0x29: ("acceleration", math.nan),
    0x2B: ("share", 1.0),
}
_MEASURED = {
    0x01: "position",
    0x02: "velocity",
    0x03: "torque",
    0x04: "current",
    0x05: "current",
    0x0A: "temperature",
    0x0D: "voltage",
    0x0E: "temperature",
}
_MODEL, _FIRMWARE = 0x0500, 0x010D
_DEFAULT_TIMEOUT_S = 0.1
_TIMEOUT_MAX_TORQUE_N_M = 5.0
_SLIP_REV = 0.05
_UNDER_VOLTAGE, _OVER_TEMPERATURE = 40, 38


class _Servo:
    """One controller; quantities in revolutions and newton metres at its output."""

    def __init__(self, kp: float, kd: float, limit_n_m: float) -> None:
        self.kp, self.kd, self.limit_n_m = kp, kd, limit_n_m
        self.mode, self.fault = _STOPPED, 0
        self.register_map = 5
        self.command = {register: start for register, (_, start) in _COMMAND.items()}
        self.wanted: int | None = None  # the mode that the frame at hand asks for
        self.target_mode = _STOPPED  # what follows when it is ready
        self.timeout_s = math.nan
        self.left = 0
        self.control_rev: float | None = None
        self.measured = dict.fromkeys(_MEASURED, 0.0)

    def write(self, register: int, kind: int, raw: float) -> int:
        """Take a value, and return what is wrong: 0 nothing, 1 no such register, 2 read only, 3 no such mode."""
        if register == 0:
            if raw not in (_STOPPED, _POSITION, _ZERO_VELOCITY):
                return 3
            self.command = {number: start for number, (_, start) in _COMMAND.items()}
            self.wanted = int(raw)
            return 0
        if register in _COMMAND:
            self.command[register] = _physical(kind, raw, _COMMAND[register][0])
            return 0
        return 2 if register in _MEASURED or register in (0x0F, 0x100, 0x101, 0x102) else 1

    def read(self, register: int, kind: int) -> float | None:
        """Return what a register has as this type, None for one that it cannot be read as."""
        if register in _MEASURED:
            return _raw(kind, self.measured[register], _MEASURED[register])
        if register in _COMMAND:
            return _raw(kind, self.command[register], _COMMAND[register][0])
        if register in (0x00, 0x0F):
            return self.mode if register == 0 else self.fault
        versions = {0x100: _MODEL, 0x101: _FIRMWARE, 0x102: self.register_map}
        return versions.get(register) if kind == 2 else None

    def obey(self) -> None:
        """Do what the frame that ends here has commanded."""
        wanted, self.wanted = self.wanted, None
        if wanted is None:
            return
        self.timeout_s = self.command[0x27] or _DEFAULT_TIMEOUT_S
        if wanted == _STOPPED:
            self.mode, self.fault, self.control_rev = _STOPPED, 0, None
        elif self.mode == _STOPPED:
            self.mode, self.left = _ENABLING, _PREPARING_TICKS[_ENABLING]
            self.target_mode = wanted
        elif self.mode in (_POSITION, _ZERO_VELOCITY):
            self.mode = wanted

    def fail(self, code: int) -> None:
        """Go to fault, as by a reason of the hardware's."""
        self.mode, self.fault, self.control_rev = _FAULT, code, None

    def torque(self) -> float | None:
        """Let a millisecond pass, and return the torque at the output, None where the driver is off."""
        if self.timeout_s > 0.0:
            self.timeout_s = max(self.timeout_s - _TICK_S, 0.0)
        if self.mode in _PREPARING_TICKS:
            self.left -= 1
            if self.left <= 0:
                following = {_ENABLING: _CALIBRATING, _CALIBRATING: _READY, _READY: self.target_mode}
                self.mode = following[self.mode]
                self.left = _PREPARING_TICKS.get(self.mode, 0)
        if self.mode == _POSITION and self.timeout_s <= 0.0:
            self.mode = _TIMEOUT
        if self.mode == _POSITION:
            return self._position_loop()
        if self.mode in (_TIMEOUT, _ZERO_VELOCITY):
            self.control_rev = None
            most = min(_TIMEOUT_MAX_TORQUE_N_M, self.limit_n_m)
            return _limited(-self.kd * self.measured[0x02], most)
        return None

    def _position_loop(self) -> float:
        at, speed = self.measured[0x01], self.measured[0x02]
        command = self.command
        target = 0.0 if math.isnan(command[0x21]) else command[0x21]
        if not math.isnan(command[0x20]):
            self.control_rev, command[0x20] = command[0x20], math.nan
        if self.control_rev is None:
            self.control_rev = at
        control = self.control_rev = at + _limited(self.control_rev + target * _TICK_S - at, _SLIP_REV)
        wanted = command[0x23] * self.kp * (control - at) + command[0x24] * self.kd * (target - speed) + command[0x22]
        most = self.limit_n_m if math.isnan(command[0x25]) else min(command[0x25], self.limit_n_m)
        return _limited(wanted, most)


class EmulatedMoteus(EmulatedMotors):
    """See ``EmulatedMotors``. Their output turns ``gear_ratio`` times as fast as the wheel.

    Attributes:
        servos: the four, for what a test has to do to one of them.
    """

    def __init__(self, settings: Settings, *node: object, **keywords: object) -> None:
        self._settings = settings
        super().__init__(*node, **keywords)  # type: ignore[arg-type]
        values, ratio = self.values, settings.gear_ratio
        per_rev = math.tau / ratio / ratio  # from a gain at the wheel in radians to one at the output in turns
        kp, kd = values["speed_ki_n_m_rad"] * per_rev, values["speed_kp_n_m_s_rad"] * per_rev
        self.servos = tuple(_Servo(kp, kd, values["torque_limit_n_m"] / ratio) for _ in settings.ids)
        self._constant = values["torque_constant_n_m_a"] / ratio
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(servo.mode in (_POSITION, _TIMEOUT, _ZERO_VELOCITY) for servo in self.servos)

    def take(self, frame: Frame) -> None:
        number = frame.id & 0x1FFF_FFFF
        if number >> 16 != self._settings.can_prefix:
            return
        source, destination = number >> 8 & 0xFF, number & 0xFF
        for servo_id, servo in zip(self._settings.ids, self.servos, strict=True):
            if destination in (servo_id, 0x7F):
                answer = self._converse(servo, frame.payload)
                servo.obey()
                if source & 0x80:
                    reply_id = self._settings.can_prefix << 16 | servo_id << 8 | source & 0x7F
                    extended = 0x8000_0000 if reply_id > 0x7FF else 0
                    self.say(Frame(extended | reply_id, _can_fd(answer)))

    def _converse(self, servo: _Servo, payload: bytes) -> bytes:
        answer = bytearray()
        try:
            for what, kind, register, raw in _subframes(payload):
                if what == 0x00:
                    if error := servo.write(register, kind, raw):
                        answer += b"\x30" + _varuint(register) + _varuint(error)
                elif (value := servo.read(register, kind)) is None:
                    answer += b"\x31" + _varuint(register) + _varuint(1)
                else:
                    answer += bytes((0x20 | kind << 2 | 1,)) + _varuint(register) + struct.pack(_FORMATS[kind], value)
        except (IndexError, struct.error):  # a frame that ends within a subframe: what came before it holds
            pass
        return bytes(answer)

    def tick(self) -> FourWheels | None:
        self._measure()
        hot, limit = self.temperature_degc, self.values["temperature_limit_degc"]
        for channel, servo in enumerate(self.servos):
            if servo.mode not in (_STOPPED, _FAULT):
                if self.battery_v < 4.0:
                    servo.fail(_UNDER_VOLTAGE)
                elif hot[channel] > limit:
                    servo.fail(_OVER_TEMPERATURE)
        torques = [servo.torque() for servo in self.servos]
        if all(torque is None for torque in torques):
            return None
        a, b, c, d = ((torque or 0.0) * self._settings.gear_ratio for torque in torques)
        return a, b, c, d

    def _measure(self) -> None:
        for channel, (servo, shaft) in enumerate(zip(self.servos, self.shafts, strict=True)):
            servo.measured.update(self._quantities(channel, shaft))

    def _quantities(self, channel: int, shaft: Shaft) -> dict[int, float]:
        turns = self._settings.gear_ratio / math.tau
        return {
            0x01: shaft.position_rad * turns,
            0x02: shaft.speed_rad_s * turns,
            0x03: self.current_a[channel] * self._constant,
            0x04: self.current_a[channel],
            0x0D: self.battery_v,
            0x0E: self.temperature_degc[channel],
        }


def _subframes(payload: bytes) -> Iterator[tuple[int, int, int, float]]:
    """Yield write or read, type, register and value. Raises IndexError or struct.error where the payload is cut."""
    at = 0

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = payload[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if not byte & 0x80:
                return value

    while at < len(payload):
        code = payload[at]
        at += 1
        if code == 0x50:
            continue
        if code >= 0x20:
            return
        kind = code >> 2 & 3
        count = code & 3 or number()
        first = number()
        for register in range(first, first + count):
            raw = 0.0
            if code < 0x10:
                (raw,) = struct.unpack_from(_FORMATS[kind], payload, at)
                at += struct.calcsize(_FORMATS[kind])
            yield code & 0x10, kind, register, raw


def _physical(kind: int, raw: float, quantity: str) -> float:
    if kind == 3:
        return raw
    lowest = -(1 << (8 << kind) - 1)
    return math.nan if raw == lowest else raw * _SCALES[quantity][kind]


def _raw(kind: int, value: float, quantity: str) -> float:
    if kind == 3:
        return value
    most = (1 << (8 << kind) - 1) - 1
    return -most - 1 if not math.isfinite(value) else int(_limited(value / _SCALES[quantity][kind], most))


def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)


def _varuint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*parts, value))


def _can_fd(payload: bytes) -> bytes:
    lengths = (*range(9), 12, 16, 20, 24, 32, 48, 64)
    return payload[:64].ljust(min(length for length in lengths if length >= min(len(payload), 64)), b"\x50")


EMULATED = EmulatedMoteus
