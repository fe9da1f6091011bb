"""A Yahboom Rosmaster board, after its firmware 3.5: one receive buffer, loops of four wheels, four reports in turn.

Bytes arrive at 115200 baud in one buffer, which is read once per millisecond. So frames without a pause between them
destroy each other, as on the board. Commands do not expire. The speed loops are those of the other emulated
controllers and run at 1 kHz; the board's run at 100 Hz on the counts of 10 ms. The reports use the counts of 10 ms.

Emulated are the functions that drive, stop, report, configure and answer. Functions that only affect lamps, the beeper
or servos are ignored.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import replace

from firmware_protocol.framing import Frame
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import FourWheels
from hil.drivers.emulated import EmulatedMotors, int16
from hil.drivers.port import clamp, four
from hil.drivers.rosmaster.board import CARS, Settings

_BYTES_PER_TICK = 115200 / 10 / 1000
_BUFFER = 50
_HEAD = b"\xff\xfc"
_HOST_BUFFER = 4096  # bytes that a serial driver accepts before a writer has to wait; here further bytes are lost
_REPORT_TICKS = 40
_BATTERY_CHECKS = 20
_TICK_S = 0.001
_SAVE = 0x5F  # follows settings that are to be stored, and confirms functions that must not happen by mistake
_MAX_PERCENT, _DEAD_PULSE, _MAX_PULSE = 100, 2000, 3600  # of the motors' voltage; pulses begin beyond the dead zone
_PID = (800, 60, 500)  # default kp, ki, kd of the wheels, in thousandths
_SPIN = 5  # mrad/s of a turn for each mm/s
_DIRECTIONS = {1: (1, 0, 0), 2: (-1, 0, 0), 3: (0, 1, 0), 4: (0, -1, 0), 5: (0, 0, _SPIN), 6: (0, 0, -_SPIN)}
_STOP, _BRAKE = 0, 7  # the other states of FUNC_CAR_RUN


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
        self._set_car(CARS[self.settings.car].number)
        self._line = bytearray()
        self._credit = 0.0
        self._receiver = _Receiver()
        self._targets_mm_s: tuple[float, ...] | None = None  # None while no speed loop runs
        self._percents: list[int] | None = None  # of the motors' voltages; None if they are released
        self._pid = _PID
        self._yaw_rad = 0.0
        self._is_reporting = True
        self._is_off = False
        self._bad_checks = 0
        self._speeds_mm_s = (0.0, 0.0, 0.0, 0.0)

    @property
    def is_driving(self) -> bool:
        return self._targets_mm_s is not None or any(self._percents or ())

    def _set_car(self, number: int) -> None:
        """Take the geometry of a car; another number than those of CARS changes nothing."""
        for name, car in CARS.items():
            if car.number == number:
                self.car_number = number
                self._car = replace(self.settings, car=name).geometry
                self._counts = self._read_counts()

    def feed(self, data: bytes) -> None:
        self._line += data[: _HOST_BUFFER - len(self._line)]

    def take_bytes(self) -> bytes:
        return b"".join(map(_framed, self.take_frames()))

    def execute(self, frame: Frame) -> None:
        """Execute one function of the serial protocol."""
        data = frame.payload
        if frame.id == 0x50 and len(data) == 2:
            self._answer(data[0], data[1])
        elif frame.id == 0x0F and data == bytes((_SAVE,)):
            self._stop(is_braking=True)
        elif frame.id == 0xA0 and data == bytes((_SAVE,)):
            self._reset()
        elif self._is_off:
            return  # a board that has switched its motors off ignores the rest
        elif frame.id == 0x12 and len(data) == 7:
            self._move(*struct.unpack("<3h", data[1:]))
        elif frame.id == 0x01 and len(data) == 2:
            self._is_reporting = data[0] != 0
        elif frame.id == 0x10 and len(data) == 4:
            self._set_voltages(struct.unpack("<4b", data))
        elif frame.id == 0x11 and len(data) == 4:
            self._run(*struct.unpack("<BH", data[1:]))
        elif frame.id == 0x13 and len(data) == 7:
            self._set_pid(*struct.unpack("<3H", data[:6]))
        elif frame.id == 0x15 and len(data) == 2:
            self._set_car(data[0])

    def receive(self, frame: Frame) -> None:
        """Ignore CAN frames: the board is on a serial line."""

    def _answer(self, function: int, parameter: int) -> None:
        answers = {0x51: bytes(self.version), 0x15: bytes([self.car_number, 0])}
        if 1 <= parameter <= 4:  # a motor; all have the same
            answers[0x13] = struct.pack("<B3H", parameter, *self._pid)
        if function in answers:
            self.send(Frame(function, answers[function]))

    def _move(self, x_mm_s: int, y_mm_s: int, turn_mrad_s: int) -> None:
        if any((x_mm_s, y_mm_s, turn_mrad_s)):
            self._go(x_mm_s, y_mm_s, turn_mrad_s)
        else:
            self._stop(is_braking=True)

    def _go(self, x_mm_s: int, y_mm_s: int, turn_mrad_s: int) -> None:
        self._percents = None
        rims = wheel_speeds((x_mm_s, y_mm_s, turn_mrad_s / 1000.0), 1.0, self._car.lever_m * 1000.0)
        self._targets_mm_s = tuple(clamp(int(speed), self._limit_mm_s) for speed in rims)

    @property
    def _limit_mm_s(self) -> int:
        return round(self._car.rim_limit_m_s * 1000.0)

    def _run(self, state: int, speed_cm_s: int) -> None:
        """Drive in one direction (FUNC_CAR_RUN). In 16-bit arithmetic a negative speed drives the opposite way."""
        speed = speed_cm_s * 10 % 65536
        if self.car_number == CARS["x3_plus"].number:
            speed = min(speed, self._limit_mm_s)
        if state in (_STOP, _BRAKE):
            self._stop(is_braking=state == _BRAKE or speed != 0)
        elif state in _DIRECTIONS:
            x, y, turn = ((sign * speed + 0x8000) % 65536 - 0x8000 for sign in _DIRECTIONS[state])
            self._go(x, y, turn)

    def _set_voltages(self, percents: Sequence[int]) -> None:
        """Drive M1 to M4 without speed loops; ignored while the loops have targets.

        A value beyond ±100 leaves its motor unchanged.
        """
        if self._targets_mm_s is not None:
            return
        m1, m2, m3, m4 = percents
        wheels = zip((m1, m3, m4, m2), self._percents or [0, 0, 0, 0], strict=True)
        self._percents = [percent if abs(percent) <= _MAX_PERCENT else before for percent, before in wheels]

    def _set_pid(self, kp: int, ki: int, kd: int) -> None:
        """Set the gains: those of the emulated loops change by the same factors. kd is stored but has no effect."""
        self._pid = (kp, ki, kd)
        gains = self.values["speed_kp_n_m_s_rad"] * kp / _PID[0], self.values["speed_ki_n_m_rad"] * ki / _PID[1]
        for loop in self.loops:
            loop.gains = gains

    def _reset(self) -> None:
        self._stop(is_braking=False)
        self._set_pid(*_PID)
        self._is_reporting, self._is_off, self._bad_checks = True, False, 0

    def _stop(self, *, is_braking: bool) -> None:
        self._targets_mm_s = None
        self._percents = [0, 0, 0, 0] if is_braking else None
        self.reset_loops()

    def tick(self) -> FourWheels | None:
        self._receive_bytes()
        self._yaw_rad = math.remainder(self._yaw_rad + self.gyro_rad_s[2] * _TICK_S, math.tau)
        if self.ticks % 10 == 0:
            self._measure()
        if self.ticks % 100 == 0 and not self._is_off:
            self._check_battery()
        if self._is_reporting and not self._is_off:
            self._report(self.ticks % _REPORT_TICKS)
        if self._targets_mm_s is not None:
            targets = [speed / 1000.0 / self._car.wheel_radius_m for speed in self._targets_mm_s]
            return self.follow(four(targets))
        if self._percents is None:
            return None
        return four(map(self._torque_of, self._percents, self.speeds_rad_s))

    def _torque_of(self, percent: int, speed_rad_s: float) -> float:
        """Return the torque [N·m] of a motor at a commanded voltage, whose pulses begin beyond the dead zone.

        At 0 its windings are shorted: its back-EMF drives the current that brakes it.
        """
        per_percent = (_MAX_PULSE - _DEAD_PULSE) / _MAX_PERCENT
        pulse = math.copysign(_DEAD_PULSE, percent) + percent * per_percent if percent else 0.0
        constant, resistance = self.values["torque_constant_n_m_a"], self.values["motor_resistance_ohm"]
        volts = pulse / _MAX_PULSE * self.battery_v - constant * speed_rad_s
        return clamp(constant * volts / resistance, self.values["torque_limit_n_m"])

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
            self.send(Frame(0x0A, struct.pack("<3hB", int16(x), int16(y), int16(turn * 1000), volts)))
        elif phase == 11:
            values = [*self.gyro_rad_s, *self.acceleration_m_s2]
            self.send(Frame(0x0E, struct.pack("<9h", *(int16(value * 1000) for value in values), 0, 0, 0)))
        elif phase == 21:
            x, y, z = self.acceleration_m_s2
            angles = math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), self._yaw_rad
            self.send(Frame(0x0C, struct.pack("<3h", *(int16(angle * 10000) for angle in angles))))
        elif phase == 31:
            fl, fr, rr, rl = (count & 0xFFFF_FFFF for count in self._counts)
            self.send(Frame(0x0D, struct.pack("<4I", fl, rl, fr, rr)))


def _framed(frame: Frame) -> bytes:
    body = bytes([len(frame.payload) + 3, frame.id]) + frame.payload
    return b"\xff\xfb" + body + bytes([sum(body) % 256])
