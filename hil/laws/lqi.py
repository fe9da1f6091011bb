"""LQI: linear-quadratic control with the integral of the error as a state, on the model's feedforward."""

from dataclasses import dataclass

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.options import require_positive
from hil.core.types import NO_GAINS, Applied, Axes, CommandMode, Reference, State, WheelCommand
from hil.laws.ahead import Ahead, TorquePrediction, carried_on
from hil.laws.riccati import lqr_gain
from hil.laws.wheel_commands import speed_command


class Lqi:
    """LQI with feedforward, worked out for when the command takes effect.

    In TORQUE mode an axis is a double integrator of the acceleration asked for beyond the reference's, with the
    states ∫e, e and ė; in SPEED mode an integrator of the speed beyond the reference's, with ∫e and e. The gains
    are those of the discrete Riccati equation for the period of the first tick, and stay: a skipped tick changes
    nothing. While the guard scales the wheels the integral stands still.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Weights of ∫e², e² and ė² in the cost, beside 1 for the square of what is asked for; of all axes.

        TORQUE asks for accelerations, SPEED for speeds: each mode has weights of its own.
        """

        torque_integral_1_s6: float = 2.0e5
        torque_error_1_s4: float = 4.0e4
        torque_rate_1_s2: float = 400.0
        speed_integral_1_s4: float = 400.0
        speed_error_1_s2: float = 64.0

        def __post_init__(self) -> None:
            require_positive(
                self,
                "torque_integral_1_s6",
                "torque_error_1_s4",
                "torque_rate_1_s2",
                "speed_integral_1_s4",
                "speed_error_1_s2",
            )

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._options = options
        self._torque = mode is CommandMode.TORQUE
        self._prediction = TorquePrediction(model)
        self._feedback: tuple[float, ...] = ()
        self._integral: Axes = (0.0, 0.0, 0.0)

    def reset(self, state: State, reference: Reference) -> None:
        """Empty the integral, and forget the commands on their way."""
        self._integral = (0.0, 0.0, 0.0)
        self._prediction.reset(state)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        if not self._feedback:
            self._feedback = _feedback(self._options, self._torque, dt_s)
        if not self._torque:
            return self._by_speed(reference, carried_on(reference, state, applied.latency_s), applied, dt_s)
        ahead = self._prediction.ahead(reference, state, applied, dt_s)
        ix, iy, ih = self._integrated(ahead, applied, dt_s)
        x, y, heading, vx, vy, yaw_rate = ahead.error
        ax, ay, ah = reference.acceleration
        ki, kp, kd = self._feedback
        asked = (
            ax - ki * ix - kp * x - kd * vx,
            ay - ki * iy - kp * y - kd * vy,
            ah - ki * ih - kp * heading - kd * yaw_rate,
        )
        return self._prediction.command(asked, ahead)

    def _by_speed(self, reference: Reference, ahead: Ahead, applied: Applied, dt_s: float) -> WheelCommand:
        ix, iy, ih = self._integrated(ahead, applied, dt_s)
        x, y, heading, _, _, _ = ahead.error
        vx, vy, yaw_rate = ahead.moving
        ki, kp = self._feedback
        wanted = vx - ki * ix - kp * x, vy - ki * iy - kp * y, yaw_rate - ki * ih - kp * heading
        return speed_command(self._model, wanted, ahead.heading_rad, ahead.moving, reference.acceleration)

    def _integrated(self, ahead: Ahead, applied: Applied, dt_s: float) -> Axes:
        """Return the integral of the error until now, and go on unless the guard limits the command."""
        integral = self._integral
        if not applied.saturated:
            ix, iy, ih = integral
            x, y, heading, _, _, _ = ahead.error
            self._integral = ix + dt_s * x, iy + dt_s * y, ih + dt_s * heading
        return integral


def _feedback(options: Lqi.Options, torque: bool, dt_s: float) -> tuple[float, ...]:
    """Return the gains of ∫e, e and, by torque, of ė for ticks of ``dt_s`` [s]: zero-order hold."""
    import numpy as np

    t = dt_s
    if torque:
        a = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
        b = np.array([[t**3 / 6], [t * t / 2], [t]])
        weights = [options.torque_integral_1_s6, options.torque_error_1_s4, options.torque_rate_1_s2]
    else:
        a = np.array([[1.0, t], [0.0, 1.0]])
        b = np.array([[t * t / 2], [t]])
        weights = [options.speed_integral_1_s4, options.speed_error_1_s2]
    try:
        return tuple(lqr_gain(a, b, np.diag(weights), np.eye(1))[0].tolist())
    except (ValueError, np.linalg.LinAlgError) as error:
        raise BadInputError(
            f"controller.gains: of the weights {weights} no gains follow at {1.0 / t:g} Hz ({error}); take some "
            "that are nearer to the defaults"
        ) from error
