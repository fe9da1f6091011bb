"""Time-optimal square-root profile with observer and delay prediction, one axis for each diagonal pair of wheels.

Derivation, options and figures: PROFILE.md beside this file.
"""

import math
from dataclasses import dataclass

from hil.core.model import RobotModel
from hil.core.options import require_positive
from hil.core.types import (
    NAN,
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    FourWheels,
    Gains,
    Reference,
    State,
    WheelCommand,
)
from hil.laws.ahead import Ahead, TorquePrediction, carried_on
from hil.laws.diagonals import SQRT2, allocate, directions, within
from hil.laws.observer import ExtendedStateObserver
from hil.laws.wheel_commands import speed_command

# Of the yaw acceleration and the yaw rate that wheels which only turn the robot would give. Pushing goes first: of the
# torque little can be counted on, and of the speed little may be taken.
_TURNING_SHARE = 0.3
# How far in time the set points may be from the speeds. Further away the firmware's limit would have the wheels that
# have most to gain drag the others backwards, which it takes for a fault (WRONG_DIRECTION).
_STEP_S = 0.05
# By so much less than the limits of torque and speed, that no rounding takes a wheel beyond them.
_ROUNDING = 1e-12


class Profile:
    """Time-optimal square-root profile: brakes as late as the torque allows, whatever the latency.

    In TORQUE mode an observer an axis finds friction and a wrong mass, and the state is taken forward by the latency
    from the commands on their way. In SPEED mode the profile gives the set points and the firmware's speed loop does
    the rest; the gain is then ``speed_k1_1_s``, and the observer has no part in it.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains [1/s], the share of the torque to brake with, the observers' bandwidth [rad/s], a lag [s].

        ``k1_1_s`` and ``k2_1_s`` are the two poles close to the reference in TORQUE mode, ``speed_k1_1_s`` is the one
        in SPEED mode. ``braking_share`` is what a robot that is heavier than believed still has: 0.85 with 20 % more
        mass. ``speed_lag_s`` is how late the firmware's estimate of a wheel's speed is, 2 / tracking_bandwidth_rad_s.
        With ``keeps_speed_limit`` the profile stays within the robot's wheel speed limit in TORQUE mode too, where
        nothing else keeps it and no other law does; in SPEED mode it always does.
        """

        k1_1_s: float = 20.0
        k2_1_s: float = 50.0
        braking_share: float = 0.85
        observer_rad_s: float = 70.0
        speed_k1_1_s: float = 12.0
        speed_lag_s: float = 0.0133
        keeps_speed_limit: bool = True

        def __post_init__(self) -> None:
            require_positive(self, "k1_1_s", "k2_1_s", "braking_share", "observer_rad_s", "speed_k1_1_s")
            if self.braking_share > 1.0:
                raise ValueError(f"braking_share = {self.braking_share!r}: expected at most 1, all the torque")
            if self.speed_lag_s < 0.0:
                raise ValueError(f"speed_lag_s = {self.speed_lag_s!r}: expected zero or more")

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._k1 = k1 = options.k1_1_s if self._torque else options.speed_k1_1_s
        self._speed_lag_s = options.speed_lag_s
        self._k2 = k2 = options.k2_1_s if self._torque else NAN
        self.gains = Gains(k1, k1, k1, k2, k2, k2)
        self._push_n_m_per_m_s2 = model.wheel_radius_m * model.effective_mass_kg / (2.0 * SQRT2)
        self._turn_n_m_per_rad_s2 = model.wheel_radius_m * model.effective_inertia_kg_m2 / (4.0 * model.lever_m)
        push_m_s2 = model.torque_limit_n_m / self._push_n_m_per_m_s2
        turn_rad_s2 = model.torque_limit_n_m / self._turn_n_m_per_rad_s2
        self._braking_m_s2 = options.braking_share * push_m_s2
        self._turn_braking_rad_s2 = _TURNING_SHARE * turn_rad_s2
        self._push_step_m_s = _STEP_S * push_m_s2
        self._turn_step_rad_s = _STEP_S * turn_rad_s2
        self._torque_limit_n_m = model.torque_limit_n_m * (1.0 - _ROUNDING)
        keeps = options.keeps_speed_limit or not self._torque
        rim_speed_m_s = model.speed_limit_rad_s * model.wheel_radius_m * (1.0 - _ROUNDING)
        self._rim_speed_m_s = rim_speed_m_s if keeps else math.inf
        self._turn_rad_s = _TURNING_SHARE * self._rim_speed_m_s / model.lever_m
        limits = (push_m_s2, push_m_s2, turn_rad_s2)
        observers = tuple(ExtendedStateObserver(options.observer_rad_s, limit) for limit in limits)
        self._prediction = TorquePrediction(model, observers, from_observers=True)

    def reset(self, state: State, reference: Reference) -> None:
        """Begin at this state, with nothing commanded and no disturbance."""
        self._prediction.reset(state)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command that acts ``applied.latency_s`` from now, in TORQUE mode within the torque limit."""
        if self._torque:
            ahead = self._prediction.ahead(reference, state, applied, dt_s)
            return self._torque_command(reference.acceleration, ahead, dt_s)
        return self._speed_command(reference, state, applied.latency_s, dt_s)

    def _torque_command(self, acceleration: Acceleration, ahead: Ahead, dt_s: float) -> WheelCommand:
        """Return τ for q̈ = q̈_d + ẇ(e) + K2 (w(e) - ė) - d, an axis each for the two pairs and the heading."""
        model = self._model
        (x, y, turned, vx_e, vy_e, now_turn), heading, (vx_d, vy_d, yaw_rate_d), (vx, vy, yaw_rate) = ahead
        # The torque is held for a tick: where the wheels push to is taken at the middle of it.
        x1, y1, x2, y2 = directions(heading + 0.5 * dt_s * yaw_rate)
        along_1, along_2 = vx_d * x1 + vy_d * y1, vx_d * x2 + vy_d * y2
        now_1, now_2 = vx_e * x1 + vy_e * y1, vx_e * x2 + vy_e * y2
        k1, braking = self._k1, self._braking_m_s2
        limit = self._turn_rad_s
        turn, turn_slope = profile(turned, now_turn, k1, self._turn_braking_rad_s2, -limit, limit)
        limit = self._push_speed_m_s(yaw_rate)
        rate_1, slope_1 = profile(x * x1 + y * y1, now_1, k1, braking, -limit - along_1, limit - along_1)
        rate_2, slope_2 = profile(x * x2 + y * y2, now_2, k1, braking, -limit - along_2, limit - along_2)
        # What brings ė to w within a tick as a pole at K2 does: exact for an acceleration that is held.
        k2 = -math.expm1(-self._k2 * dt_s) / dt_s
        coupling = model.wheels_mass_kg / model.effective_mass_kg * yaw_rate
        ax, ay, yaw_acceleration = acceleration
        zx, zy, zh = self._prediction.disturbance
        known_x = ax - zx + coupling * vy
        known_y = ay - zy - coupling * vx
        to_push, to_turn = self._push_n_m_per_m_s2, self._turn_n_m_per_rad_s2
        torque, push_1, push_2, turn = allocate(
            to_push * (known_x * x1 + known_y * y1 + slope_1 + k2 * (rate_1 - now_1)),
            to_push * (known_x * x2 + known_y * y2 + slope_2 + k2 * (rate_2 - now_2)),
            to_turn * (yaw_acceleration - zh + turn_slope + k2 * (turn - now_turn)),
            self._friction(along_1, along_2, yaw_rate_d),
            self._torque_limit_n_m,
        )
        push_1, push_2 = push_1 / to_push, push_2 / to_push
        pushed = push_1 * x1 + push_2 * x2 - coupling * vy, push_1 * y1 + push_2 * y2 + coupling * vx, turn / to_turn
        self._prediction.remember(torque, pushed)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)

    def _speed_command(self, reference: Reference, state: State, latency_s: float, dt_s: float) -> WheelCommand:
        """Return ω for q̇ = q̇_d + w(e), and the torque that the reference and the profile's own slope take.

        The robot is ahead by its own speed, and by the reference's acceleration, which is in both.
        """
        model = self._model
        (x, y, turned, vx, vy, yaw_rate), heading, moving, _ = carried_on(reference, state, latency_s)
        vx_d, vy_d, yaw_rate_d = moving
        ax, ay, yaw_acceleration = reference.acceleration
        x1, y1, x2, y2 = directions(heading)
        along_1, along_2 = vx_d * x1 + vy_d * y1, vx_d * x2 + vy_d * y2
        k1, braking = self._k1, self._braking_m_s2
        limit, step = self._turn_rad_s, self._turn_step_rad_s
        low, high = _range(-limit, limit, yaw_rate, step)
        turn, turn_slope = profile(turned, yaw_rate, k1, self._turn_braking_rad_s2, low, high)
        limit, step = self._push_speed_m_s(yaw_rate_d + turn), self._push_step_m_s
        now_1, now_2 = vx * x1 + vy * y1, vx * x2 + vy * y2
        low, high = _range(-limit - along_1, limit - along_1, now_1, step)
        rate_1, slope_1 = profile(x * x1 + y * y1, now_1, k1, braking, low, high)
        low, high = _range(-limit - along_2, limit - along_2, now_2, step)
        rate_2, slope_2 = profile(x * x2 + y * y2, now_2, k1, braking, low, high)
        # What the profile asks for on the way, no more than in step with it: its noise is not fed forward.
        slope_1, slope_2 = slope_1 * in_step(now_1, rate_1), slope_2 * in_step(now_2, rate_2)
        ax, ay = ax + slope_1 * x1 + slope_2 * x2, ay + slope_1 * y1 + slope_2 * y2
        yaw_acceleration += turn_slope * in_step(yaw_rate, turn)
        # In the middle of the tick, and less by what the wheels run ahead of the speed that the firmware measures.
        lead_s = 0.5 * dt_s - self._speed_lag_s
        # The limit comes last: over the lead, the reference, and how far the set points may be from the speeds.
        turn = within(yaw_rate_d + turn + lead_s * yaw_acceleration, self._rim_speed_m_s / model.lever_m)
        limit = self._push_speed_m_s(turn)
        push_1 = within(along_1 + rate_1 + lead_s * (ax * x1 + ay * y1), limit)
        push_2 = within(along_2 + rate_2 + lead_s * (ax * x2 + ay * y2), limit)
        wanted = push_1 * x1 + push_2 * x2, push_1 * y1 + push_2 * y2, turn
        return speed_command(model, wanted, heading, moving, (ax, ay, yaw_acceleration))

    def _push_speed_m_s(self, yaw_rate_rad_s: float) -> float:
        """Return the speed limit along a diagonal: a wheel's rim runs √2 as fast, and L times the yaw rate."""
        return max(self._rim_speed_m_s - self._model.lever_m * abs(yaw_rate_rad_s), 0.0) / SQRT2

    def _friction(self, along_1_m_s: float, along_2_m_s: float, yaw_rate_rad_s: float) -> FourWheels:
        """Return the friction torques at the speeds of the reference: no noise comes back through them."""
        scale = 1.0 / self._model.wheel_radius_m
        push_1, push_2 = SQRT2 * scale * along_1_m_s, SQRT2 * scale * along_2_m_s
        turn = scale * self._model.lever_m * yaw_rate_rad_s
        return self._model.friction_torques((push_1 - turn, push_2 + turn, push_1 + turn, push_2 - turn))


