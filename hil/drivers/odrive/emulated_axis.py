"""One emulated ODrive axis: its state, errors and watchdog, and its cascaded controller.

The input modes are PASSTHROUGH and TRAP_TRAJ, the control modes torque, velocity and position. In any other mode the
axis disarms itself with the error of a wrong configuration.
"""

import math
from collections.abc import Mapping

from hil.drivers.emulated import Shaft, SpeedLoop, Trajectory
from hil.drivers.port import clamp

IDLE, CLOSED_LOOP = 1, 8
TORQUE, VELOCITY, POSITION = 1, 2, 3
PASSTHROUGH, TRAP_TRAJ = 1, 5
SUCCESS, DISARMED, NOT_CALIBRATED = 0, 3, 14
UNADDRESSED = 63
WATCHDOG, ESTOP, INVALID_STATE, BAD_MODE, TOO_FAST = "watchdog", "estop", "invalid state", "bad mode", "too fast"
BITS: Mapping[int, Mapping[str, int]] = {
    5: {WATCHDOG: 0x800, ESTOP: 0x4000, INVALID_STATE: 0x1, BAD_MODE: 0x200, TOO_FAST: 0x200},
    6: {WATCHDOG: 0x0100_0000, ESTOP: 0x0200_0000, BAD_MODE: 0x10, TOO_FAST: 0x8000},
}
CONTROLLER_BITS: Mapping[str, int] = {BAD_MODE: 0x2, TOO_FAST: 0x1}  # of 0.5, beside the axis error
_POSITION_GAIN = 20.0  # default of both firmwares [(rev/s)/rev]
_TOLERANCE = 1.2  # default, of the speed limit
_BOOT_TICKS = 500
_STORED = (
    "node", "enable_watchdog", "watchdog_timeout_s", "velocity_limit_rev_s", "current_limit_a", "position_gain",
    "trajectory_rev_s", "acceleration_rev_s2", "deceleration_rev_s2", "control_mode", "input_mode",
)  # fmt: skip


