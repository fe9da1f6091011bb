"""The moment for which a law asks: when its command takes effect.

A command acts ``Applied.latency_s`` after the instant that it was worked out from. Laws that compensate for it are
worked out on where robot and reference will be then. The reference is taken ahead by its own acceleration, the robot by
what is known of its motion. What they would ask for at that moment is then what the robot gets at that moment.
"""

from typing import NamedTuple

from hil.controllers.observer import ExtendedStateObserver
from hil.controllers.prediction import CommandsOnTheirWay, acceleration_of
from hil.controllers.surface import TrackingError, tracking_error
from hil.controllers.wheel_commands import torque_command
from hil.kinematics import wrap_angle
from hil.model import RobotModel
from hil.types import ZERO_WHEELS, Acceleration, Applied, Axes, Reference, State, WheelCommand

_NONE = Acceleration(0.0, 0.0, 0.0)
_STILL = (0.0, 0.0, 0.0)


class Ahead(NamedTuple):
    """Where robot and reference will be when the command takes effect.

    ``moving`` is the reference's twist and ``twist`` the robot's, both in the world frame.
    """

    error: TrackingError
    heading_rad: float
    moving: Axes
    twist: Axes


def carried_on(reference: Reference, state: State, latency_s: float) -> Ahead:
    """Return both ``latency_s`` [s] later when the robot accelerates as the reference does: no model is needed."""
    return _ahead(reference, state, latency_s, _STILL, _STILL)


class TorquePrediction:
    """Looks ahead by the torque commands that are on their way, and observes what they do not explain.

    With observers, of x, y and heading, their ``disturbance`` is part of the prediction; without, it is none.
    """

    __slots__ = ("_asked", "_is_new", "_latency_s", "_model", "_observers", "_sent", "_way", "disturbance")

    def __init__(self, model: RobotModel, observers: tuple[ExtendedStateObserver, ...] = ()) -> None:
        self._model = model
        self._observers = observers
        self._way = CommandsOnTheirWay()
        self._asked = _NONE
        self._sent = ZERO_WHEELS
        self._latency_s = 0.0
        self._is_new = True
        self.disturbance: Axes = (0.0, 0.0, 0.0)

    def reset(self, state: State) -> None:
        """Begin at this state with nothing commanded: no torque on a robot that stands."""
        self._way.reset()
        self._asked, self._sent, self._latency_s = _NONE, ZERO_WHEELS, 0.0
        self._is_new = True
        self.disturbance = (0.0, 0.0, 0.0)
        for observer, position, rate in zip(self._observers, *state, strict=False):
            observer.reset(position, rate)

    def ahead(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Ahead:
        """Return where both will be when this tick's command takes effect, ``dt_s`` [s] after the last tick."""
        if self._is_new:
            self._is_new = False
        else:
            self._go_on(reference, state, applied, dt_s)
        self._latency_s = latency_s = applied.latency_s
        # What the robot does beyond the reference's acceleration, which is in both.
        dx, dy, dh, dvx, dvy, dvh = self._way.ahead(latency_s)
        zx, zy, zh = self.disturbance
        ax, ay, ah = reference.acceleration
        zx, zy, zh = latency_s * (zx - ax), latency_s * (zy - ay), latency_s * (zh - ah)
        half_s = 0.5 * latency_s
        moved_by = dx + half_s * zx, dy + half_s * zy, dh + half_s * zh
        return _ahead(reference, state, latency_s, moved_by, (dvx + zx, dvy + zy, dvh + zh))

    def _go_on(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> None:
        """Bring the commands on their way, and the observers, from the last tick to this one."""
        asked = self._asked
        pose, twist = state
        torque = applied.command.torque_n_m
        if torque != self._sent:
            # The guard scaled it, or something else was sent in its place.
            friction_at = self._model.wheel_speeds(reference.twist, pose.heading_rad)
            asked = acceleration_of(self._model, torque, twist, pose.heading_rad, friction_at)
        dx, dy, dh, dvx, dvy, dvh = self._way.advance(asked, self._latency_s, dt_s)
        if self._observers:
            x, y, heading = self._observers
            x.update(pose.x_m, dx, dvx, dt_s)
            y.update(pose.y_m, dy, dvy, dt_s)
            # On the turn of the observer's own, whichever the pose is on.
            measured = heading.position + wrap_angle(pose.heading_rad - heading.position)
            heading.update(measured, dh, dvh, dt_s)
            self.disturbance = x.disturbance, y.disturbance, heading.disturbance

    def command(self, acceleration: Axes, ahead: Ahead) -> WheelCommand:
        """Return the torques for a world acceleration at that moment, and remember them for the next ticks."""
        command = torque_command(self._model, acceleration, ahead.heading_rad, ahead.twist, ahead.moving)
        self._asked = Acceleration(*acceleration)
        self._sent = command.torque_n_m
        return command


def _ahead(reference: Reference, state: State, latency_s: float, moved_by: Axes, sped_by: Axes) -> Ahead:
    """Return both later: the robot so much further and faster than with the reference's acceleration."""
    x, y, heading, vx, vy, yaw_rate = tracking_error(reference, state)
    _, (vx_d, vy_d, yaw_rate_d), (ax, ay, ah) = reference
    dx, dy, dh = moved_by
    dvx, dvy, dvh = sped_by
    turned_rad = latency_s * (state.twist.yaw_rate_rad_s + 0.5 * latency_s * ah) + dh
    x, y, heading = x + latency_s * vx + dx, y + latency_s * vy + dy, heading + latency_s * yaw_rate + dh
    vx, vy, yaw_rate = vx + dvx, vy + dvy, yaw_rate + dvh
    vx_d, vy_d, yaw_rate_d = vx_d + latency_s * ax, vy_d + latency_s * ay, yaw_rate_d + latency_s * ah
    return Ahead(
        TrackingError(x, y, heading, vx, vy, yaw_rate),
        state.pose.heading_rad + turned_rad,
        (vx_d, vy_d, yaw_rate_d),
        (vx_d + vx, vy_d + vy, yaw_rate_d + yaw_rate),
    )
