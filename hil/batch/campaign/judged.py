"""The results of a campaign: pass rates, laws against each other, the effect of each axis, and the worst runs."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.batch.campaign.statistics import Interval, binned, paired_difference, share_explained, share_of
from hil.batch.campaign.tables import RANDOM
from hil.batch.figures import KEY, MACHINE, as_judged
from hil.batch.job import PASSED
from hil.batch.store import RECORDINGS, read_about, read_plan, read_rows

Series = npt.NDArray[np.float64]
Row = Mapping[str, Any]

COMPARED = ("steady_rms_m", "steady_max_m", "t10_s", "overshoot_m", "effort_n_m_s")
"""Figures that a report shows in detail."""
_WORST = 20


class Rate(NamedTuple):
    """The pass rate of the runs with one value of an axis, from so many independent draws (``units``)."""

    axis: str
    value: str
    runs: int
    passed: int
    units: int
    share: Interval


class Spread(NamedTuple):
    """A figure over the runs of a law; ``runs`` of them have it."""

    law: str
    figure: str
    runs: int
    median: float
    p95: float
    worst: float


class Duel(NamedTuple):
    """Two laws in the same runs: the mean of first minus second, and the share of pairs in which the first was less.

    ``units`` is the number of independent draws among the ``pairs``. In ``left_out`` further pairs a run has no figure.
    """

    first: str
    second: str
    figure: str
    pairs: int
    left_out: int
    units: int
    difference: Interval
    first_less: float


class Effect(NamedTuple):
    """The share of a figure's ranks that one axis explains, from 0 to 1; None where there is nothing to explain."""

    axis: str
    figure: str
    share: float | None


class Judged:
    """A campaign's results: its plan and the rows of the runs that are done, each a mapping of columns.

    ``by`` is the figure by which runs are worst. Samples are drawn independently, or without random axes the seeds.
    ``damaged`` has a sentence on each file whose rows are left out.
    """

    def __init__(
        self,
        folder: Path,
        about: Mapping[str, Any],
        plan: Sequence[Row],
        rows: Sequence[Row],
        damaged: Sequence[str] = (),
    ) -> None:
        self.damaged = damaged
        self.folder = folder
        self.about = about
        self.plan = plan
        self.rows = rows
        self.by = str(about["by"])
        self._unit = "sample" if about["samples"] > 1 else "seed"

    @cached_property
    def axes(self) -> dict[str, str]:
        """What differs between the runs, with its kind: each axis, then law, fault and seed where there are several."""
        axes = {name: str(axis["kind"]) for name, axis in self.about["axes"].items()}
        own = {"law": self.about["laws"], "fault": self.about["faults"]}
        axes |= {name: "choice" for name, values in own.items() if len(values) > 1}
        return axes | ({"seed": "choice"} if self.about["seeds"] > 1 else {})

    @cached_property
    def outcomes(self) -> dict[str, int]:
        """How many runs had each outcome."""
        return dict(Counter(str(row["outcome"]) for row in self.rows).most_common())

    @cached_property
    def reasons(self) -> list[tuple[str, str, int]]:
        """Why runs did not pass: outcome, sentence, and how many times, the most frequent first."""
        counts = Counter((str(row["outcome"]), str(row["reason"])) for row in self.rows if row["outcome"] != PASSED)
        return [(outcome, reason, count) for (outcome, reason), count in counts.most_common()]

    @cached_property
    def rates(self) -> list[Rate]:
        """Pass rates: of all runs, and of each value of the axes that are not random."""
        groups = [("all", "", self.rows)]
        for axis, kind in self.axes.items():
            if kind not in RANDOM and axis != "seed":
                values = dict.fromkeys(row[axis] for row in self.plan)
                groups += [(axis, word(value), [row for row in self.rows if row[axis] == value]) for value in values]
        rates = []
        for axis, value, rows in groups:
            units = [row[self._unit] for row in rows]
            passed = [row["outcome"] == PASSED for row in rows]
            if rows:
                counts = (len(rows), sum(passed), len(set(units)))
                rates.append(Rate(axis, value, *counts, share_of(units, passed)))
        return rates

    def spreads(self) -> Iterator[Spread]:
        """Yield how each figure is spread over the runs of each law."""
        for figure, law in itertools.product(COMPARED, self.about["laws"]):
            values = self.values(figure, law)
            if len(values):
                median, p95 = np.percentile(values, [50.0, 95.0])
                yield Spread(law, figure, len(values), float(median), float(p95), float(values.max()))

    def values(self, figure: str, law: str | None = None) -> Series:
        """Return a figure of all runs that have it, or of those of a law."""
        chosen = (row[figure] for row in self.rows if law is None or row["law"] == law)
        return np.array([value for value in chosen if value is not None])

    @cached_property
    def duels(self) -> list[Duel]:
        """Each law against each other, in runs that differ in the law alone."""
        axes = ("fault", "seed", "sample", *self.about["axes"])
        same = [name for name in axes if not name.startswith("controller.law")]
        by_law: dict[str, dict[tuple[Any, ...], Row]] = {law: {} for law in self.about["laws"]}
        for row in self.rows:
            by_law[row["law"]][tuple(row[name] for name in same)] = row
        duels = []
        for figure, (first, second) in itertools.product(COMPARED, itertools.combinations(by_law, 2)):
            others = by_law[second]
            pairs = [(row, others[place]) for place, row in by_law[first].items() if place in others]
            both = [(one, other) for one, other in pairs if one[figure] is not None and other[figure] is not None]
            if both:
                units = [one[self._unit] for one, _ in both]
                differences = np.array([one[figure] - other[figure] for one, other in both])
                counts = (len(both), len(pairs) - len(both), len(set(units)))
                less = float(np.mean(differences < 0.0))
                duels.append(Duel(first, second, figure, *counts, paired_difference(units, differences), less))
        return duels

    @cached_property
    def effects(self) -> list[Effect]:
        """The effect of each axis on each figure."""
        found = []
        for figure, (axis, kind) in itertools.product(COMPARED, self.axes.items()):
            rows = [row for row in self.rows if row[figure] is not None]
            values = np.array([row[figure] for row in rows])
            groups: Sequence[object] = [row[axis] for row in rows]
            draws = None
            if rows and kind in RANDOM:
                groups, draws = binned(np.array(groups, dtype=np.float64)), [row["sample"] for row in rows]
            found.append(Effect(axis, figure, share_explained(groups, values, draws) if rows else None))
        return found

    @cached_property
    def worst(self) -> list[Row]:
        """The worst runs: those that did not pass, first those without the figure, then others by falling figure."""

        def badness(row: Row) -> tuple[bool, bool, float]:
            value = row[self.by]
            return row["outcome"] != PASSED, value is None, -1.0 if value is None else value

        return sorted(self.rows, key=badness, reverse=True)[:_WORST]

    @cached_property
    def repeats(self) -> dict[str, str]:
        """The command that repeats each run, by the run's key."""
        return {row[KEY]: row["repeat"] for row in self.plan}

    def recording(self, key: str) -> Path | None:
        """Return the recording of a run that was kept, from the campaign's folder."""
        found = next((self.folder / RECORDINGS).glob(f"{key}.*"), None)
        return None if found is None else found.relative_to(self.folder)

    @cached_property
    def commits(self) -> list[str]:
        """The commits of the code that did the runs, where it was a checkout's."""
        return sorted({row[MACHINE + "commit"] for row in self.rows if row.get(MACHINE + "commit")})

    def sentences(self) -> Iterator[str]:
        """Yield the sentences that head a report."""
        total = self.about["runs"]
        why = "are not done yet, or are in damaged files" if self.damaged else "are not done yet"
        missing = f" ({total - len(self.rows)} of {total} {why})" if len(self.rows) < total else ""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.outcomes.items()) or "none"
        yield f"{len(self.rows)} runs: {counts}{missing}"
        yield from self.damaged
        if self.rows:
            yield f"pass rate {percent(self.rates[0])}"
        for duel in self.duels:
            if duel.figure == self.by:
                yield f"{duel.figure}: {duel_words(duel)}"

    def plain(self) -> dict[str, Any]:
        """Return all of it as plain values, for JSON."""
        return {
            "campaign": dict(self.about),
            "runs": len(self.rows),
            "passed": bool(self.rows) and self.outcomes.get(PASSED, 0) == self.about["runs"],
            "outcomes": self.outcomes,
            "damaged": list(self.damaged),
            "reasons": [dict(zip(("outcome", "reason", "runs"), one, strict=True)) for one in self.reasons],
            "rates": [rate._asdict() | {"share": rate.share._asdict()} for rate in self.rates],
            "figures": [spread._asdict() for spread in self.spreads()],
            "duels": [duel._asdict() | {"difference": duel.difference._asdict()} for duel in self.duels],
            "effects": [effect._asdict() for effect in self.effects],
            "worst": [self._plain_row(row) for row in self.worst],
        }

    def _plain_row(self, row: Row) -> dict[str, Any]:
        names = (KEY, "law", "fault", "seed", *self.about["axes"], "outcome", "reason", self.by)
        recording = self.recording(row[KEY])
        path = None if recording is None else recording.as_posix()
        return {name: row[name] for name in names} | {"repeat": self.repeats[row[KEY]], "recording": path}


