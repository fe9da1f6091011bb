"""The result of a run: signals as arrays, figures, and the exit code that follows from them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.core.errors import HilError, UnknownSignalError
from hil.core.percentiles import Percentiles, Reservoir
from hil.judge.figures import BLOCK_ROWS, RunFigures, figures, number
from hil.judge.measure import Series
from hil.judge.words import why_not_passed
from hil.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

_PRINTED = ("tracked_s", "steady_rms_m", "steady_max_m", "ticks")


class MemorySink:
    """Computes the figures of a run from its rows, and keeps the rows on request.

    A block of rows is processed in small steps, one in each tick, so that no tick takes long. ``names`` are the run's
    signals; with ``keep`` every row stays in memory: 0.8 MB a second at 1 kHz.
    """

    def __init__(self, names: Sequence[str], figures: RunFigures, *, keep: bool) -> None:
        self._names = names
        self._figures = figures
        self._keep = keep
        self._age_place = names.index("link.feedback_age_ms")
        self._places = [names.index(name) for name in figures.signals]
        self._age_ms = Reservoir()
        self._blocks: list[Series] = []
        self._row_bytes = 8 * len(names)
        self._block_bytes = BLOCK_ROWS * self._row_bytes
        self._steps: Iterator[None] = iter(())
        self._new_block()

    def _new_block(self) -> None:
        # Not zeroed: its memory pages are touched one by one as rows come, not all in one tick.
        self._block: Series = np.empty((BLOCK_ROWS, len(self._names)))
        self._bytes = self._block.data.cast("B")
        self._filled = 0  # bytes

    def put(self, row: bytes) -> None:
        """Take one row."""
        begin = self._filled
        end = begin + self._row_bytes
        self._bytes[begin:end] = row
        self._filled = end
        if end >= self._block_bytes:
            self._begin_block()
        else:
            next(self._steps, None)

    def figures(self, cut: str | None = None) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the figures and reasons of the run so far, as ``RunFigures``."""
        self._begin_block()
        self._finish_block()
        return self._figures.figures(cut)

    def feedback_age_ms(self) -> Percentiles | None:
        """Return the percentiles of ``link.feedback_age_ms`` over the rows that ``figures`` covered."""
        return self._age_ms.percentiles()

    def signals(self) -> dict[str, Series]:
        """Return every signal by name, each of shape (ticks,); empty when no rows are kept."""
        if not self._keep:
            return {}
        self._blocks = [np.concatenate([*self._blocks, self._rest()])]
        self._filled = 0
        return {name: self._blocks[0][:, i] for i, name in enumerate(self._names)}

    def _rest(self) -> Series:
        """Return the rows since the last block, without a copy."""
        return self._block[: self._filled // self._row_bytes]

    def _begin_block(self) -> None:
        """Begin the work on the rows since the last block."""
        self._finish_block()
        rows = self._rest()
        self._new_block()
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
        yield from self._figures.add(dict(zip(self._figures.signals, columns, strict=True)))


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


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run; its ``repr`` is a summary in a few lines.

    Attributes:
        scenario: what was run.
        metrics: the figures, as ``hil run --json`` prints them; one that is not defined is None, with a sentence in
            ``reasons``.
        signals: every signal of the run by name, each of shape (ticks,): those of ``hil list signals``, then the extra
            ones. Empty when the run kept none.
        failure: what ended the run early, or None.
    """

    scenario: Scenario
    metrics: Mapping[str, Any]
    signals: Signals
    failure: HilError | None

    def __repr__(self) -> str:
        metrics = self.metrics
        name, law, mode, link, seed = (metrics[key] for key in ("scenario", "law", "mode", "link", "seed"))
        lines = [
            f"<RunResult {name}: {law}, {mode} over {link}, seed {seed}",
            f"  passed: {'yes' if self.passed else 'no'}",
        ]
        lines += [f"  {kind}: {why}" for kind, why in why_not_passed(metrics)]
        shown = [
            f"{figure.label} {value * figure.scale:.5g} {figure.unit}".rstrip()
            for figure in figures()
            if figure.name in _PRINTED and (value := number(metrics, figure.name)) is not None
        ]
        lines.append(f"  {', '.join(shown)}")
        return "\n".join(lines) + ">"

    @property
    def passed(self) -> bool:
        """Whether the run ended as expected."""
        return bool(self.metrics["passed"])

    @property
    def exit_code(self) -> int:
        """0 passed; 1 did not pass; else that of the failure: 2 for the law, 3 for link or device, 130 interrupted."""
        if self.failure is not None:
            return self.failure.exit_code
        return 0 if self.passed else 1

    @cached_property
    def _frame(self) -> "pd.DataFrame":
        import pandas as pd

        return pd.DataFrame(dict(self.signals)).set_index("loop.t_s", drop=False)

    def frame(self) -> "pd.DataFrame":
        """Return the signals as a pandas frame, one row a tick, indexed by ``loop.t_s``."""
        return self._frame
