"""Removes sensor noise from currents: while a motor follows its commands, they give its current better than the sensor.

A torque command commands the current of a motor. Over all drives at once, the measured currents of a wheel are
regressed on the newest commands before them:

    i_k = c + Σ g_j T_{k-j},  j = 0 to 5

with an offset c for each drive. This finds the sensor's gain and offset, and the link's delay. If the residual is white
noise, it is the sensor's noise, and a fit takes the currents predicted by the commands, with the fewest lags, the same
for all wheels (``fewest_lags``). Otherwise (a limit, a motor that follows slowly or is dead) it takes the measured
currents.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.addons.identify.drives import Array, Drive
from hil.core.types import WHEEL_NAMES

_LAGS = 6
_BLOCKS = (4, 10, 40, 200, 400)  # rows over which what is left is averaged, to see whether it is white
_BIN_ROWS = 10
_SIGMAS = 4.5
_FURTHEST = 6.0  # standard deviations that a mean over a block may have
_LEAST_ROWS = 1000
_QUIET_A = 2e-3  # the resolution of the wire: nothing else is left

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

    A board commands its motors together, so their currents are late by the same time. Six free lags for each motor left
    its delay uncertain by a third of a millisecond. For a robot of 10 kg that is half a millimetre of its centre of
    mass, and 1 % of the inertia of a wheel.
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


class Quiet(NamedTuple):
    """Drives with the currents that a fit takes.

    Attributes:
        drives: in their order; those whose commands do not explain the currents are as they were.
        gain_variance: (4,) of the logarithms of the currents' factors; 0 for currents that were only measured.
        sentences: one on each drive that is as it was.
    """

    drives: tuple[Drive, ...]
    gain_variance: Array
    sentences: tuple[str, ...]


def quiet(drives: Sequence[Drive], judge: Drive) -> Quiet:
    """Return the drives, then the ``judge``, all without the noise of their currents.

    The judge is the drive by which a fit is judged, so the regression is not made from it.
    """
    both = (*drives, judge)
    lagged = [[_lagged(drive, wheel) for drive in both] for wheel in range(len(WHEEL_NAMES))]
    regressions = [_regression(ones[: len(drives)]) for ones in lagged]
    chosen = iter(fewest_lags([one for one in regressions if one is not None]))
    gain_variance, poor = np.zeros(len(WHEEL_NAMES)), [list(WHEEL_NAMES) for _ in both]
    currents = [drive.current_a.copy() for drive in both]
    for wheel, (name, ones, found) in enumerate(zip(WHEEL_NAMES, lagged, regressions, strict=True)):
        if found is None:
            continue
        factors = next(chosen)
        gain_variance[wheel] = _gain_variance(ones[: len(drives)], found, factors)
        for one, current, missing in zip(ones, currents, poor, strict=True):
            explained = None if one is None else one.explained(factors)
            if one is not None and explained is not None:
                current[one.first :, wheel] = explained
                missing.remove(name)
    sentences = tuple(
        f"{drive.path.name}: the currents of {', '.join(names)} are not what was commanded; they are taken as "
        "measured, with their noise"
        for drive, names in zip(both, poor, strict=True)
        if names and np.isfinite(drive.torque_command_n_m).any()
    )
    taken = tuple(replace(drive, current_a=current) for drive, current in zip(both, currents, strict=True))
    return Quiet(taken, gain_variance, sentences)


class _Lagged(NamedTuple):
    """The last commands (n, 6) of a motor, its currents (n,), and the row of the drive at which they begin."""

    design: Array
    current: Array
    first: int

    def centred(self) -> Array:
        centred: Array = self.design - self.design.mean(axis=0)
        return centred

    def explained(self, factors: Array) -> Array | None:
        """Return the currents by their commands; None where more than white noise is left."""
        explained = self.design @ factors
        left = self.current - explained
        return explained + left.mean() if _is_white(left - left.mean()) else None


def _lagged(drive: Drive, wheel: int) -> _Lagged | None:
    """Return the lagged commands of a drive; None without commands."""
    command, current = drive.torque_command_n_m[:, wheel], drive.current_a[:, wheel]
    count = len(command)
    lagged = np.stack([np.pad(command, (lag, 0), constant_values=np.nan)[:count] for lag in range(_LAGS)], axis=1)
    known: npt.NDArray[np.bool_] = np.isfinite(lagged).all(axis=1) & np.isfinite(current)
    # Commands begin with the drive, and from then on there is one in each row.
    first = int(np.argmax(known))
    if not known[first:].all() or count - first < _LEAST_ROWS:
        return None
    return _Lagged(lagged[first:], current[first:], first)


def _regression(lagged: Sequence[_Lagged | None]) -> Regression | None:
    """Return the regression of a wheel's currents over the drives in which it leaves white noise, None without any."""
    used = [one for one in lagged if one is not None]
    while used:
        designs = [one.centred() for one in used]
        values = [one.current - one.current.mean() for one in used]
        design, value = np.concatenate(designs), np.concatenate(values)
        factors = np.linalg.lstsq(design, value, rcond=None)[0]
        left = [value - design @ factors for design, value in zip(designs, values, strict=True)]
        white = [one for one, rest in zip(used, left, strict=True) if _is_white(rest)]
        if len(white) == len(used):
            return Regression(factors, design.T @ design, float(np.var(np.concatenate(left))), len(value))
        used = white
    return None


def _gain_variance(lagged: Sequence[_Lagged | None], found: Regression, factors: Array) -> float:
    """Return the variance of the gain's logarithm, for means over ``_BIN_ROWS``, from that of the noise.

    A robot answers to means of its currents. Much of a command may be fast noise of the loops, which tells the factors
    and hardly the gain of their means.
    """
    places = np.flatnonzero(factors)
    means = np.concatenate([_means(one.centred()[:, places], _BIN_ROWS) for one in lagged if one is not None])
    explained = means @ factors[places]
    gain_of = means.T @ explained / max(float(explained @ explained), 1e-12)
    squares = found.squares[np.ix_(places, places)]
    return found.noise_a2 * float(gain_of @ np.linalg.pinv(squares, hermitian=True) @ gain_of)


def _means(series: Array, rows: int) -> Array:
    """Return the means over blocks of rows, of shape (n // rows, ...)."""
    count = len(series) // rows
    means: Array = series[: count * rows].reshape(count, rows, *series.shape[1:]).mean(axis=1)
    return means


def _is_white(left: Array) -> bool:
    """Return whether means over blocks scatter as those of white noise, and none is far off."""
    sigma = float(np.std(left))
    if sigma < _QUIET_A:
        return True
    for rows in _BLOCKS:
        means = _means(left, rows) * np.sqrt(rows) / sigma
        count = len(means)
        if count and (np.abs(means).max() > _FURTHEST or np.mean(means**2) > 1.0 + _SIGMAS * np.sqrt(2.0 / count)):
            return False
    return True
