"""Four emulated VESCs, after the source of firmware 6.05: on one CAN bus, one of them also at a serial line.

They have the maker's defaults: a timeout of 1 s without brake current, and faults that keep a motor off for 0.5 s. The
app configuration has real values only at its beginning, where firmware 5 and 6 have the timeout; it is as long as that
of 6.05. The minimum ERPM of the speed controller is 0, as VESC.md requires. Status messages 1, 4 and 5 are sent
at ``status_hz``. They obey SET_CURRENT, SET_CURRENT_BRAKE and SET_RPM, and ignore all other commands and messages than
those of the driver.
"""

import math
import struct
from binascii import crc_hqx
from collections.abc import Callable, Iterator, Mapping
from functools import partial

from firmware_protocol.framing import Frame
from hil.addons.motors.emulated_motors import EmulatedMotors, Shaft, SpeedLoop
from hil.addons.motors.vesc import vesc_frames as frames
from hil.addons.motors.vesc.vesc_driver import Settings
from hil.core.types import FourWheels
from hil.robot.driver import EXTENDED, clamp, four

_TIMEOUT_TICKS, _FAULT_TICKS = 1000, 500
_SIGNATURE = 486554156  # of an app configuration, as 6.00 lays it out
_CONFIGURATION_BYTES = 278
_BRAKE_N_M_S_RAD = 1.0  # near standstill, so that a brake never drives; with 3 the wheels oscillate
_UNDER_VOLTAGE, _HOT_MOTOR = 2, 6
_MIN_V = 8.0
_BROADCAST = 255
_MODES = {frames.SET_CURRENT: "current", frames.SET_CURRENT_BRAKE: "brake", frames.SET_RPM: "rpm"}
_BY_CAN = {setting.can: setting for setting in _MODES}
_BY_MESSAGE = {setting.comm: setting for setting in _MODES}
_RANGES = {"B": (0, 255), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}

Reply = Callable[[bytes], None]


