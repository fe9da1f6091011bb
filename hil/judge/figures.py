"""Every figure of a run in one place: what it is called, how it is computed, and how it is shown.

``MEASURES`` holds the measures that compute figures from the recorded rows, so that a run and a review of its recording
have the same figures. ``_OF_RUNS`` holds the
figures that only the run itself knows.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, ClassVar

from hil.core.percentiles import Reservoir
from hil.judge.effort import Effort, Overshoot, Saturation, Taken
from hil.judge.measure import Figure, Measure, NoFigureError, RunSetup, Series, since_start
from hil.judge.tracking import EstimationError, Tracking

BLOCK_ROWS = 1024
"""Rows that a measure is given at once: sums are equal to the last bit only with equal blocks."""


class Ticks(Measure):
    """The number of rows."""

    figures = (Figure("ticks", "ticks", "", 1, "control periods that were done", better=None),)
    signals = ("loop.t_s",)

    def __init__(self, _setup: RunSetup) -> None:
        self._ticks = 0

    def add(self, signals: Mapping[str, Series]) -> None:
        self._ticks += len(signals["loop.t_s"])

    def value(self, _name: str) -> int:
        return self._ticks


class _Percentiles(Measure):
    _few: ClassVar[str]

    def __init__(self, _setup: RunSetup) -> None:
        self._values = Reservoir()

    def value(self, _name: str) -> dict[str, float]:
        if (percentiles := self._values.percentiles()) is None:
            raise NoFigureError(self._few)
        return percentiles._asdict()


class TickTime(_Percentiles):
    """How long the work of a tick took."""

    figures = (
        Figure("tick_us.p50", "tick p50", "µs", 1.0, "work of a tick, median", printed=False, of_machine=True),
        Figure("tick_us.p99", "tick p99", "µs", 1.0, "work of a tick, 99th percentile", printed=False, of_machine=True),
    )  # fmt: skip
    signals = ("loop.tick_us",)
    _few = "the run has fewer than two ticks"

    def add(self, signals: Mapping[str, Series]) -> None:
        self._values.extend(signals["loop.tick_us"])


class Latency(_Percentiles):
    """The latency of the loop, as passed to the law; over the ticks from t = 0 on that have one."""

    figures = (
        Figure("latency_ms.p50", "latency p50", "ms", 1.0, "from sampling to the tick that uses the command, median",
               printed=False, resolution=0.1),
        Figure("latency_ms.p99", "latency p99", "ms", 1.0, "the same, 99th percentile", column="latency_p99_ms",
               printed=False, resolution=0.1),
    )  # fmt: skip
    signals = ("loop.t_s", "link.latency_ms")
    _few = "the run has fewer than two ticks with a latency"

    def add(self, signals: Mapping[str, Series]) -> None:
        self._values.extend(since_start(signals)["link.latency_ms"])


class DeadlineMisses(Measure):
    """How many ticks began too late: the count in the newest row."""

    figures = (
        Figure("deadline_misses", "deadline misses", "", 1, "ticks that could not begin in time", of_machine=True),
    )
    signals = ("loop.deadline_misses",)

    def __init__(self, _setup: RunSetup) -> None:
        self._misses = 0

    def add(self, signals: Mapping[str, Series]) -> None:
        misses = signals["loop.deadline_misses"]
        if len(misses) and math.isfinite(misses[-1]):  # a damaged one of an earlier version may be anything
            self._misses = int(misses[-1])

    def value(self, _name: str) -> int:
        return self._misses


MEASURES: tuple[type[Measure], ...] = (
    Tracking,
    Overshoot,
    Effort,
    Saturation,
    Taken,
    EstimationError,
    Ticks,
    TickTime,
    Latency,
    DeadlineMisses,
)
_AGE, _ROUND_TRIP = "age of the feedback that a tick used", "from a command to the feedback that it was in force"
_OF_RUNS = (
    Figure("realtime_factor", "times real time", "", 1.0, "robot time over wall time", None,
           of_machine=True),
    Figure("frames.sent", "frames sent", "", 1, "frames to the robot", None, printed=False),
    Figure("frames.received", "frames received", "", 1, "frames from the robot", None, printed=False),
    Figure("rejected", "frames rejected", "", 1, "frames that were not accepted from t = 0 on, for any cause",
           column="rejected", printed=False),
    Figure("unmatched", "feedforwards unmatched", "", 1, "torque feedforwards without their command",
           column="unmatched", printed=False),
    Figure("link_statistics.lost.snapshots", "snapshots lost", "", 1, "feedback that never came", printed=False),
    Figure("link_statistics.feedback_age_ms.p50", "feedback age p50", "ms", 1.0, f"{_AGE}, median",
           printed=False, resolution=0.1, resolution_ticks=1),
    Figure("link_statistics.feedback_age_ms.p99", "feedback age p99", "ms", 1.0, f"{_AGE}, 99th percentile",
           column="feedback_age_p99_ms", printed=False, resolution=0.1, resolution_ticks=1),
    Figure("link_statistics.round_trip_ms.p50", "round trip p50", "ms", 1.0, f"{_ROUND_TRIP}, median",
           printed=False, resolution=0.1, resolution_ticks=1),
    Figure("link_statistics.round_trip_ms.p99", "round trip p99", "ms", 1.0, f"{_ROUND_TRIP}, 99th percentile",
           column="round_trip_p99_ms", printed=False, resolution=0.1, resolution_ticks=1),
    Figure("commands_refused", "commands refused", "", 1, "ticks with a command that was not finite",
           column="refused", printed=False),
    Figure("stale_ticks", "stale ticks", "", 1, "ticks in which no feedback was fresh enough to drive", printed=False),
    Figure("held_ticks", "held ticks", "", 1, "ticks in which the state was unknown or the robot lost", printed=False),
    Figure("recoveries", "recoveries", "", 1, "times that the robot was lost and armed again", printed=False),
    Figure("expect", "expectations failed", "", 1, "expectations that did not hold", printed=False),
)  # fmt: skip
"""Figures that do not follow from the rows."""


def figures() -> list[Figure]:
    """Return every figure, those that reports print on a line of their own first."""
    found = [*(figure for measure in MEASURES for figure in measure.figures), *_OF_RUNS]
    return sorted(found, key=lambda figure: not figure.printed)


def table_figures() -> dict[str, Figure]:
    """Return the figures that tables of many runs hold, by the names of their columns."""
    return {figure.column: figure for figure in figures() if figure.column is not None}


class RunFigures:
    """Computes the figures of a run that follow from its rows, block by block, in bounded memory.

    ``names`` are the run's signals. ``lacks`` takes the name of a missing signal, and returns the reason to give for
    each figure that needs it and is None.

    Attributes:
        signals: those that ``add`` needs.
    """

    def __init__(
        self,
        setup: RunSetup,
        names: Collection[str],
        lacks: Callable[[str], str] = lambda name: f"the run has no signal {name}",
    ) -> None:
        needed = figure_signals()
        self.signals = [name for name in names if name in needed]
        self._made: list[Measure] = []
        self._lacking: dict[type[Measure], str] = {}  # why there is none of a class
        for kind in MEASURES:
            if missing := [name for name in kind.signals if name not in names]:
                self._lacking[kind] = lacks(missing[0])
            else:
                self._made.append(kind(setup))

    def add(self, signals: Mapping[str, Series]) -> Iterator[None]:
        """Add the next rows, each signal by name of shape (n,), in a few steps of about equal length."""
        for measure in self._made:
            measure.add(signals)
            yield

    def figures(self, cut: str | None = None) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the figures by their keys in a run's JSON, and the reason for each that is None.

        ``cut`` is the reason why a run that ended early has no figures of its end.
        """
        found: dict[str, Any] = {}
        reasons: dict[str, str] = {}
        made = {type(measure): measure for measure in self._made}
        for kind in MEASURES:
            for name, of_end in {figure.name.partition(".")[0]: figure.of_end for figure in kind.figures}.items():
                found[name] = None
                if cut is not None and of_end:
                    reasons[name] = cut
                elif kind in self._lacking:
                    reasons[name] = self._lacking[kind]
                else:
                    try:
                        found[name] = made[kind].value(name)
                    except NoFigureError as no_figure:
                        reasons[name] = str(no_figure)
        return found, reasons


def signal_figures(
    signals: Mapping[str, Series],
    setup: RunSetup = RunSetup(),  # noqa: B008 -- immutable
    cut: str | None = None,
    **lacks: Callable[[str], str],
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the figures of a whole run at once, as ``RunFigures`` does."""
    run = RunFigures(setup, signals, **lacks)
    for start in range(0, len(signals["loop.t_s"]), BLOCK_ROWS):
        for _ in run.add({name: signals[name][start : start + BLOCK_ROWS] for name in run.signals}):
            pass
    return run.figures(cut)


def figure_signals() -> frozenset[str]:
    """Return the names of all signals from which figures are computed."""
    return frozenset(name for measure in MEASURES for name in measure.signals)


def cut_words(t_s: float, duration_s: float | None) -> str:
    """Return the reason why a run that ended early at ``t_s`` has no figures of its end; ``duration_s`` may be None."""
    whole = "" if duration_s is None else f" of {duration_s:g} s"
    return f"there is nothing after t = {t_s:.6g} s{whole}, and this is a figure of the run's end"
