"""Four emulated ODrive axes of CANSimple: firmware 0.5.6 after its published source, 0.6.10 after its documents.

Firmware 0.5: any frame to an axis feeds its watchdog, which also runs while the axis is idle; axis, motor, encoder and
controller have error registers of their own. Firmware 0.6: it has a version, endpoints, procedure results, one register
of active errors, and one with the reason of the last disarming. It is assumed, neither documented nor measured, that
only inputs feed the watchdog of 0.6, and that it runs only in closed loop.
"""

import math
import struct
from collections.abc import Mapping

from firmware_protocol.framing import Frame
from hil.core.types import FourWheels
from hil.drivers.emulated import EmulatedMotors
from hil.drivers.odrive.driver import Settings
from hil.drivers.odrive.emulated_axis import CLOSED_LOOP, ESTOP, IDLE, TRAP_TRAJ, UNADDRESSED, EmulatedAxis
from hil.drivers.port import four

_REMOTE, _STANDARD = 0x4000_0000, 0x7FF
_ADDRESS, _REBOOT = 0x06, 0x16
_INPUTS = (0x0C, 0x0D, 0x0E)
_TO_ALL = (0x02, _ADDRESS, _REBOOT, 0x18)  # Estop, Address, Reboot, Clear_Errors
_MIN_BYTES: Mapping[int, int] = {  # of a command that is not empty; shorter ones are ignored
    0x07: 4, 0x0B: 8, 0x0C: 4, 0x0D: 4, 0x0E: 4, 0x0F: 8, 0x11: 4, 0x12: 8, 0x19: 4, 0x1A: 4, 0x1B: 8,
}  # fmt: skip
_SETTERS: Mapping[int, tuple[tuple[str, ...], bool]] = {  # what its numbers set, and whether they may be negative
    0x0D: (("input_vel_rev_s", "input_torque_n_m"), True),
    0x0E: (("input_torque_n_m",), True),
    0x0F: (("velocity_limit_rev_s", "current_limit_a"), False),
    0x11: (("trajectory_rev_s",), False),
    0x12: (("acceleration_rev_s2", "deceleration_rev_s2"), False),
    0x1A: (("position_gain",), False),
    0x1B: (("velocity_gain", "integrator_gain"), False),
}
_REBOOT_ACTIONS = (_RESTART, _SAVE, _ERASE) = (0, 1, 2)
_COUNTS_PER_TURN = 8192  # of the default encoder of 0.5


