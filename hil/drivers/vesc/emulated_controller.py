"""One emulated VESC: the control modes of its motor, its timeout, and its answers to messages.

Written from the source of firmware 6.05. It answers COMM_FW_VERSION, COMM_GET_VALUES, COMM_GET_VALUES_SELECTIVE and
COMM_GET_APPCONF, and obeys COMM_SET_DUTY, COMM_SET_CURRENT, COMM_SET_CURRENT_BRAKE, COMM_SET_RPM and COMM_ALIVE. It
ignores all other messages, and those that are too short.
"""

import math
import struct
from binascii import crc_hqx
from collections.abc import Callable, Iterator, Mapping

from hil.drivers.emulated import Shaft, SpeedLoop
from hil.drivers.port import clamp

_TIMEOUT_TICKS, _FAULT_TICKS = 1000, 500
_SIGNATURE = 486554156  # of an app configuration, as 6.00 lays it out
_CONFIGURATION_BYTES = {(6, 5): 278}  # without the balance app, which 6.00 still has
_MAX_CONFIGURATION_BYTES = 493
_MIN_A = 0.05
_BRAKE_N_M_S_RAD = 1.0  # near standstill, so that a brake never drives; with 3 the wheels oscillate
_MAX_DUTY = 0.95  # of the battery's voltage, by default
_TICKS_PER_HOUR = 3_600_000

FW_VERSION, GET_VALUES, GET_APPCONF, ALIVE, GET_VALUES_SELECTIVE = 0, 4, 17, 30, 50
_COMMANDS: Mapping[int, tuple[str, float]] = {  # CAN_PACKET_SET_...: mode, and counts per unit
    0: ("duty", 1e5), 1: ("current", 1e3), 2: ("brake", 1e3), 3: ("rpm", 1.0), 10: ("current share", 1e5),
    11: ("brake share", 1e5),
}  # fmt: skip
_COMM_SET = range(5, 9)  # COMM_SET_...: the first four of these, by a message
_RANGES = {"B": (0, 255), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}
_EVERY_VALUE = (1 << 22) - 1

Reply = Callable[[bytes], None]


