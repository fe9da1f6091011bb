"""A Yahboom Rosmaster board as its firmware 3.5 is: one receive buffer, loops of four wheels, four reports in turn.

Bytes come in at 115200 baud into one buffer, which is looked at once a millisecond, so that frames without a pause
between them destroy each other as on the board. Commands never grow old. The wheels' loops are those of the other
emulated controllers, at 1 kHz, where the board's run at 100 Hz on the counts of 10 ms; what it reports are such counts.

Of the functions there are those that drive, stop, report and answer; the board's lamps, servos and open-loop motor
voltages are not, and the report of the attitude is not sent.
"""

import math
import struct

from firmware_protocol.framing import Frame
from hil.devices.emulated.motors import EmulatedMotors
from hil.dialects.rosmaster_board import Settings
from hil.types import FourWheels

_BYTES_PER_TICK = 115200 / 10 / 1000
_BUFFER = 50
_HOST_BUFFER = 4096  # what a serial driver takes before it makes a writer wait; beyond it bytes are lost here
_CAR_NUMBERS = {"x3": 1, "x3_plus": 2}
_WHEELS = {"x3": (204.203, 164.555, 1320, 1000), "x3_plus": (251.327, 214.1, 2464, 700)}  # mm, mm, counts, mm/s
_REPORT_TICKS = 40
_BATTERY_CHECKS = 20


class _Receiver:
    """The board's interrupt: bytes into the one buffer, whatever is still in there."""

    def __init__(self) -> None:
        self._buffer = bytearray(_BUFFER)
        self._step = 0
        self._at = 0
        self._length = 0
        self._is_new = False

    def take(self, byte: int) -> None:
        if self._step == 0:
            self._step = 1 if byte == 0xFF else 0
        elif self._step == 1:
            self._step = 2 if byte == 0xFC else 0
        elif self._step == 2:
            if byte + 2 >= _BUFFER:
                self._step = 0
                return
            self._length = byte + 2
            self._buffer[2] = byte
            self._at = 3
            self._step = 3
        else:
            self._buffer[self._at] = byte
            self._at += 1
            if self._at >= self._length:
                self._is_new = True
                self._step = 0

    def look(self) -> tuple[int, bytes] | None:
        """Return what a task finds in the buffer: function and data, if something is new and its sum is right."""
        if not self._is_new:
            return None
        found = bytes(self._buffer[2 : self._length])
        self._is_new = False
        self._length = 0
        if len(found) < 3 or sum(found[:-1]) % 256 != found[-1]:
            return None
        return found[1], found[2:-1]


