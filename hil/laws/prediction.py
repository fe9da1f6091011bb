"""The commands on their way: what they did since the last tick, and what they will do until the next can act.

A command acts from ``latency_s`` after the sampling instant that it was worked out from (``Applied.latency_s``)
until the next one does. A law that decides at t_n decides for t_n + latency on; by then the robot has moved, by
commands that are known. Between two commands the acceleration is taken as constant in the world frame, so both
motions are exact for a double integrator an axis, whatever the latency is in periods.
"""

import math
import operator
from collections import deque

from hil.core.kinematics import body_wrench
from hil.core.model import RobotModel
from hil.core.types import Axes, Pairs, Wheels


class CommandsOnTheirWay:
    """The accelerations that were commanded of late, each with the time from which it acts.

    Before the first one acts there is no acceleration. What they do is told as of a robot that begins at rest:
    displacement [m, rad] and rate [m/s, rad/s].
    """

    __slots__ = ("_acting", "_now_s", "_waiting")

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin with nothing commanded."""
        self._now_s = 0.0
        self._acting: Axes = (0.0, 0.0, 0.0)
        self._waiting: deque[tuple[float, Axes]] = deque()

    def advance(self, commanded: Axes, latency_s: float, dt_s: float) -> Pairs:
        """Go on by ``dt_s`` [s] to the present tick, and return how the robot was moved since the last one.

        ``commanded`` was decided at the last tick and acts from ``latency_s`` after it. One that was to act no
        sooner than this one never does: it is overtaken.
        """
        waiting = self._waiting
        acts_from_s = self._now_s + latency_s
        while waiting and waiting[-1][0] >= acts_from_s:
            waiting.pop()
        waiting.append((acts_from_s, commanded))
        moved = self.ahead(dt_s)
        self._now_s += dt_s
        while waiting and waiting[0][0] <= self._now_s:
            self._acting = waiting.popleft()[1]
        return moved

    def ahead(self, horizon_s: float) -> Pairs:
        """Return how the robot is moved within the next ``horizon_s`` [s] by what was commanded until now."""
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


def acceleration_of(model: RobotModel, torque_n_m: Wheels, twist: Axes, heading_rad: float, moving: Axes) -> Axes:
    """Return the world acceleration of these wheel torques: ``RobotModel.wheel_torques`` read backwards.

    What a law wanted and what the guard let through differ; this turns the latter into what an observer needs.
    Friction is taken as the law took it, so that both are the same where the guard did nothing. Of torques that work
    against each other the share that moves the robot counts.
    """
    friction_n_m = model.friction_torques(model.wheel_speeds(moving, heading_rad))
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
