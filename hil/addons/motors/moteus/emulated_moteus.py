"""Four emulated moteus on one CAN FD bus: mode position, its watchdog, and the registers that a driver needs.

``servo.max_position_slip`` is set, as MOTEUS.md requires; the rest of the configuration has the maker's defaults. After
a timeout the loop's derivative term brakes the wheel (``servo.timeout_mode`` 12). A command of another mode, or with an
option that is not emulated (a stop position, limits of velocity and acceleration), is ignored.
Source: mjbots moteus, docs/protocol/can.md and docs/protocol/registers.md.
"""

import math
from collections.abc import Mapping, Sequence

from firmware_protocol.framing import Frame
from hil.addons.motors.emulated_motors import EmulatedMotors
from hil.addons.motors.moteus import moteus_frames as frames
from hil.addons.motors.moteus.moteus_driver import Settings
from hil.core.types import FourWheels
from hil.robot.driver import EXTENDED, clamp, four

_TICK_S = 0.001
_STOPPED, _FAULT, _ENABLING, _CALIBRATING, _READY, _POSITION, _TIMEOUT = 0, 1, 2, 3, 4, 10, 11
_PREPARING = {_ENABLING: (2, _CALIBRATING), _CALIBRATING: (9, _READY), _READY: (1, _POSITION)}  # ticks, next mode
_UNDER_VOLTAGE, _OVER_TEMPERATURE = 40, 38
_MIN_V = 4.0
_DEFAULT_TIMEOUT_S, _MAX_POSITION_SLIP_REV, _TIMEOUT_MAX_TORQUE_N_M = 0.1, 0.05, 5.0
_MODEL, _FIRMWARE = 0x0500, 0x010D
_TORQUE = 0x003
_COMMAND: Mapping[int, float] = {  # the value of each register where a command does not write it
    0x20: 0.0, 0x21: 0.0, 0x22: 0.0, 0x23: 1.0, 0x24: 1.0, 0x25: math.nan, 0x27: 0.0, 0x2B: 1.0,
}  # fmt: skip
_NOT_EMULATED = frozenset((*range(0x10, 0x20), 0x26, *range(0x28, 0x2E), *range(0x40, 0x49))) - set(_COMMAND)
_BROADCAST = 0x7F
_MAX_ANSWER_BYTES = 64  # of a CAN FD frame


class Servo:
    """One controller. Quantities are in revolutions and newton metres at its output.

    ``kp``, ``kd``: gains of the position loop [N·m/rev, N·m·s/rev]. ``limit_n_m``: torque at ``servo.max_current_A``.
    ``measured``: values of the measured registers.
    """

    def __init__(self, kp: float, kd: float, limit_n_m: float) -> None:
        self._kp, self._kd, self._limit_n_m = kp, kd, limit_n_m
        self.mode, self.fault = _STOPPED, 0
        self.register_map = 5
        self.timeout_s = math.nan
        self.measured: dict[int, float] = {}
        self._command = dict(_COMMAND)
        self._requested: int | None = None  # the mode that the current frame asks for
        self._ticks_left = 0
        self._control_rev = math.nan  # where the position loop is; NaN while nothing is controlled

    @property
    def is_controlled(self) -> bool:
        """Whether the power stage is on."""
        return self.mode in (_POSITION, _TIMEOUT)

    # Registers

    def write(self, register: int, kind: int, raw: float) -> None:
        """Write a raw value. A command of another mode, or with an option that is not emulated, is refused."""
        if register == frames.MODE and raw in (_STOPPED, _POSITION):
            self._command = dict(_COMMAND)
            self._requested = int(raw)
        elif register in _COMMAND:
            self._command[register] = frames.physical(register, kind, raw)
        elif register == frames.MODE or register in _NOT_EMULATED:
            self.refuse()

    def read(self, register: int, kind: int) -> float | None:
        """Return the raw value of a register as this type; None if it cannot be read, or not as this type."""
        quantities = self.measured if register in self.measured else self._command
        if register in quantities:
            return frames.raw_of(register, kind, quantities[register])
        if register in (frames.MODE, frames.FAULT):
            return self.mode if register == frames.MODE else self.fault
        versions = {frames.MODEL: _MODEL, frames.FIRMWARE: _FIRMWARE, frames.REGISTER_MAP: self.register_map}
        return versions.get(register) if kind == frames.INT32 else None

    def refuse(self) -> None:
        """Drop the command of the current frame, unless it is a stop."""
        if self._requested != _STOPPED:
            self._requested = None

    def obey(self) -> None:
        """Execute the command of the frame that ends here, if it had one."""
        requested, self._requested = self._requested, None
        if requested is None:
            return
        self.timeout_s = self._command[frames.COMMAND_TIMEOUT] or _DEFAULT_TIMEOUT_S
        if requested == _STOPPED:
            self._enter(_STOPPED)
        elif self.mode == _STOPPED:
            self.mode, self._ticks_left = _ENABLING, _PREPARING[_ENABLING][0]

    def fail(self, code: int) -> None:
        """Enter mode FAULT with this code, as after a hardware fault."""
        self._enter(_FAULT, code)

    def _enter(self, mode: int, fault: int = 0) -> None:
        self.mode, self.fault, self._control_rev = mode, fault, math.nan

    # Control

    def torque(self) -> float | None:
        """Advance by 1 ms, and return the torque at the output [N·m]; None while the power stage is off."""
        if self.timeout_s > 0.0:
            self.timeout_s = max(self.timeout_s - _TICK_S, 0.0)
        if self.mode in _PREPARING:
            self._ticks_left -= 1
            if self._ticks_left <= 0:
                self.mode = _PREPARING[self.mode][1]
                self._ticks_left = _PREPARING.get(self.mode, (0, 0))[0]
        if self.mode == _POSITION and self.timeout_s <= 0.0:
            self._enter(_TIMEOUT)
        if not self.is_controlled:
            return None
        if self.mode == _POSITION:
            return self._position_loop()
        braking = -self._command[0x24] * self._kd * self.measured[frames.VELOCITY]
        return clamp(braking, min(_TIMEOUT_MAX_TORQUE_N_M, self._limit_n_m))

    def _position_loop(self) -> float:
        command, at = self._command, self.measured[frames.POSITION]
        target = _finite(command[0x21])
        if math.isfinite(command[frames.COMMAND_POSITION]):
            self._control_rev, command[frames.COMMAND_POSITION] = command[frames.COMMAND_POSITION], math.nan
        elif math.isnan(self._control_rev):
            self._control_rev = at
        self._control_rev += target * _TICK_S
        self._control_rev = at + clamp(self._control_rev - at, _MAX_POSITION_SLIP_REV)
        torque = command[0x23] * self._kp * (self._control_rev - at) + _finite(command[0x22])
        torque += command[0x24] * self._kd * (target - self.measured[frames.VELOCITY])
        most = command[frames.COMMAND_MAX_TORQUE]
        most = self._limit_n_m if math.isnan(most) else max(min(most, self._limit_n_m), 0.0)
        return clamp(_finite(torque), most)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


