"""Robust nonlinear least squares over windows: parameters common to all, and the free start of each window.

In each window, the part of the residuals that a change of its start explains is projected away (variable projection,
``linearised``). Hundreds of starts therefore add almost no cost.
"""

from typing import Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hil.addons.identify.drives import Array
from hil.addons.identify.linearised import Experiment, Local, Slopes, agreeing, linearised, slopes_at
from hil.addons.identify.robust_statistics import huber_loss

# Parameters are logarithms, or numbers in a unit of their usual size: 0.01 is about 1 % of any of them.
_MOST_STEPS = 30  # limits the time of a fit that does not converge
_LONGEST = 0.7  # the longest step of any parameter: a factor of two; the derivatives are good for no more
_DONE = 2e-4  # a fit whose step is shorter has converged: a tenth of the step of the finite differences
_NEAR = 0.02  # after a shorter step the derivatives are not computed again, which is most of the work
_FLAT = 0.01  # a fit that lowers the cost by less ends; 0.5 of the cost is one standard deviation
_NEW_SIGMAS = 3  # after each of so many first steps the noise is estimated again: poor models have large residuals
# Damping (Levenberg-Marquardt): nearly none at first, less after each good step, ten times as much after a bad one.
_DAMPING = 1e-4
_LEAST_DAMPING = 1e-6
_DAMPING_OF_BAD_STEP = 1e-3  # at least: less damping would hardly change the step
_TRIES = 5  # at most so many tries of one step, each with more damping
_RISES = 1.0  # if its cost rises by more, a window tries a shorter step: a wheel may stick there
_SHORTER = (0.3, 0.0)  # the shares of its step that the window tries
_NOTHING = 1e-14  # least curvature: replaces the curvature 0 of a parameter on which no window depends
_OPEN = 1e-10  # a smaller eigenvalue of a normalised matrix is rounding error: its direction is unknown


class Solution(NamedTuple):
    """The result of a fit.

    Attributes:
        parameters: (P,) as the model takes them.
        covariance: (P, P) a sandwich, clustered by window; huge along null directions.
        information: (P, P) the weighted normal matrix of the windows alone, from which null directions are read.
        starts: (W, S).
    """

    parameters: Array
    covariance: Array
    information: Array
    starts: Array


class Knowledge(NamedTuple):
    """The knowledge of the parameters from elsewhere than the windows.

    Attributes:
        information: (P, P) inverse covariance of the result of another measurement; zero where it has none.
        mean: (P,) that result.
        held: (P,) which parameters are not fitted.
        held_covariance: (P, P) covariance of those; it widens the intervals of the fitted ones.
    """

    information: Array
    mean: Array
    held: npt.NDArray[np.bool_]
    held_covariance: Array

    @classmethod
    def none(cls, count: int) -> Self:
        """Return an uninformative prior."""
        return cls(np.zeros((count, count)), np.zeros(count), np.zeros(count, dtype=bool), np.zeros((count, count)))


def solve(
    experiment: Experiment,
    parameters: Array,
    *,
    bounds: tuple[Array, Array],
    known: Knowledge | None = None,
) -> Solution:
    """Return the parameters that fit an experiment, by damped Gauss-Newton with Huber's loss.

    ``bounds`` are the least and the largest parameters, each (P,). What is ``known`` counts with the windows.
    """
    known = Knowledge.none(len(parameters)) if known is None else known
    at = _Iterate(parameters.copy(), experiment.starts.copy(), _predicted(experiment, parameters, experiment.starts))
    sigma = experiment.sigmas(experiment.measured - at.predicted)
    damping, has_settled = _DAMPING, False
    slopes: Slopes | None = None  # None: to be computed at the present iterate
    are_new, trusted = False, None  # are_new: ``slopes`` are of this iterate, not of one close by
    for number in range(1, _MOST_STEPS + 1):
        if slopes is None:
            slopes = slopes_at(experiment, at.predicted, at.starts, at.point, ~known.held)
            are_new, trusted = True, None
        valley = _valley(experiment, at, slopes, sigma, known, by="guess" if number == 1 else "start")
        found, damping, is_flat = _lowered(experiment, at, valley, sigma, known, bounds, damping)
        if found is None and not is_flat and not are_new:
            slopes = None  # no step was found, perhaps because these derivatives are of another point
            continue
        done = found is None
        if found is not None:
            lower, cost = found
            furthest = float(np.abs(lower.point - at.point).max())
            done = furthest < _DONE or valley.cost - cost < _FLAT
            at = lower
            slopes, are_new = slopes if furthest < _NEAR else None, False
            damping = max(damping / 10.0, _LEAST_DAMPING)
        if done and has_settled:
            break
        if done and number > _NEW_SIGMAS:  # once more, without the windows whose derivatives are not to be trusted
            has_settled, are_new, damping = True, True, _DAMPING
            slopes, sigma = trusted = _trusted(experiment, at)
        elif done or number <= _NEW_SIGMAS:
            sigma = experiment.sigmas(experiment.measured - at.predicted)
    if trusted is None or slopes is None:
        trusted = _trusted(experiment, at)
    return _with_intervals(experiment, at, known, trusted)


