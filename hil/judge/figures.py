"""Every figure of a run in one place: what it is called, how it is computed, and how it is shown.

``SHIPPED`` holds the measures that compute figures from the recorded rows, so that a run and a review of its recording
have the same figures. Other packages add theirs by entry points of the group ``hil.figures``. ``_OF_RUNS`` holds the
figures that only the run itself knows.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.core.extensions import Extensions
from hil.core.percentiles import Reservoir
from hil.judge.effort import Effort, Overshoot, Saturation
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
        """Count rows."""
        self._ticks += len(signals["loop.t_s"])

    def value(self, _name: str) -> int:
        """Return the number."""
        return self._ticks


class TickTime(Measure):
    """How long the work of a tick took."""

    figures = (
        Figure("tick_us.p50", "tick p50", "µs", 1.0, "work of a tick, median", printed=False, of_machine=True),
        Figure("tick_us.p99", "tick p99", "µs", 1.0, "work of a tick, 99th percentile", printed=False, of_machine=True),
    )  # fmt: skip
    signals = ("loop.tick_us",)

    def __init__(self, _setup: RunSetup) -> None:
        self._tick_us = Reservoir()

    def add(self, signals: Mapping[str, Series]) -> None:
        """Add rows."""
        self._tick_us.extend(signals["loop.tick_us"])

    def value(self, _name: str) -> dict[str, float]:
        """Return the percentiles. Raises NoFigureError for a run of fewer than two ticks."""
        percentiles = self._tick_us.percentiles()
        if percentiles is None:
            raise NoFigureError("the run has fewer than two ticks")
        return percentiles._asdict()


class Latency(Measure):
    """The latency of the loop, as the law is told it; over the ticks from t = 0 on that have one."""

    figures = (
        Figure("latency_ms.p50", "latency p50", "ms", 1.0, "from sampling to the tick that uses the command, median",
               printed=False, resolution=0.1),
        Figure("latency_ms.p99", "latency p99", "ms", 1.0, "the same, 99th percentile", column="latency_p99_ms",
               printed=False, resolution=0.1),
    )  # fmt: skip
    signals = ("loop.t_s", "link.latency_ms")

    def __init__(self, _setup: RunSetup) -> None:
        self._latency_ms = Reservoir()

    def add(self, signals: Mapping[str, Series]) -> None:
        """Add rows; those before t = 0 do not count."""
        self._latency_ms.extend(since_start(signals)["link.latency_ms"])

    def value(self, _name: str) -> dict[str, float]:
        """Return the percentiles. Raises NoFigureError for a run of fewer than two ticks."""
        percentiles = self._latency_ms.percentiles()
        if percentiles is None:
            raise NoFigureError("the run has fewer than two ticks with a latency")
        return percentiles._asdict()


class DeadlineMisses(Measure):
    """How many ticks began too late: the count in the newest row."""

    figures = (
        Figure("deadline_misses", "deadline misses", "", 1, "ticks that could not begin in time", of_machine=True),
    )
    signals = ("loop.deadline_misses",)

    def __init__(self, _setup: RunSetup) -> None:
        self._misses = 0

    def add(self, signals: Mapping[str, Series]) -> None:
        """Take the newest count."""
        misses = signals["loop.deadline_misses"]
        self._misses = int(misses[-1]) if len(misses) else self._misses

    def value(self, _name: str) -> int:
        """Return the count."""
        return self._misses


SHIPPED: tuple[type[Measure], ...] = (
    Tracking,
    Overshoot,
    Effort,
    Saturation,
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

_EXTENSIONS = Extensions("hil.figures", [figure.name for measure in SHIPPED for figure in measure.figures])


def measures() -> Sequence[type[Measure]]:
    """Return the classes that compute figures: the shipped ones, then those of other packages.

    Raises BadInputError when another package's class cannot be loaded, does not have what ``Measure`` requires, or has
    a figure whose name is already in use.
    """
    found = list(SHIPPED)
    taken = {_key(figure.name) for figure in (*_OF_RUNS, *(one for measure in SHIPPED for one in measure.figures))}
    for named, point, measure in _EXTENSIONS.load_all("figure"):
        if missing := [name for name in ("figures", "signals", "add", "value") if not hasattr(measure, name)]:
            expected = "expected a class as hil.judge.measure.Measure describes it"
            raise BadInputError(f"{named}: {point.value!r} has no {missing[0]}; {expected}")
        for name in (_key(figure.name) for figure in measure.figures):
            if name in taken:
                raise BadInputError(f"{named}: the name {name!r} is already in use; choose another")
        taken |= {_key(figure.name) for figure in measure.figures}
        found.append(measure)
    return found


def figures() -> list[Figure]:
    """Return every figure, those that reports print on a line of their own first. Raises as ``measures``."""
    found = [*(figure for measure in measures() for figure in measure.figures), *_OF_RUNS]
    return sorted(found, key=lambda figure: not figure.printed)


def table_figures() -> dict[str, Figure]:
    """Return the figures that tables of many runs hold, by the names of their columns. Raises as ``measures``."""
    return {figure.column: figure for figure in figures() if figure.column is not None}


def check_figure(name: str, where: str, known: Collection[str]) -> None:
    """Raise BadInputError, which begins with ``where``, for a name that is not known, with the nearest one."""
    if name not in known:
        raise BadInputError(f"{where}: unknown figure {name!r}{nearest(name, known)}")


def number(metrics: Mapping[str, Any], name: str) -> float | None:
    """Return a figure of a run from its JSON by its name, None where the run has none.

    A table of counts gives their sum, expectations how many failed, other rows (such as recoveries) how many there are.
    """
    value: Any = metrics
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    if isinstance(value, Mapping):
        return sum(value.values())
    if isinstance(value, list):
        return sum(row.get("passed", False) is False for row in value)
    return value if isinstance(value, int | float) and math.isfinite(value) else None


class RunFigures:
    """Computes the figures of a run that follow from its rows, block by block, in bounded memory.

    ``names`` are the run's signals. ``lacks`` takes the name of a missing signal, and returns the reason to give for
    each figure that needs it and is None. Raises BadInputError as ``measures`` does.

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
        self._made: list[tuple[type[Measure], Measure | None]] = []
        self._reasons: dict[type[Measure], str] = {}  # why a measure has no figures
        for kind in measures():
            measure = None
            if missing := [name for name in kind.signals if name not in names]:
                self._reasons[kind] = lacks(missing[0])
            else:
                with self._contained(kind):
                    measure = kind(setup)
            self._made.append((kind, measure))

    def add(self, signals: Mapping[str, Series]) -> Iterator[None]:
        """Add the next rows, each signal by name of shape (n,), in a few steps of about equal length."""
        for kind, measure in self._made:
            if measure is not None and kind not in self._reasons:
                with self._contained(kind):
                    measure.add(signals)
                yield

    def figures(self, cut: str | None = None) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the figures by their keys in a run's JSON, and the reason for each that is None.

        ``cut`` is the reason why a run that ended early has no figures of its end.
        """
        found: dict[str, Any] = {}
        reasons: dict[str, str] = {}
        for kind, measure in self._made:
            for name, of_end in {_key(figure.name): figure.of_end for figure in kind.figures}.items():
                found[name] = None
                try:
                    if cut is not None and of_end:
                        raise NoFigureError(cut)
                    if measure is not None and kind not in self._reasons:
                        with self._contained(kind):
                            found[name] = measure.value(name)
                    if kind in self._reasons:
                        raise NoFigureError(self._reasons[kind])
                except NoFigureError as no_figure:
                    reasons[name] = str(no_figure)
        return found, reasons

    @contextmanager
    def _contained(self, kind: type[Measure]) -> Iterator[None]:
        """Make an error in a measure the reason why it has no figures; it must not end a run that drives a robot."""
        try:
            yield
        except NoFigureError:
            raise
        except Exception as error:  # noqa: BLE001 - another package's code may raise anything
            self._reasons[kind] = f"{kind.__module__}:{kind.__qualname__} failed: {type(error).__name__}: {error}"


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
    """Return the names of all signals from which figures are computed. Raises BadInputError as ``measures``."""
    return frozenset(name for measure in measures() for name in measure.signals)


def cut_words(t_s: float, duration_s: float | None) -> str:
    """Return the reason why a run that ended early at ``t_s`` has no figures of its end; ``duration_s`` may be None."""
    whole = "" if duration_s is None else f" of {duration_s:g} s"
    return f"there is nothing after t = {t_s:.6g} s{whole}, and this is a figure of the run's end"


def _key(name: str) -> str:
    return name.partition(".")[0]
