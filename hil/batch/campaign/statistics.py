"""Statistics of a campaign: intervals of shares and differences, and how much each axis explains.

No side effects: NumPy arrays in, plain numbers out.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

Z_95 = 1.959963984540054
_RESAMPLES = 4000
_LEAST_DRAWS = 6
"""With fewer draws, even the interval from the least to the greatest contains the median less than 95 times of 100."""
_MOST_AT_ONCE = 1_000_000  # numbers that are drawn, 8 MB
_BINS = 8
_LEAST_IN_A_BIN = 5


class Interval(NamedTuple):
    """A figure with the ends of its 95 % interval; None where there is none."""

    value: float
    low: float | None
    high: float | None

    def scaled(self, factor: float) -> "Interval":
        """Return it in another unit."""
        low, high = (None if end is None else factor * end for end in self[1:])
        return Interval(factor * self.value, low, high)


def wilson(share: float, trials: float) -> Interval:
    """Return a share with Wilson's score interval (1927), which is valid for few trials and for shares of 0 and 1."""
    z2 = Z_95**2 / trials
    centre = (share + z2 / 2.0) / (1.0 + z2)
    half = Z_95 / (1.0 + z2) * np.sqrt(share * (1.0 - share) / trials + z2 / (4.0 * trials))
    # For a share of 0 or 1 one end of the interval is exactly there, which rounding would miss.
    low = 0.0 if share == 0.0 else float(centre - half)
    return Interval(share, low, 1.0 if share == 1.0 else float(centre + half))


def share_of(units: Sequence[object], passed: Sequence[bool]) -> Interval:
    """Return the share of runs that passed, with an interval that allows for runs that repeat each other.

    ``units`` names what was drawn once for several runs, as for ``paired_difference``. Wilson's interval is computed
    for the number of independent trials that would scatter as the units do (the effective sample size of a survey of
    clusters, Kish 1965), with Student's t in place of the normal quantile. If each run is a unit, it is Wilson's own;
    otherwise fewer than six units have no interval.

    Raises ValueError without runs.
    """
    if not passed:
        raise ValueError("a share of no runs")
    values = np.array(passed, dtype=np.float64)
    share, count = float(values.mean()), len(set(units))
    if count == len(passed):
        return wilson(share, count)
    if count < _LEAST_DRAWS:
        return Interval(share, None, None)
    scatter = float(unit_means(units, values).var(ddof=1)) / count
    alike = share * (1.0 - share)
    trials = float(count if alike == 0.0 else len(passed))
    if scatter > 0.0:
        trials = min(float(len(passed)), alike / scatter)
    return wilson(share, max(1.0, trials * (Z_95 / _student(count - 1)) ** 2))


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
    places = _places(units)
    return np.asarray(np.bincount(places, weights=values) / np.bincount(places), dtype=np.float64)


def _places(groups: Sequence[object]) -> npt.NDArray[np.intp]:
    """Return the number of each item's group; groups are numbered in their order."""
    names: dict[object, int] = {}
    return np.array([names.setdefault(group, len(names)) for group in groups], dtype=np.intp)


def share_explained(groups: Sequence[object], values: Series, units: Sequence[object] | None = None) -> float | None:
    """Return the share of the variance of the ranks of ``values`` that groups explain: epsilon squared (Kelley 1935).

    That is the first-order effect (correlation ratio), without what many small groups explain by chance. Ranks are used
    so that a few extreme runs do not decide. From 0 to 1; None where there is nothing to explain.

    For groups that were drawn at random ``units`` names the draw of each value. The values of one draw say nothing new
    about its group, so the result is the share that the draws explain, times the share of the draws' means that the
    groups explain. If each draw has one value, ``units`` changes nothing.
    """
    ranks = ranked(values)
    if units is None or len(set(units)) == len(values):
        return _epsilon_squared(groups, ranks)
    of_draws = _epsilon_squared(units, ranks)
    group_of = dict(zip(units, groups, strict=True))
    of_groups = _epsilon_squared(list(group_of.values()), unit_means(units, ranks))
    return None if of_draws is None or of_groups is None else of_draws * of_groups


def _epsilon_squared(groups: Sequence[object], values: Series) -> float | None:
    places, count = _places(groups), len(values)
    sizes = np.bincount(places)
    total = float(((values - values.mean()) ** 2).sum())
    if len(sizes) < 2 or count <= len(sizes) or total == 0.0:
        return None
    within = total - float((sizes * (unit_means(groups, values) - values.mean()) ** 2).sum())
    return float(max(0.0, 1.0 - within / total * (count - 1) / (count - len(sizes))))


def ranked(values: Series) -> Series:
    """Return the ranks from 1 on, the mean one where values are equal."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return np.asarray((ends - (counts - 1) / 2.0)[inverse], dtype=np.float64)


def binned(values: Series) -> list[int]:
    """Return the group of each draw of a continuous axis: about as many in each, five at least, and at most eight."""
    bins = min(_BINS, max(2, len(np.unique(values)) // _LEAST_IN_A_BIN))
    edges = np.quantile(np.unique(values), np.linspace(0.0, 1.0, bins + 1)[1:-1])
    return [int(place) for place in np.searchsorted(edges, values, side="right")]