class VescController:
    """One controller and its motor. Speeds and torques are those of the wheel.

    Args:
        number: VESC ID.
        to_erpm: ERPM at 1 rad/s of the wheel.
        constant: torque constant [N·m/A], and of the same value the back-EMF constant [V·s/rad].
        resistance_ohm: of the motor.
        limit_n_m: torque at the largest current.
        loop: the speed controller.

    Attributes for tests:
        answers_configuration: whether it answers COMM_GET_APPCONF.
        configured_number: the VESC ID in its configuration.
        enabled_statuses: numbers of the status messages that are switched on.
        has_status: whether its firmware has the status among the selective values.
    """

    def __init__(
        self, number: int, to_erpm: float, constant: float, resistance_ohm: float, limit_n_m: float, loop: SpeedLoop
    ) -> None:
        self.number, self._to_erpm, self._constant, self._limit_n_m = number, to_erpm, constant, limit_n_m
        self._resistance_ohm, self._loop = resistance_ohm, loop
        self.version, self.hardware = (6, 5), b"60_MK6"
        self.timeout_ticks, self.timeout_brake_a = _TIMEOUT_TICKS, 0.0
        self.answers_configuration = True
        self.configured_number = number
        self.enabled_statuses: tuple[int, ...] = (1, 4, 5)
        self.kill_switch = False
        self.has_status = True
        self.fault = self._fault_ticks_left = 0
        self._quiet_ticks = _TIMEOUT_TICKS + 1  # no command since the power came on
        self._control, self._set_point = "off", 0.0
        self.speed = self.current_a = self.duty = self.input_v = self.input_a = self.degc = 0.0
        self.tachometer_abs = self._steps = 0
        self._has_steps = False
        self._amp_hours, self._watt_hours = [0.0, 0.0], [0.0, 0.0]  # drawn from the battery, and given back to it

    @property
    def has_timed_out(self) -> bool:
        return 0 < self.timeout_ticks < self._quiet_ticks

    @property
    def is_driving(self) -> bool:
        """Whether a command controls the motor; the brake after a timeout does not count."""
        return self._control != "off" and not self.has_timed_out

    def command(self, control: str, set_point: float) -> None:
        """Take a command: a share of the battery's voltage ("duty"), amperes ("current", "brake") or ERPM ("rpm").

        During a fault the motor stays off.
        """
        self._quiet_ticks = 0
        if self.fault or self.kill_switch:
            return
        if control in ("current", "brake") and abs(set_point) < _MIN_A:
            control = "off"
        if control != self._control:
            self._loop.reset()
        self._control, self._set_point = control, set_point

    def obey(self, number: int, data: bytes) -> bool:
        """Execute a motor command of CAN; return False if this is none. Data of less than 4 bytes are ignored."""
        if number not in _COMMANDS:
            return False
        if len(data) >= 4:
            control, per_unit = _COMMANDS[number]
            value = struct.unpack_from(">i", data)[0] / per_unit
            control, _, share = control.partition(" ")
            self.command(control, value * self._limit_n_m / self._constant if share else value)
        return True

    def fail(self, code: int) -> None:
        """Enter the fault with this code, as after a hardware fault."""
        self.fault, self._fault_ticks_left, self._control = code, _FAULT_TICKS, "off"

    def torque(self) -> float | None:
        """Advance by 1 ms, and return the torque at the wheel [N·m]; None for a motor without current."""
        self._quiet_ticks += 1
        if self.fault:
            self._fault_ticks_left -= 1
            if self._fault_ticks_left <= 0:
                self.fault = 0
        if self.kill_switch:
            self._control = "off"
        elif self.has_timed_out and not self.fault:
            self._control = "brake" if self.timeout_brake_a >= _MIN_A else "off"
            self._set_point = self.timeout_brake_a
        torque = self._controlled()
        if self.input_v > 0.0:
            volts = (torque or 0.0) / self._constant * self._resistance_ohm + self._constant * self.speed
            self.duty = clamp(volts / self.input_v, 1.0)
        return torque

    def _controlled(self) -> float | None:
        if self._control == "rpm":
            return self._loop.torque(self._set_point / self._to_erpm, self.speed)
        if self._control == "current":
            return self._limited(self._set_point * self._constant)
        if self._control == "brake":
            most = abs(self._limited(self._set_point * self._constant))
            return clamp(-_BRAKE_N_M_S_RAD * self.speed, most)
        if self._control == "duty":
            # A duty of 0 shorts the windings, which brakes.
            volts = clamp(self._set_point, _MAX_DUTY) * self.input_v
            current_a = (volts - self._constant * self.speed) / self._resistance_ohm
            return self._limited(current_a * self._constant)
        return None

    def _limited(self, torque: float) -> float:
        return clamp(torque, self._limit_n_m)

    def measure(self, shaft: Shaft, steps_per_rad: float) -> None:
        """Take the shaft's angle and speed, and add the battery's charge and energy of 1 ms."""
        self.speed = shaft.speed_rad_s
        steps = math.floor(shaft.position_rad * steps_per_rad)
        if self._has_steps:
            self.tachometer_abs += abs(steps - self._steps)
        self._steps, self._has_steps = steps, True
        returned = self.input_a < 0.0
        self._amp_hours[returned] += abs(self.input_a) / _TICKS_PER_HOUR
        self._watt_hours[returned] += abs(self.input_a) * self.input_v / _TICKS_PER_HOUR

    @property
    def tachometer(self) -> int:
        return (self._steps + 2**31) % 2**32 - 2**31

    @property
    def erpm(self) -> int:
        return int(self.speed * self._to_erpm)

    @property
    def motor_a(self) -> float:
        """The current, positive when it drives: its sign is not that of the torque."""
        return math.copysign(self.current_a, self.current_a * self.speed)

    def statuses(self) -> list[tuple[int, bytes]]:
        """Return the status messages that are switched on: command and data."""
        (drawn_ah, given_ah), (drawn_wh, given_wh) = self._amp_hours, self._watt_hours
        every = {
            1: (9, _packed("ihh", self.erpm, self.motor_a * 10, self.duty * 1000)),
            2: (14, _packed("ii", drawn_ah * 1e4, given_ah * 1e4)),
            3: (15, _packed("ii", drawn_wh * 1e4, given_wh * 1e4)),
            4: (16, _packed("hhhh", self.degc * 10, self.degc * 10, self.input_a * 10, 0)),
            5: (27, _packed("ihh", self.tachometer, self.input_v * 10, 0)),
        }
        return [every[number] for number in self.enabled_statuses]

    def process(self, message: bytes, reply: Reply) -> None:
        """Execute a message, and send the answer, if it has one, with ``reply``."""
        code, data = message[0], message[1:]
        if code == FW_VERSION:
            # Unique id; paired, test version, kind of hardware, configurations, filters, two pages, radio; name; CRC.
            reply(bytes((0, *self.version)) + self.hardware + b"\0" + bytes(range(12)) + bytes(8) + b"\0" + bytes(4))
        elif code == GET_VALUES:
            reply(message[:1] + self._values(_EVERY_VALUE))
        elif code == GET_APPCONF and self.answers_configuration:
            reply(b"\x11" + self._configuration())
        elif code == GET_VALUES_SELECTIVE and len(data) >= 4:
            reply(message[:5] + self._values(int.from_bytes(data[:4], "big")))
        elif code == ALIVE:
            self._quiet_ticks = 0
        elif code in _COMM_SET:
            self.obey(code - _COMM_SET.start, data)

    def _configuration(self) -> bytes:
        size = _CONFIGURATION_BYTES.get(self.version, _MAX_CONFIGURATION_BYTES)
        front = struct.pack(">IBI", _SIGNATURE, self.configured_number, self.timeout_ticks)
        front += float32_auto(self.timeout_brake_a)
        return front + bytes(i & 0xFF for i in range(len(front), size))

    def _values(self, mask: int) -> bytes:
        nothing = 0
        (drawn_ah, given_ah), (drawn_wh, given_wh) = self._amp_hours, self._watt_hours
        volts = self.duty * self.input_v
        every = {
            0: ("h", self.degc * 10), 1: ("h", self.degc * 10), 2: ("i", self.motor_a * 100),
            3: ("i", self.input_a * 100), 4: ("i", nothing), 5: ("i", self.current_a * 100),
            6: ("h", self.duty * 1000), 7: ("i", self.erpm), 8: ("h", self.input_v * 10),
            9: ("i", drawn_ah * 1e4), 10: ("i", given_ah * 1e4), 11: ("i", drawn_wh * 1e4), 12: ("i", given_wh * 1e4),
            13: ("i", self.tachometer), 14: ("i", self.tachometer_abs & 0x7FFF_FFFF), 15: ("B", self.fault),
            16: ("i", nothing), 17: ("B", self.number), 18: ("hhh", self.degc * 10), 19: ("i", nothing),
            20: ("i", volts * 1000),
        }  # fmt: skip
        if self.has_status:
            every[21] = ("B", self.has_timed_out | self.kill_switch << 1)
        selected = (every[bit] for bit in sorted(every) if mask >> bit & 1)
        return b"".join(_packed(layout, *[value] * len(layout)) for layout, value in selected)


