"""Whether rows can be what a run wrote: an .rrd file has no checksums, and damage decodes to numbers too."""

import numpy as np

from hil.core.signals import SIGNAL_NAMES
from hil.review.contents import DamagedError, Series

CLOCK = frozenset({"loop.t_s", "loop.tick"})
"""The signals that every row is checked by."""
# No quantity of the vocabulary comes near, not even a robot's clock in µs since 1970. The gains and a run's own signals
# are whatever a law makes of them, which may diverge.
_LARGEST = 1e18
_MEASURED = frozenset(name for name in SIGNAL_NAMES if not name.startswith("gain."))
_TOLERANCE = 0.01  # of a period; t_s is the tick times the period, but for rounding


def check_plausible(signals: dict[str, Series]) -> None:
    """Raise DamagedError, with the time, when the clock of the rows, each of shape (n,), or a value makes no sense.

    Time goes on with the ticks by one period each, and no tick is before the one above it. Rows may be missing; in a
    file merged of parts some may be there twice.
    """
    if not signals.keys() >= CLOCK or not len(signals["loop.t_s"]):
        return
    t_s, tick = signals["loop.t_s"], signals["loop.tick"]
    with np.errstate(all="ignore"):  # what is damaged may be any number
        bad = ~(np.isfinite(t_s) & (tick == np.rint(tick)))
        for name in _MEASURED & signals.keys():
            bad |= np.abs(signals[name]) >= _LARGEST
        if len(tick) > 1:
            passed_s, ticks = np.diff(t_s), np.diff(tick)
            period_s = np.nanmedian(passed_s / ticks)
            bad[1:] |= ~(np.abs(passed_s - period_s * ticks) <= _TOLERANCE * period_s)
            if (ticks <= 0).any() and len(np.unique(tick)) == len(tick):
                bad[1:] |= ticks <= 0
    if bad.any():
        first = int(np.argmax(bad))
        near_s = t_s[first - 1] if first else t_s[np.argmin(bad)]
        where = f" near t = {near_s:.3f} s" if not bad.all() else ""
        raise DamagedError(f"damaged{where}: from there on values or times make no sense")