class _Iterate(NamedTuple):
    """The state of a fit: parameters (P,), starts (W, S) and the prediction (W, M) from both."""

    point: Array
    starts: Array
    predicted: Array


class _Valley(NamedTuple):
    """The quadratic model of the cost at an iterate: value, steepest descent (P,), normal matrix (P, P)."""

    local: Local
    cost: float
    descent: Array
    information: Array


def _valley(
    experiment: Experiment,
    at: _Iterate,
    slopes: Slopes,
    sigma: Array,
    known: Knowledge,
    by: Literal["start", "guess"],
) -> _Valley:
    local = linearised(experiment, at.predicted, slopes, sigma, by=by)
    descent = _scores(local).sum(axis=0) + known.information @ (known.mean - at.point)
    information = _pieces(local).sum(axis=0) + known.information
    return _Valley(local, _cost(local.residual, known, at.point), descent, information)


def _lowered(
    experiment: Experiment,
    at: _Iterate,
    valley: _Valley,
    sigma: Array,
    known: Knowledge,
    bounds: tuple[Array, Array],
    damping: float,
) -> tuple[tuple[_Iterate, float] | None, float, bool]:
    """Try damped steps. Return the first iterate whose cost is not higher, with that cost, or None; the damping; and
    whether the valley is flat: its model promises less than ``_FLAT``.
    """
    free, (descent, information) = ~known.held, valley[2:]
    for _ in range(_TRIES):
        matrix = (information + np.diag(damping * np.diag(information) + 1e-12))[np.ix_(free, free)]
        step = np.zeros(len(at.point))
        step[free] = np.linalg.solve(matrix, descent[free])
        step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12))
        tried = np.clip(at.point + step, *bounds)
        end = _moved(experiment, valley.local, at, sigma, tried)
        cost = _cost((experiment.measured - end.predicted) / sigma, known, tried)
        if cost <= valley.cost:
            return (end, cost), damping, False
        if 0.5 * float(descent @ step) < _FLAT:
            return None, damping, True
        damping = max(damping * 10.0, _DAMPING_OF_BAD_STEP)
    return None, damping, False


def _with_intervals(experiment: Experiment, at: _Iterate, known: Knowledge, trusted: tuple[Slopes, Array]) -> Solution:
    """Return an optimum with its covariance, by derivatives and standard deviations of windows that are ``trusted``."""
    local = linearised(experiment, at.predicted, *trusted)
    # The curvature of Huber's loss itself: its weights would make intervals a tenth too narrow.
    pieces = _pieces(local._replace(jacobian=local.jacobian * local.inside[..., None]))
    curvature = pieces.sum(axis=0)
    scatter = _scatter(_scores(local), pieces, curvature + known.information, ~known.held)
    covariance = _covariance(curvature, scatter, known)
    return Solution(at.point, covariance, _pieces(local).sum(axis=0), at.starts)


def _scatter(scores: Array, pieces: Array, curvature: Array, free: npt.NDArray[np.bool_]) -> Array:
    """Return the sum (P, P) of the outer products of the windows' scores, each as if the fit had not seen its window.

    A fit follows its windows, most of all those that tell most, so the residuals in these are too small. Without window
    g the optimum would move by (H - H_g)⁻¹ s_g, to which the score H (H - H_g)⁻¹ s_g belongs. This is the jackknife CR3
    of J. G. MacKinnon, M. Ø. Nielsen and M. D. Webb, "Cluster-robust inference: a guide to empirical practice", Journal
    of Econometrics 232, 2023, without its factor (W - 1) / W.

    ``scores`` (W, P) are the gradients s_g, ``pieces`` (W, P, P) the parts H_g that the windows have in the
    ``curvature`` H (P, P). Parameters that are not ``free`` (P,) are not fitted; their rows and columns are zero.
    """
    scale = np.sqrt(np.maximum(np.diag(curvature), _NOTHING))
    inner = np.ix_(free, free)
    whole, scatter = (curvature / np.outer(scale, scale))[inner], np.zeros_like(curvature)
    for score, piece in zip(scores, pieces, strict=True):
        own, pull = (piece / np.outer(scale, scale))[inner], (score / scale)[free]
        moved = pull + own @ np.linalg.pinv(whole - own, rcond=_OPEN, hermitian=True) @ pull
        scatter[inner] += np.outer(moved, moved)
    scatter *= np.outer(scale, scale)
    return scatter


def information_of(experiment: Experiment, parameters: Array) -> Array:
    """Return the information (P, P) that an experiment holds near these parameters, by the noise of its sensors."""
    predicted = _predicted(experiment, parameters, experiment.starts)
    every = np.ones(len(parameters), dtype=bool)
    slopes = slopes_at(experiment, predicted, experiment.starts, parameters, every)
    local = linearised(experiment, predicted, slopes, experiment.least_sigmas, by="nothing")
    information: Array = _pieces(local).sum(axis=0)
    return information


