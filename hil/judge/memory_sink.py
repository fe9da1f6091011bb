"""The rows of a run in memory, and the figures that follow from them."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hil.core.percentiles import Percentiles, Reservoir
from hil.judge.figures import BLOCK_ROWS, RunFigures
from hil.judge.measure import Series

_AGE = "link.feedback_age_ms"


class MemorySink:
    """Computes the figures of a run from its rows, and keeps the rows on request.

    A block of rows is processed in small steps, one in each tick, so that no tick takes long. ``names`` are those of a
    row, ``needs`` and those of ``figures`` among them; with ``keep`` every row stays in memory: 0.8 MB a second at
    1 kHz.
    """

    needs = (_AGE,)

    def __init__(self, names: Sequence[str], figures: RunFigures, *, keep: bool) -> None:
        self._names = names
        self._figures = figures
        self._keep = keep
        self._age_place = names.index(_AGE)
        self._places = [names.index(name) for name in figures.signals]
        self._age_ms = Reservoir()
        self._blocks: list[Series] = []
        self._rows: list[bytes] = []  # since the last block
        self._before: bytes | None = None  # the last row of that block
        self._steps: Iterator[None] = iter(())

    def put(self, row: bytes) -> None:
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
        self._before = self.newest()
        rows, self._rows = b"".join(self._rows), []
        return np.frombuffer(rows).reshape(-1, len(self._names))

    def _begin_block(self) -> None:
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
        yield from self._figures.add(dict(zip(self._figures.signals, columns, strict=True)))
