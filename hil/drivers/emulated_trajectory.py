"""The control position of an emulated position loop: at once at what is commanded, or on a ramp within limits."""

import math

from hil.drivers.emulated import limited

_TICK_S = 0.001
_NEAR_REV = 2e-6


class Trajectory:
    """Where the position loop is to be, in revolutions.

    Attributes:
        position_rev: NaN while nothing is controlled.
        velocity: of the control position [rev/s].
        is_complete: it is at what was commanded.
    """

    def __init__(self) -> None:
        self.position_rev = math.nan
        self.velocity = 0.0
        self.is_complete = False
        self._target_rev: float | None = None

    def forget(self) -> None:
        """Begin anew, at the next step, where the output is."""
        self.position_rev, self.velocity, self._target_rev = math.nan, 0.0, None

    def aim(self, position_rev: float) -> None:
        """Go to a position."""
        self._target_rev, self.is_complete = position_rev, False

    def step(self, at: float, speed: float, target: float, velocity_most: float, accel_most: float) -> None:
        """Go on for a millisecond.

        Args:
            at, speed: of the output, where a trajectory begins [rev, rev/s].
            target: the velocity at the end [rev/s].
            velocity_most, accel_most: limits, infinite for none [rev/s, rev/s²].
        """
        has_limits = math.isfinite(velocity_most) or math.isfinite(accel_most)
        if math.isnan(self.position_rev):
            self.position_rev, self.velocity = at, speed if has_limits else 0.0
        if has_limits:
            self._ramp(target, velocity_most, accel_most)
            return
        if self._target_rev is not None:
            self.position_rev, self._target_rev = self._target_rev, None
        self.velocity, self.is_complete = target, True
        self.position_rev += target * _TICK_S

    def stop_at(self, stop_rev: float, at: float, target: float) -> float:
        """Return the velocity to command, which is 0 where the stop position is reached or behind."""
        place = at if math.isnan(self.position_rev) else self.position_rev
        if not math.isfinite(stop_rev) or (stop_rev - place) * target > 0.0:
            return target
        self.position_rev = stop_rev
        return 0.0

    def slip(self, at: float, most_rev: float) -> None:
        """Stay so near to where the output is; NaN is no limit."""
        if not math.isnan(most_rev):
            self.position_rev = at + limited(self.position_rev - at, most_rev)

    def _ramp(self, target: float, velocity_most: float, accel_most: float) -> None:
        wanted, step = limited(target, velocity_most), accel_most * _TICK_S
        if self._target_rev is not None:
            self._target_rev += target * _TICK_S
            left = self._target_rev - self.position_rev
            closing = min(abs(left) / _TICK_S, math.sqrt(2.0 * accel_most * abs(left)) if left else 0.0)
            wanted = limited(target + math.copysign(closing, left), velocity_most)
        self.velocity += limited(wanted - self.velocity, step)
        self.position_rev += self.velocity * _TICK_S
        if self._target_rev is None:
            self.is_complete = self.velocity == wanted
            return
        near = max(_NEAR_REV, 2.0 * step * _TICK_S) if math.isfinite(step) else _NEAR_REV
        if abs(self._target_rev - self.position_rev) <= near and abs(self.velocity - target) <= 2.0 * step:
            self.position_rev, self._target_rev = self._target_rev, None
            self.velocity, self.is_complete = target, True
