"""PID with kinematics: what is usually on such a robot, and needs no more of it than its geometry."""

from dataclasses import dataclass

from hil.core.model import RobotModel
from hil.core.options import require_not_negative, require_positive
from hil.core.types import NO_GAINS, ZERO_WHEELS, Applied, Axes, CommandMode, Reference, State, WheelCommand, Wheels
from hil.laws.ahead import carried_on
from hil.laws.wheel_commands import speed_command


class Pid:
    """PID with kinematics: a PID an axis sets the speed, the kinematics share it out to the wheels.

    v = q̇_d - Kp e - Ki ∫e - Kd ė, worked out for when it takes effect by the measured speed. In SPEED mode the
    firmware's speed loop follows v, with the torque feedforward of the reference as with every law. In TORQUE mode
    a PI a wheel does it here, on ω = H Rᵀ q̇ / r, and knows neither mass nor friction. While the guard scales the
    wheels, all integrals stand still.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes: Kp [1/s], Ki [1/s²], Kd [1]; and of a wheel's PI in TORQUE mode."""

        kp_1_s: float = 8.0
        ki_1_s2: float = 4.0
        kd: float = 0.0
        wheel_kp_n_m_s_rad: float = 1.1
        wheel_ki_n_m_rad: float = 12.0

        def __post_init__(self) -> None:
            require_positive(self, "kp_1_s", "wheel_kp_n_m_s_rad")
            require_not_negative(self, "ki_1_s2", "kd", "wheel_ki_n_m_rad")

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._options = options
        self._torque = mode is CommandMode.TORQUE
        self._integral: Axes = (0.0, 0.0, 0.0)
        self._wheel_integral = ZERO_WHEELS

    def reset(self, state: State, reference: Reference) -> None:
        """Empty the integrals."""
        self._integral = (0.0, 0.0, 0.0)
        self._wheel_integral = ZERO_WHEELS

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        error, heading_rad, moving, _ = carried_on(reference, state, applied.latency_s)
        options = self._options
        kp, ki, kd = options.kp_1_s, options.ki_1_s2, options.kd
        x, y, heading, vx, vy, yaw_rate = error
        ix, iy, ih = self._integral
        vx_d, vy_d, yaw_rate_d = moving
        wanted = (
            vx_d - kp * x - ki * ix - kd * vx,
            vy_d - kp * y - ki * iy - kd * vy,
            yaw_rate_d - kp * heading - ki * ih - kd * yaw_rate,
        )
        if not applied.saturated:
            self._integral = ix + dt_s * x, iy + dt_s * y, ih + dt_s * heading
        if not self._torque:
            return speed_command(self._model, wanted, heading_rad, moving, reference.acceleration)
        vx, vy, yaw_rate = state.twist
        lacking = wanted[0] - vx, wanted[1] - vy, wanted[2] - yaw_rate
        return self._by_wheel(self._model.wheel_speeds(lacking, heading_rad), applied, dt_s)

    def _by_wheel(self, lacking_rad_s: Wheels, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the torques of each wheel's PI for the speed that it lacks."""
        kp, ki = self._options.wheel_kp_n_m_s_rad, self._options.wheel_ki_n_m_rad
        fl, fr, rr, rl = lacking_rad_s
        ifl, ifr, irr, irl = self._wheel_integral
        torque = Wheels(kp * fl + ki * ifl, kp * fr + ki * ifr, kp * rr + ki * irr, kp * rl + ki * irl)
        if not applied.saturated:
            self._wheel_integral = Wheels(ifl + dt_s * fl, ifr + dt_s * fr, irr + dt_s * rr, irl + dt_s * rl)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)
