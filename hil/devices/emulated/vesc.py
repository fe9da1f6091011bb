"""Four VESCs as their firmware is published: on one CAN bus, and one of them at a serial line that it passes on.

Their timeout is 1 s with no brake current, and a fault holds a motor off for half a second, both as delivered. Of the
app configuration the front is told, where firmware 5 and 6 have the timeout; the rest is as long as in 6.00 or 6.05.
The minimum ERPM of the speed controller is 0, as hil/dialects/VESC.md asks for; status 1, 4 and 5 go at ``status_hz``.
"""

import math
import struct
from collections.abc import Callable

from firmware_protocol.framing import Frame
from hil.devices.emulated import vesc_wire as wire
from hil.devices.emulated.motors import EmulatedMotors, Shaft, SpeedLoop
from hil.dialects.vesc import Settings
from hil.types import FourWheels

_EXTENDED = 0x8000_0000
_TIMEOUT_TICKS, _FAULT_TICKS = 1000, 500
_SIGNATURE = 486554156  # of an app configuration, as 6.00 lays it out
_CONFIGURATION_BYTES = {(6, 5): 278}  # without the balance app, which 6.00 still has
_MOST_CONFIGURATION_BYTES = 493
_UNDER_VOLTAGE, _HOT_MOTOR = 2, 6
_LEAST_V, _LEAST_A = 8.0, 0.05
_IDS, _PING_TICKS = 255, 10
_BRAKE_N_M_S_RAD = 1.0  # near standstill, where no brake drives; with 3 wheels swing, as their speed is told late

Reply = Callable[[bytes], None]


