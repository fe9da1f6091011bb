"""Time-optimal square-root profile with observer and delay prediction, one axis for each diagonal pair of wheels.

Derivation, options and figures: PROFILE.md beside this file.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from hil.controllers.diagonals import SQRT2, Demand, Diagonals, allocate
from hil.controllers.observer import ExtendedStateObserver
from hil.controllers.prediction import CommandsOnTheirWay, Moved, acceleration_of, forward
from hil.controllers.surface import TrackingError, tracking_error
from hil.model import FRICTION_SPEED_RAD_S, RobotModel
from hil.options import require_positive
from hil.types import (
    NAN,
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Gains,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)

# Of the yaw acceleration that all torque would give: pushing may need it at any time, so little is counted on.
_TURNING_SHARE = 0.3
_NO_ACCELERATION = Acceleration(0.0, 0.0, 0.0)
_NOT_MOVED = Moved(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Profile:
    """Time-optimal square-root profile: brakes as late as the torque allows, whatever the latency.

    In TORQUE mode an observer an axis finds friction and a wrong mass, and the state is taken forward by the latency
    from the commands on their way. In SPEED mode the profile gives the set points and the firmware's speed loop does
    the rest; the gain is then ``speed_k1_1_s``, and the observer has no part in it.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains [1/s], the share of the torque to brake with, and the observer's bandwidth [rad/s].

        ``k1_1_s`` and ``k2_1_s`` are the two poles close to the reference. ``braking_share`` is what a robot that is
        heavier than believed still has: 0.85 with 20 % more mass. With ``keeps_speed_limit`` the robot's wheel speed
        limit holds in TORQUE mode too, where nothing else keeps it; in SPEED mode it always does.
        """

        k1_1_s: float = 20.0
        k2_1_s: float = 60.0
        braking_share: float = 0.85
        observer_rad_s: float = 80.0
        speed_k1_1_s: float = 8.0
        keeps_speed_limit: bool = False

        def __post_init__(self) -> None:
            require_positive(self, "k1_1_s", "k2_1_s", "braking_share", "observer_rad_s", "speed_k1_1_s")
            if self.braking_share > 1.0:
                raise ValueError(f"braking_share = {self.braking_share!r}: expected at most 1, all the torque")

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._k1 = k1 = options.k1_1_s if self._torque else options.speed_k1_1_s
        self._k2 = k2 = options.k2_1_s if self._torque else NAN
        self.gains = Gains(k1, k1, k1, k2, k2, k2)
        self._push_n_m_per_m_s2 = model.wheel_radius_m * model.effective_mass_kg / (2.0 * SQRT2)
        self._turn_n_m_per_rad_s2 = model.wheel_radius_m * model.effective_inertia_kg_m2 / (4.0 * model.lever_m)
        push_m_s2 = model.torque_limit_n_m / self._push_n_m_per_m_s2
        turn_rad_s2 = model.torque_limit_n_m / self._turn_n_m_per_rad_s2
        self._braking_m_s2 = options.braking_share * push_m_s2
        self._turn_braking_rad_s2 = _TURNING_SHARE * turn_rad_s2
        keeps = options.keeps_speed_limit or not self._torque
        self._rim_speed_m_s = model.speed_limit_rad_s * model.wheel_radius_m if keeps else math.inf
        bandwidth = options.observer_rad_s
        self._observe_x = ExtendedStateObserver(bandwidth, push_m_s2)
        self._observe_y = ExtendedStateObserver(bandwidth, push_m_s2)
        self._observe_heading = ExtendedStateObserver(bandwidth, turn_rad_s2)
        self._on_their_way = CommandsOnTheirWay()
        self._commanded = _NO_ACCELERATION
        self._sent = ZERO_WHEELS
        self._is_new = True

    def reset(self, state: State, reference: Reference) -> None:
        """Begin at this state, with nothing commanded and no disturbance."""
        (x, y, heading), (vx, vy, yaw_rate) = state
        self._observe_x.reset(x, vx)
        self._observe_y.reset(y, vy)
        self._observe_heading.reset(heading, yaw_rate)
        self._on_their_way.reset()
        self._is_new = True

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command that acts ``applied.latency_s`` from now, in TORQUE mode within the torque limit."""
        latency_s = applied.latency_s
        if self._torque:
            state, disturbance = self._observed(state, applied, dt_s)
            moved = self._on_their_way.ahead(latency_s)
            state = forward(state, disturbance, moved, latency_s)
            return self._torque_command(ahead(reference, latency_s), state, disturbance, dt_s)
        state = forward(state, _NO_ACCELERATION, _NOT_MOVED, latency_s)
        return self._speed_command(ahead(reference, latency_s), state)

    def _observed(self, state: State, applied: Applied, dt_s: float) -> tuple[State, Acceleration]:
        """Return the state with the observers' rates, and the disturbance."""
        x, y, heading = self._observe_x, self._observe_y, self._observe_heading
        if self._is_new:
            self._is_new = False
        else:
            torque = applied.command.torque_n_m
            if torque != self._sent:  # something else than this law had its say
                friction_at = self._model.wheel_speeds(state.twist, state.pose.heading_rad)
                self._commanded = acceleration_of(self._model, torque, state.twist, state.pose.heading_rad, friction_at)
            moved = self._on_their_way.advance(self._commanded, applied.latency_s, dt_s)
            x.update(state.pose.x_m, moved.x_m, moved.vx_m_s, dt_s)
            y.update(state.pose.y_m, moved.y_m, moved.vy_m_s, dt_s)
            heading.update(state.pose.heading_rad, moved.heading_rad, moved.yaw_rate_rad_s, dt_s)
        return (
            State(Pose(x.position, y.position, heading.position), Twist(x.rate, y.rate, heading.rate)),
            Acceleration(x.disturbance, y.disturbance, heading.disturbance),
        )

    def _torque_command(
        self, reference: Reference, state: State, disturbance: Acceleration, dt_s: float
    ) -> WheelCommand:
        """Return τ for q̈ = q̈_d + ẇ(e) + K2 (w(e) - ė) - d, an axis each for the two pairs and the heading."""
        model = self._model
        (_, _, heading), (vx, vy, yaw_rate) = state
        error = tracking_error(reference, state)
        # The torque is held for a tick: where the wheels push to is taken at the middle of it.
        diagonals = x1, y1, x2, y2 = Diagonals.at(heading + 0.5 * dt_s * yaw_rate)
        first, second, turn = self._profiles(reference, error, diagonals)
        # What brings ė to w within a tick as a pole at K2 does: exact for an acceleration that is held.
        k2 = -math.expm1(-self._k2 * dt_s) / dt_s
        coupling = model.wheels_mass_kg / model.effective_mass_kg * yaw_rate
        known_x = reference.acceleration.ax_m_s2 - disturbance.ax_m_s2 + coupling * vy
        known_y = reference.acceleration.ay_m_s2 - disturbance.ay_m_s2 - coupling * vx
        push = self._push_n_m_per_m_s2
        demand = Demand(
            push * (known_x * x1 + known_y * y1 + first.slope + k2 * (first.rate - first.now)),
            push * (known_x * x2 + known_y * y2 + second.slope + k2 * (second.rate - second.now)),
            self._turn_n_m_per_rad_s2
            * (reference.acceleration.yaw_rad_s2 - disturbance.yaw_rad_s2 + turn.slope + k2 * (turn.rate - turn.now)),
        )
        torque, given = allocate(demand, self._friction(reference, heading), model.torque_limit_n_m)
        along_1, along_2 = given.first_n_m / push, given.second_n_m / push
        self._sent = torque
        self._commanded = Acceleration(
            along_1 * x1 + along_2 * x2 - coupling * vy,
            along_1 * y1 + along_2 * y2 + coupling * vx,
            given.turn_n_m / self._turn_n_m_per_rad_s2,
        )
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)

    def _speed_command(self, reference: Reference, state: State) -> WheelCommand:
        """Return ω for q̇ = q̇_d + w(e), and the torque that the reference and the profile's own slope take."""
        model = self._model
        heading = state.pose.heading_rad
        diagonals = x1, y1, x2, y2 = Diagonals.at(heading)
        first, second, turn = self._profiles(reference, tracking_error(reference, state), diagonals)
        vx, vy, yaw_rate = reference.twist
        ax, ay, yaw_acceleration = reference.acceleration
        twist = Twist(
            vx + first.rate * x1 + second.rate * x2, vy + first.rate * y1 + second.rate * y2, yaw_rate + turn.rate
        )
        acceleration = Acceleration(
            ax + first.slope * x1 + second.slope * x2,
            ay + first.slope * y1 + second.slope * y2,
            yaw_acceleration + turn.slope,
        )
        friction_at = model.wheel_speeds(reference.twist, heading)
        torque = model.wheel_torques(acceleration, reference.twist, heading, friction_at)
        return WheelCommand(CommandMode.SPEED, model.wheel_speeds(twist, heading), torque)

    def _profiles(
        self, reference: Reference, error: TrackingError, diagonals: Diagonals
    ) -> tuple["Along", "Along", "Along"]:
        """Return the profile along both diagonals and about the vertical."""
        x1, y1, x2, y2 = diagonals
        x, y, heading, vx, vy, yaw_rate = error
        k1 = self._k1
        first = profile(x * x1 + y * y1, vx * x1 + vy * y1, k1, self._braking_m_s2)
        second = profile(x * x2 + y * y2, vx * x2 + vy * y2, k1, self._braking_m_s2)
        turn = profile(heading, yaw_rate, k1, self._turn_braking_rad_s2)
        rim_m_s = self._rim_speed_m_s
        if rim_m_s < math.inf:
            # A wheel's rim runs at √2 the speed along its diagonal, and L the yaw rate.
            vx, vy, yaw_rate = reference.twist
            limit = max(rim_m_s - self._model.lever_m * abs(yaw_rate + turn.rate), 0.0) / SQRT2
            first = within(first, limit, vx * x1 + vy * y1)
            second = within(second, limit, vx * x2 + vy * y2)
        return first, second, turn

    def _friction(self, reference: Reference, heading_rad: float) -> Wheels:
        """Return the friction torques at the speeds of the reference: no noise comes back through them."""
        friction = self._model.wheel_friction_n_m
        if friction == 0.0:
            return ZERO_WHEELS
        fl, fr, rr, rl = self._model.wheel_speeds(reference.twist, heading_rad)
        return Wheels(
            friction * math.tanh(fl / FRICTION_SPEED_RAD_S),
            friction * math.tanh(fr / FRICTION_SPEED_RAD_S),
            friction * math.tanh(rr / FRICTION_SPEED_RAD_S),
            friction * math.tanh(rl / FRICTION_SPEED_RAD_S),
        )


