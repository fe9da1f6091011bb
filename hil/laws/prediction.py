"""Compensation of the latency: where robot and reference will be when a command takes effect.

A command takes effect ``Applied.latency_s`` after the sampling instant from which it was computed, and acts until the
next command does. A law that compensates for this is evaluated at the predicted robot and the predicted reference. The
reference is extrapolated by its own acceleration. The robot is extrapolated by the commands that were sent and do not
act yet. Between two commands the acceleration is taken as constant in the world frame. Each axis is then a
double integrator, whose motion is computed exactly for any latency.
"""

import math
import operator
from collections import deque

from hil.core.errors import BadInputError
from hil.core.kinematics import body_wrench
from hil.core.model import RobotModel
from hil.core.tuples import make_speed_command, make_torque_command
from hil.core.types import ZERO_WHEELS, Applied, Axes, CommandMode, Pairs, Reference, State, Twist, WheelCommand, Wheels

Prediction = tuple[Pairs, float, Axes, Axes]
"""The predicted robot and reference at the time when the command takes effect, a plain tuple.

In order: error, which is state minus reference in the world frame [m, rad], and its rate; heading [rad]; twist of the
reference, and of the robot, in the world frame.
"""


def require_torque(law: str, mode: CommandMode, other: str) -> None:
    """Raise BadInputError for SPEED mode with a law that computes torques; the ``other`` law has speed commands."""
    if mode is not CommandMode.TORQUE:
        raise BadInputError(
            f"controller.law = {law!r}: it computes torques, which controller.command = 'speed' does not carry; set "
            f"controller.command = 'torque', or take a law that has speed commands, such as {other!r}"
        )


def torque_command(model: RobotModel, acceleration: Axes, predicted: Prediction) -> WheelCommand:
    """Return the torques for a world acceleration: τ = B⁺ (M u + C) + ξ (the paper's equation 18 with the model's C).

    Friction is computed at the reference's twist and not at the measured one, so measurement noise does not enter.
    """
    _, heading_rad, reference_twist, twist = predicted
    return make_torque_command(*model.wheel_torques(acceleration, twist, heading_rad, reference_twist))


def speed_command(model: RobotModel, desired: Axes, predicted: Prediction, acceleration: Axes) -> WheelCommand:
    """Return the set points of the firmware's speed loop for a world twist: ω = H Rᵀ x̄2 / r.

    ``desired`` is the twist [m/s, m/s, rad/s]. The reference's twist and ``acceleration`` give the torque feedforward.
    """
    _, heading_rad, twist, _ = predicted
    feedforward = model.wheel_torques(acceleration, twist, heading_rad, twist)
    return make_speed_command(*model.wheel_speeds(desired, heading_rad), *feedforward)


# A member of an enumeration takes longer to look up than a global name.
_SPEED, _TORQUE = CommandMode.SPEED, CommandMode.TORQUE


