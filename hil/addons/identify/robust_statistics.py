"""Robust statistics: Huber's loss, a standard deviation that outliers do not move, and a regression by both."""

import numpy as np
import numpy.typing as npt

from hil.addons.identify.drives import Array

Z_95 = 1.96  # half the width of a 95 % interval, in standard deviations
HUBER = 1.5  # residuals beyond so many standard deviations count linearly
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


def regression(design: Array, values: Array, instrument: Array, clusters: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the factors (P,) of the robust regression of ``values`` (N,) on a ``design`` (N, P), and their covariance.

    The covariance (P, P) is a sandwich. ``instrument`` (N, P) has the instrumental variables: the design itself where
    that has no noise. Rows of one cluster (N,) are not independent.
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
    return found, inverse @ (each.T @ each) @ inverse.T
