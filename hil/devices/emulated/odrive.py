"""Four ODrive axes of CANSimple as their firmware has it: 0.5.6 from its published source, 0.6.10 from its documents.

What differs is done as each does it. 0.5: any frame to an axis feeds its watchdog, which also runs while the axis is
idle; errors are of axis, motor, encoder and controller. 0.6: a version, endpoints, results of procedures, one word of
active errors and the reason of the last disarming. That its watchdog is fed by inputs alone and runs in closed loop
alone is assumed: the makers do not say, and nobody here has measured it.
"""

import math
import struct

from firmware_protocol.framing import Frame
from hil.devices.emulated.motors import EmulatedMotors, SpeedLoop
from hil.dialects.odrive_settings import Settings
from hil.types import FourWheels

_REMOTE, _STANDARD = 0x4000_0000, 0x7FF
_IDLE, _CLOSED_LOOP = 1, 8
_TORQUE, _VELOCITY, _POSITION = 1, 2, 3
_SUCCESS, _DISARMED, _NOT_CALIBRATED = 0, 3, 14
_WATCHDOG, _ESTOP, _INVALID_STATE = "watchdog", "estop", "invalid state"
_BITS = {
    5: {_WATCHDOG: 0x800, _ESTOP: 0x4000, _INVALID_STATE: 0x1},
    6: {_WATCHDOG: 0x0100_0000, _ESTOP: 0x0200_0000},
}
_POSITION_GAIN = 20.0  # of both firmwares, as they come [(rev/s)/rev]


class EmulatedAxis:
    """One axis. Errors are set by ``fail``, as a fault of motor or encoder would; ``is_calibrated`` as it was left.

    ``enable_watchdog`` and ``watchdog_timeout_s`` are what odrivetool sets over USB; as they come there is none.
    """

    def __init__(self, node: int, loop: SpeedLoop) -> None:
        self.node = node
        self.loop = loop
        self.state = _IDLE
        self.result = _SUCCESS
        self.is_calibrated = True
        self.axis_error = 0  # 0.6: the active errors
        self.disarm_reason = 0
        self.motor_error = 0
        self.encoder_error = 0
        self.controller_error = 0
        self.control_mode, self.input_mode = _POSITION, 1
        self.input_vel_rev_s = 0.0
        self.input_torque_n_m = 0.0
        self.hold_rev = 0.0
        self.enable_watchdog = False
        self.watchdog_timeout_s = 0.0
        self.fed_tick = 0

    def fail(self, axis: int = 0, *, motor: int = 0, encoder: int = 0, controller: int = 0) -> None:
        """Set error bits; a motor that is driven is disarmed by them."""
        self.axis_error |= axis
        self.motor_error |= motor
        self.encoder_error |= encoder
        self.controller_error |= controller
        if self.state == _CLOSED_LOOP:
            self.disarm_reason = axis
            self.result = _DISARMED
            self.state = _IDLE

    @property
    def has_errors(self) -> bool:
        return bool(self.axis_error or self.motor_error or self.encoder_error or self.controller_error)

    def clear(self) -> None:
        self.axis_error = self.motor_error = self.encoder_error = self.controller_error = self.disarm_reason = 0