class EmulatedAxis:
    """One axis. A test sets errors with ``fail``, and ``is_calibrated``.

    ``enable_watchdog`` and ``watchdog_timeout_s`` are what odrivetool sets over USB; by default there is no watchdog.
    ``velocity_limit_rev_s`` is infinite until Set_Limits sets it, as hil/drivers/odrive/ODRIVE.md requires a high one.

    Args:
        node: node id.
        serial: serial number of 48 bits.
        firmware: 5 or 6.
        loop: the velocity controller, at the wheel.
        gear: motor turns per turn of the wheel.
        limit_n_m: torque at the wheel at the motor's largest current.
        constant: torque at the wheel per ampere [N·m/A].
    """

    def __init__(
        self, node: int, serial: int, firmware: int, loop: SpeedLoop, gear: float, limit_n_m: float, constant: float
    ) -> None:
        self.node, self.serial = node, serial
        self.firmware = firmware
        self.loop = loop
        self._gear, self._limit_n_m, self._constant = gear, limit_n_m, constant
        self.is_calibrated = True
        self.fed_tick = 0
        self.boot_left = 0
        self.is_identified = False
        self.set_defaults()
        self.save()
        self.boot(0)

    # Configuration and reboot

    def set_defaults(self) -> None:
        """Reset the configuration to its defaults, except the node id and the gains of the velocity loop."""
        self.enable_watchdog = False
        self.watchdog_timeout_s = 0.0
        self.velocity_limit_rev_s, self.current_limit_a = math.inf, math.inf
        self.position_gain = _POSITION_GAIN
        self.trajectory_rev_s, self.acceleration_rev_s2, self.deceleration_rev_s2 = 2.0, 0.5, 0.5  # of TRAP_TRAJ
        self.control_mode, self.input_mode = POSITION, PASSTHROUGH

    def save(self) -> None:
        """Store the configuration, so that it survives a reboot."""
        self._saved = {name: getattr(self, name) for name in _STORED}

    def boot(self, ticks: int = _BOOT_TICKS) -> None:
        """Reboot with the stored configuration. For ``ticks`` ms the axis neither sends nor receives."""
        self.set(self._saved)
        self.boot_left = ticks
        self.state, self.result = IDLE, SUCCESS
        self.is_identified = False
        self.axis_error = self.disarm_reason = 0  # of 0.6: the active errors
        self.motor_error = self.encoder_error = self.controller_error = 0
        self.input_vel_rev_s = self.input_torque_n_m = self.velocity_ff_rev_s = 0.0
        self.torque_n_m = 0.0  # at the motor, as commanded
        self.offset_rev = 0.0
        self.trajectory = Trajectory()
        self.loop.reset()

    # Errors

    def fail(self, axis: int = 0, *, motor: int = 0, encoder: int = 0, controller: int = 0) -> None:
        """Set error bits, and disarm the axis if it is in closed loop."""
        self.axis_error |= axis
        self.motor_error |= motor
        self.encoder_error |= encoder
        self.controller_error |= controller
        if self.state == CLOSED_LOOP:
            self.disarm_reason = axis
            self.result = DISARMED
            self.state = IDLE

    def fail_by(self, reason: str) -> None:
        """Set the error bits that this firmware has for a reason."""
        is_old = self.firmware == 5
        self.fail(BITS[self.firmware][reason], controller=CONTROLLER_BITS.get(reason, 0) if is_old else 0)

    @property
    def has_errors(self) -> bool:
        return bool(self.axis_error or self.motor_error or self.encoder_error or self.controller_error)

    def clear(self) -> None:
        self.axis_error = self.motor_error = self.encoder_error = self.controller_error = self.disarm_reason = 0

    # Commands

    def request(self, state: int, tick: int) -> None:
        """Enter idle, or closed loop if the axis is calibrated and has no errors."""
        if self.firmware == 5:
            self.axis_error &= ~BITS[5][INVALID_STATE]  # a new request clears this error
        if state == IDLE:
            self.state, self.result = IDLE, SUCCESS
        elif state == CLOSED_LOOP and not self.is_calibrated:
            self.result = NOT_CALIBRATED
            if self.firmware == 5:
                self.fail_by(INVALID_STATE)
        elif state == CLOSED_LOOP and not self.has_errors:
            self.state, self.result = CLOSED_LOOP, SUCCESS
            self.velocity_ff_rev_s = 0.0
            self.trajectory.forget()
            self.fed_tick = tick
            self.loop.reset()

    def set(self, values: Mapping[str, float]) -> None:
        """Set attributes by name; ``velocity_gain`` and ``integrator_gain`` are those of the velocity loop."""
        if "velocity_gain" in values:
            per_rad = self._gear * self._gear / math.tau  # from a gain per motor turn to one per radian of the wheel
            self.loop.gains = values["velocity_gain"] * per_rad, values["integrator_gain"] * per_rad
            return
        for name, value in values.items():
            setattr(self, name, value)

    def go_to(self, position_rev: float, velocity_ff_rev_s: float, torque_ff_n_m: float) -> None:
        """Set the input to a position, with feedforward of velocity and torque."""
        self.trajectory.aim(position_rev)
        self.velocity_ff_rev_s, self.input_torque_n_m = velocity_ff_rev_s, torque_ff_n_m

    def watch(self, tick: int) -> None:
        """Fail with the error of the watchdog if it has expired."""
        runs = self.enable_watchdog and (self.firmware == 5 or self.state == CLOSED_LOOP)
        if runs and tick - self.fed_tick > self.watchdog_timeout_s * 1000.0:
            self.fail_by(WATCHDOG)

    # Control

    def revolutions(self, wheel_rad: float) -> float:
        """Return the motor's turns for an angle of the wheel."""
        return wheel_rad / math.tau * self._gear

    def position_rev(self, shaft: Shaft) -> float:
        """Return the motor's position as it is reported, with the offset of ``set_position``."""
        return self.revolutions(shaft.position_rad) + self.offset_rev

    def set_position(self, position_rev: float, shaft: Shaft) -> None:
        """Set the current position of the motor to this one."""
        self.offset_rev = position_rev - self.revolutions(shaft.position_rad)
        self.trajectory.forget()

    def torque(self, shaft: Shaft) -> float:
        """Return the torque at the wheel [N·m] of the position, velocity and torque cascade, within the limits."""
        self.torque_n_m = self._torque(shaft) / self._gear if self.state == CLOSED_LOOP else 0.0
        return self.torque_n_m * self._gear

    def _torque(self, shaft: Shaft) -> float:
        speed = self.revolutions(shaft.speed_rad_s)
        most = self.velocity_limit_rev_s
        if self.control_mode not in (TORQUE, VELOCITY, POSITION) or self.input_mode not in (PASSTHROUGH, TRAP_TRAJ):
            self.fail_by(BAD_MODE)
        elif abs(speed) > _TOLERANCE * most:
            self.fail_by(TOO_FAST)
        if self.state != CLOSED_LOOP:
            return 0.0
        limit = min(self._limit_n_m, self.current_limit_a * self._constant)
        if self.control_mode == TORQUE:
            torque = clamp(self.input_torque_n_m * self._gear, limit)
            return torque if abs(speed) < most or torque * speed <= 0.0 else 0.0
        target = self.input_vel_rev_s
        if self.control_mode == POSITION:
            ramps = self.trajectory_rev_s, min(self.acceleration_rev_s2, self.deceleration_rev_s2)
            at = self.position_rev(shaft)
            self.trajectory.step(at, speed, 0.0, *(ramps if self.input_mode == TRAP_TRAJ else (math.inf, math.inf)))
            target = self.position_gain * (self.trajectory.position_rev - at) + self.trajectory.velocity
            target += self.velocity_ff_rev_s
        target_rad_s = clamp(target, most) / self._gear * math.tau
        torque = self.loop.torque(target_rad_s, shaft.speed_rad_s, self.input_torque_n_m * self._gear)
        return clamp(torque, limit)
