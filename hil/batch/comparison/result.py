"""What a comparison found: a row for each law under each condition, nominal and worst."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from hil.batch.comparison.columns import COLUMNS
from hil.batch.comparison.conditions import Condition, Variation
from hil.batch.comparison.entries import Entry
from hil.batch.comparison.runs import FIGURES, Outcome


class Run(NamedTuple):
    """One run of a row."""

    variation: Variation
    outcome: Outcome


class Row(NamedTuple):
    """A law under a condition, with all its runs, the nominal one first."""

    entry: Entry
    condition: Condition
    runs: Sequence[Run]

    @property
    def nominal(self) -> Outcome:
        """What became of the nominal run."""
        return self.runs[0].outcome

    def worst(self, name: str) -> float | None:
        """Return a figure's worst over mass and friction; None when a run has none: that is worse than any."""
        return _worst([run.outcome for run in self.runs], name)

    def worst_over_mass(self, name: str) -> float | None:
        """Return a figure's worst over the mass alone, at the nominal friction."""
        return _worst([run.outcome for run in self.runs if run.variation.friction is None], name)

    def value(self, name: str) -> float | None:
        """Return a figure of the nominal run."""
        return _worst([self.nominal], name)

    def notes(self) -> Iterator[str]:
        """Say why figures are missing: one sentence for a law that refuses, or for each thing that went wrong."""
        if self.nominal.refused is not None:
            yield f"refused: {self.nominal.refused}"
            return
        said: set[str] = set()
        for run in self.runs:
            trouble = run.outcome.failed or run.outcome.refused
            if trouble is not None and trouble not in said:
                said.add(trouble)
                yield f"failed ({run.variation.words}): {trouble}"
        first: dict[str, tuple[list[str], list[Run]]] = {}  # by the reason of the first run that lacks a figure
        for column in COLUMNS:
            without = [run for run in self.runs if column.name in run.outcome.reasons]
            if without:
                first.setdefault(without[0].outcome.reasons[column.name], ([], without))[0].append(column.head)
        for reason, (heads, without) in first.items():
            yield f"no {', '.join(heads)}{self._among(without)}: {reason}"

    def _among(self, without: Sequence[Run]) -> str:
        if len(self.runs) == 1:
            return ""
        if len(without) == len(self.runs):
            return f" in any of {len(self.runs)} runs"
        return f" in {len(without)} of {len(self.runs)} runs, first with {without[0].variation.words}"

    @property
    def has_failed(self) -> bool:
        """Whether a run did not come to its end, for another reason than that the law refuses the mode."""
        return any(run.outcome.failed is not None for run in self.runs)


class Comparison(NamedTuple):
    """All rows, condition by condition, the laws in the order in which they were named, of runs of this duration."""

    scenario: str
    seed: int
    duration_s: float
    rows: Sequence[Row]

    def conditions(self) -> list[Condition]:
        """Return the conditions, in order."""
        return list(dict.fromkeys(row.condition for row in self.rows))

    def under(self, condition: Condition) -> list[Row]:
        """Return the rows of a condition."""
        return [row for row in self.rows if row.condition == condition]

    @property
    def has_failed(self) -> bool:
        """Whether a run did not come to its end."""
        return any(row.has_failed for row in self.rows)

    def plain(self) -> dict[str, Any]:
        """Return everything but the curves as plain values, for JSON."""
        return {
            "scenario": self.scenario,
            "seed": self.seed,
            "passed": not self.has_failed,
            "rows": [_plain(row) for row in self.rows],
        }


def _worst(outcomes: Sequence[Outcome], name: str) -> float | None:
    values = [None if outcome.figures is None else outcome.figures[name] for outcome in outcomes]
    there = [value for value in values if value is not None]
    return max(there) if len(there) == len(values) else None


def _plain(row: Row) -> dict[str, Any]:
    return {
        "law": row.entry.label,
        "gains": row.entry.gains[row.condition.mode],
        "condition": row.condition._asdict(),
        "refused": row.nominal.refused,
        "nominal": {name: row.value(name) for name in FIGURES},
        "worst_over_mass": {name: row.worst_over_mass(name) for name in FIGURES},
        "worst": {name: row.worst(name) for name in FIGURES},
        "notes": list(row.notes()),
        "runs": [
            run.variation._asdict() | {name: value for name, value in run.outcome._asdict().items() if name != "curves"}
            for run in row.runs
        ],
    }
