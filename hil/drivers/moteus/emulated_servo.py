"""One emulated moteus: its modes, the watchdog of its commands, and its control loops.

``servo.max_position_slip`` is set, as hil/drivers/moteus/MOTEUS.md requires; the rest of the configuration has the
maker's defaults: after a timeout the loop's derivative term brakes the wheel (``servo.timeout_mode`` 12), and positions
have no bounds.

As in the firmware, the watchdog ends only position mode and "stay within". A voltage, a current, "zero velocity" and
the brake hold until another command comes. Raw phase voltages and overrides of the control are not emulated: a command
that contains one is ignored.
"""

import math
from collections.abc import Mapping

from hil.drivers.emulated import Trajectory
from hil.drivers.moteus import frames
from hil.drivers.port import clamp

_TICK_S = 0.001
STOPPED, FAULT, TIMEOUT = 0, 1, 11
_ENABLING, _CALIBRATING, _READY = 2, 3, 4
VOLTAGE_FOC, VOLTAGE_DQ, CURRENT, POSITION, ZERO_VELOCITY, STAY_WITHIN, BRAKE = 7, 8, 9, 10, 12, 13, 15
_CONTROLLED = (VOLTAGE_FOC, VOLTAGE_DQ, CURRENT, POSITION, TIMEOUT, ZERO_VELOCITY, STAY_WITHIN, BRAKE)
_PREPARING_TICKS = {_ENABLING: 2, _CALIBRATING: 9, _READY: 1}
_STOP_POSITION_WITH_LIMITS = 45
_MODEL, _FIRMWARE = 0x0500, 0x010D
_OUTPUT_IS_REFERENCED = 2

ID, SERIAL_NUMBER, UUID, UUID_MASK, UUID_CAPABLE = 0x110, 0x120, 0x150, 0x154, 0x158
_SET_NEAREST, _SET_EXACT, _RECAPTURE, _MILLISECONDS = 0x130, 0x131, 0x133, 0x70
NO_REGISTER, _READ_ONLY, _NO_MODE = 1, 2, 3  # error numbers
_COMMAND: Mapping[int, float] = {  # the value of each register where a command does not write it
    **dict.fromkeys((0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x1E, 0x20, 0x21, 0x22, 0x27, 0x2D, 0x40, 0x41), 0.0),
    **dict.fromkeys((0x23, 0x24, 0x2B), 1.0),
    **dict.fromkeys((0x25, 0x26, 0x28, 0x29), math.nan),
}
_SHADOWS = dict(zip(range(0x42, 0x49), (0x22, 0x23, 0x24, 0x25, 0x27, 0x2B, 0x2D), strict=True))
"""The same registers again, beside the bounds of "stay within"."""
_NOT_EMULATED = frozenset((0x10, 0x11, 0x12, 0x14, 0x15, 0x16, 0x2A, 0x2C))
_MEASURED = (0x01, 0x02, 0x03, 0x04, 0x05, 0x07, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x38, 0x39, 0x3A, 0x50, 0x51)

OPTIONAL = ("servo.default_accel_limit", "servo.default_velocity_limit", "servo.max_position_slip")
"""Settings that accept NaN, which stands for no limit."""
SETTABLE = (
    *OPTIONAL, "servo.default_timeout_s", "servo.max_current_A", "servo.pid_position.kd", "servo.pid_position.kp",
    "servo.timeout_max_torque_Nm", "servo.timeout_mode",
)  # fmt: skip
"""Settings that ``conf set`` accepts; none is negative."""
TIMEOUT_MODES = (STOPPED, ZERO_VELOCITY, BRAKE)


