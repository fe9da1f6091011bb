"""The results of a campaign: pass rates and laws against each other, with intervals, and the worst runs."""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from hil.addons.batch.campaign.campaign_file import RANDOM
from hil.addons.batch.columns import KEY, MACHINE
from hil.addons.batch.job import FAILED, PASSED
from hil.addons.batch.store import RECORDING_SUFFIX, RECORDINGS, Row, read_about, read_rows
from hil.judge.figures import table_figures
from hil.judge.measure import Series

COMPARED = ("steady_rms_m", "steady_max_m", "t10_s", "overshoot_m", "effort_n_m_s")
"""Figures that a report shows in detail."""
BY = "steady_rms_m"
"""The figure by which runs are worst."""
_WORST = 20


Z_95 = 1.959963984540054
_RESAMPLES = 4000
_LEAST_DRAWS = 6
"""With fewer draws, even the interval from the least to the greatest contains the median less than 95 times of 100."""
_MOST_AT_ONCE = 1_000_000  # numbers that are drawn, 8 MB


class Interval(NamedTuple):
    """A figure with the ends of its 95 % interval; None where there is none."""

    value: float
    low: float | None
    high: float | None

    def scaled(self, factor: float) -> "Interval":
        """Return it in another unit."""
        low, high = (None if end is None else factor * end for end in self[1:])
        return Interval(factor * self.value, low, high)


class Rate(NamedTuple):
    """The pass rate of the runs with one value of an axis, from so many independent draws (``units``)."""

    axis: str
    value: str
    runs: int
    passed: int
    units: int
    share: Interval


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


class Judged:
    """A campaign's results: its plan and the rows of the runs that are done, each a mapping of columns.

    Samples are drawn independently, or without random axes the seeds. ``damaged`` has a sentence on each row that is
    left out. Raises BadInputError when there is no campaign in the folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.damaged: list[str] = []
        done = read_rows(folder, self.damaged)
        self.about = read_about(folder)
        self.plan: Sequence[Row] = self.about.pop("plan")
        # A row may be older than a law's name or an axis, so the plan's columns replace the row's. The order is the
        # plan's, so that a report does not depend on which run was done first.
        self.rows = [_judged(done[row[KEY]]) | row for row in self.plan if row[KEY] in done]
        self._unit = "sample" if self.about["samples"] > 1 else "seed"

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

    def spreads(self) -> Iterator[dict[str, Any]]:
        """Yield how each figure is spread over the runs of each law that have it."""
        for figure, law in itertools.product(COMPARED, self.about["laws"]):
            values = self.values(figure, law)
            if len(values):
                median, p95 = np.percentile(values, [50.0, 95.0])
                spread = {"median": float(median), "p95": float(p95), "worst": float(values.max())}
                yield {"law": law, "figure": figure, "runs": len(values), **spread}

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
    def worst(self) -> list[Row]:
        """The worst runs: those that did not pass, first those without the figure, then others by falling figure."""

        def badness(row: Row) -> tuple[bool, bool, float]:
            value = row[BY]
            return row["outcome"] != PASSED, value is None, -1.0 if value is None else value

        return sorted(self.rows, key=badness, reverse=True)[:_WORST]

    def recording(self, key: str) -> Path | None:
        """Return the recording of a run that was kept, from the campaign's folder."""
        recording = Path(RECORDINGS) / (key + RECORDING_SUFFIX)
        return recording if (self.folder / recording).exists() else None

    @cached_property
    def commits(self) -> list[str]:
        """The commits of the code that did the runs, where it was a checkout's."""
        return sorted({row[MACHINE + "commit"] for row in self.rows if row.get(MACHINE + "commit")})

    def sentences(self) -> Iterator[str]:
        """Yield the sentences that head a report."""
        total = self.about["runs"]
        why = "are not done yet, or are damaged" if self.damaged else "are not done yet"
        missing = f" ({total - len(self.rows)} of {total} {why})" if len(self.rows) < total else ""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.outcomes.items()) or "none"
        yield f"{len(self.rows)} runs: {counts}{missing}"
        yield from self.damaged
        if self.rows:
            yield f"pass rate {percent(self.rates[0])}"
        for duel in self.duels:
            if duel.figure == BY:
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
            "figures": list(self.spreads()),
            "duels": [duel._asdict() | {"difference": duel.difference._asdict()} for duel in self.duels],
            "worst": [self._plain_row(row) for row in self.worst],
        }

    def _plain_row(self, row: Row) -> dict[str, Any]:
        names = (KEY, "law", "fault", "seed", *self.about["axes"], "outcome", "reason", BY, "repeat")
        recording = self.recording(row[KEY])
        path = None if recording is None else recording.as_posix()
        return {name: row[name] for name in names} | {"recording": path}


