"""How far the wheels of makers' controllers have turned, as the counts of 16 bits that odometry takes. Pure."""

import math

from hil.core.types import FourWheels
from hil.drivers.port import Sample

# Over a longer gap, which is a lost link or a stall of this process, two speeds say nothing of what was between them.
_LONGEST_S = 0.25


class Angles:
    """Follows the positions that controllers tell, or their speeds where they tell none.

    After a loss it goes on from where it was: a controller that was reset counts from zero again, and how far the
    wheels rolled meanwhile is not known. Nor is it over a gap of more than 0.25 s where only speeds are told.
    """

    def __init__(self, counts_per_revolution: int) -> None:
        self._per_rad = counts_per_revolution / math.tau
        self._turned_rad: FourWheels = (0.0, 0.0, 0.0, 0.0)
        self._last: Sample | None = None

    def take(self, sample: Sample) -> tuple[int, int, int, int]:
        """Take the newest sample and return the counts, which wrap."""
        last, self._last = self._last, sample
        if last is not None and last is not sample:
            self._turned_rad = self._moved(last, sample)
        fl, fr, rr, rl = (round(angle * self._per_rad) & 0xFFFF for angle in self._turned_rad)
        return fl, fr, rr, rl

    def restart(self) -> None:
        """Go on with controllers that may have been reset."""
        self._last = None

    def _moved(self, last: Sample, sample: Sample) -> FourWheels:
        dt_s = max(0.0, (sample.stamp_ns - last.stamp_ns) * 1e-9)
        counted_s = dt_s if dt_s <= _LONGEST_S else 0.0
        fl, fr, rr, rl = (
            turned + (0.5 * (slow + fast) * counted_s if math.isnan(now - before) else now - before)
            for turned, before, now, slow, fast in zip(
                self._turned_rad,
                last.position_rad,
                sample.position_rad,
                last.speed_rad_s,
                sample.speed_rad_s,
                strict=True,
            )
        )
        return fl, fr, rr, rl