def profile(error: float, rate: float, k1: float, braking: float, low: float, high: float) -> tuple[float, float]:
    """Return w(e) = -sign(e) min(K1 ρ, √(2 a (ρ - ρl/2))) with ρ = abs(e), ρl = a / K1², and ẇ = w'(e) ė.

    Far away w is the rate from which ``braking`` a just leads to the linear part, which begins at ρl with the same
    rate and the same slope. ``rate`` is ė. Where w would leave ``low`` to ``high`` it stands there.
    """
    distance = abs(error)
    linear = braking / (k1 * k1)
    if distance <= linear:
        wanted, slope = -k1 * error, -k1 * rate
    else:
        fast = math.sqrt(2.0 * braking * (distance - 0.5 * linear))
        wanted, slope = -math.copysign(fast, error), -braking / fast * rate
    if wanted > high:
        return high, 0.0
    return (low, 0.0) if wanted < low else (wanted, slope)


def _range(low: float, high: float, now: float, step: float) -> tuple[float, float]:
    """Return the range from ``low`` to ``high`` within ``step`` of ``now``, or where that is none, the nearest to it.

    A rate beyond a limit by more than a step comes back to it by a step at a time.
    """
    least, most = now - step, now + step
    return min(max(low, least), most), max(min(high, most), least)


def in_step(rate: float, wanted: float) -> float:
    """Return how much of ``rate`` is on the way that ``wanted`` asks for: 1 for as fast or more slowly, less beyond.

    None of a rate that is NaN.
    """
    return min(1.0, wanted / rate) if rate * wanted > 0.0 else 0.0
