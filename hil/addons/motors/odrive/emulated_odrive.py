"""Four emulated ODrive axes of CANSimple: firmware 0.5.6 after its published source, 0.6.10 after its documents.

Firmware 0.5: any frame to an axis feeds its watchdog, which also runs while the axis is idle; axis, motor, encoder and
controller have error registers of their own. Firmware 0.6: it has a version, endpoints, procedure results, one register
of active errors, and one with the reason of the last disarming. It is assumed, neither documented nor measured, that
only inputs feed the watchdog of 0.6, and that it runs only in closed loop.

The control modes are torque and velocity, the input mode is PASSTHROUGH. In any other mode an axis disarms itself with
the error of a wrong configuration. Other commands than those of the driver are ignored.
"""

import math
import struct
from collections.abc import Mapping

from firmware_protocol.framing import Frame
from hil.addons.motors.emulated_motors import EmulatedMotors, Shaft, SpeedLoop
from hil.addons.motors.odrive.odrive_driver import Settings
from hil.core.types import FourWheels
from hil.robot.driver import REMOTE, clamp, four

_STANDARD = 0x7FF
_IDLE, _CLOSED_LOOP = 1, 8
_TORQUE, _VELOCITY, _PASSTHROUGH = 1, 2, 1
_SUCCESS, _DISARMED, _NOT_CALIBRATED = 0, 3, 14
_WATCHDOG, _ESTOP, _INVALID_STATE, _BAD_MODE = "watchdog", "estop", "invalid state", "bad mode"
_BITS: Mapping[int, Mapping[str, int]] = {
    5: {_WATCHDOG: 0x800, _ESTOP: 0x4000, _INVALID_STATE: 0x1, _BAD_MODE: 0x200},
    6: {_WATCHDOG: 0x0100_0000, _ESTOP: 0x0200_0000, _BAD_MODE: 0x10},
}
_INVALID_INPUT_MODE = 0x2  # controller error of 0.5, beside the axis error of a bad mode
_INPUTS = (0x0D, 0x0E)
_MIN_BYTES: Mapping[int, int] = {0x04: 4, 0x07: 4, 0x0B: 8, 0x0D: 4, 0x0E: 4}  # of a command; shorter ones are ignored