class ExtendedStateObserver:
    """Estimates position, rate, and the acceleration that no command explains, of one axis in m or rad.

    The axis is ẍ = u + d with a known commanded acceleration u and a disturbance d that changes slowly:
    friction, a wrong mass, a force from outside. The observer uses the measured x alone, so late or noisy wheel speeds
    do not disturb it. It predicts exactly for a piecewise constant u and a constant d, and then corrects its
    estimates by the innovation ε = x - x̂:

        x̂ += (1 - β³) ε,    v̂ += 3/2 (1 - β)² (1 + β) / T ε,    d̂ += (1 - β)³ / T² ε,    β = exp(-ωo T)

    This puts the three poles of its error at β, as (s + ωo)³ does in continuous time (J. Han, "From PID to active
    disturbance rejection control", IEEE Trans. Ind. Electron. 56, 2009; the gains in discrete time: R. Miklosovic,
    A. Radke and Z. Gao, "Discrete implementation and generalization of the extended state observer", ACC 2006).

    ``bandwidth_rad_s`` is ωo. The disturbance is limited to ±``disturbance_limit``. Raises ValueError unless both are
    finite and greater than zero. ``position``, ``rate`` and ``disturbance`` are the estimates at the last measurement.
    """

    __slots__ = ("_bandwidth_rad_s", "_dt_s", "_gains", "_limit", "disturbance", "position", "rate")

    def __init__(self, bandwidth_rad_s: float, disturbance_limit: float) -> None:
        for value in (bandwidth_rad_s, disturbance_limit):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"observer: {value!r}: expected a finite number, more than zero")
        self._bandwidth_rad_s = bandwidth_rad_s
        self._limit = disturbance_limit
        self._dt_s = math.nan
        self._gains: tuple[float, float, float]
        self.reset(0.0, 0.0)

    def reset(self, position: float, rate: float) -> None:
        """Start at this position and rate with zero disturbance."""
        self.position = position
        self.rate = rate
        self.disturbance = 0.0

    def update(self, measured: float, displacement: float, rate_change: float, dt_s: float) -> None:
        """Predict over ``dt_s`` [s], then correct by the position ``measured`` now.

        ``displacement`` and ``rate_change`` are the motion that the commanded acceleration alone causes over that
        time from rest. ``PendingCommands`` computes them for delayed commands.
        """
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._gains = observer_gains(self._bandwidth_rad_s, dt_s)
        to_position, to_rate, to_disturbance = self._gains
        disturbed = self.disturbance * dt_s
        position = self.position + dt_s * (self.rate + 0.5 * disturbed) + displacement
        innovation = measured - position
        self.position = position + to_position * innovation
        self.rate += disturbed + rate_change + to_rate * innovation
        disturbance = self.disturbance + to_disturbance * innovation
        limit = self._limit
        self.disturbance = limit if disturbance > limit else -limit if disturbance < -limit else disturbance


def observer_gains(bandwidth_rad_s: float, dt_s: float) -> tuple[float, float, float]:
    """Return the gains of position [1], rate [1/s] and disturbance [1/s²] that put all poles at exp(-ωo T)."""
    rest = -math.expm1(-bandwidth_rad_s * dt_s)
    beta = 1.0 - rest
    return 1.0 - beta**3, 1.5 * rest * rest * (1.0 + beta) / dt_s, rest**3 / (dt_s * dt_s)


_ZERO: Axes = (0.0, 0.0, 0.0)