class VescController:
    """One controller and its motor. Speeds and torques are those of the wheel.

    ``to_erpm``: ERPM at 1 rad/s. ``constant``: of the torque [N·m/A] and, of the same value, of the back-EMF [V·s/rad].
    ``limit_n_m``: torque at the largest current. Tests change ``answers_configuration``, whether it answers
    COMM_GET_APPCONF, and ``configured_number``, the VESC ID in its configuration.
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
        self.kill_switch = False
        self.fault = self._fault_ticks_left = 0
        self._quiet_ticks = _TIMEOUT_TICKS + 1  # no command since the power came on
        self._control, self._set_point = "off", 0.0
        self.speed = self.current_a = self.duty = self.input_v = self.input_a = self.degc = 0.0
        self._steps = 0

    @property
    def has_timed_out(self) -> bool:
        return 0 < self.timeout_ticks < self._quiet_ticks

    @property
    def is_driving(self) -> bool:
        """Whether a command controls the motor; the brake after a timeout does not count."""
        return self._control != "off" and not self.has_timed_out

    def command(self, control: str, set_point: float) -> None:
        """Take a command: amperes ("current", "brake") or ERPM ("rpm"). During a fault the motor stays off."""
        self._quiet_ticks = 0
        if self.fault or self.kill_switch:
            return
        if control in ("current", "brake") and abs(set_point) < frames.MIN_CURRENT_A:
            control = "off"
        if control != self._control:
            self._loop.reset()
        self._control, self._set_point = control, set_point

    def obey(self, setting: frames.Setting, data: bytes) -> None:
        """Execute a motor command, unless its data is not of 4 bytes."""
        if len(data) == 4:
            self.command(_MODES[setting], int.from_bytes(data, "big", signed=True) / setting.per_unit)

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
            self._control = "brake" if self.timeout_brake_a >= frames.MIN_CURRENT_A else "off"
            self._set_point = self.timeout_brake_a
        torque = self._controlled()
        if self.input_v > 0.0:
            volts = (torque or 0.0) / self._constant * self._resistance_ohm + self._constant * self.speed
            self.duty = clamp(volts / self.input_v, 1.0)
        return torque

    def _controlled(self) -> float | None:
        if self._control == "rpm":
            return self._loop.torque(self._set_point / self._to_erpm, self.speed)
        limited = clamp(self._set_point * self._constant, self._limit_n_m)
        if self._control == "brake":
            return clamp(-_BRAKE_N_M_S_RAD * self.speed, abs(limited))
        return limited if self._control == "current" else None

    def measure(self, shaft: Shaft, steps_per_rad: float) -> None:
        """Take the shaft's angle and speed."""
        self.speed = shaft.speed_rad_s
        self._steps = math.floor(shaft.position_rad * steps_per_rad)

    @property
    def _tachometer(self) -> int:
        return (self._steps + 2**31) % 2**32 - 2**31

    @property
    def _erpm(self) -> int:
        return int(self.speed * self._to_erpm)

    @property
    def _motor_a(self) -> float:
        """The current, positive when it drives: its sign is not that of the torque."""
        return math.copysign(self.current_a, self.current_a * self.speed)

    def statuses(self) -> list[tuple[int, bytes]]:
        """Return the status messages 1, 4 and 5: command and data."""
        return [
            (frames.CAN_STATUS, _packed("ihh", self._erpm, self._motor_a * 10, self.duty * 1000)),
            (frames.CAN_STATUS_4, _packed("hhhh", self.degc * 10, self.degc * 10, self.input_a * 10, 0)),
            (frames.CAN_STATUS_5, _packed("ihh", self._tachometer, self.input_v * 10, 0)),
        ]

    def process(self, message: bytes, reply: Reply) -> None:
        """Execute a message, and send the answer, if it has one, with ``reply``."""
        code, data = message[0], message[1:]
        if code == frames.FW_VERSION:
            # Unique id; paired, test version, kind of hardware, configurations, filters, two pages, radio; name; CRC.
            reply(bytes((0, *self.version)) + self.hardware + b"\0" + bytes(range(12)) + bytes(8) + b"\0" + bytes(4))
        elif code == frames.GET_APPCONF and self.answers_configuration:
            reply(message[:1] + self._configuration())
        elif code == frames.GET_VALUES_SELECTIVE and len(data) >= 4:
            reply(message[:5] + self._values(int.from_bytes(data[:4], "big")))
        elif code in _BY_MESSAGE:
            self.obey(_BY_MESSAGE[code], data)

    def _configuration(self) -> bytes:
        values = self.configured_number, self.timeout_ticks, self.timeout_brake_a
        front = struct.pack(">IBIf", _SIGNATURE, *values)
        return front + bytes(i & 0xFF for i in range(len(front), _CONFIGURATION_BYTES))

    def _values(self, mask: int) -> bytes:
        every: Mapping[int, tuple[str, float]] = {
            0: ("h", self.degc * 10), 2: ("i", self._motor_a * 100), 3: ("i", self.input_a * 100), 7: ("i", self._erpm),
            8: ("h", self.input_v * 10), 13: ("i", self._tachometer), frames.FAULT_BIT: ("B", self.fault),
            frames.ID_BIT: ("B", self.number), frames.STATUS_BIT: ("B", self.has_timed_out | self.kill_switch << 1),
        }  # fmt: skip
        return b"".join(_packed(*every[bit]) for bit in every if mask >> bit & 1)


def _packed(layout: str, *values: float) -> bytes:
    ranges = [_RANGES[letter] for letter in layout]
    whole = (int(clamp(value, high, low)) for value, (low, high) in zip(values, ranges, strict=True))
    return struct.pack(">" + layout, *whole)


