"""The moment for which a law asks: when its command takes effect.

A command acts ``Applied.latency_s`` after the instant that it was worked out from. Laws that compensate for it are
worked out on where robot and reference will be then. The reference is taken ahead by its own acceleration, the robot by
what is known of its motion. What they would ask for at that moment is then what the robot gets at that moment.
"""

import math
from typing import NamedTuple

from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Applied, Axes, Pairs, Reference, State, WheelCommand, Wheels
from hil.laws.observer import ExtendedStateObserver
from hil.laws.prediction import CommandsOnTheirWay, acceleration_of
from hil.laws.wheel_commands import torque_command

_STILL = (0.0, 0.0, 0.0)


class Ahead(NamedTuple):
    """Where robot and reference will be when the command takes effect.

    ``error`` is as ``hil.laws.surface.tracking_error`` has it, ``moving`` the reference's twist and ``twist``
    the robot's, both in the world frame.
    """

    error: Pairs
    heading_rad: float
    moving: Axes
    twist: Axes


def carried_on(reference: Reference, state: State, latency_s: float) -> Ahead:
    """Return both ``latency_s`` [s] later when the robot accelerates as the reference does: no model is needed."""
    ax, ay, ah = reference.acceleration
    vx, vy, vh = latency_s * ax, latency_s * ay, latency_s * ah
    half_s = 0.5 * latency_s
    return _ahead(reference, state, latency_s, (half_s * vx, half_s * vy, half_s * vh, vx, vy, vh))


class TorquePrediction:
    """Looks ahead by the torque commands that are on their way, and observes what they do not explain.

    With ``observers``, of x, y and heading, their ``disturbance`` is part of the prediction; without, it is none. The
    prediction begins at the measured state or, ``from_observers``, at what they believe: the pose is then all that
    is measured.
    """

    __slots__ = (
        "_asked",
        "_from_observers",
        "_is_new",
        "_latency_s",
        "_model",
        "_observers",
        "_sent",
        "_way",
        "disturbance",
    )

    def __init__(
        self, model: RobotModel, observers: tuple[ExtendedStateObserver, ...] = (), *, from_observers: bool = False
    ) -> None:
        self._model = model
        self._observers = observers
        self._from_observers = from_observers
        self._way = CommandsOnTheirWay()
        self._asked: Axes = _STILL
        self._sent = ZERO_WHEELS
        self._latency_s = 0.0
        self._is_new = True
        self.disturbance: Axes = _STILL

    def reset(self, state: State) -> None:
        """Begin at this state with nothing commanded: no torque on a robot that stands."""
        self._way.reset()
        self._asked, self._sent, self._latency_s = _STILL, ZERO_WHEELS, 0.0
        self._is_new = True
        self.disturbance = _STILL
        for observer, position, rate in zip(self._observers, *state, strict=False):
            observer.reset(position, rate)

    def ahead(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Ahead:
        """Return where both will be when this tick's command takes effect, ``dt_s`` [s] after the last tick."""
        if self._is_new:
            self._is_new = False
        else:
            self._go_on(reference.twist, state, applied, dt_s)
        self._latency_s = latency_s = applied.latency_s
        moved = self._way.ahead(latency_s)
        if not self._observers:
            return _ahead(reference, state, latency_s, moved)
        dx, dy, dh, dvx, dvy, dvh = moved
        zx, zy, zh = self.disturbance
        vx, vy, vh = latency_s * zx, latency_s * zy, latency_s * zh
        half_s = 0.5 * latency_s
        moved = dx + half_s * vx, dy + half_s * vy, dh + half_s * vh, dvx + vx, dvy + vy, dvh + vh
        if not self._from_observers:
            return _ahead(reference, state, latency_s, moved)
        x, y, heading = self._observers
        believed = (x.position, y.position, heading.position), (x.rate, y.rate, heading.rate)
        return _ahead(reference, believed, latency_s, moved)

    def _go_on(self, moving: Axes, state: State, applied: Applied, dt_s: float) -> None:
        """Bring the commands on their way, and the observers, from the last tick to this one."""
        asked = self._asked
        pose, twist = state
        torque = applied.command.torque_n_m
        if torque != self._sent:
            # The guard scaled it, or something else was sent in its place.
            asked = acceleration_of(self._model, torque, twist, pose.heading_rad, moving)
        dx, dy, dh, dvx, dvy, dvh = self._way.advance(asked, self._latency_s, dt_s)
        if self._observers:
            x, y, heading = self._observers
            x.update(pose.x_m, dx, dvx, dt_s)
            y.update(pose.y_m, dy, dvy, dt_s)
            # On the turn of the observer's own, whichever the pose is on.
            turned = math.remainder(pose.heading_rad - heading.position, math.tau)
            heading.update(heading.position + turned, dh, dvh, dt_s)
            self.disturbance = x.disturbance, y.disturbance, heading.disturbance

    def command(self, acceleration: Axes, ahead: Ahead) -> WheelCommand:
        """Return the torques for a world acceleration at that moment, and remember them for the next ticks."""
        command = torque_command(self._model, acceleration, ahead.heading_rad, ahead.twist, ahead.moving)
        self.remember(command.torque_n_m, acceleration)
        return command

    def remember(self, torque_n_m: Wheels, acceleration: Axes) -> None:
        """Take in the torques of this tick's command, and the world acceleration that the robot has of them."""
        self._sent, self._asked = torque_n_m, acceleration


def _ahead(reference: Reference, start: tuple[Axes, Axes], latency_s: float, moved: Pairs) -> Ahead:
    """Return both later: the robot from its pose and twist, moved by accelerations as from rest."""
    (x, y, heading), (vx, vy, yaw_rate) = start
    (x_d, y_d, heading_d), (vx_d, vy_d, yaw_rate_d), (ax, ay, ah) = reference
    dx, dy, dh, dvx, dvy, dvh = moved
    half_s = 0.5 * latency_s
    x += latency_s * vx + dx - x_d - latency_s * (vx_d + half_s * ax)
    y += latency_s * vy + dy - y_d - latency_s * (vy_d + half_s * ay)
    turn = latency_s * yaw_rate + dh
    turned = math.remainder(heading - heading_d, math.tau) + turn - latency_s * (yaw_rate_d + half_s * ah)
    vx, vy, yaw_rate = vx + dvx, vy + dvy, yaw_rate + dvh
    vx_d, vy_d, yaw_rate_d = vx_d + latency_s * ax, vy_d + latency_s * ay, yaw_rate_d + latency_s * ah
    return Ahead(
        (x, y, turned, vx - vx_d, vy - vy_d, yaw_rate - yaw_rate_d),
        heading + turn,
        (vx_d, vy_d, yaw_rate_d),
        (vx, vy, yaw_rate),
    )
