"""Time-optimal square-root profile with observer and delay prediction, one axis for each diagonal pair of wheels.

PROFILE.md beside this file has the derivation, the options and figures. ``approach.py`` has
the pairs, and the way to a reference that is far.
"""

import math
from dataclasses import dataclass
from typing import Annotated

from hil.core.model import FRICTION_SPEED_RAD_S, RobotModel
from hil.core.options import RATE, Range
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
from hil.laws.adaptation import AccelerationShare
from hil.laws.approach import SQRT2, allocate, directions, even_turn, friction_share, profile, time_to_go, within
from hil.laws.prediction import DelayPredictor, ExtendedStateObserver, Prediction, extrapolate, speed_command

# Share of the largest yaw acceleration and yaw rate that the profile plans with. Pushing has priority, so little torque
# is certain to be left for turning, and turning may use little of the speed.
_TURNING_SHARE = 0.3
# Share of the wheels' speed that turning leaves for the way, and the share that it has in any case near the reference.
_KEPT_SHARE, _LEAST_TURNING_SHARE = 0.9, 0.05
# The reference is far from the first distance on until the second is reached [m]. Then K1 is larger by this factor,
# because an axis may go on to brake with all of its torque to its last few millimetres.
_FAR_M, _NEAR_M, _FAR_K1 = 0.1, 0.012, 2.0
# Largest yaw rate on the way [rad/s], and the share that is made of the turn that torque and time allow. A full turn
# would still take a part of the speed when the first axis reaches its largest one.
_SWING_RAD_S, _SWING_SHARE = 2.0, 0.7
# Largest change of the yaw rate, in units of the profile's braking. Measured wheel speeds are late: if a wheel changes
# its speed faster, the limiter sees slip.
_SWING_BRAKING = 1.2
# By how much one pair must be there earlier, so that turning has priority over its push [s].
_SPARE_S = 0.095
# Share of the believed friction that may be there in addition: the prior of the learnt friction.
_UNKNOWN_FRICTION = 0.5
# Least share of the torque to brake with, whatever reference and friction need of it.
_LEAST_BRAKING_SHARE = 0.2
# Latency and tick together up to which the gains are as configured.
_FULL_GAIN_S = 0.015
# How far set points may be from measured speeds, as time at full acceleration. Further away the torque limit would let
# the fastest wheels drag the others backwards, which the firmware reports as the fault WRONG_DIRECTION.
_STEP_S = 0.05
# Margin below the limits of torque and speed, so that rounding does not take a wheel beyond them.
_ROUNDING = 1e-12


# One axis: e [m], ė, the reference's own rate [m/s], the acceleration to brake with [m/s²], and the limits of w [m/s].
_Axis = tuple[float, float, float, float, float, float]


