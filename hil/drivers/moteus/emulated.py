"""Four emulated moteus on one CAN FD bus: the frames of their registers, and of their diagnostic stream.

The stream with acknowledgements, which moteus_tool tries first, is not emulated.
Source: mjbots moteus, docs/protocol/can.md.
"""

import math

from firmware_protocol.framing import Frame
from hil.core.types import FourWheels
from hil.drivers.emulated import EmulatedMotors, Shaft
from hil.drivers.moteus import frames
from hil.drivers.moteus.driver import Settings
from hil.drivers.moteus.emulated_console import Console
from hil.drivers.moteus.emulated_servo import FAULT, NO_REGISTER, STOPPED, UUID_MASK, Servo
from hil.drivers.port import four

_UNDER_VOLTAGE, _OVER_TEMPERATURE = 40, 38
_BROADCAST, _STREAM, _MAX_STREAM_BYTES = 0x7F, 1, 61
_STREAM_FROM_DEVICE = 0x41
_MAX_ANSWER_BYTES = 64  # of a CAN FD frame


class EmulatedMoteus(EmulatedMotors[Settings]):
    """Emulates four moteus. Their outputs turn ``gear_ratio`` times as fast as the wheels.

    Attributes:
        servos: the four controllers, for tests that change one of them.
    """

    def power_on(self) -> None:
        settings = self.settings
        values, ratio = self.values, settings.gear_ratio
        per_rev = math.tau / ratio / ratio  # converts a gain per radian of the wheel to one per turn of the output
        kp, kd = values["speed_ki_n_m_rad"] * per_rev, values["speed_kp_n_m_s_rad"] * per_rev
        self._constant = values["torque_constant_n_m_a"] / ratio
        resistance, limit = values["motor_resistance_ohm"], values["torque_limit_n_m"] / ratio
        self.servos = tuple(Servo(number, kp, kd, self._constant, resistance, limit) for number in settings.ids)
        self._consoles = tuple(Console(servo) for servo in self.servos)
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(servo.is_controlled for servo in self.servos)

    def receive(self, frame: Frame) -> None:
        number = frame.id & 0x1FFF_FFFF
        if number >> 16 != self.settings.can_prefix:
            return
        source, destination = number >> 8 & 0xFF, number & 0xFF
        for servo_id, servo, console in zip(self.settings.ids, self.servos, self._consoles, strict=True):
            if destination in (servo_id, _BROADCAST):
                answer = _converse(servo, console, frame.payload)
                servo.obey()
                if source & 0x80 and answer is not None:
                    reply_id = self.settings.can_prefix << 16 | servo_id << 8 | source & 0x7F
                    extended = 0x8000_0000 if reply_id > 0x7FF else 0
                    self.send(Frame(extended | reply_id, answer))

    def tick(self) -> FourWheels | None:
        self._measure()
        hot, limit = self.temperature_degc, self.values["temperature_limit_degc"]
        for channel, servo in enumerate(self.servos):
            if servo.mode not in (STOPPED, FAULT):
                if self.battery_v < 4.0:
                    servo.fail(_UNDER_VOLTAGE)
                elif hot[channel] > limit:
                    servo.fail(_OVER_TEMPERATURE)
        torques = [servo.torque() for servo in self.servos]
        if all(torque is None for torque in torques):
            return None
        return four((torque or 0.0) * self.settings.gear_ratio for torque in torques)

    def _measure(self) -> None:
        for channel, (servo, shaft) in enumerate(zip(self.servos, self.shafts, strict=True)):
            servo.measure(self._quantities(channel, shaft))

    def _quantities(self, channel: int, shaft: Shaft) -> dict[int, float]:
        turns = self.settings.gear_ratio / math.tau
        current = self.current_a[channel]
        copper_w = current * current * self.values["motor_resistance_ohm"]
        return {
            0x01: shaft.position_rad * turns,
            0x02: shaft.speed_rad_s * turns,
            0x03: current * self._constant,
            0x04: current,
            0x07: copper_w + current * self.values["torque_constant_n_m_a"] * shaft.speed_rad_s,
            0x0A: self.temperature_degc[channel],
            0x0D: self.battery_v,
            0x0E: self.temperature_degc[channel],
        }


def _converse(servo: Servo, console: Console, payload: bytes) -> bytes | None:
    """Execute the subframes of a frame, and return the answer; None if its UUID mask selects another controller."""
    answer = _Answer()
    found, is_whole = frames.subframes(payload)
    for one in found:
        if one.code == frames.WRITE and servo.is_masked_out(one.register, one.raw):
            return None
        if one.code in (frames.STREAM_TO_DEVICE, frames.STREAM_POLL):
            if one.register != _STREAM:
                continue
            if one.code == frames.STREAM_TO_DEVICE:
                console.feed(one.data)
            else:
                data = console.take(min(int(one.raw), _MAX_STREAM_BYTES))
                answer.add(bytes((_STREAM_FROM_DEVICE, _STREAM, len(data))) + data)
        elif one.code == frames.WRITE:
            if UUID_MASK <= one.register < UUID_MASK + 4:
                continue
            if error := servo.write(one.register, one.kind, one.raw):
                answer.add_error(frames.WRITE_ERROR, one.register, error)
        elif one.code == frames.READ:
            if (value := servo.read(one.register, one.kind)) is None:
                answer.add_error(frames.READ_ERROR, one.register, NO_REGISTER)
            else:
                answer.add_value(one.register, one.kind, value)
        else:  # an answer: not for a device
            is_whole = False
            break
    if not is_whole:
        servo.refuse()
    return answer.payload()


class _Answer:
    """Collects the subframes of one answer. Values of consecutive registers share one; a subframe is never cut off."""

    def __init__(self) -> None:
        self._whole = b""
        self._first, self._kind = 0, frames.INT8
        self._values: list[bytes] = []

    def add_value(self, register: int, kind: int, raw: float) -> None:
        """Add the raw value of a register."""
        if kind != self._kind or register != self._first + len(self._values):
            self._close()
            self._first, self._kind = register, kind
        self._values.append(frames.pack(kind, raw))

    def add_error(self, code: int, register: int, error: int) -> None:
        """Add why a register could not be written (``WRITE_ERROR``) or read (``READ_ERROR``)."""
        self.add(bytes((code,)) + frames.varuint(register) + frames.varuint(error))

    def add(self, subframe: bytes) -> None:
        """Add any subframe; it is left out if the frame has no room for it."""
        self._close()
        if len(self._whole) + len(subframe) <= _MAX_ANSWER_BYTES:
            self._whole += subframe

    def payload(self) -> bytes:
        """Return the payload of the answer, padded to a length that a CAN FD frame can have."""
        self._close()
        return frames.padded(self._whole)

    def _close(self) -> None:
        """Add the values that are collected, as many of them as the frame has room for."""
        values, self._values = self._values, []
        while values:
            subframe = frames.header(frames.REPLY, self._kind, self._first, len(values)) + b"".join(values)
            if len(self._whole) + len(subframe) <= _MAX_ANSWER_BYTES:
                self._whole += subframe
                return
            values.pop()
