"""Robust nonlinear least squares over windows: parameters common to all, and the free start of each window.

Per window, the part of the residuals that a change of its start explains is projected away (variable projection),
so that hundreds of starts cost no more than the few parameters (``linearised``).
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hil.identify.linearised import Experiment, Local, Slopes, agreeing, all_slopes, linearised
from hil.identify.recorded import Array
from hil.identify.robust import huber_loss

_MOST_STEPS = 30
_DAMPING = 1e-4
_DONE = 2e-4
_NEAR = 0.02  # so near derivatives are good enough for another step; they are most of the work
_FLAT = 0.01  # of the cost, of which 0.5 is one standard deviation
_NEW_SIGMAS = 3
_NOTHING = 1e-14
_OPEN = 1e-10
_LONGEST = 0.7
_RISES = 1.0  # of a window's cost
_SHORTER = (0.3, 0.0)
_HALVINGS = 4


class Solution(NamedTuple):
    """The result of a fit.

    Attributes:
        parameters: (P,) as the model takes them.
        covariance: (P, P) a sandwich, clustered by window; huge along null directions.
        information: (P, P) the weighted normal matrix of the windows alone, from which null directions are read.
        starts: for each experiment (W, S).
        cost: mean Huber loss of a residual.
        steps: how many steps were taken.
    """

    parameters: Array
    covariance: Array
    information: Array
    starts: tuple[Array, ...]
    cost: float
    steps: int


class Knowledge(NamedTuple):
    """What is known of the parameters besides the windows.

    Attributes:
        information: (P, P) inverse covariance of what another measurement found; zero where it found nothing.
        mean: (P,) what it found.
        held: (P,) which parameters are not fitted.
        held_covariance: (P, P) how well these are known; it is carried over to those that are fitted.
    """

    information: Array
    mean: Array
    held: npt.NDArray[np.bool_]
    held_covariance: Array

    @classmethod
    def none(cls, count: int) -> Self:
        """Return that nothing is known."""
        return cls(np.zeros((count, count)), np.zeros(count), np.zeros(count, dtype=bool), np.zeros((count, count)))


def solve(
    experiments: Sequence[Experiment],
    parameters: Array,
    *,
    bounds: tuple[Array, Array],
    known: Knowledge | None = None,
) -> Solution:
    """Return the parameters that fit all experiments, by damped Gauss-Newton with Huber's loss.

    ``bounds`` are the least and the largest parameters, each (P,). What is ``known`` counts with the windows.
    """
    known = Knowledge.none(len(parameters)) if known is None else known
    point, free = parameters.copy(), ~known.held
    starts = [experiment.starts.copy() for experiment in experiments]
    predicted = _predicted(experiments, point, starts)
    sigmas = _sigmas(experiments, predicted)
    damping, steps, has_settled = _DAMPING, 0, False
    slopes: list[Slopes] = []
    are_new, trusted = False, None
    for steps in range(1, _MOST_STEPS + 1):
        if not slopes:
            slopes, are_new, trusted = all_slopes(experiments, predicted, starts, point, free), True, None
        locals_ = [
            linearised(*args, by="guess" if steps == 1 else "start")
            for args in zip(experiments, predicted, slopes, sigmas, strict=True)
        ]
        gradient, information = _scores(locals_).sum(axis=0), _pieces(locals_).sum(axis=0)
        gradient = gradient + known.information @ (known.mean - point)
        information = information + known.information
        cost = _cost([local.residual for local in locals_], known, point)
        found, is_flat = None, False
        for _ in range(_HALVINGS + 1):
            matrix = (information + np.diag(damping * np.diag(information) + 1e-12))[np.ix_(free, free)]
            step = np.zeros(len(point))
            step[free] = np.linalg.solve(matrix, gradient[free])
            step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12))
            tried = np.clip(point + step, *bounds)
            ends = [
                _moved(*args, tried, tried - point) for args in zip(experiments, locals_, starts, sigmas, strict=True)
            ]
            moved, there = [end for end, _ in ends], [seen for _, seen in ends]
            now = _cost(_residuals(experiments, there, sigmas), known, tried)
            if now <= cost:
                found = tried, moved, there, now
                break
            is_flat = 0.5 * float(gradient @ step) < _FLAT  # a shorter step would win nothing
            if is_flat:
                break
            damping = max(damping * 10.0, 1e-3)
        if found is None and not is_flat and not are_new:
            slopes = []  # those of a point near by may be what fails
            continue
        done = found is None
        if found is not None:
            furthest = float(np.abs(found[0] - point).max())
            done = furthest < _DONE or cost - found[3] < _FLAT
            point, starts, predicted, _ = found
            slopes, are_new = slopes if furthest < _NEAR else [], False
            damping = max(damping / 10.0, 1e-6)
        if done and has_settled:
            break
        if done and steps > _NEW_SIGMAS:
            has_settled, are_new, damping = True, True, _DAMPING
            slopes, sigmas = trusted = _trusted(experiments, predicted, starts, point)
        elif done or steps <= _NEW_SIGMAS:  # the last were those of a poorer model
            sigmas = _sigmas(experiments, predicted)
    if trusted is None or not slopes:
        trusted = _trusted(experiments, predicted, starts, point)
    return _with_intervals(experiments, point, starts, predicted, known, steps, trusted)


def _with_intervals(
    experiments: Sequence[Experiment],
    point: Array,
    starts: Sequence[Array],
    predicted: Sequence[Array],
    known: Knowledge,
    steps: int,
    trusted: tuple[list[Slopes], list[Array]],
) -> Solution:
    """Return an optimum with its covariance, by derivatives and standard deviations of windows that are ``trusted``."""
    locals_ = [linearised(*args) for args in zip(experiments, predicted, *trusted, strict=True)]
    # The curvature of Huber's loss itself: its weights would make intervals a tenth too narrow.
    curved = [local._replace(jacobian=local.jacobian * local.inside[..., None]) for local in locals_]
    pieces = _pieces(curved)
    curvature = pieces.sum(axis=0)
    scatter = _scatter(_scores(locals_), pieces, curvature + known.information, ~known.held)
    count = sum(local.residual.size for local in locals_)
    cost = _cost([local.residual for local in locals_], known, point) / count
    covariance = _covariance(curvature, scatter, known)
    return Solution(point, covariance, _pieces(locals_).sum(axis=0), tuple(starts), cost, steps)


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


def information_of(experiments: Sequence[Experiment], parameters: Array) -> Array:
    """Return the information (P, P) that experiments hold near these parameters, by the noise of their sensors."""
    every = np.ones(len(parameters), dtype=bool)
    starts = [one.starts for one in experiments]
    predicted = _predicted(experiments, parameters, starts)
    slopes = all_slopes(experiments, predicted, starts, parameters, every)
    locals_ = [
        linearised(one, seen, slope, one.least_sigmas, by="nothing")
        for one, seen, slope in zip(experiments, predicted, slopes, strict=True)
    ]
    information: Array = _pieces(locals_).sum(axis=0)
    return information


def _covariance(information: Array, scatter: Array, known: Knowledge) -> Array:
    """Return the sandwich of the fitted parameters, with the share of those held in it."""
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
    """Return the covariance of an optimum, with a huge variance in the directions that have no curvature."""
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


def _predicted(experiments: Sequence[Experiment], point: Array, starts: Sequence[Array]) -> list[Array]:
    """Return what each experiment predicts at one point, (W, M) each."""
    return [one.predict(point[None], start[None])[0] for one, start in zip(experiments, starts, strict=True)]


def _residuals(experiments: Sequence[Experiment], predicted: Sequence[Array], sigmas: Sequence[Array]) -> list[Array]:
    """Return what is left of the measurements, in standard deviations."""
    return [(one.measured - seen) / sigma for one, seen, sigma in zip(experiments, predicted, sigmas, strict=True)]


def _sigmas(experiments: Sequence[Experiment], predicted: Sequence[Array]) -> list[Array]:
    return [one.sigmas(one.measured - seen) for one, seen in zip(experiments, predicted, strict=True)]


def _trusted(
    experiments: Sequence[Experiment], predicted: Sequence[Array], starts: Sequence[Array], point: Array
) -> tuple[list[Slopes], list[Array]]:
    """Return the derivatives at ``point`` (P,) as means of those to either side, and the measurements' deviations.

    Of each experiment these are its ``Slopes``, and standard deviations (W, M) that are infinite in windows of which
    the derivatives to the two sides do not agree (``agreeing``). A wheel on the verge of sticking makes a prediction
    jump. A finite difference takes the jump for a huge derivative, so that one such window would tell a parameter
    better than all the others together: its interval would be too narrow, and each Gauss-Newton step too short.
    """
    every, slopes, sigmas = np.ones(len(point), dtype=bool), [], []
    sides = [all_slopes(experiments, predicted, starts, point, every, way=way) for way in (1.0, -1.0)]
    for experiment, seen, sigma, *both in zip(
        experiments, predicted, _sigmas(experiments, predicted), *sides, strict=True
    ):
        agree = agreeing(*(linearised(experiment, seen, slope, sigma) for slope in both))
        slopes.append(Slopes(*(0.5 * (one + other) for one, other in zip(*both, strict=True))))
        sigmas.append(np.where(agree[:, None], sigma, np.inf))
    return slopes, sigmas


def _scores(locals_: Sequence[Local]) -> Array:
    """Return what each window adds to the gradient, of shape (W, P)."""
    return np.concatenate([np.einsum("wmp,wm->wp", one.jacobian, one.reduced) for one in locals_])


def _pieces(locals_: Sequence[Local]) -> Array:
    """Return what each window adds to the normal matrix, of shape (W, P, P)."""
    return np.concatenate([np.swapaxes(one.jacobian, 1, 2) @ one.jacobian for one in locals_])


def _cost(residuals: Sequence[Array], known: Knowledge, point: Array) -> float:
    away = point - known.mean
    return sum(float(huber_loss(residual).sum()) for residual in residuals) + 0.5 * float(
        away @ known.information @ away
    )


def _moved(
    experiment: Experiment, local: Local, start: Array, sigma: Array, tried: Array, step: Array
) -> tuple[Array, Array]:
    """Return the starts (W, S) after a step of the parameters to ``tried``, and what is predicted from them (W, M).

    A window whose cost rises by its own step takes a part of it, or none: from there a wheel may stick.
    """
    by = _start_step(local, step)
    moved = start + by
    there = experiment.predict(tried[None], moved[None])[0]
    costs = _window_costs(experiment, there, sigma)
    if np.any(costs > huber_loss(local.residual).sum(axis=1) + _RISES):
        shorter = np.stack([start + share * by for share in _SHORTER])
        others = experiment.predict(np.repeat(tried[None], len(shorter), axis=0), shorter)
        for other, seen in zip(shorter, others, strict=True):
            now = _window_costs(experiment, seen, sigma)
            better = (now < costs)[:, None]
            moved, there, costs = np.where(better, other, moved), np.where(better, seen, there), np.minimum(now, costs)
    return moved, there


def _window_costs(experiment: Experiment, predicted: Array, sigma: Array) -> Array:
    """Return Huber's loss of each window, of shape (W,)."""
    cost: Array = huber_loss((experiment.measured - predicted) / sigma).sum(axis=1)
    return cost


def _start_step(local: Local, step: Array) -> Array:
    """Return the change of each start that fits best after a step of the parameters."""
    left = local.weighted - local.raw_jacobian @ step
    if local.start_jacobian.shape[2] == 0:
        return np.zeros((len(left), 0))
    found: Array = np.einsum("wsm,wm->ws", np.linalg.pinv(local.start_jacobian), left)
    return found
