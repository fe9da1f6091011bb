"""LQI: linear-quadratic control with the integral of the error as a state, on the model's feedforward."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.options import Range
from hil.core.types import NO_GAINS, Applied, Axes, CommandMode, Reference, State, WheelCommand
from hil.laws.prediction import DelayPredictor, extrapolate, speed_command

Array = NDArray[np.float64]
_DOUBLINGS = 60


def lqr_cost(a: Array, b: Array, q: Array, r: Array) -> Array:
    """Return S of xᵀ S x, the least sum of xᵀ Q x + uᵀ R u over all ticks of x⁺ = A x + B u.

    ``a`` is n by n, ``b`` n by m, ``q`` n by n, ``r`` m by m and invertible; S is n by n. The Riccati equation is
    solved by structured doubling, which squares the closed loop at every step (E. K.-W. Chu et al., "A structure
    preserving doubling algorithm for periodic discrete-time algebraic Riccati equations", Int. J. Control 77,
    2004). Raises ValueError where it does not converge: the pair (A, B) cannot be stabilised.
    """
    identity = np.eye(len(a))
    # Over k ticks: A is the transition, G the reach of the inputs, and H the cost, which tends to the solution.
    transition, reached, cost = a, b @ np.linalg.solve(r, b.T), q
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            shared = np.linalg.inv(identity + reached @ cost)
            step = transition.T @ cost @ shared @ transition
            transition, reached, cost = (
                transition @ shared @ transition,
                reached + transition @ shared @ reached @ transition.T,
                cost + step,
            )
            if not np.isfinite(cost).all():
                break
            if np.abs(step).max() <= 1e-14 * np.abs(cost).max():
                return np.asarray(cost, dtype=np.float64)
    raise ValueError("the Riccati equation has no stabilising solution for these weights")


def lqr_gain(a: Array, b: Array, q: Array, r: Array) -> Array:
    """Return K, m by n, of the input u = -K x that has the cost of ``lqr_cost``. Raises as that does."""
    cost = lqr_cost(a, b, q, r)
    return np.asarray(np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a), dtype=np.float64)


class Lqi:
    """LQI with feedforward and latency compensation.

    In TORQUE mode each axis is a double integrator with the states ∫e, e and ė; its input is the acceleration in
    addition to the reference's. In SPEED mode it is an integrator with the states ∫e and e; its input is the speed in
    addition to the reference's. The gains solve the discrete Riccati equation for the period of the first tick. They
    stay constant, so a skipped tick changes nothing. The integral stops while the guard scales the command.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Weights of ∫e², e² and ė² in the cost, for all axes. The square of the input has the weight 1.

        The input is an acceleration in TORQUE mode and a speed in SPEED mode: each mode has its own weights.
        """

        torque_integral_1_s6: Annotated[float, Range(gt=0, le=1e12)] = 2.0e5
        torque_error_1_s4: Annotated[float, Range(gt=0, le=1e10)] = 4.0e4
        torque_rate_1_s2: Annotated[float, Range(gt=0, le=1e8)] = 400.0
        speed_integral_1_s4: Annotated[float, Range(gt=0, le=1e8)] = 400.0
        speed_error_1_s2: Annotated[float, Range(gt=0, le=1e6)] = 64.0

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._options = options
        self._torque = mode is CommandMode.TORQUE
        self._predictor = DelayPredictor(model)
        self._feedback: tuple[float, ...] = ()
        self._integral: Axes

    def reset(self, state: State, reference: Reference) -> None:
        """Reset the integral, and discard the commands that do not act yet."""
        self._integral = (0.0, 0.0, 0.0)
        self._predictor.reset(state)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        if not self._feedback:
            self._feedback = _feedback(self._options, self._torque, dt_s)
        ki, kp, kd = self._feedback
        if self._torque:
            predicted = self._predictor.predict(reference, state, applied, dt_s)
            ax, ay, ah = reference.acceleration
        else:
            predicted = extrapolate(reference, state, applied.latency_s)
            _, _, (ax, ay, ah), _ = predicted
        ix, iy, ih = self._integral
        (x, y, heading, vx, vy, yaw_rate), *_ = predicted
        if not applied.saturated:
            self._integral = ix + dt_s * x, iy + dt_s * y, ih + dt_s * heading
        desired = (
            ax - ki * ix - kp * x - kd * vx,
            ay - ki * iy - kp * y - kd * vy,
            ah - ki * ih - kp * heading - kd * yaw_rate,
        )
        if self._torque:
            return self._predictor.command(desired, predicted)
        return speed_command(self._model, desired, predicted, reference.acceleration)


def _feedback(options: Lqi.Options, torque: bool, dt_s: float) -> tuple[float, ...]:
    """Return the gains of ∫e, e and ė for ticks of ``dt_s`` [s] with zero-order hold; that of ė is 0 in SPEED mode."""
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
        return (*lqr_gain(a, b, np.diag(weights), np.eye(1))[0].tolist(), 0.0)[:3]
    except (ValueError, np.linalg.LinAlgError) as error:
        raise BadInputError(
            f"controller.gains: no gains exist for the weights {weights} at {1.0 / t:g} Hz ({error}); take "
            "weights nearer to the defaults"
        ) from error
