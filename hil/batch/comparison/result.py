"""The results of a comparison: a row for each law under each condition, nominal and worst."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.batch.comparison.conditions import Condition, Variation
from hil.batch.figures import shown_columns
from hil.batch.job import PASSED, REFUSED, Outcome
from hil.core.types import CommandMode
from hil.scenario import format_value

Gains = dict[str, object]
OVER = ("nominal", "worst_over_mass", "worst")
"""Over which runs the worst of a figure is taken (``Row.worst``)."""
Curves = Mapping[str, npt.NDArray[np.float64]]
"""Signals of a run by name, and ``torque.fl`` to ``torque.rl`` [N·m], each of shape (n,)."""


class Entry(NamedTuple):
    """A law with its gains in either mode; ``law`` is as a scenario would have it, ``label`` as the user wrote it.

    ``hidden`` are gains of the scenario that differ from the law's defaults and that the label does not name.
    """

    label: str
    law: str
    gains: Mapping[CommandMode, Gains]
    hidden: Mapping[CommandMode, Gains]

    def title(self, mode: CommandMode) -> str:
        """Return its name in a table: the label, and in brackets the gains by which the law differs beyond it."""
        hidden = ", ".join(f"{name} = {format_value(value)}" for name, value in self.hidden[mode].items())
        return f"{self.label} ({hidden})" if hidden else self.label


class Run(NamedTuple):
    """One run of a row."""

    variation: Variation
    outcome: Outcome

    @property
    def figures(self) -> Mapping[str, float | None] | None:
        """The figures of the tables by name; None for a run that was refused or failed."""
        if self.outcome.status != PASSED:
            return None
        return {column.name: self.outcome.figures[column.name] for column in shown_columns()}

    @property
    def reasons(self) -> Mapping[str, str]:
        """For each figure that is None, one sentence."""
        why = self.outcome.details.get("reasons", {})
        return {name: why.get(name, "there is none") for name, value in (self.figures or {}).items() if value is None}

    @property
    def refused(self) -> str | None:
        """Why the run could not begin, such as a law that does not support the mode."""
        return self.outcome.reason if self.outcome.status == REFUSED else None

    @property
    def failed(self) -> str | None:
        """What ended the run, or why its figures do not describe the law."""
        return None if self.outcome.status in (PASSED, REFUSED) else self.outcome.reason


class Row(NamedTuple):
    """A law under a condition with all its runs, the nominal one first, and that one's curves if they were wanted."""

    entry: Entry
    condition: Condition
    runs: Sequence[Run]
    curves: Curves | None = None

    def worst(self, name: str, over: str = "worst") -> float | None:
        """Return the worst value of a figure in some of the runs; None if one of these lacks it, which is worse still.

        ``over`` says which: ``nominal`` (that run), ``worst_over_mass`` (those with nominal friction), ``worst`` (all).
        """
        some = self.runs[:1] if over == "nominal" else self.runs
        if over == "worst_over_mass":
            some = [run for run in self.runs if run.variation.friction is None]
        values = [None if run.figures is None else run.figures[name] for run in some]
        known = [value for value in values if value is not None]
        return max(known) if len(known) == len(values) else None

    def notes(self) -> Iterator[str]:
        """Yield why figures are missing: one sentence for a law that refuses, or for each thing that went wrong."""
        if self.runs[0].refused is not None:
            yield f"refused: {self.runs[0].refused}"
            return
        troubles: dict[str, str] = {}
        for run in self.runs:
            if (trouble := run.failed or run.refused) is not None:
                troubles.setdefault(trouble, run.variation.words)
        yield from (f"failed ({words}): {trouble}" for trouble, words in troubles.items())
        first: dict[str, tuple[list[str], list[Run]]] = {}  # by the reason of the first run that lacks a figure
        for column in shown_columns():
            if without := [run for run in self.runs if column.name in run.reasons]:
                first.setdefault(without[0].reasons[column.name], ([], without))[0].append(column.head)
        for reason, (heads, without) in first.items():
            among = f" in {len(without)} of {len(self.runs)} runs, first with {without[0].variation.words}"
            if len(without) == len(self.runs):
                among = "" if len(self.runs) == 1 else f" in any of {len(self.runs)} runs"
            yield f"no {', '.join(heads)}{among}: {reason}"

    def plain(self) -> dict[str, Any]:
        """Return everything but the curves as plain values, for JSON."""
        names = [column.name for column in shown_columns()]
        of_run = ("figures", "reasons", "refused", "failed")
        return {
            "law": self.entry.label,
            "gains": self.entry.gains[self.condition.mode],
            "condition": self.condition._asdict(),
            "refused": self.runs[0].refused,
            **{over: {name: self.worst(name, over) for name in names} for over in OVER},
            "notes": list(self.notes()),
            "runs": [run.variation._asdict() | {name: getattr(run, name) for name in of_run} for run in self.runs],
        }


class Comparison(NamedTuple):
    """All rows, condition by condition, the laws in the order in which they were named, of runs of this duration.

    ``limiter`` says what limits torques beyond the law, and where that is off.
    """

    scenario: str
    seed: int
    duration_s: float
    rows: Sequence[Row]
    limiter: str = ""

    def tables(self) -> dict[Condition, list[Row]]:
        """Return the rows of each condition, in order."""
        tables: dict[Condition, list[Row]] = {}
        for row in self.rows:
            tables.setdefault(row.condition, []).append(row)
        return tables

    @property
    def has_failed(self) -> bool:
        """Whether a run failed, other than by the law refusing the mode."""
        return any(run.failed is not None for row in self.rows for run in row.runs)

    def plain(self) -> dict[str, Any]:
        """Return everything but the curves as plain values, for JSON."""
        rows = [row.plain() for row in self.rows]
        return {
            "scenario": self.scenario,
            "seed": self.seed,
            "limiter": self.limiter,
            "passed": not self.has_failed,
            "rows": rows,
        }