class PendingCommands:
    """Queue of commanded accelerations, each with the time from which it acts.

    Before the first one acts the acceleration is zero. The motion that they cause is given for a robot that starts
    at rest: displacement [m, m, rad] and rate [m/s, m/s, rad/s].
    """

    __slots__ = ("_acting", "_now_s", "_waiting")

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Empty the queue."""
        self._now_s = 0.0
        self._acting = _ZERO
        self._waiting: deque[tuple[float, Axes]] = deque()

    def advance(self, commanded: Axes, latency_s: float, dt_s: float) -> Pairs:
        """Advance by ``dt_s`` [s] to the present tick, and return the motion since the last tick.

        ``commanded`` was computed at the last tick and acts from ``latency_s`` [s] after it. It replaces every queued
        command that would have begun to act at the same time or later.
        """
        waiting = self._waiting
        acts_from_s = self._now_s + latency_s
        while waiting and waiting[-1][0] >= acts_from_s:
            waiting.pop()
        waiting.append((acts_from_s, commanded))
        moved = self.motion(dt_s)
        self._now_s += dt_s
        while waiting and waiting[0][0] <= self._now_s:
            self._acting = waiting.popleft()[1]
        return moved

    def motion(self, horizon_s: float) -> Pairs:
        """Return the motion within the next ``horizon_s`` [s] that the commands in the queue cause."""
        dx = dy = dh = vx = vy = vh = 0.0
        ax, ay, ah = self._acting
        at_s = self._now_s
        end_s = at_s + horizon_s
        for from_s, following in self._waiting:
            if from_s >= end_s:
                break
            d = from_s - at_s
            if d > 0.0:
                half = 0.5 * d
                dx, vx = dx + d * (vx + half * ax), vx + d * ax
                dy, vy = dy + d * (vy + half * ay), vy + d * ay
                dh, vh = dh + d * (vh + half * ah), vh + d * ah
                at_s = from_s
            ax, ay, ah = following
        d = end_s - at_s
        half = 0.5 * d
        return (
            dx + d * (vx + half * ax),
            dy + d * (vy + half * ay),
            dh + d * (vh + half * ah),
            vx + d * ax,
            vy + d * ay,
            vh + d * ah,
        )


def acceleration_of(
    model: RobotModel, torque_n_m: Wheels, twist: Axes, heading_rad: float, reference_twist: Axes
) -> Axes:
    """Return the world acceleration that wheel torques cause: the inverse of ``RobotModel.wheel_torques``.

    An observer needs it when the guard has changed the torques that the law computed. Friction is computed at the
    reference's twist ``reference_twist``, as the law does, so both agree where the guard changed nothing. The part of
    the torques that works against itself and moves nothing is ignored.
    """
    friction_n_m = model.friction_torques(model.wheel_speeds(reference_twist, heading_rad))
    fl, fr, rr, rl = map(operator.sub, torque_n_m, friction_n_m)
    forward_n, left_n, yaw_n_m = body_wrench((fl, fr, rr, rl), model.wheel_radius_m, model.lever_m)
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    vx, vy, yaw_rate = twist
    coupling = model.wheels_mass_kg * yaw_rate
    mass = model.effective_mass_kg
    return (
        (c * forward_n - s * left_n - coupling * vy) / mass,
        (s * forward_n + c * left_n + coupling * vx) / mass,
        yaw_n_m / model.effective_inertia_kg_m2,
    )


def extrapolate(reference: Reference, state: State, latency_s: float, *, in_speed_mode: bool = True) -> Prediction:
    """Return both ``latency_s`` [s] later, if the robot accelerates as the reference does. Needs no model.

    In SPEED mode it is taken to turn as the reference does, too. The measured yaw rate would close a second loop around
    the firmware's. That loop has little damping there: a wheel has a fifth as much inertia against yaw as against a
    push.
    """
    if in_speed_mode:
        pose, (vx, vy, _) = state
        state = State(pose, Twist(vx, vy, reference.twist.yaw_rate_rad_s))
    ax, ay, ah = reference.acceleration
    vx, vy, vh = latency_s * ax, latency_s * ay, latency_s * ah
    half_s = 0.5 * latency_s
    return _at_latency(reference, state, latency_s, (half_s * vx, half_s * vy, half_s * vh, vx, vy, vh))


class DelayPredictor:
    """Predicts the robot from the torque commands that do not act yet, and observes the disturbance.

    ``observers``, if given, are those of x, y and heading. The prediction then includes their ``disturbance``
    (acceleration [m/s², m/s², rad/s²]), which is zero without them. It starts at the measured state or, with
    ``from_observers``, at the observers' estimate, which uses the measured pose and not the measured twist.

    ``moved`` is the motion since the last tick that the commands account for, by the model. With observers a law may
    set ``shares``: how much of it, along x and y and around the heading, the robot really has (``adaptation.py``).
    """

    def __init__(
        self, model: RobotModel, observers: tuple[ExtendedStateObserver, ...] = (), *, from_observers: bool = False
    ) -> None:
        self._model = model
        self._observers = observers
        self._from_observers = from_observers
        self._pending = PendingCommands()
        self._commanded: Axes
        self._sent: Wheels
        self._latency_s: float
        self._is_new: bool
        self.disturbance: Axes
        self.moved: Pairs
        self.shares = 1.0, 1.0

    def reset(self, state: State) -> None:
        """Start at this state, with no command sent and no disturbance."""
        self._pending.reset()
        self.moved = _ZERO + _ZERO
        self._commanded, self._sent = _ZERO, ZERO_WHEELS
        self._is_new = True
        self.disturbance = _ZERO
        for observer, position, rate in zip(self._observers, *state, strict=False):
            observer.reset(position, rate)

    def predict(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Prediction:
        """Return the prediction for this tick's command; ``dt_s`` [s] is the time since the last tick."""
        if self._is_new:
            self._is_new = False
        else:
            self._advance(reference.twist, state, applied, dt_s)
        self._latency_s = latency_s = applied.latency_s
        moved = self._pending.motion(latency_s)
        if not self._observers:
            return _at_latency(reference, state, latency_s, moved)
        dx, dy, dh, dvx, dvy, dvh = moved
        push, turn = self.shares
        dx, dy, dh, dvx, dvy, dvh = push * dx, push * dy, turn * dh, push * dvx, push * dvy, turn * dvh
        zx, zy, zh = self.disturbance
        vx, vy, vh = latency_s * zx, latency_s * zy, latency_s * zh
        half_s = 0.5 * latency_s
        moved = dx + half_s * vx, dy + half_s * vy, dh + half_s * vh, dvx + vx, dvy + vy, dvh + vh
        if not self._from_observers:
            return _at_latency(reference, state, latency_s, moved)
        x, y, heading = self._observers
        believed = (x.position, y.position, heading.position), (x.rate, y.rate, heading.rate)
        return _at_latency(reference, believed, latency_s, moved)

    def _advance(self, reference_twist: Axes, state: State, applied: Applied, dt_s: float) -> None:
        """Advance the queue and the observers from the last tick to this one."""
        commanded = self._commanded
        pose, twist = state
        torque = applied.command.torque_n_m
        if torque != self._sent:
            # The guard scaled the command, or another one was sent in its place.
            commanded = acceleration_of(self._model, torque, twist, pose.heading_rad, reference_twist)
        self.moved = dx, dy, dh, dvx, dvy, dvh = self._pending.advance(commanded, self._latency_s, dt_s)
        if self._observers:
            x, y, heading = self._observers
            push, turn = self.shares
            x.update(pose.x_m, push * dx, push * dvx, dt_s)
            y.update(pose.y_m, push * dy, push * dvy, dt_s)
            # The pose wraps at π; the observer's heading does not.
            turned = math.remainder(pose.heading_rad - heading.position, math.tau)
            heading.update(heading.position + turned, turn * dh, turn * dvh, dt_s)
            self.disturbance = x.disturbance, y.disturbance, heading.disturbance

    def command(self, acceleration: Axes, predicted: Prediction) -> WheelCommand:
        """Return the torques for a world acceleration at the predicted state, and remember them for later ticks."""
        command = torque_command(self._model, acceleration, predicted)
        self.remember(command.torque_n_m, acceleration)
        return command

    def remember(self, torque_n_m: Wheels, acceleration: Axes) -> None:
        """Remember the torques of this tick's command and the world acceleration that they cause."""
        self._sent, self._commanded = torque_n_m, acceleration