def _packed(layout: str, *values: float) -> bytes:
    """Return the bytes of numbers in this layout, each saturated to its type."""
    ranges = [_RANGES[letter] for letter in layout]
    whole = (int(clamp(value, high, low)) for value, (low, high) in zip(values, ranges, strict=True))
    return struct.pack(">" + layout, *whole)


# The wire format of a VESC's messages, written from its specification and independently of the driver

_MAX_BYTES = 512


def can_parts(sender: int, message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield command and data of the CAN frames of an answer: one for up to 6 bytes, else its pieces and a last one."""
    if len(message) <= 6:
        yield 8, bytes((sender, 1)) + message
        return
    offset = 0
    while offset < len(message):
        if offset <= 255:
            yield 5, bytes((offset,)) + message[offset : offset + 7]
            offset += 7
        else:
            yield 6, offset.to_bytes(2, "big") + message[offset : offset + 6]
            offset += 6
    yield 7, struct.pack(">BBHH", sender, 1, len(message), crc_hqx(message, 0))


def packet(message: bytes) -> bytes:
    """Return the packet of a message on the serial line."""
    size = len(message)
    head = bytes((3, size >> 8, size & 0xFF)) if size > 255 else bytes((2, size))
    return head + message + crc_hqx(message, 0).to_bytes(2, "big") + b"\x03"


def first_packet(data: bytes) -> tuple[int, bytes]:
    """Return the number of bytes to remove and the message in them, if any; 0 bytes if the packet is incomplete."""
    if data[0] not in (2, 3):
        return 1, b""
    head = data[0]
    if len(data) < head:
        return 0, b""
    length = int.from_bytes(data[1:head], "big")
    if not (1 if head == 2 else 255) <= length <= _MAX_BYTES:
        return 1, b""
    size = head + length + 3
    if len(data) < size:
        return 0, b""
    message = data[head : head + length]
    if data[size - 1] != 3 or crc_hqx(message, 0) != int.from_bytes(data[size - 3 : size - 1], "big"):
        return 1, b""
    return size, message


def float32_auto(value: float) -> bytes:
    """Return a number as in a configuration: sign, exponent of ``frexp`` plus 126, significand minus one half."""
    if abs(value) < 1.5e-38:
        return bytes(4)
    significand, exponent = math.frexp(abs(value))
    bits = (value < 0.0) << 31 | exponent + 126 << 23 | int((significand - 0.5) * 2**24)
    return bits.to_bytes(4, "big")
