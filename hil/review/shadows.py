"""How the set points of another law differ from the command: of a shadow beside a run, or of a law replayed on it."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from hil.laws.shadows import QUANTITY
from hil.review.contents import Series

_PREFIX = "shadow."


class CommandDifference(NamedTuple):
    """Set points of another law minus the recorded ones, of one wheel, in the unit of the signal.

    ``max`` is the largest absolute difference, at ``max_s`` of the run; ``recorded_rms`` is the size of the commands.
    """

    rms: float
    max: float
    max_s: float
    recorded_rms: float


def command_difference(t_s: Series, recorded: Series, other: Series) -> CommandDifference:
    """Compare set points at the times ``t_s`` [s], all of shape (n,) with n at least 1 and without NaN."""
    apart = np.abs(other - recorded)
    most = int(np.argmax(apart))
    rms, recorded_rms = (float(np.sqrt(np.mean(series**2))) for series in (apart, recorded))
    return CommandDifference(rms, float(apart[most]), float(t_s[most]), recorded_rms)


def shadow_signals(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return, of the names of a recording's signals, those of its shadows: by shadow, then by the command's signal."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        if name.startswith(_PREFIX) and name.endswith(tuple(QUANTITY.values())):
            shadow, _, command = name.removeprefix(_PREFIX).partition(".")
            found.setdefault(shadow, {})[command] = name
    return found


def shadow_differences(signals: Mapping[str, Series]) -> dict[str, dict[str, CommandDifference]]:
    """Return how each shadow's set points differ from the command, by shadow and by the command's signal.

    ``signals`` are those of a run with the shadows' among them. Ticks without a command or without a value of the
    shadow are left out; a shadow that never had a value beside a command has no entry.
    """
    found: dict[str, dict[str, CommandDifference]] = {}
    for shadow, names in shadow_signals(signals).items():
        for command, name in names.items():
            known = np.isfinite(signals[name]) & np.isfinite(signals[command])
            if known.any():
                t_s, recorded, other = (signals[one][known] for one in ("loop.t_s", command, name))
                found.setdefault(shadow, {})[command] = command_difference(t_s, recorded, other)
    return found
