"""Four RoboMaster C620 or C610 as their guide describes them: current loops, and one feedback frame each per ms.

When commands end, the emulated controller keeps its last currents for ever: the worst that a real one might do.
"""

import math
import struct

from firmware_protocol.framing import Frame
from hil.addons.motors.c620.c620_driver import MOTORS, Settings
from hil.addons.motors.emulated_motors import EmulatedMotors, int16
from hil.core.types import FourWheels
from hil.robot.driver import clamp, four


class EmulatedC620(EmulatedMotors[Settings]):
    """Emulates four C620 or C610. A rotor turns ``gear_ratio`` times as fast as its wheel."""

    def power_on(self) -> None:
        settings = self.settings
        self._ids = settings.ids
        self._motor = MOTORS[settings.controller]
        self._gear = settings.gear_ratio or self._motor.gear_ratio
        self._set_point_a = [0.0] * 4
        self._was_commanded = False

    @property
    def is_driving(self) -> bool:
        return any(self._set_point_a)

    def receive(self, frame: Frame) -> None:
        first = {0x200: 1, 0x1FF: 5}.get(frame.id)
        if first is None or len(frame.payload) != 8:
            return
        self._was_commanded = True
        for slot in range(4):
            if first + slot in self._ids:
                (raw,) = struct.unpack_from(">h", frame.payload, 2 * slot)
                limited = clamp(raw, self._motor.max_count)
                self._set_point_a[self._ids.index(first + slot)] = limited * self._motor.amperes

    def tick(self) -> FourWheels | None:
        for channel, number in enumerate(self._ids):
            shaft = self.shafts[channel]
            angle = round(shaft.position_rad / math.tau * self._gear * 8192) % 8192
            rpm = round(shaft.speed_rad_s * self._gear * 60.0 / math.tau)
            raw_current = round(self.current_a[channel] / self._motor.amperes)
            temperature = clamp(round(self.temperature_degc[channel]), 255, 0)
            payload = struct.pack(">HhhBB", angle, int16(rpm), int16(raw_current), temperature, 0)
            self.send(Frame(0x200 + number, payload))
        if not self._was_commanded:
            return None
        constant = self.values["torque_constant_n_m_a"]
        return four(constant * current for current in self._set_point_a)
