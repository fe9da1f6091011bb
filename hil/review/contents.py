"""The contents of a recording's file, in either format, and a check that its rows are plausible."""

import json
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.signals import SIGNAL_NAMES
from hil.record.properties import APPLICATION

Series = npt.NDArray[np.float64]
Selection = Collection[str] | None
"""Names of the signals to read; None for all."""

CUT_BEFORE_ROWS = "cut before its first rows"


class DamagedError(Exception):
    """The file cannot be read as a recording of a run; the text says what is wrong with it."""


class Contents(NamedTuple):
    """What was read from one file.

    Attributes:
        signals: by name, each of shape (rows,).
        events: time [s], level and text of each.
        properties: the texts of each property.
        cut_bytes: None for a file with a proper end; otherwise the number of bytes that were left out at its end: a
            message or record that was cut short.
        damage: a sentence for each damaged piece in the middle that could not be read.
        lost_rows: how many rows these pieces had, as far as that is known.
    """

    signals: dict[str, Series]
    events: list[tuple[float, str, str]]
    properties: dict[str, dict[str, str]]
    cut_bytes: int | None
    damage: tuple[str, ...] = ()
    lost_rows: int = 0


def why_nothing(programs: Collection[str], cut_bytes: int | None) -> str:
    """Return the reason why a file holds no run, by the programs named in it and by whether it was cut."""
    if APPLICATION in programs:
        return "damaged: it does not say what its signals are" if cut_bytes is None else CUT_BEFORE_ROWS
    if programs or cut_bytes is None:
        return "a recording of another program"
    return "cut off so early that its program is not known"


def json_property(properties: dict[str, dict[str, str]], name: str) -> dict[str, Any] | None:
    """Return a property that holds a JSON object, None if it is missing. Raises DamagedError for other content."""
    texts = properties.get(name)
    if texts is None:
        return None
    try:
        value = json.loads(texts["json"])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise DamagedError(f"damaged: its property {name!r} is not readable")
    return value


CLOCK = frozenset({"loop.t_s", "loop.tick"})
"""The signals by which every row is checked."""
# No measured quantity comes near this, not even a robot's clock in µs since 1970. Gains and the laws' own signals are
# not checked against it, because a law may diverge.
_LARGEST = 1e18
_MEASURED = frozenset(name for name in SIGNAL_NAMES if not name.startswith("gain."))
_TOLERANCE = 0.01  # of a period; t_s is the tick times the period, except for rounding


def check_plausible(signals: dict[str, Series]) -> None:
    """Raise DamagedError, with the time, when the clock of the rows or a value makes no sense.

    An .rrd file has no checksums, so damaged bytes decode to numbers too. Signals have shape (n,). Each tick must take
    one period, and ticks must ascend. Rows may be missing; in a file merged from several some may be there twice.
    """
    if not signals.keys() >= CLOCK or not len(signals["loop.t_s"]):
        return
    t_s, tick = signals["loop.t_s"], signals["loop.tick"]
    with np.errstate(all="ignore"):  # a damaged value may be any number
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