class EmulatedAxis:
    """One axis. A test sets errors with ``fail``, and ``is_calibrated``.

    ``enable_watchdog`` and ``watchdog_timeout_s`` are what odrivetool sets over USB; by default there is no watchdog.
    There is no limit of speed, as ODRIVE.md requires a high one. ``loop`` and ``limit_n_m`` are at the wheel; ``gear``:
    motor turns per turn of the wheel.
    """

    def __init__(self, loop: SpeedLoop, gear: float, limit_n_m: float) -> None:
        self._loop, self._gear, self._limit_n_m = loop, gear, limit_n_m
        self.firmware = 6  # or 5
        self.is_calibrated = True
        self.enable_watchdog = False
        self.watchdog_timeout_s = 0.0
        self.fed_tick = 0
        self.state, self.result = _IDLE, _SUCCESS
        self.control_mode, self.input_mode = 0, _PASSTHROUGH
        self.input_vel_rev_s = self.input_torque_n_m = 0.0
        self.axis_error = self.disarm_reason = 0  # of 0.6: the active errors
        self.motor_error = self.encoder_error = self.controller_error = 0

    # Errors

    def fail(self, axis: int = 0, *, motor: int = 0, encoder: int = 0, controller: int = 0) -> None:
        """Set error bits, and disarm the axis if it is in closed loop."""
        self.axis_error |= axis
        self.motor_error |= motor
        self.encoder_error |= encoder
        self.controller_error |= controller
        if self.state == _CLOSED_LOOP:
            self.disarm_reason = axis
            self.state, self.result = _IDLE, _DISARMED

    def fail_by(self, reason: str) -> None:
        """Set the error bits that this firmware has for a reason."""
        is_input_mode = self.firmware == 5 and reason == _BAD_MODE
        self.fail(_BITS[self.firmware][reason], controller=_INVALID_INPUT_MODE if is_input_mode else 0)

    @property
    def has_errors(self) -> bool:
        return bool(self.axis_error or self.motor_error or self.encoder_error or self.controller_error)

    def clear(self) -> None:
        self.axis_error = self.disarm_reason = self.motor_error = self.encoder_error = self.controller_error = 0

    # Commands

    def request(self, state: int, tick: int) -> None:
        """Enter idle, or closed loop if the axis is calibrated and has no errors."""
        if self.firmware == 5:
            self.axis_error &= ~_BITS[5][_INVALID_STATE]  # a new request clears this error
        if state == _IDLE:
            self.state, self.result = _IDLE, _SUCCESS
        elif state == _CLOSED_LOOP and not self.is_calibrated:
            self.result = _NOT_CALIBRATED
            if self.firmware == 5:
                self.fail_by(_INVALID_STATE)
        elif state == _CLOSED_LOOP and not self.has_errors:
            self.state, self.result = _CLOSED_LOOP, _SUCCESS
            self.fed_tick = tick
            self._loop.reset()

    def watch(self, tick: int) -> None:
        """Fail with the error of the watchdog if it has expired."""
        runs = self.enable_watchdog and (self.firmware == 5 or self.state == _CLOSED_LOOP)
        if runs and tick - self.fed_tick > self.watchdog_timeout_s * 1000.0:
            self.fail_by(_WATCHDOG)

    # Control

    def revolutions(self, wheel_rad: float) -> float:
        """Return the motor's turns for an angle of the wheel."""
        return wheel_rad / math.tau * self._gear

    def torque(self, shaft: Shaft) -> float:
        """Return the torque at the wheel [N·m], within the limit."""
        if self.state != _CLOSED_LOOP:
            return 0.0
        if self.control_mode not in (_TORQUE, _VELOCITY) or self.input_mode != _PASSTHROUGH:
            self.fail_by(_BAD_MODE)
            return 0.0
        torque = self.input_torque_n_m * self._gear
        if self.control_mode == _VELOCITY:
            target_rad_s = self.input_vel_rev_s / self._gear * math.tau
            torque = self._loop.torque(target_rad_s, shaft.speed_rad_s, torque)
        return clamp(torque, self._limit_n_m)


