"""What a run turned out to have, known at its end: the layout of its review is made from it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hil.addons.report.claim_watch import ClaimWatch
from hil.addons.report.lanes import FaultLane

_START_S = 1.0
"""How much of a run's beginning is shown as its transient, unless it is known when the robot tracked the reference."""
_LONGEST_START_S = 10.0
_BEFORE = 0.25
"""Part of a window that lies before its moment, of its length after it."""
_AFTER_S = 1.0
_TOGETHER_S = 0.25
_MOST_WINDOWS = 8


class Moment(NamedTuple):
    """Something that happened: its time [s], a word for it, and how long it lasted [s]."""

    t_s: float
    words: str
    lasts_s: float = 0.0


class Window(NamedTuple):
    """A span of time [s] that deserves a closer look, and its content as text."""

    from_s: float
    to_s: float
    words: str


class Course(NamedTuple):
    """The course of a run.

    Attributes:
        begin_s, end_s: its first and last time.
        violated: the paths of the plots in which a violation is marked, the earliest first.
        first_violation: from when to when an expectation was violated first [s]; None if none was.
        windows: its transient, then a window for each moment, in the order of time.
        lanes: how many lanes of states it has.
        lines: how many lines its verdict has below the headline.
    """

    begin_s: float
    end_s: float
    violated: tuple[str, ...]
    first_violation: tuple[float, float] | None
    windows: tuple[Window, ...]
    lanes: int
    lines: int


def windows(
    begin_s: float, end_s: float, summary: Mapping[str, Any] | None, moments: Sequence[Moment]
) -> tuple[Window, ...]:
    """Return the windows of a run: its start until the robot tracks the reference, then one for each moment.

    Moments so close that one window shows both share it.
    """
    tracked = (summary or {}).get("tracked_s")
    start_s = 1.5 * tracked if isinstance(tracked, int | float) and tracked > 0.0 else _START_S
    first_s = min((moment.t_s for moment in moments if moment.t_s > begin_s), default=end_s) - begin_s
    start_s = min(max(start_s, 0.5 * _START_S), _LONGEST_START_S, first_s)
    newest_s = -math.inf
    found = [Window(begin_s, begin_s + start_s, "start")]
    for moment in sorted(moments):
        length_s = min(moment.lasts_s, 3.0 * _AFTER_S) + _AFTER_S
        window = Window(
            max(begin_s, moment.t_s - _BEFORE * length_s),
            min(end_s, moment.t_s + length_s),
            f"{moment.words} at {moment.t_s:.4g} s",
        )
        if len(found) > 1 and moment.t_s - newest_s < _TOGETHER_S:
            found[-1] = Window(found[-1].from_s, max(found[-1].to_s, window.to_s), f"{found[-1].words}; {moment.words}")
        elif window.from_s < window.to_s:
            found.append(window)
            newest_s = moment.t_s
    return tuple(found[:_MOST_WINDOWS])


def moments(
    watches: Sequence[ClaimWatch], faults: Sequence[FaultLane], summary: Mapping[str, Any] | None, end_s: float
) -> list[Moment]:
    """Return what happened: each fault that began, each first violation, each loss of the robot, and a failure."""
    found = [Moment(one.begin_s, one.words, min(one.end_s, end_s) - one.begin_s) for one in faults]
    found += [Moment(one.violation_s[0], f"violated: {one.claim.words}") for one in watches if one.violation_s]
    found += [
        Moment(row["lost_s"], "robot lost", row["armed_s"] - row["lost_s"])
        for row in (summary or {}).get("recoveries") or ()
    ]
    if (summary or {}).get("failure") is not None:
        found.append(Moment(end_s, "run ended"))
    return found