class EmulatedMoteus(EmulatedMotors[Settings]):
    """Emulates four moteus. Their outputs turn ``gear_ratio`` times as fast as the wheels.

    Attributes:
        servos: the four controllers, for tests that change one of them.
    """

    def power_on(self) -> None:
        values, ratio = self.values, self.settings.gear_ratio
        per_rev = math.tau / ratio / ratio  # converts a gain per radian of the wheel to one per turn of the output
        kp, kd = values["speed_ki_n_m_rad"] * per_rev, values["speed_kp_n_m_s_rad"] * per_rev
        self._constant = values["torque_constant_n_m_a"] / ratio
        self.servos = tuple(Servo(kp, kd, values["torque_limit_n_m"] / ratio) for _ in range(4))
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(servo.is_controlled for servo in self.servos)

    def receive(self, frame: Frame) -> None:
        number = frame.id & ~EXTENDED
        if number >> 16 != self.settings.can_prefix:
            return
        source, destination = number >> 8 & 0xFF, number & 0xFF
        for servo_id, servo in zip(self.settings.ids, self.servos, strict=True):
            if destination in (servo_id, _BROADCAST):
                answer = _converse(servo, frame.payload)
                servo.obey()
                if source & 0x80:
                    reply_id = self.settings.can_prefix << 16 | servo_id << 8 | source & 0x7F
                    self.send(Frame(reply_id | (EXTENDED if reply_id > 0x7FF else 0), answer))

    def tick(self) -> FourWheels | None:
        self._measure()
        for servo, temperature_degc in zip(self.servos, self.temperature_degc, strict=True):
            if servo.mode not in (_STOPPED, _FAULT):
                if self.battery_v < _MIN_V:
                    servo.fail(_UNDER_VOLTAGE)
                elif temperature_degc > self.values["temperature_limit_degc"]:
                    servo.fail(_OVER_TEMPERATURE)
        torques = [servo.torque() for servo in self.servos]
        if all(torque is None for torque in torques):
            return None
        return four((torque or 0.0) * self.settings.gear_ratio for torque in torques)

    def _measure(self) -> None:
        turns = self.settings.gear_ratio / math.tau
        for channel, (servo, shaft) in enumerate(zip(self.servos, self.shafts, strict=True)):
            servo.measured = {
                frames.POSITION: shaft.position_rad * turns,
                frames.VELOCITY: shaft.speed_rad_s * turns,
                _TORQUE: self.current_a[channel] * self._constant,
                frames.Q_CURRENT: self.current_a[channel],
                frames.VOLTAGE: self.battery_v,
                frames.TEMPERATURE: self.temperature_degc[channel],
            }


def _converse(servo: Servo, payload: bytes) -> bytes:
    answer: list[tuple[int, int, float]] = []
    found, is_whole = frames.subframes(payload)
    for one in found:
        if one.code == frames.WRITE:
            servo.write(one.register, one.kind, one.raw)
        elif one.code == frames.READ:
            if (value := servo.read(one.register, one.kind)) is not None:
                answer.append((one.register, one.kind, value))
        else:  # an answer: not for a device
            is_whole = False
            break
    if not is_whole:
        servo.refuse()
    return _payload(answer)


def _payload(values: Sequence[tuple[int, int, float]]) -> bytes:
    """Return an answer with raw values by register and type, as many as fit. Consecutive registers share a subframe."""
    whole, begin = b"", 0
    while begin < len(values):
        first, kind, _ = values[begin]
        end = begin + 1
        while end < len(values) and values[end][:2] == (first + end - begin, kind):
            end += 1
        subframe = frames.header(frames.REPLY, kind, first, end - begin)
        subframe += b"".join(frames.pack(kind, raw) for _, _, raw in values[begin:end])
        if len(whole) + len(subframe) > _MAX_ANSWER_BYTES:
            break
        whole, begin = whole + subframe, end
    return frames.padded(whole)
