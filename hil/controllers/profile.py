"""The time-optimal square-root profile with observer and delay prediction, on the diagonals of the wheels."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from hil.controllers.observer import ExtendedStateObserver
from hil.controllers.prediction import CommandsOnTheirWay, forward
from hil.kinematics import wrap_angle
from hil.model import FRICTION_SPEED_RAD_S, RobotModel
from hil.options import require_positive
from hil.types import (
    NAN,
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Gains,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)

_SQRT2 = math.sqrt(2.0)


class Profile:
    """PROFILE"""

    @dataclass(frozen=True, slots=True)
    class Options:
        """O."""

        k1_1_s: float = 18.0
        k2_1_s: float = 60.0
        braking_share: float = 0.85
        heading_k1_1_s: float = 12.0
        heading_braking_share: float = 0.3
        observer_rad_s: float = 60.0

        def __post_init__(self) -> None:
            require_positive(self, "k1_1_s", "k2_1_s", "observer_rad_s")

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._o = options
        self._pair_m_s2 = 2.0 * _SQRT2 * model.torque_limit_n_m / (model.wheel_radius_m * model.effective_mass_kg)
        self._yaw_rad_s2 = 4.0 * model.torque_limit_n_m * model.lever_m / (
            model.wheel_radius_m * model.effective_inertia_kg_m2
        )
        limit = self._pair_m_s2
        self._obs = tuple(ExtendedStateObserver(options.observer_rad_s, l) for l in (limit, limit, self._yaw_rad_s2))
        self._way = CommandsOnTheirWay()
        self._commanded = Acceleration(0.0, 0.0, 0.0)
        self.gains = Gains(*[options.k1_1_s] * 3, *[options.k2_1_s] * 3)

    def reset(self, state: State, reference: Reference) -> None:
        for obs, x, v in zip(self._obs, state.pose, state.twist, strict=True):
            obs.reset(x, v)
        self._way.reset()
        self._commanded = Acceleration(0.0, 0.0, 0.0)
        self._fresh = True

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        model = self._model
        o = self._o
        latency = applied.latency_s
        ox, oy, oh = self._obs
        if self._fresh:
            self._fresh = False
        else:
            moved = self._way.advance(self._commanded, latency, dt_s)
            ox.update(state.pose.x_m, moved.x_m, moved.vx_m_s, dt_s)
            oy.update(state.pose.y_m, moved.y_m, moved.vy_m_s, dt_s)
            oh.update(state.pose.heading_rad, moved.heading_rad, moved.yaw_rate_rad_s, dt_s)
        d = Acceleration(ox.disturbance, oy.disturbance, oh.disturbance)
        here = State(type(state.pose)(ox.position, oy.position, oh.position), Twist(ox.rate, oy.rate, oh.rate))
        (x, y, h), (vx, vy, w) = forward(here, d, self._way.ahead(latency), latency)
        (rx, ry, rh), (rvx, rvy, rw), (rax, ray, rah) = reference
        half = 0.5 * latency
        ex = x - rx - latency * (rvx + half * rax)
        ey = y - ry - latency * (rvy + half * ray)
        eh = wrap_angle(h - rh - latency * (rw + half * rah))
        dvx = vx - rvx - latency * rax
        dvy = vy - rvy - latency * ray
        dw = w - rw - latency * rah
        # axes
        hm = h + 0.5 * dt_s * w
        c, s = math.cos(hm), math.sin(hm)
        # pair A FL, RR along (1,-1)/sqrt2 body ; pair B FR, RL along (1,1)/sqrt2
        bx, by = (c - s) / _SQRT2, (s + c) / _SQRT2
        ax, ay = by, -bx
        k2 = -math.expm1(-o.k2_1_s * dt_s) / dt_s
        g = o.braking_share * self._pair_m_s2
        ua = wanted(ex * ax + ey * ay, dvx * ax + dvy * ay, o.k1_1_s, k2, g)
        ub = wanted(ex * bx + ey * by, dvx * bx + dvy * by, o.k1_1_s, k2, g)
        uh = wanted(eh, dw, o.heading_k1_1_s, k2, o.heading_braking_share * self._yaw_rad_s2)
        # accelerations, world
        fx, fy = rax - d.ax_m_s2, ray - d.ay_m_s2
        couple = model.wheels_mass_kg / model.effective_mass_kg * w
        fx += couple * vy
        fy -= couple * vx
        ua += fx * ax + fy * ay
        ub += fx * bx + fy * by
        uh += rah - d.yaw_rad_s2
        friction_at = model.wheel_speeds(Twist(rvx, rvy, rw), h)
        xi = Wheels(*(model.wheel_friction_n_m * math.tanh(v / FRICTION_SPEED_RAD_S) for v in friction_at))
        to_t = model.wheel_radius_m * model.effective_mass_kg / (2.0 * _SQRT2)
        turn = model.wheel_radius_m * model.effective_inertia_kg_m2 / (4.0 * model.lever_m) * uh
        torque, ta, tb, n = allocate(ua * to_t, ub * to_t, turn, xi, model.torque_limit_n_m)
        ua, ub = ta / to_t, tb / to_t
        self._commanded = Acceleration(
            ua * ax + ub * bx - couple * vy,
            ua * ay + ub * by + couple * vx,
            n * (4.0 * model.lever_m) / (model.wheel_radius_m * model.effective_inertia_kg_m2),
        )
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)


def wanted(e: float, v: float, k1: float, k2: float, a: float) -> float:
    rho = abs(e)
    rl = a / (k1 * k1)
    if rho <= rl:
        return -k1 * v + k2 * (-k1 * e - v)
    speed = math.sqrt(2.0 * a * (rho - 0.5 * rl))
    wish = -math.copysign(speed, e)
    return -a / speed * v + k2 * (wish - v)


def allocate(ta: float, tb: float, n: float, xi: Wheels, limit: float):
    fl, fr, rr, rl = xi
    ta, lo_a, hi_a = _pair(ta, fl, rr, limit)
    tb, lo_b, hi_b = _pair(tb, rl, fr, limit)
    a = min(max(n, lo_a), hi_a)
    b = min(max(2.0 * n - a, lo_b), hi_b)
    a = min(max(2.0 * n - b, lo_a), hi_a)
    return Wheels(ta + fl - a, tb + fr + b, ta + rr + a, tb + rl - b), ta, tb, 0.5 * (a + b)


def _pair(t: float, minus: float, plus: float, limit: float):
    """Wheels t + minus - a and t + plus + a within the limit."""
    mean = 0.5 * (minus + plus)
    t = min(max(t, -limit - mean), limit - mean)
    lo = max(t + minus - limit, -limit - t - plus)
    hi = min(t + minus + limit, limit - t - plus)
    return t, lo, hi
