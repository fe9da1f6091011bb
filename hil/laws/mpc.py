"""Model predictive control: each tick the best plan within the limits of the wheels, of which the first move is taken.

The error e = q - q_d and its rate are seen in the axes that the body has when the command acts. Over the horizon, a
fraction of a second, these axes and the reference's velocity and acceleration are taken as constant. Each axis is then
a double integrator, and the limits of the wheels are linear with coefficients that never change:

    e⁺ = e + h ė + h² u / 2,    ė⁺ = ė + h u,    u = q̈ - q̈_d
    -τ_max <= B⁺ (M (q̈_d - ẑ + u) + C) + ξ <= τ_max
    -ω_max <= H (q̇_d + ė) / r <= ω_max                  softly: the robot may already be faster

The plan minimises the sum of eᵀ Q e + ėᵀ R ė + uᵀ u over N steps of h, and what an LQR without limits would cost from
there on. So where no limit binds, the optimum is that LQR's feedback, and takes no solver. Else OSQP solves the
quadratic program (B. Stellato et al., "OSQP: an operator splitting solver for quadratic programs", Math. Prog. Comp.
12, 2020), from the solution of the tick before and within a fixed number of iterations.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from hil.core.extras import need
from hil.core.kinematics import BodyTwist, to_body, to_world
from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.types import NO_GAINS, Applied, CommandMode, FourWheels, Pairs, Reference, State, Twist, WheelCommand
from hil.laws.lqi import Array, lqr_cost, lqr_gain
from hil.laws.prediction import DelayPredictor, ExtendedStateObserver, require_torque

_DISTURBANCE_LIMITS = (3.0, 3.0, 10.0)  # [m/s², m/s², rad/s²]
# Cost of 1 (rad/s)² above the speed limit: tenths of 1 rad/s are left in a rush from half a metre.
_EXCESS_WEIGHT = 1e5
# The solver is done when a plan is this accurate: torques [N·m] and speeds [rad/s], and the share of the gradient.
_ACCURACY, _GRADIENT_SHARE = 1e-3, 1e-4
# Step of the operator splitting. It stays, because one that adapts itself would depend on plans long past.
_RHO = 1.0


class Mpc:
    """Model predictive control over OSQP: the plan keeps torques and speeds of the wheels within their limits.

    It computes torques, so it refuses SPEED mode with BadInputError. It needs the extra ``mpc``, and raises
    BadInputError without. ``iterations`` is the number of the solver's in the last update: 0 where no limit bound.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Horizon [s] and its steps, weights of e² and ė² for an input of weight 1, bandwidth of the observer [rad/s].

        A step is at least a tick, so the horizon of a slow loop is longer. ``later_share`` is the share of the torque
        limit that the plan counts on after its first step: a robot that is heavier than believed then still brakes in
        time. ``most_iterations`` bounds the work of a tick: of a plan that is not found by then, the solver's last is
        used.
        """

        horizon_s: Annotated[float, Range(ge=0.02, le=5)] = 0.4
        steps: Annotated[int, Range(ge=2, le=100)] = 16
        error_1_s4: Annotated[float, Range(gt=0, le=1e10)] = 1.0e6
        rate_1_s2: Annotated[float, Range(gt=0, le=1e8)] = 2.9e3
        later_share: Annotated[float, Range(gt=0, le=1)] = 0.8
        observer_rad_s: Annotated[float, RATE] = 60.0
        most_iterations: Annotated[int, Range(ge=10, le=100_000)] = 200

    gains = NO_GAINS

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        need("mpc", "controller.law = 'mpc'")
        require_torque("mpc", mode, "profile")
        self._model = model
        self._options = options
        observers = tuple(ExtendedStateObserver(options.observer_rad_s, limit) for limit in _DISTURBANCE_LIMITS)
        self._predictor = DelayPredictor(model, observers)
        self._plans: _Plans | None = None
        self.iterations = 0

    def reset(self, state: State, reference: Reference) -> None:
        """Discard the last plan, the commands that do not act yet, and the disturbance."""
        self._predictor.reset(state)
        if self._plans is not None:
            self._plans.forget()

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the torques of the plan's first step; they keep the limit as exactly as the solver is accurate."""
        model, plans = self._model, self._plans
        if plans is None:
            plans = self._plans = _Plans(model, self._options, dt_s)
        predicted = self._predictor.predict(reference, state, applied, dt_s)
        (x, y, heading_error, vx, vy, yaw_rate), heading, twist_d, twist = predicted
        error, rate = to_body(Twist(x, y, heading_error), heading), to_body(Twist(vx, vy, yaw_rate), heading)
        (ax, ay, ah), (zx, zy, zh) = reference.acceleration, self._predictor.disturbance
        ax, ay, ah = ax - zx, ay - zy, ah - zh
        torque = model.wheel_torques((ax, ay, ah), twist, heading, twist_d)
        move, self.iterations = plans.first_move((*error, *rate), torque, model.wheel_speeds(twist_d, heading))
        ux, uy, uh = to_world(move, heading)
        return self._predictor.command((ax + ux, ay + uy, ah + uh), predicted)