def judge(folder: Path) -> Judged:
    """Return the results of a campaign from its folder alone, without files of rows that are damaged.

    Raises BadInputError when there is no campaign.
    """
    damaged: list[str] = []
    done = {row[KEY]: row for row in read_rows(folder, damaged=damaged).to_pylist()}
    about, plan = read_about(folder), read_plan(folder)
    # A row may be older than a law's name or an axis, so the plan's columns replace the row's. The order is the plan's,
    # so that a report does not depend on which run was done first.
    rows = [as_judged(done[row[KEY]]) | row for row in plan if row[KEY] in done]
    return Judged(folder, about, plan, rows, damaged)


def percent(rate: Rate) -> str:
    """Return a share with its interval in words."""
    value, low, high = rate.share.scaled(100.0)
    words = f"{value:.4g} %"
    if low is None or high is None:
        return f"{words} (from {_draws(rate.units)})"
    return f"{words} (95 %: {low:.3g} to {high:.3g} %)"


def duel_words(duel: Duel) -> str:
    """Return a sentence that compares two laws in one figure."""
    value, low, high = duel.difference
    words = f"{duel.first} - {duel.second} = {value:+.3g}"
    if low is None or high is None:
        return f"{words}, from {_draws(duel.units)}"
    verdict = "no difference shown" if low <= 0.0 <= high else f"{duel.first if high < 0.0 else duel.second} is less"
    return f"{words} (95 %: {low:+.3g} to {high:+.3g}): {verdict}"


def _draws(count: int) -> str:
    return f"{count} draw{'' if count == 1 else 's'}: too few for an interval"


def word(value: object) -> str:
    """Return a value of an axis as text."""
    return f"{value:g}" if isinstance(value, float) else str(value)