class EmulatedRosmaster(EmulatedMotors):
    """See ``EmulatedMotors``. ``version`` and ``car_number`` are what the board says of itself."""

    def __init__(self, settings: Settings, *node: object, **keywords: object) -> None:
        circle_mm, self._lever_mm, counts, self._limit_mm_s = _WHEELS[settings.car]
        self._radius_mm = settings.wheel_radius_m * 1e3 or circle_mm / math.tau
        self._lever_mm = settings.lever_m * 1e3 or self._lever_mm
        self._counts_per_turn = settings.counts_per_turn or counts
        self._battery_v_limits = settings.battery_low_v, settings.battery_high_v
        self.version = (3, 5)
        self.car_number = _CAR_NUMBERS[settings.car]
        self._line = bytearray()
        self._credit = 0.0
        self._receiver = _Receiver()
        self._targets_mm_s: tuple[float, ...] | None = None  # None: no loop, the motors brake or are off
        self._is_braking = False
        self._is_reporting = True
        self._is_off = False
        self._bad_checks = 0
        self._counts = (0, 0, 0, 0)
        self._speeds_mm_s = (0.0, 0.0, 0.0, 0.0)
        super().__init__(*node, **keywords)  # type: ignore[arg-type]
        self._loops = self.speed_loops()

    @property
    def is_driving(self) -> bool:
        return self._targets_mm_s is not None

    def feed(self, data: bytes) -> None:
        self._line += data[: _HOST_BUFFER - len(self._line)]

    def take_bytes(self) -> bytes:
        return b"".join(map(_framed, self.take_frames()))

    def take(self, frame: Frame) -> None:
        """Obey a function; the board has no CAN dialect of its own here."""
        data = frame.payload
        if frame.id == 0x50 and len(data) == 2:
            self._answer(data[0])
        elif frame.id == 0x0F and data == b"\x5f":
            self._stop(is_braking=True)
        elif self._is_off:
            return  # a board that has switched itself off does nothing else any more
        elif frame.id == 0x12 and len(data) == 7:
            self._move(*struct.unpack("<3h", data[1:]))
        elif frame.id == 0x01 and len(data) == 2:
            self._is_reporting = data[0] != 0

    def receive(self, frame: Frame) -> None:
        """The board is on a serial line."""

    def _answer(self, function: int) -> None:
        answers = {0x51: bytes(self.version), 0x15: bytes([self.car_number, 0])}
        if function in answers:
            self.say(Frame(function, answers[function]))

    def _move(self, x_mm_s: int, y_mm_s: int, turn_mrad_s: int) -> None:
        if x_mm_s == 0 and y_mm_s == 0 and turn_mrad_s == 0:
            self._stop(is_braking=True)
            return
        turn = turn_mrad_s / 1000.0 * self._lever_mm
        limit = self._limit_mm_s
        wanted = (x_mm_s - y_mm_s - turn, x_mm_s + y_mm_s + turn, x_mm_s - y_mm_s + turn, x_mm_s + y_mm_s - turn)
        self._targets_mm_s = tuple(min(max(int(speed), -limit), limit) for speed in wanted)

    def _stop(self, *, is_braking: bool) -> None:
        self._targets_mm_s = None
        self._is_braking = is_braking
        for loop in self._loops:
            loop.reset()

    def tick(self) -> FourWheels | None:
        self._receive_bytes()
        if self.ticks % 10 == 0:
            self._measure()
        if self.ticks % 100 == 0 and not self._is_off:
            self._check_battery()
        if self._is_reporting and not self._is_off:
            self._report(self.ticks % _REPORT_TICKS)
        speeds = [shaft.speed_rad_s for shaft in self.shafts]
        if self._targets_mm_s is not None:
            targets = [speed / self._radius_mm for speed in self._targets_mm_s]
            a, b, c, d = (loop.torque(*pair) for loop, *pair in zip(self._loops, targets, speeds, strict=True))
            return a, b, c, d
        if self._is_braking:
            # Windings that are shorted: the motor's own voltage drives the current that brakes it.
            constant, resistance = self.values["torque_constant_n_m_a"], self.values["motor_resistance_ohm"]
            limit = self.values["torque_limit_n_m"]
            a, b, c, d = (min(max(-(constant**2) / resistance * speed, -limit), limit) for speed in speeds)
            return a, b, c, d
        return None

    def _receive_bytes(self) -> None:
        self._credit += _BYTES_PER_TICK
        count = min(int(self._credit), len(self._line))
        self._credit = min(self._credit - count, 1.0)
        for byte in bytes(self._line[:count]):
            self._receiver.take(byte)
        del self._line[:count]
        found = self._receiver.look()
        if found is not None:
            self.take(Frame(*found))

    def _measure(self) -> None:
        """Speeds from the counts of 10 ms: one count is 15 mm/s on an X3."""
        counts = tuple(math.floor(shaft.position_rad / math.tau * self._counts_per_turn) for shaft in self.shafts)
        per_count = 100.0 * math.tau * self._radius_mm / self._counts_per_turn
        a, b, c, d = (per_count * (now - before) for now, before in zip(counts, self._counts, strict=True))
        self._speeds_mm_s = (a, b, c, d)
        fl, fr, rr, rl = counts
        self._counts = (fl, fr, rr, rl)

    def _check_battery(self) -> None:
        low, high = self._battery_v_limits
        self._bad_checks = 0 if low < self.battery_v < high else self._bad_checks + 1
        if self._bad_checks > _BATTERY_CHECKS:
            self._is_off = True
            self._stop(is_braking=False)

    def _report(self, phase: int) -> None:
        fl, fr, rr, rl = self._speeds_mm_s
        if phase == 1:
            x = (fl + rl + fr + rr) / 4
            y = -(fl - rl - fr + rr) / 4
            turn = -(fl + rl - fr - rr) / 4 / self._lever_mm * 1000
            self.say(Frame(0x0A, struct.pack("<3hB", int(x), int(y), int(turn), min(int(self.battery_v * 10), 255))))
        elif phase == 11:
            rates = [_int16(rate * 1000) for rate in self.gyro_rad_s]
            forces = [_int16(force * 1000) for force in self.acceleration_m_s2]
            self.say(Frame(0x0E, struct.pack("<9h", *rates, *forces, 0, 0, 0)))
        elif phase == 31:
            front_left, front_right, rear_right, rear_left = (count & 0xFFFF_FFFF for count in self._counts)
            self.say(Frame(0x0D, struct.pack("<4I", front_left, rear_left, front_right, rear_right)))


def _int16(value: float) -> int:
    return min(max(int(value), -32768), 32767)


def _framed(frame: Frame) -> bytes:
    body = bytes([len(frame.payload) + 3, frame.id]) + frame.payload
    return b"\xff\xfb" + body + bytes([sum(body) % 256])


EMULATED = EmulatedRosmaster