class Servo:
    """One controller. Quantities are in revolutions and newton metres at its output.

    Args:
        number: ``id.id``.
        kp, kd: gains of the position loop [N·m/rev, N·m·s/rev].
        constant: torque constant [N·m/A], and of the same value the back-EMF constant [V·s/rad].
        resistance_ohm: of the motor.
        limit_n_m: torque at ``servo.max_current_A``.

    Attributes:
        mode, fault: values of the registers of these names.
        measured: values of the measured registers.
        config: the configuration, by the firmware's names.
    """

    def __init__(
        self, number: int, kp: float, kd: float, constant: float, resistance_ohm: float, limit_n_m: float
    ) -> None:
        self._constant, self._resistance_ohm = constant, resistance_ohm
        self.mode, self.fault = STOPPED, 0
        self.register_map = 5
        self.uuid = bytes((number, *range(0xA1, 0xB0)))
        self.config: dict[str, float] = {
            "id.id": number,
            "motor.poles": 14,
            "motor.resistance_ohm": resistance_ohm,
            "motor_position.rotor_to_output_ratio": 1.0,
            "servo.default_accel_limit": math.nan,
            "servo.default_timeout_s": 0.1,
            "servo.default_velocity_limit": math.nan,
            "servo.max_current_A": limit_n_m / constant,
            "servo.max_position_slip": 0.05,
            "servo.pid_position.ilimit": 0.0,
            "servo.pid_position.kd": kd,
            "servo.pid_position.ki": 0.0,
            "servo.pid_position.kp": kp,
            "servo.timeout_max_torque_Nm": 5.0,
            "servo.timeout_mode": ZERO_VELOCITY,
            "servopos.position_max": math.nan,
            "servopos.position_min": math.nan,
        } | {f"uuid.uuid.{i}": byte for i, byte in enumerate(self.uuid)}
        self.command = dict(_COMMAND)
        self.measured = dict.fromkeys(_MEASURED, 0.0)
        self._requested: int | None = None  # the mode that the current frame asks for
        self._target_mode = STOPPED  # the mode after the preparation
        self.timeout_s = math.nan
        self._ticks_left = 0
        self.ticks = 0
        self._offset_rev = 0.0
        self._trajectory = Trajectory()

    @property
    def is_controlled(self) -> bool:
        """Whether the power stage is on: the windings have a voltage or are shorted."""
        return self.mode in _CONTROLLED and not (self.mode == TIMEOUT and self.config["servo.timeout_mode"] == STOPPED)

    # Registers

    def write(self, register: int, kind: int, raw: float) -> int:
        """Write a raw value, and return the error number, 0 for none."""
        register = _SHADOWS.get(register, register)
        if register == frames.MODE:
            if raw not in (STOPPED, *_CONTROLLED):
                return _NO_MODE
            self.begin(int(raw))
        elif register in _NOT_EMULATED:
            self.refuse()  # no error number: the firmware has these registers
        elif register in _COMMAND:
            self.command[register] = frames.physical(register, kind, raw)
        elif register in (_SET_NEAREST, _SET_EXACT):
            if math.isfinite(position := frames.physical(register, kind, raw)):
                self.set_output(position, nearest=register == _SET_NEAREST)
        elif register == _RECAPTURE:
            self.recapture()
        else:
            return NO_REGISTER if self.read(register, frames.INT32) is None else _READ_ONLY
        return 0

    def read(self, register: int, kind: int) -> float | None:
        """Return the raw value of a register as this type; None if it cannot be read, or not as this type."""
        register = _SHADOWS.get(register, register)
        if register in _MEASURED or register in _COMMAND:
            return frames.raw_of(register, kind, (self.measured if register in _MEASURED else self.command)[register])
        milliseconds = self.ticks % (1 << (23 if kind == frames.FLOAT else (8 << kind) - 1))
        plain = {frames.MODE: self.mode, frames.FAULT: self.fault, _MILLISECONDS: milliseconds, UUID_CAPABLE: 1}
        if register in plain or register == ID:
            return self.config["id.id"] if register == ID else plain[register]
        if kind != frames.INT32:
            return None
        if UUID <= register < UUID + 4:
            return self._uuid_word(register - UUID)
        serial = {SERIAL_NUMBER + i: 0x1000 + i for i in range(3)}
        versions = {frames.MODEL: _MODEL, frames.FIRMWARE: _FIRMWARE, frames.REGISTER_MAP: self.register_map}
        return (versions | serial).get(register)

    def _uuid_word(self, i: int) -> int:
        return int.from_bytes(self.uuid[4 * i : 4 * i + 4], "little", signed=True)

    def is_masked_out(self, register: int, raw: float) -> bool:
        """Return whether a value is written to the UUID mask that differs from this UUID: the frame is then ignored."""
        return UUID_MASK <= register < UUID_MASK + 4 and raw != self._uuid_word(register - UUID_MASK)

    # Commands

    def begin(self, mode: int) -> None:
        """Begin a command of this mode; registers that are written after it complete the command."""
        self.command = dict(_COMMAND)
        self._requested = mode

    def refuse(self) -> None:
        """Drop the command of a damaged frame, unless it is a stop."""
        if self._requested != STOPPED:
            self._requested = None

    def obey(self) -> None:
        """Execute the command of the frame that ends here, if it had one."""
        requested, self._requested = self._requested, None
        if requested is None:
            return
        self.timeout_s = self.command[0x27] or self.config["servo.default_timeout_s"]
        if requested == STOPPED:
            self.mode, self.fault = STOPPED, 0
            self.recapture()
        elif self.mode == STOPPED:
            self.mode, self._ticks_left = _ENABLING, _PREPARING_TICKS[_ENABLING]
            self._target_mode = requested
        elif self.mode in _CONTROLLED and self.mode != TIMEOUT:
            if requested != self.mode:
                self.recapture()
            self.mode = requested
        elif self.mode in _PREPARING_TICKS:
            self._target_mode = requested

    def recapture(self) -> None:
        """Restart the position loop from the output's current position."""
        self._trajectory.forget()

    def set_output(self, position_rev: float, *, nearest: bool) -> None:
        """Set the current position of the output to this one; with ``nearest`` change it by whole turns only."""
        change = position_rev - self.measured[0x01]
        change = round(change) if nearest else change
        self._offset_rev += change
        self.measured[0x01] += change
        self.recapture()

    def fail(self, code: int) -> None:
        """Enter mode FAULT with this code, as after a hardware fault."""
        self.mode, self.fault = FAULT, code
        self.recapture()

    # Control

    def measure(self, quantities: Mapping[int, float]) -> None:
        """Take measured values by register. The position is without the offset of ``set_output``."""
        self.measured.update(quantities)
        self.measured[0x01] += self._offset_rev
        self.measured[0x0B] = self._trajectory.is_complete
        self.measured[0x0C] = _OUTPUT_IS_REFERENCED if self._offset_rev else 1
        self.measured[0x38], self.measured[0x39] = self._trajectory.position_rev, self._trajectory.velocity
        self.measured[0x50], self.measured[0x51] = quantities[0x01] % 1.0, quantities[0x02]

    def torque(self) -> float | None:
        """Advance by 1 ms, and return the torque at the output [N·m]; None while the power stage is off."""
        self.ticks += 1
        if self.timeout_s > 0.0:
            self.timeout_s = max(self.timeout_s - _TICK_S, 0.0)
        if self.mode in _PREPARING_TICKS:
            self._ticks_left -= 1
            if self._ticks_left <= 0:
                following = {_ENABLING: _CALIBRATING, _CALIBRATING: _READY, _READY: self._target_mode}
                self.mode = following[self.mode]
                self._ticks_left = _PREPARING_TICKS.get(self.mode, 0)
        if self.mode in (POSITION, STAY_WITHIN) and self.timeout_s <= 0.0:
            self.mode = TIMEOUT
            self.recapture()
        torque = self._controlled()
        self.measured[0x3A] = torque or 0.0
        return torque

    def _controlled(self) -> float | None:
        command, config = self.command, self.config
        mode = self.mode if self.mode != TIMEOUT else int(config["servo.timeout_mode"])
        limit = config["servo.max_current_A"] * self._constant
        if mode == POSITION:
            return self._position_loop(limit)
        if mode == STAY_WITHIN:
            return self._within(limit)
        if mode == ZERO_VELOCITY:
            most = min(config["servo.timeout_max_torque_Nm"], limit)
            return clamp(-command[0x24] * config["servo.pid_position.kd"] * self.measured[0x02], most)
        if mode == CURRENT:
            return clamp(_finite(command[0x1C]) * self._constant, limit)
        if mode == VOLTAGE_DQ:
            return clamp(self._torque_of(_finite(command[0x1B])), limit)
        if mode == BRAKE:
            return clamp(self._torque_of(0.0), limit)
        if mode == VOLTAGE_FOC:
            command[0x18] = math.remainder(_finite(command[0x18]) + _finite(command[0x1E]) * _TICK_S, 2.0)
            electrical = math.tau * (self.measured[0x01] - self._offset_rev) * config["motor.poles"] / 2.0
            return clamp(self._torque_of(_finite(command[0x19]), math.pi * command[0x18] - electrical), limit)
        return None

    def _torque_of(self, volts: float, lead_rad: float = math.pi / 2.0) -> float:
        """Return the torque [N·m] of a voltage that leads the rotor by this electrical angle, against the back-EMF."""
        most = self.measured[0x0D] / math.sqrt(3.0)
        turning = self._constant * math.tau * self.measured[0x02]
        return self._constant * (clamp(volts, most) * math.sin(lead_rad) - turning) / self._resistance_ohm

    def _position_loop(self, limit: float) -> float:
        at, command, config = self.measured[0x01], self.command, self.config
        target = _finite(command[0x21])
        velocity_most = _limit_of(command[0x28], config["servo.default_velocity_limit"])
        accel_most = _limit_of(command[0x29], config["servo.default_accel_limit"])
        trajectory, stop = self._trajectory, command[0x26]
        if math.isfinite(stop) and (math.isfinite(velocity_most) or math.isfinite(accel_most)):
            self.fail(_STOP_POSITION_WITH_LIMITS)
            return 0.0
        if math.isfinite(command[0x20]):
            trajectory.aim(command[0x20])
            command[0x20] = math.nan
        target = trajectory.stop_at(stop, at, target)
        trajectory.step(at, self.measured[0x02], target, velocity_most, accel_most)
        trajectory.slip(at, config["servo.max_position_slip"])
        return self._loop(trajectory.position_rev, trajectory.velocity, limit)

    def _within(self, limit: float) -> float:
        at, lower, upper = self.measured[0x01], self.command[0x40], self.command[0x41]
        if at < lower or at > upper:
            return self._loop(lower if at < lower else upper, 0.0, limit)
        return clamp(_finite(self.command[0x22]), self._most(limit))

    def _loop(self, control_rev: float, control_velocity: float, limit: float) -> float:
        command, config = self.command, self.config
        position_error = control_rev - self.measured[0x01]
        velocity_error = control_velocity - self.measured[0x02]
        torque = command[0x23] * config["servo.pid_position.kp"] * position_error + _finite(command[0x22])
        torque += command[0x24] * config["servo.pid_position.kd"] * velocity_error
        return clamp(_finite(torque), self._most(limit))

    def _most(self, limit: float) -> float:
        most = self.command[0x25]
        return limit if math.isnan(most) else max(min(most, limit), 0.0)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _limit_of(commanded: float, default: float) -> float:
    """Return the commanded limit, the default if it is NaN; infinity if the result is negative or NaN."""
    chosen = default if math.isnan(commanded) else commanded
    return chosen if chosen >= 0.0 else math.inf
