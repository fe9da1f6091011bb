"""What the figures of a run have in common that are made from blocks of rows, which are not kept."""

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

RESOLUTION_M = 0.001


class NoMeaningError(Exception):
    """A figure has no meaning for this run; the text says why."""


class TruthGaps:
    """Whether a value was always there."""

    def __init__(self) -> None:
        self._samples = 0
        self._missing = 0
        self._first_s = 0.0

    def take(self, t_s: Series, value: Series) -> None:
        """Take the times of rows and the value, NaN where there was none, both of shape (n,)."""
        gaps = np.flatnonzero(~np.isfinite(value))
        if len(gaps) and not self._missing:
            self._first_s = float(t_s[gaps[0]])
        self._samples += len(t_s)
        self._missing += len(gaps)

    def require_truth(self) -> None:
        """Raise NoMeaningError unless there were rows, and the value in all of them."""
        if not self._samples:
            raise NoMeaningError("the run has no samples")
        if self._missing == self._samples:
            raise NoMeaningError("the run has no ground truth")
        if self._missing:
            raise NoMeaningError(f"the ground truth is missing at t = {self._first_s:.6g} s")


def figures_or_reasons(
    computations: Mapping[str, Callable[[], float]],
) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return each figure by name, None for one without a meaning, and for those the reasons."""
    values: dict[str, float | None] = {}
    reasons: dict[str, str] = {}
    for name, compute in computations.items():
        try:
            values[name] = compute()
        except NoMeaningError as no_meaning:
            values[name] = None
            reasons[name] = str(no_meaning)
    return values, reasons
