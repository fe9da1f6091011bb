"""Currents without their sensors' noise: where a motor did as commanded, the commands tell its current better than the
sensor.

A torque command commands the current of a motor. Over all drives at once, the measured currents of a wheel are
regressed on the newest commands before them:

    i_k = c + Σ g_j T_{k-j},  j = 0 to 5

with an offset c for each drive. Gain and offset are thus the sensor's own, and the link's delay is found. If what is
left is white noise, it is the sensor's, and a fit takes what the commands predict, with the fewest lags and the same
ones for all wheels (``lags``). If anything else is left (a limit, a motor that follows slowly or is dead), it takes the
measured currents.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.types import WHEEL_NAMES
from hil.identify.lags import Regression, fewest_lags
from hil.identify.recorded import Array, Drive

_LAGS = 6
_BLOCKS = (4, 10, 40, 200, 400)
"""Rows over which what is left is averaged, to see whether it is white."""
_BIN_ROWS = 10
_SIGMAS = 4.5
_FURTHEST = 6.0  # standard deviations that a mean over a block may have
_LEAST_ROWS = 1000
_QUIET_A = 2e-3  # the resolution of the wire: nothing else is left


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
    factors = iter(fewest_lags([one for one in regressions if one is not None]))
    by_wheel = [
        _Wheel((None,) * len(both), 0.0)
        if one is None
        else _by_commands(both, wheel, lagged[wheel], one, next(factors))
        for wheel, one in enumerate(regressions)
    ]
    taken, sentences = [], []
    for place, drive in enumerate(both):
        found = [one.currents[place] for one in by_wheel]
        poor = [name for name, one in zip(WHEEL_NAMES, found, strict=True) if one is None]
        if poor and np.isfinite(drive.torque_command_n_m).any():
            sentences.append(
                f"{drive.path.name}: the currents of {', '.join(poor)} are not what was commanded; they are taken as "
                "measured, with their noise"
            )
        currents = [drive.current_a[:, w] if one is None else one for w, one in enumerate(found)]
        taken.append(replace(drive, current_a=np.stack(currents, axis=1)))
    return Quiet(tuple(taken), np.array([one.gain_variance for one in by_wheel]), tuple(sentences))


class _Wheel(NamedTuple):
    """A wheel's currents in each drive by its commands, None where these do not explain them."""

    currents: tuple[Array | None, ...]
    gain_variance: float


def _regression(lagged: Sequence["_Lagged | None"]) -> Regression | None:
    """Return the regression of a wheel's currents over the drives in which it leaves white noise, None without any."""
    used = [one for one in lagged if one is not None]
    while used:
        designs = [design - design.mean(axis=0) for design, _, _ in used]
        values = [current - current.mean() for _, current, _ in used]
        design, value = np.concatenate(designs), np.concatenate(values)
        factors = np.linalg.lstsq(design, value, rcond=None)[0]
        left = [value - design @ factors for design, value in zip(designs, values, strict=True)]
        white = [one for one, rest in zip(used, left, strict=True) if _is_white(rest)]
        if len(white) == len(used):
            return Regression(factors, design.T @ design, float(np.var(np.concatenate(left))), len(value))
        used = white
    return None


def _by_commands(
    drives: Sequence[Drive], wheel: int, lagged: Sequence["_Lagged | None"], found: Regression, factors: Array
) -> _Wheel:
    currents = [_by_command(drive, wheel, one, factors) for drive, one in zip(drives, lagged, strict=True)]
    designs = [one[0] - one[0].mean(axis=0) for one in lagged[:-1] if one is not None]  # without the judge
    return _Wheel(tuple(currents), _gain_variance(designs, found, factors))


def _gain_variance(designs: Sequence[Array], found: Regression, factors: Array) -> float:
    """Return the variance of the gain's logarithm, for means over ``_BIN_ROWS``, from that of the noise.

    A robot answers to means of its currents. Much of a command may be fast noise of the loops, which tells the factors
    and hardly the gain of their means.
    """
    places = np.flatnonzero(factors)
    means = np.concatenate([_means(design[:, places], _BIN_ROWS) for design in designs])
    explained = means @ factors[places]
    gain_of = means.T @ explained / max(float(explained @ explained), 1e-12)
    squares = found.squares[np.ix_(places, places)]
    return found.noise_a2 * float(gain_of @ np.linalg.pinv(squares, hermitian=True) @ gain_of)


def _means(series: Array, rows: int) -> Array:
    """Return the means over blocks of rows, of shape (n // rows, ...)."""
    count = len(series) // rows
    means: Array = series[: count * rows].reshape(count, rows, *series.shape[1:]).mean(axis=1)
    return means


_Lagged = tuple[Array, Array, int]


def _lagged(drive: Drive, wheel: int) -> _Lagged | None:
    """Return the last commands of each row (n, 6), its currents (n,) and the first such row; None without commands."""
    command, current = drive.torque_command_n_m[:, wheel], drive.current_a[:, wheel]
    count = len(command)
    lagged = np.stack([np.pad(command, (lag, 0), constant_values=np.nan)[:count] for lag in range(_LAGS)], axis=1)
    known: npt.NDArray[np.bool_] = np.isfinite(lagged).all(axis=1) & np.isfinite(current)
    # Commands begin with the drive, and from then on there is one in each row.
    first = int(np.argmax(known))
    if not known[first:].all() or count - first < _LEAST_ROWS:
        return None
    return lagged[first:], current[first:], first


def _by_command(drive: Drive, wheel: int, lagged: _Lagged | None, factors: Array) -> Array | None:
    if lagged is None:
        return None
    design, current, first = lagged
    explained = design @ factors
    left = current - explained
    if not _is_white(left - left.mean()):
        return None
    return np.concatenate([drive.current_a[:first, wheel], explained + left.mean()])


def _is_white(left: Array) -> bool:
    """Return whether means over blocks scatter as those of white noise, and none is far off."""
    sigma = float(np.std(left))
    if sigma < _QUIET_A:
        return True
    for rows in _BLOCKS:
        means = _means(left, rows) * np.sqrt(rows) / sigma
        count = len(means)
        if count == 0:
            continue
        if np.abs(means).max() > _FURTHEST or np.mean(means**2) > 1.0 + _SIGMAS * np.sqrt(2.0 / count):
            return False
    return True
