"""A Yahboom Rosmaster board, after its firmware 3.5: one receive buffer, loops of four wheels, four reports in turn.

Bytes arrive at 115200 baud in one buffer, which is read once per millisecond. So frames without a pause between them
destroy each other, as on the board. Commands do not expire. The speed loops are those of the other emulated
controllers and run at 1 kHz; the board's run at 100 Hz on the counts of 10 ms. The reports use the counts of 10 ms.

Emulated are the motion of the body, the stop, the reports, and the answers to version and car. Every other function is
ignored.
"""

import math
import struct

from firmware_protocol.framing import Frame
from hil.addons.motors.emulated_motors import EmulatedMotors, int16
from hil.addons.motors.rosmaster import rosmaster_driver as driver
from hil.addons.motors.rosmaster.rosmaster_driver import CARS, Settings
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import FourWheels
from hil.robot.driver import clamp, four

_BYTES_PER_TICK = 115200 / 10 / 1000
_BUFFER = 50
_HEAD = b"\xff\xfc"
_HOST_BUFFER = 4096  # bytes that a serial driver accepts before a writer has to wait; here further bytes are lost
_REPORT_TICKS = 40
_BATTERY_CHECKS = 20
_TICK_S = 0.001
_CONFIRM = 0x5F  # protects a function from mistakes
_ATTITUDE_REPORT = 0x0C


class _Receiver:
    """The board's receive interrupt: writes bytes into the one buffer, over whatever it still holds."""

    def __init__(self) -> None:
        self._buffer = bytearray(_BUFFER)
        self._step = 0
        self._at = 0
        self._length = 0
        self._is_new = False

    def take(self, byte: int) -> None:
        if self._step < 2:
            self._step = self._step + 1 if byte == _HEAD[self._step] else 0
        elif self._step == 2 and byte + 2 >= _BUFFER:
            self._step = 0
        elif self._step == 2:
            self._length = byte + 2
            self._buffer[2] = byte
            self._at = self._step = 3
        else:
            self._buffer[self._at] = byte
            self._at += 1
            if self._at >= self._length:
                self._is_new = True
                self._step = 0

    def look(self) -> tuple[int, bytes] | None:
        """Return function and data of a new frame in the buffer; None without a new one, or for a wrong checksum."""
        if not self._is_new:
            return None
        found = bytes(self._buffer[2 : self._length])
        self._is_new = False
        self._length = 0
        return (found[1], found[2:-1]) if len(found) >= 3 and sum(found[:-1]) % 256 == found[-1] else None