class _Plans:
    """The quadratic program of a plan u_0, x_1, u_1, x_2 ... with x = (e, ė), and excess speeds E of the wheels:

        minimise  ½ Σ (xᵀ Q x + uᵀ u + w Eᵀ E) + ½ x_Nᵀ S x_N
        within    x_{k+1} = A x_k + B u_k,    abs(T u_k + τ) <= τ_k,    abs(V x_{k+1} + ω_d + E_k) <= ω_max

    From tick to tick only the bounds of its rows change, so its matrix is factorised once.
    """

    def __init__(self, model: RobotModel, options: Mpc.Options, dt_s: float) -> None:
        self._options = options
        h = max(options.horizon_s / options.steps, dt_s)
        one, none = np.eye(3), np.zeros((3, 3))
        self._a = np.block([[one, h * one], [none, one]])
        self._b = np.vstack([h * h / 2 * one, h * one])
        self._q = np.diag([options.error_1_s4] * 3 + [options.rate_1_s2] * 3)
        axes, still = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)
        self._torques = np.array([model.wheel_torques(axis, still, 0.0, still) for axis in axes]).T
        speeds = np.array([model.wheel_speeds(axis, 0.0) for axis in axes]).T
        self._speeds = np.hstack([0.0 * speeds, speeds])
        # Friction takes its torque in any plan.
        torque = max(model.torque_limit_n_m, model.wheel_friction_n_m)
        shares = np.array([1.0, *[options.later_share] * (options.steps - 1)])
        self._limits = np.hstack(
            [np.outer(shares * torque, np.ones(4)), np.full((options.steps, 4), model.speed_limit_rad_s)]
        )
        self._gain = lqr_gain(self._a, self._b, self._q, one)
        closed = self._a - self._b @ self._gain
        ahead = [np.linalg.matrix_power(closed, k) for k in range(options.steps + 1)]
        # Torques and speeds of the wheels along the path that the LQR takes, from x.
        self._reached = np.array(
            [np.vstack([-self._torques @ self._gain @ now, self._speeds @ then]) for now, then in pairwise(ahead)]
        )
        self._solver: Any = None

    def forget(self) -> None:
        """Forget the last plan, from which the solver would start."""
        self._solver = None

    def first_move(self, start: Pairs, torque_n_m: FourWheels, speed_rad_s: FourWheels) -> tuple[BodyTwist, int]:
        """Return the acceleration u in the body's axes in the first step, and the iterations that it took.

        ``start`` is (e, ė) in these axes; torque and speed are those of the wheels for u = 0 and for ė = 0.
        """
        x, known = np.array(start), np.array([*torque_n_m, *speed_rad_s])
        low, high = -self._limits - known, self._limits - known
        reached = self._reached @ x
        # A state that is NaN breaks no limit, and its result is NaN too.
        if not ((reached < low) | (reached > high)).any():
            return BodyTwist(*(-self._gain @ x).tolist()), 0
        steps = self._options.steps
        begin = np.concatenate([self._a @ x, np.zeros(6 * steps - 6)])
        low, high = (np.concatenate([begin, side[:, :4].ravel(), side[:, 4:].ravel()]) for side in (low, high))
        if self._solver is None:
            self._solver = self._new_solver(low, high)
        self._solver.update(l=low, u=high)
        result = self._solver.solve(raise_error=False)
        return BodyTwist(*result.x[:3].tolist()), int(result.info.iter)

    def _new_solver(self, low: Array, high: Array) -> Any:
        import osqp
        from scipy.sparse import csc_matrix

        count = self._options.steps
        one, last, excess = np.eye(count), np.diag([*[0.0] * (count - 1), 1.0]), np.eye(4 * count)
        moves = np.vstack([np.kron(one, -self._b), np.kron(one, self._torques), np.zeros((4 * count, 3 * count))])
        after = np.eye(6 * count) - np.kron(np.eye(count, k=-1), self._a)
        states = np.vstack([after, np.zeros((4 * count, 6 * count)), np.kron(one, self._speeds)])
        rows = np.hstack([moves, states, np.vstack([np.zeros((10 * count, 4 * count)), excess])])
        end = lqr_cost(self._a, self._b, self._q, np.eye(3))
        cost = np.zeros((13 * count, 13 * count))
        cost[: 3 * count, : 3 * count] = np.eye(3 * count)
        cost[3 * count : 9 * count, 3 * count : 9 * count] = np.kron(one - last, self._q) + np.kron(last, end)
        cost[9 * count :, 9 * count :] = _EXCESS_WEIGHT * excess
        solver = osqp.OSQP(algebra="builtin")
        solver.setup(
            csc_matrix(cost),
            np.zeros(13 * count),
            csc_matrix(rows),
            low,
            high,
            verbose=False,
            eps_abs=_ACCURACY,
            eps_rel=_GRADIENT_SHARE,
            adaptive_rho=False,
            rho=_RHO,
            max_iter=self._options.most_iterations,
            check_termination=10,
        )
        return solver
