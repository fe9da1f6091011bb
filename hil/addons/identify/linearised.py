"""A model of windows, linearised: its derivatives by the parameters, and without what the start of a window explains.

Derivatives are finite differences: all sets of a step are predicted in one call.
"""

from typing import Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from hil.addons.identify.drives import Array
from hil.addons.identify.robust_statistics import huber_weights

STEP = 2e-3  # by how much a parameter is varied for a derivative


class Experiment(Protocol):
    """Windows of one kind of drive, and a model that predicts them.

    Attributes:
        measured: (W, M) what was measured in each window.
        starts: (W, S) a first guess of each window's start.
        start_steps: (S,) steps of the finite differences of a start.
        least_sigmas: (M,) standard deviations of the sensors themselves, if the model were true.
    """

    measured: Array
    starts: Array
    start_steps: Array
    least_sigmas: Array

    def predict(self, parameters: Array, starts: Array) -> Array:
        """Return the predictions (K, W, M) for K sets of parameters (K, P), each with starts (K, W, S)."""

    def sigmas(self, residual: Array) -> Array:
        """Return the standard deviations (M,) of the measurements, from residuals (W, M)."""


class Local(NamedTuple):
    """One experiment at one point: whitened residuals and their derivatives, times the roots of Huber's weights.

    With the weights inside, the step of the parameters and those of the starts belong to one cost; a projection without
    them ended a fit on the way.
    """

    residual: Array  # (W, M) only whitened
    weighted: Array  # (W, M) before the projection
    reduced: Array  # (W, M) after the projection
    jacobian: Array  # (W, M, P) after the projection
    raw_jacobian: Array  # (W, M, P) before the projection
    start_jacobian: Array  # (W, M, S)
    inside: npt.NDArray[np.bool_]  # (W, M) where Huber's loss is a square


class Slopes(NamedTuple):
    """Derivatives of an experiment's predictions by the parameters (W, M, P) and by the starts (W, M, S)."""

    by_parameter: Array
    by_start: Array


def slopes_at(
    experiment: Experiment,
    predicted: Array,
    starts: Array,
    point: Array,
    varied: npt.NDArray[np.bool_],
    way: float = 1.0,
) -> Slopes:
    """Return the derivatives by the parameters that are ``varied``, and by the starts; those by the others are zero.

    ``predicted`` is at ``point``. ``way`` is the side to which the parameters are varied: 1 or -1.
    """
    places = np.flatnonzero(varied)
    count = len(places)
    sets = np.repeat(point[None], count + starts.shape[1], axis=0)
    sets[np.arange(count), places] += way * STEP
    moved = np.repeat(starts[None], len(sets), axis=0)
    for place, step in enumerate(experiment.start_steps):
        moved[count + place, :, place] += step
    changes = np.moveaxis(experiment.predict(sets, moved) - predicted, 0, -1)
    by_parameter = np.zeros((*predicted.shape, len(point)))
    by_parameter[..., places] = changes[..., :count] / (way * STEP)
    return Slopes(by_parameter, changes[..., count:] / experiment.start_steps)


def linearised(
    experiment: Experiment,
    predicted: Array,
    slopes: Slopes,
    sigma: Array,
    by: Literal["start", "guess", "nothing"] = "start",
) -> Local:
    """Return an experiment linearised where it predicts this.

    ``sigma`` are standard deviations (M,) or (W, M); a window in which they are infinite says nothing.

    ``by`` selects the residuals by which outliers are found: from the starts, after the best starts (if the starts are
    only a guess), or none.
    """
    residual = (experiment.measured - predicted) / sigma
    jacobian, by_start = (slope / sigma[..., None] for slope in slopes)
    left = residual if by == "start" else _projected(by_start, residual[..., None])[..., 0]
    weights = np.ones_like(left) if by == "nothing" else huber_weights(left)
    roots = np.sqrt(weights)
    weighted, jacobian, by_start = residual * roots, jacobian * roots[..., None], by_start * roots[..., None]
    reduced = _projected(by_start, np.concatenate([weighted[..., None], jacobian], axis=2))
    return Local(residual, weighted, reduced[..., 0], reduced[..., 1:], jacobian, by_start, weights == 1.0)


def agreeing(forward: Local, backward: Local) -> npt.NDArray[np.bool_]:
    """Return in which windows (W,) the derivatives to both sides are the same, or differ by less than a usual one."""
    sizes = [np.einsum("wmp->wp", one.jacobian**2) for one in (forward, backward)]
    usual = np.mean(np.minimum(*sizes), axis=0)
    agree: npt.NDArray[np.bool_] = np.all(
        np.einsum("wmp->wp", (forward.jacobian - backward.jacobian) ** 2) <= usual, axis=1
    )
    return agree


def _projected(by_start: Array, columns: Array) -> Array:
    """Return columns (W, M, C) without what a change of the starts, by (W, M, S), explains of them."""
    basis, _ = np.linalg.qr(by_start)
    left: Array = columns - basis @ (np.swapaxes(basis, 1, 2) @ columns)
    return left
