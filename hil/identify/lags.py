"""How late motors follow their commands: the fewest lags that explain their currents, and the same of all motors.

A board commands its motors together, so their currents are late by the same. Six free lags of each motor by itself left
its delay in doubt by a third of a millisecond. A robot of 10 kg loses that much of its speed to viscous friction in
this time that such delays, different from motor to motor, were half a millimetre of its centre of mass, and 1 % of the
inertia of a wheel.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from hil.identify.recorded import Array

_ROUNDS = 12
_NOTHING = 1e-12


class Regression(NamedTuple):
    """The currents of one motor, regressed on its last L commands.

    Attributes:
        factors: (L,) of the newest command and of those before it [A/(N·m)].
        squares: (L, L) sums of products of the commands [N²·m²].
        noise_a2: variance of what is left [A²].
        rows: how many currents there were.
    """

    factors: Array
    squares: Array
    noise_a2: float
    rows: int


def fewest_lags(motors: Sequence[Regression]) -> list[Array]:
    """Return the factors (L,) of each motor by the best of all models, most of them 0.

    A model has a choice of lags, and either its own factors for each motor or the same ones up to a gain. The best is
    by Schwarz's criterion: a factor more has to explain more than chance does.
    """
    if not motors:
        return []
    price = math.log(sum(one.rows for one in motors))
    best, least = [one.factors for one in motors], math.inf
    lags = range(len(motors[0].factors))
    for chosen in chain.from_iterable(combinations(lags, count + 1) for count in lags):
        places = list(chosen)
        for parameters, factors in (
            (len(places) + len(motors) - 1, _shared(motors, places)),
            (len(places) * len(motors), _separate(motors, places)),
        ):
            cost = price * parameters + sum(_misfits(motors, factors))
            if cost < least:
                best, least = factors, cost
    return best


def _misfits(motors: Sequence[Regression], factors: Sequence[Array]) -> Iterator[float]:
    """Yield how much worse than each motor's own regression these factors are: the rise of χ²."""
    for one, found in zip(motors, factors, strict=True):
        away = found - one.factors
        yield float(away @ one.squares @ away) / max(one.noise_a2, _NOTHING)


def _separate(motors: Sequence[Regression], places: Sequence[int]) -> list[Array]:
    """Return each motor's own factors of these lags."""
    return [_solved(one.squares, one.squares @ one.factors, places) for one in motors]


def _shared(motors: Sequence[Regression], places: Sequence[int]) -> list[Array]:
    """Return factors of these lags that are the same up to each motor's gain: factors and gains are found by turns."""
    weighted = [one.squares / max(one.noise_a2, _NOTHING) for one in motors]
    gains = np.ones(len(motors))
    factors = np.zeros(len(motors[0].factors))
    for _ in range(_ROUNDS):
        matrix = sum((gain**2 * each for gain, each in zip(gains, weighted, strict=True)), np.zeros(()))
        vector = sum(
            (gain * each @ one.factors for gain, each, one in zip(gains, weighted, motors, strict=True)), np.zeros(())
        )
        factors = _solved(matrix, vector, places)
        sizes = np.array([factors @ each @ factors for each in weighted])
        fits = np.array([factors @ each @ one.factors for each, one in zip(weighted, motors, strict=True)])
        gains = np.divide(fits, sizes, out=np.ones(len(motors)), where=sizes > _NOTHING)
    return [gain * factors for gain in gains]


def _solved(matrix: Array, vector: Array, places: Sequence[int]) -> Array:
    """Return the solution of normal equations that is 0 at all other places."""
    found = np.zeros(len(vector))
    found[places] = np.linalg.lstsq(matrix[np.ix_(places, places)], vector[places], rcond=None)[0]
    return found