class Along(NamedTuple):
    """The profile of one axis: the rate of its error that is wanted, how that changes on the way, and the rate now."""

    rate: float
    slope: float
    now: float


def profile(error: float, rate: float, k1: float, braking: float) -> Along:
    """Return w(e) = -sign(e) min(K1 ρ, √(2 a (ρ - ρl/2))) with ρ = abs(e), ρl = a / K1², and ẇ = w'(e) ė.

    Far away it is the speed from which ``braking`` a just leads to the linear part, which begins at ρl with the same
    speed and the same slope.
    """
    distance = abs(error)
    linear = braking / (k1 * k1)
    if distance <= linear:
        return Along(-k1 * error, -k1 * rate, rate)
    speed = math.sqrt(2.0 * braking * (distance - 0.5 * linear))
    return Along(-math.copysign(speed, error), -braking / speed * rate, rate)


def within(along: Along, limit: float, reference_rate: float) -> Along:
    """Return the profile with the speed over ground within ``limit``; where that holds, it does not change."""
    low, high = -limit - reference_rate, limit - reference_rate
    if along.rate > high:
        return Along(high, 0.0, along.now)
    return Along(low, 0.0, along.now) if along.rate < low else along


def ahead(reference: Reference, time_s: float) -> Reference:
    """Return the reference ``time_s`` [s] later, its acceleration held: q + v L + a L² / 2."""
    return Reference(
        *forward(State(reference.pose, reference.twist), reference.acceleration, _NOT_MOVED, time_s),
        reference.acceleration,
    )
