"""What a run leaves: its figures, its signals as arrays, and its events."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.errors import UnknownSignalError
from hil.core.percentiles import Percentiles, Reservoir
from hil.core.ports import Note
from hil.judge.course import ErrorCourse
from hil.judge.figures import BLOCK_ROWS, RunFigures
from hil.judge.measure import Series
from hil.judge.shadows import CommandDifference, ShadowDifferences

_EVENTS_KEPT = 10_000
_AGE = "link.feedback_age_ms"


class Event(NamedTuple):
    """A line of the event log; the level is DEBUG, INFO, WARN or ERROR, as rerun names it."""

    t_s: float
    level: str
    text: str

    @property
    def severity(self) -> str:
        """The level as ``Recording.event`` takes it: debug, info, warning or error."""
        return "warning" if self.level == "WARN" else self.level.lower()


class EventLog:
    """The events of a run, the first 10,000 of them, each passed on to the next log, such as that of a recording."""

    def __init__(self, following: Note) -> None:
        self.events: list[Event] = []
        self._following = following

    def note(self, t_s: float, level: str, text: str) -> None:
        """Add an event; the level is debug, info, warning or error."""
        if len(self.events) < _EVENTS_KEPT:
            self.events.append(Event(t_s, "WARN" if level == "warning" else level.upper(), text))
        self._following(t_s, level, text)


class MemorySink:
    """Computes the figures of a run from its rows, and keeps the rows on request.

    A block of rows is processed in small steps, one in each tick, so that no tick takes long. ``names`` are those of a
    row, ``needs`` and those of ``figures`` among them; with ``keep`` every row stays in memory: 0.8 MB a second at
    1 kHz.
    """

    needs = (_AGE, *ErrorCourse.signals)

    def __init__(self, names: Sequence[str], figures: RunFigures, *, keep: bool) -> None:
        self._names = names
        self._figures = figures
        self._keep = keep
        self._age_place = names.index(_AGE)
        self._shadows = ShadowDifferences(names)
        self._course = ErrorCourse()
        self._columns = list(dict.fromkeys([*figures.signals, *self._course.signals, *self._shadows.signals]))
        self._places = [names.index(name) for name in self._columns]
        self._age_ms = Reservoir()
        self._blocks: list[Series] = []
        self._rows: list[bytes] = []  # since the last block
        self._before: bytes | None = None  # the last row of that block
        self._steps: Iterator[None] = iter(())

    def put(self, row: bytes) -> None:
        """Take one row."""
        self._rows.append(row)
        if len(self._rows) == BLOCK_ROWS:
            self._begin_block()
        else:
            next(self._steps, None)

    def newest(self) -> bytes | None:
        """Return the newest row, None before the first."""
        rows = self._rows  # another thread may ask, whose tick is stuck
        return rows[-1] if rows else self._before

    def figures(self, cut: str | None = None) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the figures and reasons of the run so far, as ``RunFigures``."""
        self._begin_block()
        self._finish_block()
        return self._figures.figures(cut)

    def error_course(self) -> dict[str, Any] | None:
        """Return the course of the position error over the rows that ``figures`` covered."""
        return self._course.figures()

    def shadow_differences(self) -> dict[str, dict[str, CommandDifference]]:
        """Return how the run's shadows differ from its command, over the rows that ``figures`` covered."""
        return self._shadows.results()

    def feedback_age_ms(self) -> Percentiles | None:
        """Return the percentiles of ``link.feedback_age_ms`` over the rows that ``figures`` covered."""
        return self._age_ms.percentiles()

    def signals(self) -> dict[str, Series]:
        """Return every signal by name, each of shape (ticks,); empty when no rows are kept."""
        if not self._keep:
            return {}
        self._blocks = [np.concatenate([*self._blocks, self._taken()])]
        return {name: self._blocks[0][:, i] for i, name in enumerate(self._names)}

    def _taken(self) -> Series:
        """Take the rows since the last block."""
        self._before = self.newest()
        rows, self._rows = b"".join(self._rows), []
        return np.frombuffer(rows).reshape(-1, len(self._names))

    def _begin_block(self) -> None:
        """Begin the work on the rows since the last block."""
        self._finish_block()
        rows = self._taken()
        if self._keep:
            self._blocks.append(rows)
        self._steps = self._work(rows)

    def _finish_block(self) -> None:
        for _ in self._steps:
            pass

    def _work(self, rows: Series) -> Iterator[None]:
        self._age_ms.extend(rows[:, self._age_place])
        yield
        # Copied once: each measure would gather its columns from all over the block.
        columns = np.ascontiguousarray(rows.T[self._places])
        signals = dict(zip(self._columns, columns, strict=True))
        yield from self._figures.add(signals)
        self._course.add(signals)
        yield
        if self._shadows.signals:
            self._shadows.add(signals)
            yield


class Signals(Mapping[str, Series]):
    """The signals of a run by name, each of shape (ticks,); a wrong name raises UnknownSignalError with near ones."""

    def __init__(self, series: Mapping[str, Series]) -> None:
        self._series = series

    def __getitem__(self, name: str) -> Series:
        try:
            return self._series[name]
        except KeyError:
            raise UnknownSignalError(name, self._series) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._series)

    def __len__(self) -> int:
        return len(self._series)

    def __repr__(self) -> str:
        ticks = len(next(iter(self._series.values()), ()))
        return f"<{len(self)} signals of {ticks} ticks>"