class EmulatedODrive(EmulatedMotors[Settings]):
    """Emulates four axes. ``firmware`` and ``hardware`` may be changed before the first tick."""

    def power_on(self) -> None:
        settings = self.settings
        firmware = settings.endpoints_firmware or ("0.5.6" if settings.firmware == "0.5" else "0.6.10")
        self.firmware = tuple(map(int, firmware.split(".")))
        self.hardware = tuple(map(int, (settings.endpoints_hardware or "4.4.58").split(".")))
        self._timeout_id, self._enable_id = settings.watchdog_endpoints or (419, 420)
        self._estimates_ticks = round(1000.0 / settings.feedback_hz) if settings.feedback_hz else 0
        limit = self.values["torque_limit_n_m"]
        self.axes = [EmulatedAxis(loop, settings.gear_ratio, limit) for loop in self.loops]

    @property
    def is_driving(self) -> bool:
        return any(axis.state == _CLOSED_LOOP for axis in self.axes)

    # Commands

    def receive(self, frame: Frame) -> None:
        is_remote, number = bool(frame.id & REMOTE), frame.id & ~REMOTE
        if number > _STANDARD or number >> 5 not in self.settings.node_ids:
            return
        channel, command = self.settings.node_ids.index(number >> 5), number & 0x1F
        axis = self.axes[channel]
        axis.firmware = self.firmware[1]
        if axis.firmware == 5 or (command in _INPUTS and not is_remote):
            axis.fed_tick = self.ticks
        if is_remote:
            self._answer(channel, command)
        elif len(frame.payload) >= _MIN_BYTES.get(command, 0):
            self._command(channel, command, frame.payload.ljust(8, b"\0"))

    def _command(self, channel: int, command: int, payload: bytes) -> None:
        axis = self.axes[channel]
        first, second = struct.unpack("<II", payload)
        values = struct.unpack("<ff", payload)
        if command == 0x02:
            axis.fail_by(_ESTOP)
        elif command == 0x04 and axis.firmware >= 6:
            self._parameter(channel, payload)
        elif command == 0x07:
            axis.request(first, self.ticks)
        elif command == 0x0B:
            axis.control_mode, axis.input_mode = first, second
        elif command == 0x0D and all(map(math.isfinite, values)):
            axis.input_vel_rev_s, axis.input_torque_n_m = values
        elif command == 0x0E and math.isfinite(values[0]):
            axis.input_torque_n_m = values[0]
        elif command == 0x18:
            axis.clear()

    def _parameter(self, channel: int, payload: bytes) -> None:
        operation, number = struct.unpack_from("<BH", payload)
        parameters = {self._timeout_id: ("watchdog_timeout_s", "<f"), self._enable_id: ("enable_watchdog", "<?")}
        if number not in parameters:
            return
        name, layout = parameters[number]
        axis = self.axes[channel]
        if operation == 1:
            setattr(axis, name, struct.unpack_from(layout, payload, 4)[0])
            if self.firmware < (0, 6, 11):
                return
        self._say(channel, 0x05, struct.pack("<BHB", 0, number, 0) + struct.pack(layout, getattr(axis, name)))

    # Answers and cyclic messages

    def _say(self, channel: int, command: int, payload: bytes) -> None:
        self.send(Frame(self.settings.node_ids[channel] << 5 | command, payload))

    def _answer(self, channel: int, command: int) -> None:
        axis, shaft, current_a = self.axes[channel], self.shafts[channel], self.current_a[channel]
        is_old = axis.firmware == 5
        floats = struct.Struct("<ff").pack
        answers = {
            0x09: self._estimates(channel),
            0x14: floats(current_a, current_a),
            0x17: floats(self.battery_v, self.battery_a / (2 if is_old else 4)),
        }
        if is_old:
            answers |= {0x03: struct.pack("<Q", axis.motor_error), 0x04: struct.pack("<II", axis.encoder_error, 0)}
            if self.firmware >= (0, 5, 4):
                answers[0x1D] = struct.pack("<II", axis.controller_error, 0)
        else:
            power_w = self.torque_n_m[channel] * shaft.speed_rad_s
            answers |= {
                0x00: bytes((2, *self.hardware, *self.firmware, 0)),
                0x03: struct.pack("<II", axis.axis_error, axis.disarm_reason),
                0x15: floats(self.temperature_degc[channel], math.nan),
                0x1D: floats(self.battery_v * self.battery_a / 4.0, power_w),
            }
        if command in answers:
            self._say(channel, command, answers[command])

    def _heartbeat(self, axis: EmulatedAxis) -> bytes:
        """Return the heartbeat; its trajectory is always done."""
        if axis.firmware == 5:
            flags = (bool(axis.motor_error), bool(axis.encoder_error), bool(axis.controller_error) | 0x80)
            return struct.pack("<IBBBB", axis.axis_error, axis.state, *flags)
        return struct.pack("<IBBBx", axis.axis_error | axis.disarm_reason, axis.state, axis.result, True)

    def _estimates(self, channel: int) -> bytes:
        axis, shaft = self.axes[channel], self.shafts[channel]
        return struct.pack("<ff", axis.revolutions(shaft.position_rad), axis.revolutions(shaft.speed_rad_s))

    # Loops

    def tick(self) -> FourWheels | None:
        for channel, axis in enumerate(self.axes):
            axis.firmware = self.firmware[1]
            axis.watch(self.ticks)
            if self.ticks % 100 == 0:
                self._say(channel, 0x01, self._heartbeat(axis))
            if self._estimates_ticks and self.ticks % self._estimates_ticks == 0:
                self._say(channel, 0x09, self._estimates(channel))
        if not self.is_driving:
            return None
        return four(axis.torque(shaft) for axis, shaft in zip(self.axes, self.shafts, strict=True))
