"""PID with kinematics: the usual law for such a robot. Of the robot's properties it needs only the geometry."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.types import (
    NO_GAINS,
    ZERO_WHEELS,
    Applied,
    Axes,
    CommandMode,
    FourWheels,
    Reference,
    State,
    WheelCommand,
    Wheels,
)
from hil.laws.prediction import extrapolate, speed_command


class Pid:
    """PID with kinematics: one PID per axis sets the twist, the kinematics turn it into wheel speeds.

    v = q̇_d - Kp e - Ki ∫e - Kd ė, with the error extrapolated over the latency by the measured speed. In SPEED mode the
    firmware's speed loop follows v, with the torque feedforward of the reference as for every law. In TORQUE mode one
    PI per wheel follows ω = H Rᵀ v / r here, without knowledge of mass or friction. The integrals stop while the guard
    scales the command (anti-windup).
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes, Kp [1/s], Ki [1/s²] and Kd [1], and of each wheel's PI in TORQUE mode."""

        kp_1_s: Annotated[float, RATE] = 8.0
        ki_1_s2: Annotated[float, Range(ge=0, le=10_000)] = 4.0
        kd: Annotated[float, Range(ge=0, le=10)] = 0.0
        wheel_kp_n_m_s_rad: Annotated[float, Range(gt=0, le=100)] = 1.1
        wheel_ki_n_m_rad: Annotated[float, Range(ge=0, le=10_000)] = 12.0

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._options = options
        self._torque = mode is CommandMode.TORQUE
        self._integral: Axes
        self._wheel_integral: Wheels

    def reset(self, state: State, reference: Reference) -> None:
        """Reset the integrals."""
        self._integral = (0.0, 0.0, 0.0)
        self._wheel_integral = ZERO_WHEELS

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        predicted = extrapolate(reference, state, applied.latency_s, in_speed_mode=not self._torque)
        (x, y, heading, vx, vy, yaw_rate), heading_rad, (vx_d, vy_d, yaw_rate_d), _ = predicted
        options = self._options
        kp, ki, kd = options.kp_1_s, options.ki_1_s2, options.kd
        ix, iy, ih = self._integral
        desired = (
            vx_d - kp * x - ki * ix - kd * vx,
            vy_d - kp * y - ki * iy - kd * vy,
            yaw_rate_d - kp * heading - ki * ih - kd * yaw_rate,
        )
        if not applied.saturated:
            self._integral = ix + dt_s * x, iy + dt_s * y, ih + dt_s * heading
        if not self._torque:
            return speed_command(self._model, desired, predicted, reference.acceleration)
        vx, vy, yaw_rate = state.twist
        twist_error = desired[0] - vx, desired[1] - vy, desired[2] - yaw_rate
        return self._by_wheel(self._model.wheel_speeds(twist_error, heading_rad), applied, dt_s)

    def _by_wheel(self, speed_error_rad_s: FourWheels, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the torque of each wheel's PI for its speed error [rad/s]."""
        kp, ki = self._options.wheel_kp_n_m_s_rad, self._options.wheel_ki_n_m_rad
        fl, fr, rr, rl = speed_error_rad_s
        ifl, ifr, irr, irl = self._wheel_integral
        torque = Wheels(kp * fl + ki * ifl, kp * fr + ki * ifr, kp * rr + ki * irr, kp * rl + ki * irl)
        if not applied.saturated:
            self._wheel_integral = Wheels(ifl + dt_s * fl, ifr + dt_s * fr, irr + dt_s * rr, irl + dt_s * rl)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)