class EmulatedODrive(EmulatedMotors[Settings]):
    """Emulates four axes. ``firmware`` and ``hardware`` may be changed before the first tick."""

    def power_on(self) -> None:
        settings = self.settings
        self.firmware = (0, 5, 6) if settings.firmware == "0.5" else (0, 6, 10)
        self.hardware = (4, 4, 58)
        if settings.endpoints_firmware:
            self.firmware = _version(settings.endpoints_firmware)
            self.hardware = _version(settings.endpoints_hardware)
        self._timeout_id, self._enable_id = settings.watchdog_endpoints or (419, 420)
        gear = self._gear = settings.gear_ratio
        self._estimates_ticks = round(1000.0 / settings.feedback_hz) if settings.feedback_hz else 0
        limit, constant = self.values["torque_limit_n_m"], self.values["torque_constant_n_m_a"]
        self.axes = [
            EmulatedAxis(node, 0x3868_0000_1000 + node, self.firmware[1], loop, gear, limit, constant)
            for node, loop in zip(settings.node_ids, self.loops, strict=True)
        ]

    @property
    def is_driving(self) -> bool:
        return any(axis.state == CLOSED_LOOP for axis in self.axes)

    # Commands

    def receive(self, frame: Frame) -> None:
        is_remote, number = bool(frame.id & _REMOTE), frame.id & ~_REMOTE
        if number > _STANDARD:
            return
        node, command = number >> 5, number & 0x1F
        is_to_all = node == UNADDRESSED and self.firmware[1] >= 6
        for channel, axis in enumerate(self.axes):
            is_meant = command in _TO_ALL if is_to_all else axis.node == node
            if is_meant and axis.boot_left == 0:
                self._take(channel, axis, command, frame.payload, is_remote)

    def _take(self, channel: int, axis: EmulatedAxis, command: int, payload: bytes, is_remote: bool) -> None:
        axis.firmware = self.firmware[1]
        if self.firmware[1] == 5 or (command in _INPUTS and not is_remote):
            axis.fed_tick = self.ticks
        if is_remote or (not payload and self.firmware >= (0, 5, 5)):
            self._answer(channel, axis, command)
        if self.firmware[1] >= 6 and (is_remote or (not payload and command in _MIN_BYTES)):
            return  # 0.5 does not check this, and takes a remote or empty frame for a command with the value 0
        if payload and len(payload) < _MIN_BYTES.get(command, 0):
            return
        if command == 0x04 and self.firmware[1] >= 6:
            self._parameter(axis, payload.ljust(8, b"\0"))
        elif command == _ADDRESS:
            self._address(axis, payload)
        elif command == _REBOOT:
            self._reboot(axis, payload)
        else:
            self._command(channel, axis, command, payload.ljust(8, b"\0"))

    def _command(self, channel: int, axis: EmulatedAxis, command: int, payload: bytes) -> None:
        first, second = struct.unpack("<II", payload)
        number, other = struct.unpack("<ff", payload)
        if command in _SETTERS:
            names, is_signed = _SETTERS[command]
            values = (number, other)[: len(names)]
            if all(map(math.isfinite, values)) and (is_signed or min(values) >= 0.0):
                axis.set(dict(zip(names, values, strict=True)))
        elif command == 0x02:
            axis.fail_by(ESTOP)
        elif command == 0x07:
            axis.request(first, self.ticks)
        elif command == 0x0B:
            axis.control_mode, axis.input_mode = first, second
        elif command == 0x0C and math.isfinite(number):
            velocity_ff, torque_ff = struct.unpack_from("<hh", payload, 4)
            axis.go_to(number, velocity_ff / 1000.0, torque_ff / 1000.0)
        elif command == 0x18:
            axis.clear()
            axis.is_identified = self.firmware[1] >= 6 and payload[0] == 1
        elif command == 0x19:
            counts = struct.unpack_from("<i", payload)[0] / _COUNTS_PER_TURN
            position = counts if self.firmware[1] == 5 else number
            if math.isfinite(position):
                axis.set_position(position, self.shafts[channel])

    def _address(self, axis: EmulatedAxis, payload: bytes) -> None:
        """Set the node id if the message is for this axis. If another axis gets this one's id, this one loses it."""
        if self.firmware[1] == 5:
            if len(payload) >= 4 and (node := int.from_bytes(payload[:4], "little")) < UNADDRESSED:
                axis.node = node
        elif len(payload) >= 7 and payload[0] <= UNADDRESSED:
            if int.from_bytes(payload[1:7], "little") == axis.serial:
                axis.node = payload[0]
            elif axis.node == payload[0]:
                axis.node = UNADDRESSED

    def _reboot(self, axis: EmulatedAxis, payload: bytes) -> None:
        action = payload[0] if payload and self.firmware[1] >= 6 else _RESTART
        if action not in _REBOOT_ACTIONS or (action == _SAVE and axis.state != IDLE):
            return
        if action == _ERASE:
            axis.set_defaults()
            axis.node = UNADDRESSED
        if action != _RESTART:
            axis.save()
        axis.boot()

    def _parameter(self, axis: EmulatedAxis, payload: bytes) -> None:
        operation, number = struct.unpack_from("<BH", payload)
        parameters = {self._timeout_id: ("watchdog_timeout_s", "<f"), self._enable_id: ("enable_watchdog", "<?")}
        if number not in parameters:
            return
        name, layout = parameters[number]
        if operation == 1:
            axis.set({name: struct.unpack_from(layout, payload, 4)[0]})
            if self.firmware < (0, 6, 11):
                return
        self._say(axis, 0x05, struct.pack("<BHB", 0, number, 0) + struct.pack(layout, getattr(axis, name)))

    # Answers and cyclic messages

    def _say(self, axis: EmulatedAxis, command: int, payload: bytes) -> None:
        self.send(Frame(axis.node << 5 | command, payload))

    def _answer(self, channel: int, axis: EmulatedAxis, command: int) -> None:
        """Answer a question. There is no sensorless estimator in 0.5, so that its values and its error are 0."""
        shaft, current_a, torque_n_m = self.shafts[channel], self.current_a[channel], self.torque_n_m[channel]
        is_old = self.firmware[1] == 5
        floats = struct.Struct("<ff").pack
        answers = {
            0x09: self._estimates(channel),
            0x14: floats(current_a, current_a),
            0x17: floats(self.battery_v, self.battery_a / (2 if is_old else 4)),
        }
        if is_old:
            count = math.floor(axis.position_rev(shaft) * _COUNTS_PER_TURN)
            answers |= {
                0x03: struct.pack("<Q", axis.motor_error),
                0x04: struct.pack("<II", axis.encoder_error, 0),
                0x05: bytes(8),
                0x0A: struct.pack("<ii", (count + 2**31) % 2**32 - 2**31, count % _COUNTS_PER_TURN),
                0x15: bytes(8),
            }
            if self.firmware >= (0, 5, 4):
                answers[0x1D] = struct.pack("<II", axis.controller_error, 0)
        else:
            answers |= {
                0x00: bytes((2, *self.hardware, *self.firmware, 0)),
                0x01: self._heartbeat(axis),
                0x03: struct.pack("<II", axis.axis_error, axis.disarm_reason),
                _ADDRESS: bytes((axis.node,)) + axis.serial.to_bytes(6, "little") + b"\0",
                0x15: floats(self.temperature_degc[channel], math.nan),
                0x1D: floats(self.battery_v * self.battery_a / 4.0, torque_n_m * shaft.speed_rad_s),
            }
            if self.firmware >= (0, 6, 9):
                estimate = current_a * self.values["torque_constant_n_m_a"] / self._gear
                answers[0x1C] = floats(axis.torque_n_m, estimate)
        if command in answers:
            self._say(axis, command, answers[command])

    def _heartbeat(self, axis: EmulatedAxis) -> bytes:
        is_done = axis.trajectory.is_complete or axis.input_mode != TRAP_TRAJ
        if self.firmware[1] == 5:
            flags = (bool(axis.motor_error), bool(axis.encoder_error), bool(axis.controller_error) | is_done << 7)
            return struct.pack("<IBBBB", axis.axis_error, axis.state, *flags)
        return struct.pack("<IBBBx", axis.axis_error | axis.disarm_reason, axis.state, axis.result, is_done)

    def _estimates(self, channel: int) -> bytes:
        axis, shaft = self.axes[channel], self.shafts[channel]
        return struct.pack("<ff", axis.position_rev(shaft), axis.revolutions(shaft.speed_rad_s))

    # Loops

    def tick(self) -> FourWheels | None:
        for channel, axis in enumerate(self.axes):
            axis.firmware = self.firmware[1]
            axis.boot_left = max(axis.boot_left - 1, 0)
            axis.watch(self.ticks)
            if axis.boot_left or axis.node == UNADDRESSED:
                continue
            if self.ticks % 100 == 0:
                self._say(axis, 0x01, self._heartbeat(axis))
            if self._estimates_ticks and self.ticks % self._estimates_ticks == 0:
                self._say(axis, 0x09, self._estimates(channel))
        if not self.is_driving:
            return None
        return four(axis.torque(shaft) for axis, shaft in zip(self.axes, self.shafts, strict=True))


def _version(dotted: str) -> tuple[int, int, int]:
    major, minor, revision = map(int, dotted.split("."))
    return major, minor, revision