class _Vesc:
    """One controller and its motor; speeds and torques are of the wheel."""

    def __init__(self, number: int, to_erpm: float, constant: float, limit_n_m: float, loop: SpeedLoop) -> None:
        self.number, self._to_erpm, self._constant, self._limit_n_m = number, to_erpm, constant, limit_n_m
        self._loop = loop
        self.version = (6, 5)
        self.hardware = b"60_MK6"
        self.timeout_ticks = _TIMEOUT_TICKS
        self.timeout_brake_a = 0.0
        self.tells_configuration = True
        self.told_number = number  # in the configuration
        self.kill_switch = False
        self.knows_status = True
        self.fault = 0
        self._fault_left = 0
        self._quiet_ticks = _TIMEOUT_TICKS + 1  # nobody has commanded since the power came on
        self._control, self._wanted = "off", 0.0
        self.speed = self.current_a = self.duty = self.input_v = self.input_a = self.degc = 0.0
        self.tachometer = 0

    @property
    def has_timed_out(self) -> bool:
        return 0 < self.timeout_ticks < self._quiet_ticks

    @property
    def is_driving(self) -> bool:
        """Whether somebody's command has the motor; the brake of the timeout is nobody's."""
        return self._control != "off" and not self.has_timed_out

    def command(self, control: str, raw: int) -> None:
        """Take a command; a fault keeps the motor off whatever comes."""
        self._quiet_ticks = 0
        if self.fault or self.kill_switch:
            return
        wanted = raw / (1.0 if control == "rpm" else 1000.0)
        if control != "rpm" and abs(wanted) < _LEAST_A:
            control = "off"
        if control != self._control:
            self._loop.reset()
        self._control, self._wanted = control, wanted

    def fail(self, code: int) -> None:
        """Go to fault, as by a reason of the hardware's."""
        self.fault, self._fault_left, self._control = code, _FAULT_TICKS, "off"

    def torque(self) -> float | None:
        """Let a millisecond pass, and return the torque at the wheel, None for a motor that is let go."""
        self._quiet_ticks += 1
        if self.fault:
            self._fault_left -= 1
            if self._fault_left <= 0:
                self.fault = 0
        if self.kill_switch:
            self._control = "off"
        elif self.has_timed_out and not self.fault:
            self._control = "brake" if self.timeout_brake_a >= _LEAST_A else "off"
            self._wanted = self.timeout_brake_a
        if self._control == "rpm":
            return self._loop.torque(self._wanted / self._to_erpm, self.speed)
        if self._control == "current":
            return self._limited(self._wanted * self._constant)
        if self._control == "brake":
            most = abs(self._limited(self._wanted * self._constant))
            return min(max(-_BRAKE_N_M_S_RAD * self.speed, -most), most)
        return None

    def _limited(self, torque: float) -> float:
        return min(max(torque, -self._limit_n_m), self._limit_n_m)

    def measure(self, shaft: Shaft, steps_per_rad: float) -> None:
        self.speed = shaft.speed_rad_s
        steps = math.floor(shaft.position_rad * steps_per_rad)
        self.tachometer = (steps + 2**31) % 2**32 - 2**31

    @property
    def erpm(self) -> int:
        return int(self.speed * self._to_erpm)

    @property
    def motor_a(self) -> float:
        """The current, positive when it drives: the sign is not that of the torque."""
        return math.copysign(self.current_a, self.current_a * self.speed)

    def statuses(self) -> tuple[tuple[int, bytes], ...]:
        """Return the status messages 1, 4 and 5: command and data."""
        one = struct.pack(">ihh", self.erpm, int(self.motor_a * 10), int(self.duty * 1000))
        four = struct.pack(">hhhh", int(self.degc * 10), int(self.degc * 10), int(self.input_a * 10), 0)
        five = struct.pack(">ihh", self.tachometer, int(self.input_v * 10), 0)
        return (9, one), (16, four), (27, five)

    def process(self, message: bytes, reply: Reply) -> None:
        """Do what a message asks."""
        code, data = message[0], message[1:]
        if code == 0:
            name = self.hardware + b"\0"
            reply(bytes((0, *self.version)) + name + bytes(range(12)) + bytes((0, 0, 0, 0, 0, 0, 0, 0)) + b"\0")
        elif code == 17 and self.tells_configuration:
            reply(b"\x11" + self._configuration())
        elif code == 50 and len(data) >= 4:
            reply(message[:5] + self._values(int.from_bytes(data[:4], "big")))
        elif code in (6, 7, 8) and len(data) >= 4:
            self.command({6: "current", 7: "brake", 8: "rpm"}[code], struct.unpack_from(">i", data)[0])

    def _configuration(self) -> bytes:
        size = _CONFIGURATION_BYTES.get(self.version, _MOST_CONFIGURATION_BYTES)
        front = struct.pack(">IBI", _SIGNATURE, self.told_number, self.timeout_ticks)
        front += wire.float32_auto(self.timeout_brake_a)
        return front + bytes(place & 0xFF for place in range(len(front), size))

    def _values(self, mask: int) -> bytes:
        nothing = 0
        every = {
            0: ("h", self.degc * 10), 1: ("h", self.degc * 10), 2: ("i", self.motor_a * 100),
            3: ("i", self.input_a * 100), 4: ("i", nothing), 5: ("i", self.current_a * 100),
            6: ("h", self.duty * 1000), 7: ("i", self.erpm), 8: ("h", self.input_v * 10),
            9: ("i", nothing), 10: ("i", nothing), 11: ("i", nothing), 12: ("i", nothing),
            13: ("i", self.tachometer), 14: ("i", abs(self.tachometer)), 15: ("B", self.fault),
            16: ("i", nothing), 17: ("B", self.number), 18: ("6x", None), 19: ("i", nothing), 20: ("i", nothing),
        }  # fmt: skip
        if self.knows_status:
            every[21] = ("B", self.has_timed_out | self.kill_switch << 1)
        parts = (every[bit] for bit in sorted(every) if mask >> bit & 1)
        return b"".join(
            struct.pack(layout) if value is None else struct.pack(">" + layout, int(value)) for layout, value in parts
        )