class Profile:
    """Time-optimal square-root profile: brakes as late as the torque allows, whatever the latency.

    In TORQUE mode an observer for each axis estimates unmodelled friction and mass, and the state is predicted over the
    latency from the commands that do not act yet. In SPEED mode the profile computes the set points of the firmware's
    speed loop. It then uses the gain ``speed_k1_1_s`` and no observer.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains [1/s], braking share, bandwidth of the observers [rad/s] and lag of the speed estimate [s].

        ``k1_1_s`` and ``k2_1_s`` are the two poles near the reference in TORQUE mode; in SPEED mode ``speed_k1_1_s``
        is the pole of x and y, ``speed_turn_k1_1_s`` that of the heading. ``braking_share`` is the share of the torque
        that the profile plans to brake with until it has learnt the mass: 0.85 suffices for a robot with 20 % more mass
        than configured. ``speed_lag_s`` is the delay of the firmware's estimate of a wheel's speed, 2 /
        tracking_bandwidth_rad_s. ``keeps_speed_limit`` applies to TORQUE mode, where no other law limits the wheel
        speed: with it the profile stays within the robot's wheel speed limit. In SPEED mode it always does.
        """

        k1_1_s: Annotated[float, RATE] = 20.0
        k2_1_s: Annotated[float, RATE] = 50.0
        braking_share: Annotated[float, Range(gt=0, le=1)] = 0.85
        observer_rad_s: Annotated[float, RATE] = 70.0
        speed_k1_1_s: Annotated[float, RATE] = 12.0
        speed_turn_k1_1_s: Annotated[float, RATE] = 4.0
        speed_lag_s: Annotated[float, Range(ge=0, le=1)] = 0.0133
        keeps_speed_limit: bool = True

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._k1 = k1 = options.k1_1_s if self._torque else options.speed_k1_1_s
        self._turn_k1 = turn_k1 = k1 if self._torque else options.speed_turn_k1_1_s
        self._speed_lag_s = options.speed_lag_s
        self._k2 = k2 = options.k2_1_s if self._torque else NAN
        self.gains = Gains(k1, k1, turn_k1, k2, k2, k2)
        self._push_n_m_per_m_s2 = model.wheel_radius_m * model.effective_mass_kg / (2.0 * SQRT2)
        self._turn_n_m_per_rad_s2 = model.wheel_radius_m * model.effective_inertia_kg_m2 / (4.0 * model.lever_m)
        push_m_s2 = model.torque_limit_n_m / self._push_n_m_per_m_s2
        turn_rad_s2 = model.torque_limit_n_m / self._turn_n_m_per_rad_s2
        self._braking_m_s2 = options.braking_share * push_m_s2
        self._push_m_s2 = push_m_s2
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
        self._predictor = DelayPredictor(model, observers, from_observers=True)
        self._is_far, self._aim_rad = False, 0.0
        self._friction_m_s2 = model.wheel_friction_n_m / self._push_n_m_per_m_s2
        # Wheel speed in units of that at which friction has three quarters of its size, for a push and for a turn.
        self._friction_per_m_s = SQRT2 / (model.wheel_radius_m * FRICTION_SPEED_RAD_S)
        self._friction_per_rad_s = model.lever_m / (model.wheel_radius_m * FRICTION_SPEED_RAD_S)
        self._push_share = AccelerationShare(push_m_s2, _UNKNOWN_FRICTION * self._friction_m_s2)
        self._turn_share = AccelerationShare(turn_rad_s2)

    def reset(self, state: State, reference: Reference) -> None:
        """Start at this state, with no command sent and no disturbance."""
        self._predictor.reset(state)
        self._is_far = False
        self._push_share.reset()
        self._turn_share.reset()

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command that acts ``applied.latency_s`` from now, in TORQUE mode within the torque limit."""
        if self._torque:
            predicted = self._predictor.predict(reference, state, applied, dt_s)
            self._learn(state, applied, dt_s)
            return self._torque_command(reference.acceleration, predicted, applied.latency_s, dt_s)
        return self._speed_command(reference, state, applied.latency_s, dt_s)

    def _learn(self, state: State, applied: Applied, dt_s: float) -> None:
        """Learn how much of the commanded acceleration the robot has, and predict by that.

        Around the heading only a robot that turns more easily than believed counts: pushes leave little torque there.
        """
        ((_, _, heading), (vx, vy, yaw_rate)), (*_, dvx, dvy, dvh) = state, self._predictor.moved
        push, turn, is_limited = self._push_share, self._turn_share, applied.saturated
        # Friction acts on wheels, and so along the directions of both pairs, and not against the motion of the whole.
        x1, y1, x2, y2 = directions(heading)
        rubs_1 = -math.tanh(self._friction_per_m_s * (vx * x1 + vy * y1))
        rubs_2 = -math.tanh(self._friction_per_m_s * (vx * x2 + vy * y2))
        rubbed = dt_s * (rubs_1 * x1 + rubs_2 * x2), dt_s * (rubs_1 * y1 + rubs_2 * y2)
        push.update((vx, vy), (dvx, dvy), rubbed, dt_s, is_limited=is_limited)
        rubs = -math.tanh(self._friction_per_rad_s * yaw_rate)
        turn.update((yaw_rate,), (dvh,), (dt_s * rubs,), dt_s, is_limited=is_limited)
        self._predictor.shares = push.share, max(turn.share, 1.0)

    def _torque_command(
        self, acceleration: Acceleration, predicted: Prediction, latency_s: float, dt_s: float
    ) -> WheelCommand:
        """Return τ for q̈ = q̈_d + ẇ(e) + K2 (w(e) - ė) - d, with one axis for each pair and one for the heading."""
        (x, y, heading_error, vx_e, vy_e, now_turn), heading, (vx_d, vy_d, yaw_rate_d), (vx, vy, yaw_rate) = predicted
        # The torque is held for a tick, so the directions are those at its middle.
        x1, y1, x2, y2 = directions(heading + 0.5 * dt_s * yaw_rate)
        ax, ay, yaw_acceleration = acceleration
        limit = self._push_speed_m_s(yaw_rate)
        away, now, along = x * x1 + y * y1, vx_e * x1 + vy_e * y1, vx_d * x1 + vy_d * y1
        first = away, now, along, self._braking(away, now, along, ax * x1 + ay * y1), -limit - along, limit - along
        away, now, along = x * x2 + y * y2, vx_e * x2 + vy_e * y2, vx_d * x2 + vy_d * y2
        second = away, now, along, self._braking(away, now, along, ax * x2 + ay * y2), -limit - along, limit - along
        # The bandwidth follows the latency: K1 and K2 keep their distance from its phase.
        slower = min(1.0, _FULL_GAIN_S / (latency_s + dt_s))
        # The gain that moves ė towards w as a pole at K2 does, exact for an acceleration held over the tick.
        k1, k2 = slower * self._k1, -math.expm1(-slower * self._k2 * dt_s) / dt_s
        was_far = self._is_far
        self._is_far = is_far = math.hypot(x, y) > (_NEAR_M if was_far else _FAR_M)
        # Wheels that slip get no more to do than the way itself: the heading stays where it is.
        if is_far and not self._push_share.was_limited:
            k1 *= _FAR_K1
            if not was_far:
                self._aim_rad = self._aim(predicted, first, second, limit)
            to_turn_rad = math.remainder(heading_error - self._aim_rad, math.tau)
            pushed_1, pushed_2 = first[2] + first[1], second[2] + second[1]
            used_m_s, most_rad_s = SQRT2 * max(abs(pushed_1), abs(pushed_2)), _SWING_RAD_S
            friction_n_m = self._friction(pushed_1, pushed_2, yaw_rate)
            spare = _pair_to_spare(first, second)
        else:
            to_turn_rad = 0.0 if is_far else heading_error
            used_m_s, most_rad_s = SQRT2 * math.hypot(vx_d, vy_d), self._turn_rad_s
            friction_n_m = self._friction(first[2], second[2], yaw_rate_d)
            spare = 0
        most_rad_s = self._turn_speed_rad_s(used_m_s, yaw_rate_d, most_rad_s)
        turning = self._turning(to_turn_rad, now_turn, k1, k2, most_rad_s)
        coupling = self._model.wheels_mass_kg / self._model.effective_mass_kg * yaw_rate
        zx, zy, zh = self._predictor.disturbance
        known_x = ax - zx + coupling * vy
        known_y = ay - zy - coupling * vx
        to_push, to_turn = self._push_n_m_per_m_s2, self._turn_n_m_per_rad_s2
        torque, push_1, push_2, turn = allocate(
            to_push * self._push(first, k1, k2, known_x * x1 + known_y * y1),
            to_push * self._push(second, k1, k2, known_x * x2 + known_y * y2),
            to_turn / self._predictor.shares[1] * (yaw_acceleration - zh + turning),
            friction_n_m,
            self._torque_limit_n_m,
            spare,
        )
        push_1, push_2 = push_1 / to_push, push_2 / to_push
        pushed = push_1 * x1 + push_2 * x2 - coupling * vy, push_1 * y1 + push_2 * y2 + coupling * vx, turn / to_turn
        self._predictor.remember(torque, pushed)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)

    def _push(self, axis: _Axis, k1: float, k2: float, known_m_s2: float) -> float:
        """Return the acceleration [m/s²] to command along an axis, which the believed mass would have.

        ``known_m_s2`` is what reference, disturbance and turning need. What is known in advance takes the estimated
        mass. The gains do not grow by it: it may be wrong.
        """
        away, now, _, braking, low, high = axis
        rate, slope = profile(away, now, k1, braking, low, high)
        share = self._predictor.shares[0]
        return (known_m_s2 + slope) / share + k2 * (rate - now) / max(share, 1.0)

    def _turning(self, error_rad: float, rate_rad_s: float, k1: float, k2: float, most_rad_s: float) -> float:
        """Return the yaw acceleration [rad/s²] that takes away this error and rate, in addition to the reference's."""
        turn, slope = profile(error_rad, rate_rad_s, k1, self._turn_braking_rad_s2, -most_rad_s, most_rad_s)
        turning = slope + k2 * (turn - rate_rad_s)
        return within(turning, _SWING_BRAKING * self._turn_braking_rad_s2) if self._is_far else turning

    def _aim(self, predicted: Prediction, first: _Axis, second: _Axis, limit_m_s: float) -> float:
        """Return the heading error to turn to on the way: towards that at which both axes arrive at once."""
        (x, y, heading_error, vx, vy, _), heading, (vx_d, vy_d, _), _ = predicted
        even_rad = even_turn(heading, (x, y), (vx, vy), (vx_d, vy_d), self._push_m_s2, limit_m_s)
        return heading_error + within(
            even_rad, self._swing_rad(math.hypot(x, y), first[2] + first[1], second[2] + second[1])
        )

    def _braking(self, away_m: float, rate_m_s: float, along_m_s: float, needed_m_s2: float) -> float:
        """Return the acceleration [m/s²] that an axis can brake with on the rest of its way.

        ``away_m`` and ``rate_m_s`` are e and ė, ``along_m_s`` is the reference's own rate, and ``needed_m_s2`` what the
        reference takes of the torque by its acceleration.
        """
        known = self._push_share
        own = self._push_m_s2 if known.is_known else self._braking_m_s2
        helps = friction_share(away_m, rate_m_s, along_m_s)
        braking = known.share * (own + helps * self._friction_m_s2) - math.copysign(1.0, away_m) * needed_m_s2
        if known.is_known:
            braking += helps * known.friction
        return max(braking, _LEAST_BRAKING_SHARE * self._push_m_s2)

    def _swing_rad(self, away_m: float, pushed_1_m_s: float, pushed_2_m_s: float) -> float:
        """Return how far to turn from rest to rest before an axis is at its largest speed, or half the way is made."""
        left_m_s = max(self._push_speed_m_s(0.0) - max(abs(pushed_1_m_s), abs(pushed_2_m_s)), 0.0)
        lasts_s = min(left_m_s / self._push_m_s2, math.sqrt(away_m / self._push_m_s2))
        return _SWING_SHARE * 0.25 * self._turn_braking_rad_s2 * lasts_s * lasts_s

    def _speed_command(self, reference: Reference, state: State, latency_s: float, dt_s: float) -> WheelCommand:
        """Return ω for q̇ = q̇_d + w(e), with the feedforward torque for the reference and the slope of the profile.

        Over the latency the robot is extrapolated by its own speed and the reference's acceleration. The measured yaw
        rate only limits the step: PROFILE.md says why.
        """
        model = self._model
        predicted = extrapolate(reference, state, latency_s)
        (x, y, heading_error, vx, vy, _), heading, (vx_d, vy_d, yaw_rate_d), _ = predicted
        ax, ay, yaw_acceleration = reference.acceleration
        x1, y1, x2, y2 = directions(heading)
        along_1, along_2 = vx_d * x1 + vy_d * y1, vx_d * x2 + vy_d * y2
        k1, braking = self._k1, self._braking_m_s2
        limit = self._turn_speed_rad_s(SQRT2 * math.hypot(vx_d, vy_d), yaw_rate_d, self._turn_rad_s)
        step = self._turn_step_rad_s
        low, high = _range(-limit, limit, state.twist.yaw_rate_rad_s - reference.twist.yaw_rate_rad_s, step)
        turn, _ = profile(heading_error, 0.0, self._turn_k1, self._turn_braking_rad_s2, low, high)
        limit, step = self._push_speed_m_s(yaw_rate_d + turn), self._push_step_m_s
        now_1, now_2 = vx * x1 + vy * y1, vx * x2 + vy * y2
        low, high = _range(-limit - along_1, limit - along_1, now_1, step)
        rate_1, slope_1 = profile(x * x1 + y * y1, now_1, k1, braking, low, high)
        low, high = _range(-limit - along_2, limit - along_2, now_2, step)
        rate_2, slope_2 = profile(x * x2 + y * y2, now_2, k1, braking, low, high)
        # The slope counts only as far as the robot follows the profile, so that measurement noise is not fed forward.
        slope_1, slope_2 = slope_1 * in_step(now_1, rate_1), slope_2 * in_step(now_2, rate_2)
        ax, ay = ax + slope_1 * x1 + slope_2 * x2, ay + slope_1 * y1 + slope_2 * y2
        # Set points for the middle of the tick, minus the lag of the speed that the firmware measures.
        lead_s = 0.5 * dt_s - self._speed_lag_s
        # The speed limit comes last: it overrides lead, reference and step.
        turn = within(yaw_rate_d + turn + lead_s * yaw_acceleration, self._rim_speed_m_s / model.lever_m)
        limit = self._push_speed_m_s(turn)
        push_1 = within(along_1 + rate_1 + lead_s * (ax * x1 + ay * y1), limit)
        push_2 = within(along_2 + rate_2 + lead_s * (ax * x2 + ay * y2), limit)
        desired = push_1 * x1 + push_2 * x2, push_1 * y1 + push_2 * y2, turn
        return speed_command(model, desired, predicted, (ax, ay, yaw_acceleration))

    def _turn_speed_rad_s(self, used_m_s: float, yaw_rate_rad_s: float, most_rad_s: float) -> float:
        """Return the limit of the yaw rate towards a reference with this yaw rate, at most ``most_rad_s``.

        ``used_m_s`` is the part of the wheels' rim speed that the way takes: far away for the robot's own motion, near
        for the reference's at any heading. It has priority: a robot that turns back and thereby loses the reference
        would be far away again.
        """
        lever_m, rim_m_s = self._model.lever_m, self._rim_speed_m_s
        left_m_s = _KEPT_SHARE * rim_m_s - used_m_s - lever_m * abs(yaw_rate_rad_s)
        least_m_s = 0.0 if self._is_far else _LEAST_TURNING_SHARE * rim_m_s
        return min(max(left_m_s, least_m_s) / lever_m, most_rad_s)

    def _push_speed_m_s(self, yaw_rate_rad_s: float) -> float:
        """Return the speed limit [m/s] along a diagonal. A wheel's rim moves at √2 of it, plus L times the yaw rate."""
        return max(self._rim_speed_m_s - self._model.lever_m * abs(yaw_rate_rad_s), 0.0) / SQRT2

    def _friction(self, along_1_m_s: float, along_2_m_s: float, yaw_rate_rad_s: float) -> FourWheels:
        """Return the friction torques at the wheel speeds of the reference, which carry no measurement noise."""
        scale = 1.0 / self._model.wheel_radius_m
        push_1, push_2 = SQRT2 * scale * along_1_m_s, SQRT2 * scale * along_2_m_s
        turn = scale * self._model.lever_m * yaw_rate_rad_s
        return self._model.friction_torques((push_1 - turn, push_2 + turn, push_1 + turn, push_2 - turn))


def _pair_to_spare(first: _Axis, second: _Axis) -> int:
    """Return the pair, 1 or 2, that would be there early enough to give turning its torque; 0 for none."""
    away, now, _, braking, low, high = first
    later_s = time_to_go(away, now, braking, low, high)
    away, now, _, braking, low, high = second
    later_s -= time_to_go(away, now, braking, low, high)
    return 0 if abs(later_s) <= _SPARE_S else 2 if later_s > 0.0 else 1


def _range(low: float, high: float, now: float, step: float) -> tuple[float, float]:
    """Return the part of ``low`` to ``high`` within ``step`` of ``now``; where there is none, the nearest value twice.

    A rate that is beyond a limit by more than a step thus returns to it step by step.
    """
    least, most = now - step, now + step
    return min(max(low, least), most), max(min(high, most), least)


def in_step(rate: float, desired: float) -> float:
    """Return how far ``rate`` follows ``desired``: 1 up to its size, less beyond, 0 for the other sign or NaN."""
    return min(1.0, desired / rate) if rate * desired > 0.0 else 0.0
