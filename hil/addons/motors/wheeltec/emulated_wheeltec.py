"""A WHEELTEC base with a C50X board, after its firmware: control at 100 Hz, ramped targets, reports at 20 Hz.

It starts after the 12 s in which a real base ignores commands and drives to test itself. Its speed loops are those of
the other emulated controllers and run at 1 kHz; the board's run at 100 Hz. Charging, remote controls and the parking
mode are not emulated.
"""

from struct import Struct

from firmware_protocol.framing import Frame
from hil.addons.motors.emulated_motors import EmulatedMotors, int16
from hil.addons.motors.wheeltec.wheeltec_driver import COMMAND, HEAD, REPORTS, TAIL, Settings, checksum
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import FourWheels
from hil.robot.driver import clamp, four

_CONTROL_TICKS, _REPORT_TICKS = 10, 50
_STEP = 0.02  # m/s or rad/s in 10 ms
_SILENT_STEPS = 100  # control steps without a command, after which the board stops
_COMMAND = Struct(">3h")
_REPORT = Struct(">BB9hH")


class EmulatedWheeltec(EmulatedMotors[Settings]):
    """Emulates the base. ``is_switched_off`` is its emergency stop button, which a test presses and releases."""

    def power_on(self) -> None:
        settings = self.settings
        self.is_switched_off = False
        self._received = bytearray()
        self._targets = [0.0, 0.0, 0.0]
        self._ramped = [0.0, 0.0, 0.0]
        self._steps_without_command = 0
        self._is_off = False
        self._radius_m = settings.wheel_radius_m or self.values["wheel_radius_m"]
        self._lever_m = settings.lever_m or self.values["half_length_m"] + self.values["half_width_m"]

    @property
    def is_driving(self) -> bool:
        return any(self._targets) or any(self._ramped)

    def feed(self, data: bytes) -> None:
        """Take eleven bytes from the first 7B on, as the board's interrupt does, also where that 7B is no head."""
        for byte in data:
            if self._received or byte == HEAD:
                self._received.append(byte)
            if len(self._received) == 11:
                whole = bytes(self._received)
                self._received.clear()
                if whole[10] == TAIL and whole[9] == checksum(whole[:9]) and whole[1] == 0:
                    self._obey(whole[3:9])

    def receive(self, frame: Frame) -> None:
        if frame.id == COMMAND and len(frame.payload) == 8:
            self._obey(frame.payload[:6])

    def take_bytes(self) -> bytes:
        return b"".join(frame.payload for frame in self.take_frames())

    def _obey(self, numbers: bytes) -> None:
        self._steps_without_command = 0
        self._targets = [number / 1000 for number in _COMMAND.unpack(numbers)]

    def tick(self) -> FourWheels | None:
        if self.ticks % _CONTROL_TICKS == 0:
            self._control()
        if self.ticks % _REPORT_TICKS == 0:
            self._report()
        if self._is_off:
            return None
        x, y, turn = self._ramped
        limit = self.settings.speed_limit_m_s
        rims = wheel_speeds((x, y, turn), 1.0, self._lever_m)
        return self.follow(four(clamp(rim, limit) / self._radius_m for rim in rims))

    def _control(self) -> None:
        self._steps_without_command += 1
        if self.settings.stops_on_silence and self._steps_without_command > _SILENT_STEPS:
            self._targets = [0.0, 0.0, 0.0]
        limit = self.settings.speed_limit_m_s
        for axis, target in enumerate(self._targets):
            self._ramped[axis] += clamp(clamp(target, limit) - self._ramped[axis], _STEP)
        was_off, self._is_off = self._is_off, self.is_switched_off or self.battery_v < self.settings.battery_low_v
        if self._is_off:
            self.reset_loops()
        elif was_off:
            self._targets, self._ramped = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]

    def _report(self) -> None:
        twist = body_twist(self.speeds_rad_s, self._radius_m, self._lever_m)
        rates = (*self.gyro_rad_s[:2], 0.0 if self._is_off else self.gyro_rad_s[2])
        numbers = [speed * 1000 for speed in twist]
        numbers += [force / 19.6 * 32768 for force in self.acceleration_m_s2]
        numbers += [rate * 57.30 * 65.5 for rate in rates]
        volts = clamp(int(self.battery_v * 1000), 65535, 0)
        body = _REPORT.pack(HEAD, self._is_off, *map(int16, numbers), volts)
        whole = body + bytes([checksum(body), TAIL])
        for i, number in enumerate(REPORTS):
            self.send(Frame(number, whole[8 * i : 8 * i + 8]))
