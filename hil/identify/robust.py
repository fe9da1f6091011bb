"""Robust statistics: Huber's loss, a standard deviation that outliers do not move, and a regression by both."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.identify.recorded import Array

Z_95 = 1.96
"""Half the width of a 95 % interval, in standard deviations."""
HUBER = 1.5
"""Residuals beyond so many standard deviations count linearly."""
_ROUNDS = 8
_NOTHING = 1e-12


def sigma(residual: Array) -> float:
    """Return the standard deviation of residuals around zero, by their median size."""
    return 1.4826 * float(np.median(np.abs(residual)))


def huber_weights(residual: Array) -> Array:
    """Return the weights that make least squares of Huber's loss, for residuals in standard deviations."""
    size = np.abs(residual)
    return np.where(size <= HUBER, 1.0, HUBER / np.maximum(size, HUBER))


def huber_loss(residual: Array) -> Array:
    """Return Huber's loss of residuals in standard deviations."""
    size = np.abs(residual)
    return np.where(size <= HUBER, 0.5 * size**2, HUBER * size - 0.5 * HUBER**2)


class Regression(NamedTuple):
    """The factors (P,) of a linear regression, and their covariance (P, P): a sandwich, clustered."""

    found: Array
    covariance: Array


def regression(design: Array, values: Array, instrument: Array, clusters: npt.NDArray[np.intp]) -> Regression:
    """Return the robust regression of ``values`` (N,) on a ``design`` (N, P), with instrumental variables (N, P).

    ``instrument`` is the design itself where that has no noise. Rows of one cluster (N,) are not independent.
    """
    weights: Array = np.ones(len(values))
    found: Array = np.zeros(design.shape[1])
    residual = values
    for _ in range(_ROUNDS):
        weighted = instrument * weights[:, None]
        found = np.asarray(np.linalg.solve(weighted.T @ design, weighted.T @ values), dtype=np.float64)
        residual = values - design @ found
        weights = huber_weights(residual / max(sigma(residual), _NOTHING))
    inverse = np.linalg.inv(instrument.T @ (weights[:, None] * design))
    scores = instrument * (weights * residual)[:, None]
    each = np.stack([scores[clusters == one].sum(axis=0) for one in np.unique(clusters)])
    return Regression(found, inverse @ (each.T @ each) @ inverse.T)
