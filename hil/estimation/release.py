"""Corrections of a pose, given out over time: what a fix changes is no motion, and a law must not take it for one."""

import math

from hil.core.types import Axes, Pose
from hil.estimation.belief import Belief

_NONE = (0.0, 0.0, 0.0)
_MOST_M = 0.01
_MOST_RAD = 0.01


class Release:
    """Holds back what fixes change in the pose, and gives it out with the time constant ``release_s`` [s].

    Between fixes the pose then moves as wheels and gyro tell, and after one it comes to the corrected one without a
    jump. With 0 s it jumps. No more than 10 mm and 10 mrad are held back: what is further off, as after slip, is told
    at once, for a law that acts on it does more harm than the jump.
    """

    def __init__(self, release_s: float) -> None:
        self._release_s = release_s
        self._held: Axes = _NONE

    def correct(self, before: Belief, after: Belief) -> None:
        """Take in what fixes have changed. A new start, which the belief was nowhere near, counts at once."""
        if not before.is_known or after.restarts != before.restarts or self._release_s == 0.0:
            self._held = _NONE
            return
        x, y, heading = self._held
        x += after.x_m - before.x_m
        y += after.y_m - before.y_m
        heading += after.heading_rad - before.heading_rad
        # By one factor for all three, so that what is told lies between both poses.
        share = min(1.0, _MOST_M / max(math.hypot(x, y), 1e-9), _MOST_RAD / max(abs(heading), 1e-9))
        self._held = share * x, share * y, share * heading

    def advance(self, dt_s: float) -> None:
        """Give out what ``dt_s`` [s] bring."""
        if self._held is not _NONE:
            rest = math.exp(-dt_s / self._release_s)
            x, y, heading = self._held
            self._held = rest * x, rest * y, rest * heading

    def pose(self, belief: Belief) -> Pose:
        """Return the pose to tell."""
        x, y, heading = self._held
        return Pose(belief.x_m - x, belief.y_m - y, belief.heading_rad - heading)