def _covariance(information: Array, scatter: Array, known: Knowledge) -> Array:
    """Return the covariance (P, P): the sandwich of the fitted parameters, widened by the covariance of those held."""
    free = np.flatnonzero(~known.held)
    held = np.flatnonzero(known.held)
    inner = np.ix_(free, free)
    covariance = np.zeros_like(information)
    covariance[inner] = _sandwich((information + known.information)[inner], (scatter + known.information)[inner])
    carried = np.diag(known.held.astype(np.float64))
    inverse = inverted((information + known.information)[inner])
    carried[np.ix_(free, held)] = -inverse @ (information + known.information)[np.ix_(free, held)]
    covariance += carried @ known.held_covariance @ carried.T
    return covariance


def _sandwich(curvature: Array, scatter: Array) -> Array:
    """Return the sandwich H⁻¹ S H⁻¹ of curvature H and scatter S; huge in directions that have no curvature."""
    scale = np.sqrt(np.maximum(np.diag(curvature), _NOTHING))
    values, vectors = np.linalg.eigh(curvature / np.outer(scale, scale))
    is_open = values < _OPEN
    inverse = (vectors * np.where(is_open, 0.0, 1.0 / np.maximum(values, _OPEN))) @ vectors.T
    unknown = (vectors * np.where(is_open, 1.0 / _NOTHING, 0.0)) @ vectors.T
    covariance: Array = (inverse @ (scatter / np.outer(scale, scale)) @ inverse + unknown) / np.outer(scale, scale)
    return covariance


def inverted(information: Array) -> Array:
    """Return the inverse of an information matrix, with a huge variance in place of an infinite one."""
    scale = np.sqrt(np.maximum(np.diag(information), _NOTHING))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse: Array = (vectors / np.maximum(values, _NOTHING)) @ vectors.T / np.outer(scale, scale)
    return inverse


def _predicted(experiment: Experiment, point: Array, starts: Array) -> Array:
    predicted: Array = experiment.predict(point[None], starts[None])[0]
    return predicted


def _trusted(experiment: Experiment, at: _Iterate) -> tuple[Slopes, Array]:
    """Return the derivatives where the fit is, as means of those to either side, and the measurements' deviations.

    The deviations (W, M) are infinite in windows where the derivatives to the two sides disagree (``agreeing``). A
    wheel about to stick makes a prediction jump, and a finite difference takes the jump for a huge derivative. One such
    window would outweigh all others: the parameter's interval would be too narrow, and each Gauss-Newton step too
    short.
    """
    every = np.ones(len(at.point), dtype=bool)
    sigma = experiment.sigmas(experiment.measured - at.predicted)
    sides = [slopes_at(experiment, at.predicted, at.starts, at.point, every, way=way) for way in (1.0, -1.0)]
    agree = agreeing(*(linearised(experiment, at.predicted, slopes, sigma) for slopes in sides))
    mean = Slopes(*(0.5 * (one + other) for one, other in zip(*sides, strict=True)))
    return mean, np.where(agree[:, None], sigma, np.inf)


def _scores(local: Local) -> Array:
    """Return what each window adds to the gradient, of shape (W, P)."""
    scores: Array = np.einsum("wmp,wm->wp", local.jacobian, local.reduced)
    return scores


def _pieces(local: Local) -> Array:
    """Return what each window adds to the normal matrix, of shape (W, P, P)."""
    pieces: Array = np.swapaxes(local.jacobian, 1, 2) @ local.jacobian
    return pieces


def _cost(residual: Array, known: Knowledge, point: Array) -> float:
    away = point - known.mean
    return float(huber_loss(residual).sum()) + 0.5 * float(away @ known.information @ away)


def _moved(experiment: Experiment, local: Local, at: _Iterate, sigma: Array, tried: Array) -> _Iterate:
    """Return the iterate after a step of the parameters to ``tried``, with the starts that then fit best.

    A window whose start would raise its own cost moves it by less, or not at all: a wheel may stick there.
    """
    by = _start_step(local, tried - at.point)
    moved = at.starts + by
    there = _predicted(experiment, tried, moved)
    costs = _window_costs(experiment, there, sigma)
    if np.any(costs > huber_loss(local.residual).sum(axis=1) + _RISES):
        shorter = np.stack([at.starts + share * by for share in _SHORTER])
        others = experiment.predict(np.repeat(tried[None], len(shorter), axis=0), shorter)
        for other, seen in zip(shorter, others, strict=True):
            now = _window_costs(experiment, seen, sigma)
            better = (now < costs)[:, None]
            moved, there, costs = np.where(better, other, moved), np.where(better, seen, there), np.minimum(now, costs)
    return _Iterate(tried, moved, there)


def _window_costs(experiment: Experiment, predicted: Array, sigma: Array) -> Array:
    cost: Array = huber_loss((experiment.measured - predicted) / sigma).sum(axis=1)
    return cost


def _start_step(local: Local, step: Array) -> Array:
    """Return the change of each start that fits best after a step of the parameters."""
    left = local.weighted - local.raw_jacobian @ step
    found: Array = np.einsum("wsm,wm->ws", np.linalg.pinv(local.start_jacobian), left)
    return found