def _judged(row: Row) -> dict[str, Any]:
    """Return a row, without figures if its run ended early: that lowers effort and overshoot undeservedly."""
    missing: dict[str, Any] = dict.fromkeys(table_figures())
    return {**missing, **row} if row["outcome"] in (PASSED, FAILED) else {**row, **missing}


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


def wilson(share: float, trials: float) -> Interval:
    """Return a share with Wilson's score interval (1927), which is valid for few trials and for shares of 0 and 1."""
    z2 = Z_95**2 / trials
    centre = (share + z2 / 2.0) / (1.0 + z2)
    half = Z_95 / (1.0 + z2) * np.sqrt(share * (1.0 - share) / trials + z2 / (4.0 * trials))
    # For a share of 0 or 1 one end of the interval is exactly there, which rounding would miss.
    low = 0.0 if share == 0.0 else float(centre - half)
    return Interval(share, low, 1.0 if share == 1.0 else float(centre + half))


def share_of(units: Sequence[object], passed: Sequence[bool]) -> Interval:
    """Return the share of passed runs with Wilson's interval for as many trials as there are independent ``units``.

    ``units`` names what was drawn once for several runs, as for ``paired_difference``: these repeat each other, so that
    the interval is rather too wide. Fewer than six units that several runs share have none.
    """
    share, count = sum(passed) / len(passed), len(set(units))
    return wilson(share, count) if count == len(passed) or count >= _LEAST_DRAWS else Interval(share, None, None)


def paired_difference(units: Sequence[object], differences: Series, seed: int = 1) -> Interval:
    """Return the mean of paired differences, with a bootstrap's expanded percentile interval over independent units.

    ``units`` names the unit of each difference: pairs that share a draw are one unit, because they repeat each other
    and are no further evidence. Each unit enters with the mean of its pairs. Fewer than six units have no interval.
    Percentiles are expanded (Hesterberg 2015, "What Teachers Should Know About the Bootstrap"), because the plain ones
    of ten units contain the mean only 89 times of 100.
    """
    means = unit_means(units, differences)
    value = float(means.mean())
    if len(means) < _LEAST_DRAWS:
        return Interval(value, None, None)
    generator = np.random.default_rng(seed)
    at_once = max(1, _MOST_AT_ONCE // len(means))
    resampled = [
        means[generator.integers(0, len(means), (min(at_once, _RESAMPLES - begin), len(means)))].mean(axis=1)
        for begin in range(0, _RESAMPLES, at_once)
    ]
    # Student's t in place of the normal quantile, and the variance with count - 1.
    tail = NormalDist().cdf(-_student(len(means) - 1) * math.sqrt(len(means) / (len(means) - 1)))
    low, high = np.quantile(np.concatenate(resampled), [tail, 1.0 - tail])
    return Interval(value, float(low), float(high))


def _student(freedom: int) -> float:
    """Return Student's t of 95 %, to 0.003 from 5 degrees of freedom on."""
    z = Z_95
    # Its expansion in 1 / freedom (Abramowitz and Stegun 26.7.5).
    t = z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    return t + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)


def unit_means(units: Sequence[object], values: Series) -> Series:
    """Return the mean of each unit's values."""
    names: dict[object, int] = {}
    places = [names.setdefault(unit, len(names)) for unit in units]
    return np.asarray(np.bincount(places, weights=values) / np.bincount(places), dtype=np.float64)