class EmulatedVesc(EmulatedMotors):
    """See ``EmulatedMotors``.

    Attributes:
        vescs: the four, for what a test has to do to one of them.
    """

    def __init__(self, settings: Settings, *node: object, **keywords: object) -> None:
        self._settings = settings
        self._open = b""
        self._bytes = bytearray()
        self._scan_left = 0
        super().__init__(*node, **keywords)  # type: ignore[arg-type]
        to_erpm = settings.gear_ratio * settings.pole_pairs * 60.0 / math.tau
        self._steps_per_rad = 6 * settings.pole_pairs * settings.gear_ratio / math.tau
        constant, limit = self.values["torque_constant_n_m_a"], self.values["torque_limit_n_m"]
        self.vescs = tuple(
            _Vesc(number, to_erpm, constant, limit, loop)
            for number, loop in zip(settings.ids, self.speed_loops(), strict=True)
        )
        self._by_id = {vesc.number: vesc for vesc in self.vescs}
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(vesc.is_driving for vesc in self.vescs)

    def tick(self) -> FourWheels | None:
        self._measure()
        if self._scan_left:
            self._scan_left -= 1
            if not self._scan_left:
                self._serial_reply(bytes((62, *self._behind())))
        period = max(round(1000.0 / self._settings.status_hz), 1)
        for place, vesc in enumerate(self.vescs):
            if self.ticks % period == place * period // 4:
                for command, data in vesc.statuses():
                    self.say(Frame(_EXTENDED | command << 8 | vesc.number, data))
            if vesc.is_driving and self.battery_v < _LEAST_V:
                vesc.fail(_UNDER_VOLTAGE)
            elif vesc.is_driving and self.temperature_degc[place] > self.values["temperature_limit_degc"]:
                vesc.fail(_HOT_MOTOR)
        torques = [vesc.torque() for vesc in self.vescs]
        if all(torque is None for torque in torques):
            return None
        a, b, c, d = (torque or 0.0 for torque in torques)
        return a, b, c, d

    def _measure(self) -> None:
        for place, vesc in enumerate(self.vescs):
            vesc.measure(self.shafts[place], self._steps_per_rad)
            vesc.current_a, vesc.degc = self.current_a[place], self.temperature_degc[place]
            vesc.input_v, vesc.input_a = self.battery_v, self.battery_a / 4.0

    # CAN

    def take(self, frame: Frame) -> None:
        command, number, data = (frame.id & 0x1FFF_FFFF) >> 8, frame.id & 0xFF, frame.payload
        if not frame.id & _EXTENDED:
            return
        for vesc in self.vescs:
            if number not in (vesc.number, 255):
                continue
            if command in (1, 2, 3) and len(data) >= 4:
                vesc.command({1: "current", 2: "brake", 3: "rpm"}[command], struct.unpack_from(">i", data)[0])
            elif command == 8 and len(data) > 2 and data[1] == 0:
                vesc.process(data[2:], self._can_reply(vesc.number, data[0]))
            elif command == 17 and data:
                self.say(Frame(_EXTENDED | 18 << 8 | data[0], bytes((vesc.number, 0))))

    def _can_reply(self, sender: int, to: int) -> Reply:
        def reply(message: bytes) -> None:
            for command, data in wire.can_parts(sender, message):
                self.say(Frame(_EXTENDED | command << 8 | to, data))

        return reply

    # The serial line

    def feed(self, data: bytes) -> None:
        self._open += data
        while self._open:
            size, message = wire.first_packet(self._open)
            if size == 0:
                return
            self._open = self._open[size:]
            if message:
                self._process(message)

    def _process(self, message: bytes) -> None:
        near = self._settings.serial_id
        if message[0] == 62:
            # Each id in turn: whoever is there answers at once. Asked again meanwhile, it goes on with the first scan.
            self._scan_left = self._scan_left or _PING_TICKS * (_IDS - len(self._behind()))
        elif message[0] == 34:
            if len(message) > 2 and message[1] != near and (behind := self._by_id.get(message[1])) is not None:
                behind.process(message[2:], self._serial_reply)
        elif (here := self._by_id.get(near)) is not None:
            here.process(message, self._serial_reply)

    def _behind(self) -> list[int]:
        return sorted(number for number in self._by_id if number != self._settings.serial_id)

    def _serial_reply(self, message: bytes) -> None:
        self._bytes += wire.packet(message)

    def take_bytes(self) -> bytes:
        """Return what the near VESC says; what they broadcast on the bus between them reaches nobody here."""
        self.take_frames()
        said = bytes(self._bytes)
        self._bytes.clear()
        return said


EMULATED = EmulatedVesc