def can_parts(sender: int, message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield command and data of the CAN frames of an answer: one for up to 6 bytes, else its pieces and a last one."""
    if len(message) <= 6:
        yield frames.CAN_SHORT, bytes((sender, 1)) + message
        return
    offset = 0
    while offset < len(message):
        if offset <= 255:
            yield frames.CAN_FILL, bytes((offset,)) + message[offset : offset + 7]
            offset += 7
        else:
            yield frames.CAN_FILL_LONG, offset.to_bytes(2, "big") + message[offset : offset + 6]
            offset += 6
    yield frames.CAN_PROCESS, struct.pack(">BBHH", sender, 1, len(message), crc_hqx(message, 0))


class EmulatedVesc(EmulatedMotors[Settings]):
    """Emulates four VESCs.

    Attributes:
        vescs: the four controllers, for tests that change one of them.
    """

    def power_on(self) -> None:
        settings = self.settings
        self._line = frames.SerialFraming()
        self._bytes = bytearray()
        to_erpm = settings.gear_ratio * settings.pole_pairs * 60.0 / math.tau
        self._steps_per_rad = frames.STEPS * settings.pole_pairs * settings.gear_ratio / math.tau
        constant, resistance = self.values["torque_constant_n_m_a"], self.values["motor_resistance_ohm"]
        limit = self.values["torque_limit_n_m"]
        self.vescs = tuple(
            VescController(number, to_erpm, constant, resistance, limit, loop)
            for number, loop in zip(settings.ids, self.loops, strict=True)
        )
        self._by_id = {vesc.number: vesc for vesc in self.vescs}
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(vesc.is_driving for vesc in self.vescs)

    def tick(self) -> FourWheels | None:
        self._measure()
        period = max(round(1000.0 / self.settings.status_hz), 1)
        for channel, vesc in enumerate(self.vescs):
            if self.ticks % period == channel * period // 4:
                for command, data in vesc.statuses():
                    self.send(Frame(EXTENDED | command << 8 | vesc.number, data))
            if vesc.is_driving and self.battery_v < _MIN_V:
                vesc.fail(_UNDER_VOLTAGE)
            elif vesc.is_driving and self.temperature_degc[channel] > self.values["temperature_limit_degc"]:
                vesc.fail(_HOT_MOTOR)
        torques = [vesc.torque() for vesc in self.vescs]
        if all(torque is None for torque in torques):
            return None
        return four(torque or 0.0 for torque in torques)

    def _measure(self) -> None:
        for channel, vesc in enumerate(self.vescs):
            vesc.measure(self.shafts[channel], self._steps_per_rad)
            vesc.current_a, vesc.degc = self.current_a[channel], self.temperature_degc[channel]
            vesc.input_v, vesc.input_a = self.battery_v, self.battery_a / 4.0

    # CAN

    def receive(self, frame: Frame) -> None:
        command, number, data = (frame.id & ~EXTENDED) >> 8, frame.id & 0xFF, frame.payload
        if not frame.id & EXTENDED:
            return
        for vesc in self.vescs:
            if number not in (vesc.number, _BROADCAST):
                continue
            if command in _BY_CAN:
                vesc.obey(_BY_CAN[command], data)
            elif command == frames.CAN_SHORT and len(data) > 2 and data[1] == 0:
                vesc.process(data[2:], partial(self._can_reply, vesc.number, data[0]))
            elif command == frames.CAN_PING and data:
                self.send(Frame(EXTENDED | frames.CAN_PONG << 8 | data[0], bytes((vesc.number, 0))))

    def _can_reply(self, sender: int, to: int, message: bytes) -> None:
        for command, data in can_parts(sender, message):
            self.send(Frame(EXTENDED | command << 8 | to, data))

    # The serial line

    def feed(self, data: bytes) -> None:
        for frame in self._line.feed(data):
            self._process(bytes((frame.id,)) + frame.payload)

    def _process(self, message: bytes) -> None:
        near = self.settings.serial_id
        if message[0] == frames.FORWARD_CAN:
            if len(message) > 2 and message[1] != near and (behind := self._by_id.get(message[1])) is not None:
                behind.process(message[2:], self._serial_reply)
        elif (here := self._by_id.get(near)) is not None:
            here.process(message, self._serial_reply)

    def _serial_reply(self, message: bytes) -> None:
        self._bytes += self._line.encode(Frame(message[0], message[1:]))

    def take_bytes(self) -> bytes:
        """Return the answers of the near VESC. Broadcasts on the bus behind it are discarded."""
        self.take_frames()
        data = bytes(self._bytes)
        self._bytes.clear()
        return data