class EmulatedRosmaster(EmulatedMotors[Settings]):
    """Emulates the board. ``version`` and ``car_number`` are what it answers when asked for them."""

    def power_on(self) -> None:
        self.version = (3, 5)
        self._car = CARS[self.settings.car]
        self.car_number = self._car.number
        self._counts = self._read_counts()
        self._line = bytearray()
        self._credit = 0.0
        self._receiver = _Receiver()
        self._targets_mm_s: tuple[float, ...] | None = None  # None while no speed loop runs
        self._is_braking = False  # whether their windings are shorted
        self._yaw_rad = 0.0
        self._is_off = False
        self._bad_checks = 0
        self._speeds_mm_s = (0.0, 0.0, 0.0, 0.0)

    @property
    def is_driving(self) -> bool:
        return self._targets_mm_s is not None

    def feed(self, data: bytes) -> None:
        self._line += data[: _HOST_BUFFER - len(self._line)]

    def take_bytes(self) -> bytes:
        return b"".join(map(_framed, self.take_frames()))

    def execute(self, frame: Frame) -> None:
        """Execute one function of the serial protocol."""
        data = frame.payload
        if frame.id == driver.REQUEST and len(data) == 2:
            self._answer(data[0])
        elif frame.id == driver.RESET_STATE and data == bytes((_CONFIRM,)):
            self._stop(is_braking=True)
        elif self._is_off:
            return  # a board that has switched its motors off ignores the rest
        elif frame.id == driver.MOTION and len(data) == 7:
            self._move(*struct.unpack("<3h", data[1:]))

    def receive(self, frame: Frame) -> None:
        """Ignore CAN frames: the board is on a serial line."""

    def _answer(self, function: int) -> None:
        answers = {driver.VERSION: bytes(self.version), driver.CAR_TYPE: bytes([self.car_number, 0])}
        if function in answers:
            self.send(Frame(function, answers[function]))

    def _move(self, x_mm_s: int, y_mm_s: int, turn_mrad_s: int) -> None:
        if not any((x_mm_s, y_mm_s, turn_mrad_s)):
            self._stop(is_braking=True)
            return
        rims = wheel_speeds((x_mm_s, y_mm_s, turn_mrad_s / 1000.0), 1.0, self._car.lever_m * 1000.0)
        limit_mm_s = round(self._car.rim_limit_m_s * 1000.0)
        self._targets_mm_s = tuple(clamp(int(speed), limit_mm_s) for speed in rims)

    def _stop(self, *, is_braking: bool) -> None:
        self._targets_mm_s = None
        self._is_braking = is_braking
        self.reset_loops()

    def tick(self) -> FourWheels | None:
        self._receive_bytes()
        self._yaw_rad = math.remainder(self._yaw_rad + self.gyro_rad_s[2] * _TICK_S, math.tau)
        if self.ticks % 10 == 0:
            self._measure()
        if self.ticks % 100 == 0 and not self._is_off:
            self._check_battery()
        if not self._is_off:
            self._report(self.ticks % _REPORT_TICKS)
        if self._targets_mm_s is not None:
            targets = [speed / 1000.0 / self._car.wheel_radius_m for speed in self._targets_mm_s]
            return self.follow(four(targets))
        return four(map(self._braking_torque, self.speeds_rad_s)) if self._is_braking else None

    def _braking_torque(self, speed_rad_s: float) -> float:
        """Return the torque [N·m] of a motor with shorted windings: its back-EMF drives the current that brakes it."""
        constant, resistance = self.values["torque_constant_n_m_a"], self.values["motor_resistance_ohm"]
        return clamp(constant * (0.0 - constant * speed_rad_s) / resistance, self.values["torque_limit_n_m"])

    def _receive_bytes(self) -> None:
        self._credit += _BYTES_PER_TICK
        count = min(int(self._credit), len(self._line))
        self._credit = min(self._credit - count, 1.0)
        for byte in self._line[:count]:
            self._receiver.take(byte)
        del self._line[:count]
        if (found := self._receiver.look()) is not None:
            self.execute(Frame(*found))

    def _measure(self) -> None:
        """Compute the speeds from the counts of 10 ms; one count is 15 mm/s on an X3."""
        before, self._counts = self._counts, self._read_counts()
        per_count = 100.0 * math.tau * self._car.wheel_radius_m * 1000.0 / self._car.counts_per_turn
        self._speeds_mm_s = four(per_count * (now - then) for now, then in zip(self._counts, before, strict=True))

    def _read_counts(self) -> tuple[int, int, int, int]:
        per_turn = self._car.counts_per_turn
        return four(math.floor(shaft.position_rad / math.tau * per_turn) for shaft in self.shafts)

    def _check_battery(self) -> None:
        is_good = self.settings.battery_low_v < self.battery_v < self.settings.battery_high_v
        self._bad_checks = 0 if is_good else self._bad_checks + 1
        if self._bad_checks > _BATTERY_CHECKS:
            self._is_off = True
            self._stop(is_braking=False)

    def _report(self, phase: int) -> None:
        if phase == 1:
            x, y, turn = body_twist(self._speeds_mm_s, 1.0, self._car.lever_m * 1000.0)
            volts = clamp(int(self.battery_v * 10), 255, 0)
            self.send(Frame(driver.TWIST_REPORT, struct.pack("<3hB", int16(x), int16(y), int16(turn * 1000), volts)))
        elif phase == 11:
            values = [*self.gyro_rad_s, *self.acceleration_m_s2]
            self.send(Frame(driver.ICM_REPORT, struct.pack("<9h", *(int16(value * 1000) for value in values), 0, 0, 0)))
        elif phase == 21:
            x, y, z = self.acceleration_m_s2
            angles = math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), self._yaw_rad
            self.send(Frame(_ATTITUDE_REPORT, struct.pack("<3h", *(int16(angle * 10000) for angle in angles))))
        elif phase == 31:
            fl, fr, rr, rl = (count & 0xFFFF_FFFF for count in self._counts)
            self.send(Frame(driver.ENCODER_REPORT, struct.pack("<4I", fl, rl, fr, rr)))


def _framed(frame: Frame) -> bytes:
    body = bytes([len(frame.payload) + 3, frame.id]) + frame.payload
    return b"\xff\xfb" + body + bytes([sum(body) % 256])