def _at_latency(reference: Reference, start: tuple[Axes, Axes], latency_s: float, moved: Pairs) -> Prediction:
    """Return both after the latency. ``moved`` is the motion that accelerations add to the robot's pose and twist."""
    (x, y, heading), (vx, vy, yaw_rate) = start
    (x_d, y_d, heading_d), (vx_d, vy_d, yaw_rate_d), (ax, ay, ah) = reference
    dx, dy, dh, dvx, dvy, dvh = moved
    half_s = 0.5 * latency_s
    x += latency_s * vx + dx - x_d - latency_s * (vx_d + half_s * ax)
    y += latency_s * vy + dy - y_d - latency_s * (vy_d + half_s * ay)
    turn = latency_s * yaw_rate + dh
    heading_error = math.remainder(heading - heading_d, math.tau) + turn - latency_s * (yaw_rate_d + half_s * ah)
    vx, vy, yaw_rate = vx + dvx, vy + dvy, yaw_rate + dvh
    vx_d, vy_d, yaw_rate_d = vx_d + latency_s * ax, vy_d + latency_s * ay, yaw_rate_d + latency_s * ah
    error = x, y, heading_error, vx - vx_d, vy - vy_d, yaw_rate - yaw_rate_d
    return error, heading + turn, (vx_d, vy_d, yaw_rate_d), (vx, vy, yaw_rate)
