"""How long what a controller said counts: a message that has fallen silent says nothing of now.

A driver asks no clock. What else arrives tells it the time: a value is too old when others have come since for longer
than ``late_ns``. When nothing comes at all, ``Sample.stamp_ns`` grows old, which holds the robot.
"""

import math

from hil.core.types import NAN

_PERIODS = 5
_LEAST_S = 0.1


def late_ns(period_s: float) -> int:
    """Return after how long what comes once a period counts no more: five of them, and not for a hiccup."""
    return round(max(_PERIODS * period_s, _LEAST_S) * 1e9)


def holds_back(stamp_ns: int, other_ns: int, limit_ns: int) -> int:
    """Return the stamp of a sample which rests on something else too, that came at ``other_ns``.

    It is that of the speeds, but goes on no longer once the other is older than ``limit_ns``: so a sample never goes
    back in time, and yet grows old.
    """
    return min(stamp_ns, other_ns + limit_ns)


def lowest(*values: float) -> float:
    """Return the lowest of those that are known, NaN when none is: each of four tells the voltage of one battery."""
    return min((value for value in values if not math.isnan(value)), default=NAN)