class EmulatedODrive(EmulatedMotors):
    """See ``EmulatedMotors``. ``firmware`` and ``hardware`` may be set to others before the first tick."""

    def __init__(self, settings: Settings, *node: object, **keywords: object) -> None:
        self.firmware = (0, 5, 6) if settings.firmware == "0.5" else (0, 6, 10)
        self.hardware = (4, 4, 58)
        if settings.endpoints_firmware:
            self.firmware = _version(settings.endpoints_firmware)
            self.hardware = _version(settings.endpoints_hardware)
        self._timeout_id, self._enable_id = settings.watchdog_endpoints or (419, 420)
        self._gear = settings.gear_ratio
        self._estimates_ticks = round(1000.0 / settings.feedback_hz) if settings.feedback_hz else 0
        super().__init__(*node, **keywords)  # type: ignore[arg-type]
        self.axes = [EmulatedAxis(node, loop) for node, loop in zip(settings.node_ids, self.speed_loops(), strict=True)]

    @property
    def is_driving(self) -> bool:
        return any(axis.state == _CLOSED_LOOP for axis in self.axes)

    # Commands

    def take(self, frame: Frame) -> None:
        is_remote, number = bool(frame.id & _REMOTE), frame.id & ~_REMOTE
        if number > _STANDARD:
            return
        for channel, axis in enumerate(self.axes):
            if axis.node == number >> 5:
                self._take(channel, axis, number & 0x1F, frame.payload, is_remote)

    def _take(self, channel: int, axis: EmulatedAxis, command: int, payload: bytes, is_remote: bool) -> None:
        if self.firmware[1] == 5 or (command in (0x0C, 0x0D, 0x0E) and not is_remote):
            axis.fed_tick = self.ticks
        if is_remote or (not payload and self.firmware >= (0, 5, 5)):
            self._answer(channel, axis, command)
        if is_remote and self.firmware[1] >= 6:
            return  # 0.5 does not look, and takes a remote frame of a command for one that says zero
        payload = payload.ljust(8, b"\0")
        first, second = struct.unpack_from("<II", payload)
        if command == 0x02:
            axis.fail(_BITS[self.firmware[1]][_ESTOP])
        elif command == 0x04 and self.firmware[1] >= 6:
            self._parameter(axis, payload)
        elif command == 0x07:
            self._request(channel, axis, first)
        elif command == 0x0B:
            axis.control_mode, axis.input_mode = first, second
        elif command == 0x0D:
            axis.input_vel_rev_s, axis.input_torque_n_m = struct.unpack("<ff", payload)
        elif command == 0x0E:
            (axis.input_torque_n_m,) = struct.unpack_from("<f", payload)
        elif command == 0x18:
            axis.clear()

    def _request(self, channel: int, axis: EmulatedAxis, state: int) -> None:
        if self.firmware[1] == 5:
            axis.axis_error &= ~_BITS[5][_INVALID_STATE]  # which a new request clears by itself
        if state == _IDLE:
            axis.state, axis.result = _IDLE, _SUCCESS
        elif state == _CLOSED_LOOP and not axis.is_calibrated:
            axis.result = _NOT_CALIBRATED
            if self.firmware[1] == 5:
                axis.fail(_BITS[5][_INVALID_STATE])
        elif state == _CLOSED_LOOP and not axis.has_errors:
            axis.state, axis.result = _CLOSED_LOOP, _SUCCESS
            axis.hold_rev = self._revolutions(self.shafts[channel].position_rad)
            axis.fed_tick = self.ticks
            axis.loop.reset()

    def _parameter(self, axis: EmulatedAxis, payload: bytes) -> None:
        operation, number = struct.unpack_from("<BH", payload)
        if operation == 1 and number == self._timeout_id:
            (axis.watchdog_timeout_s,) = struct.unpack_from("<f", payload, 4)
        elif operation == 1 and number == self._enable_id:
            axis.enable_watchdog = bool(payload[4])
        if operation == 1 and self.firmware < (0, 6, 11):
            return
        values = {
            self._timeout_id: struct.pack("<f", axis.watchdog_timeout_s),
            self._enable_id: struct.pack("<?", axis.enable_watchdog),
        }
        if number in values:
            self._say(axis, 0x05, struct.pack("<BHB", 0, number, 0) + values[number])

    # Answers, and what is sent by itself

    def _say(self, axis: EmulatedAxis, command: int, payload: bytes) -> None:
        self.say(Frame(axis.node << 5 | command, payload))

    def _answer(self, channel: int, axis: EmulatedAxis, command: int) -> None:
        is_old = self.firmware[1] == 5
        payload = None
        if command == 0x00 and not is_old:
            payload = bytes((2, *self.hardware, *self.firmware, 0))
        elif command == 0x03:
            old, new = struct.pack("<Q", axis.motor_error), struct.pack("<II", axis.axis_error, axis.disarm_reason)
            payload = old if is_old else new
        elif command == 0x04 and is_old:
            payload = struct.pack("<II", axis.encoder_error, 0)
        elif command == 0x09:
            payload = self._estimates(channel)
        elif command == 0x14:
            current = self.current_a[channel]
            payload = struct.pack("<ff", current, current)
        elif command == 0x15 and not is_old:
            payload = struct.pack("<ff", self.temperature_degc[channel], math.nan)
        elif command == 0x17:
            payload = struct.pack("<ff", self.battery_v, self.battery_a / (2 if is_old else 4))
        elif command == 0x1D and self.firmware >= (0, 5, 4):
            powers = struct.pack("<ff", self.battery_v * self.battery_a, 0.0)
            payload = struct.pack("<II", axis.controller_error, 0) if is_old else powers
        if payload is not None:
            self._say(axis, command, payload)

    def _heartbeat(self, axis: EmulatedAxis) -> bytes:
        if self.firmware[1] == 5:
            flags = (bool(axis.motor_error), bool(axis.encoder_error), bool(axis.controller_error) | 0x80)
            return struct.pack("<IBBBB", axis.axis_error, axis.state, *flags)
        return struct.pack("<IBBBx", axis.axis_error | axis.disarm_reason, axis.state, axis.result, 1)

    def _estimates(self, channel: int) -> bytes:
        shaft = self.shafts[channel]
        return struct.pack("<ff", self._revolutions(shaft.position_rad), self._revolutions(shaft.speed_rad_s))

    def _revolutions(self, wheel_rad: float) -> float:
        return wheel_rad / math.tau * self._gear

    # Loops

    def tick(self) -> FourWheels | None:
        for channel, axis in enumerate(self.axes):
            self._watch(axis)
            if self.ticks % 100 == 0:
                self._say(axis, 0x01, self._heartbeat(axis))
            if self._estimates_ticks and self.ticks % self._estimates_ticks == 0:
                self._say(axis, 0x09, self._estimates(channel))
        if not self.is_driving:
            return None
        a, b, c, d = (self._torque(channel, axis) for channel, axis in enumerate(self.axes))
        return a, b, c, d

    def _watch(self, axis: EmulatedAxis) -> None:
        runs = axis.enable_watchdog and (self.firmware[1] == 5 or axis.state == _CLOSED_LOOP)
        if runs and self.ticks - axis.fed_tick > axis.watchdog_timeout_s * 1000.0:
            axis.fail(_BITS[self.firmware[1]][_WATCHDOG])

    def _torque(self, channel: int, axis: EmulatedAxis) -> float:
        """Return the torque at the wheel [N·m]: of a cascade of position, velocity and torque, cut at the limit."""
        if axis.state != _CLOSED_LOOP:
            return 0.0
        shaft, limit = self.shafts[channel], self.values["torque_limit_n_m"]
        if axis.control_mode == _TORQUE:
            return min(max(axis.input_torque_n_m * self._gear, -limit), limit)
        speed_rev_s = axis.input_vel_rev_s
        if axis.control_mode != _VELOCITY:
            speed_rev_s = _POSITION_GAIN * (axis.hold_rev - self._revolutions(shaft.position_rad))
        target_rad_s = speed_rev_s / self._gear * math.tau
        return axis.loop.torque(target_rad_s, shaft.speed_rad_s, axis.input_torque_n_m * self._gear)


def _version(dotted: str) -> tuple[int, int, int]:
    major, minor, revision = map(int, dotted.split("."))
    return major, minor, revision


EMULATED = EmulatedODrive
