"""The figures of a run from its signals alone: a run and a review compute them alike.

Pure: NumPy arrays in, plain numbers out. A figure that has no meaning for a run is None, with a reason.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.types import WHEEL_NAMES

Series = npt.NDArray[np.float64]

TRACKED_RATIO = 0.02
TRACKED_DISTANCE_M = 0.010
RESOLUTION_M = 0.001
STEADY_WINDOW_S = 5.0
AT_LIMIT = 0.999
"""Share of a limit from which on a command is at it: codecs and rounding take a little."""


_TORQUE_SIGNALS = ("loop.t_s", *(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES))
_ERROR_SIGNALS = ("loop.t_s", "error.planar_m")
FIGURE_SIGNALS: dict[str, tuple[str, ...]] = {
    "tracked_s": _ERROR_SIGNALS,
    "t10_s": _ERROR_SIGNALS,
    "steady_rms_m": _ERROR_SIGNALS,
    "steady_max_m": _ERROR_SIGNALS,
    "overshoot_m": ("loop.t_s", "error.x_m", "error.y_m"),
    "effort_n_m_s": _TORQUE_SIGNALS,
    "torque_variation_n_m_per_s": _TORQUE_SIGNALS,
    "saturation_s": (
        "loop.t_s",
        "guard.saturated",
        *(f"wheel.{wheel}.{name}" for wheel in WHEEL_NAMES for name in ("speed_command_rad_s", "torque_command_n_m")),
    ),
    "estimation_error": (
        "loop.t_s",
        *(f"{group}.{name}" for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")),
    ),
    "ticks": ("loop.t_s",),
    "tick_us": ("loop.tick_us",),
    "deadline_misses": ("loop.deadline_misses",),
}
"""The signals from which ``signal_figures`` makes each figure."""


class Percentiles(NamedTuple):
    """Median and 99th percentile, in the unit of the signal."""

    p50: float
    p99: float


class CommandLimits(NamedTuple):
    """What the scenario's ``[robot]`` allows one wheel to be told, in SPEED mode [rad/s] and in TORQUE mode [N·m]."""

    speed_rad_s: float
    torque_n_m: float


class Tracking(NamedTuple):
    """How fast and how well the truth came to the reference; None where ``reasons`` says why.

    Attributes:
        tracked_s: the first time from which the planar error stays below 2 % of its initial value.
        t10_s: the first time from which it stays below 10 mm.
        steady_rms_m: planar error over the last 5 s, root mean square.
        steady_max_m: planar error over the last 5 s, largest.
        reasons: for each figure that is None, one sentence.
    """

    tracked_s: float | None
    t10_s: float | None
    steady_rms_m: float | None
    steady_max_m: float | None
    reasons: dict[str, str]

    def figures(self) -> dict[str, float | None]:
        """Return the four figures by name, in this order."""
        return {name: value for name, value in self._asdict().items() if name != "reasons"}


class Demand(NamedTuple):
    """How far a run went past the reference, and what it took from the motors; None where ``reasons`` says why.

    Attributes:
        overshoot_m: how far the error went past zero, along the line on which it began: the largest -e(t)·e(0)/|e(0)|,
            at least 0, e = (x, y) of truth minus reference.
        effort_n_m_s: control effort, the integral of the four wheels' absolute torques, ∫ Σ|τ| dt [N·m·s].
        torque_variation_n_m_per_s: mean absolute slew of a wheel's torque, the total variation Σ|τ(t + T) - τ(t)| over
            the time that it took, mean of the four wheels [N·m/s].
        saturation_s: for how long in all a wheel's command was at its limit, kept by the law or by the guard.
        reasons: for each figure that is None, one sentence.
    """

    overshoot_m: float | None
    effort_n_m_s: float | None
    torque_variation_n_m_per_s: float | None
    saturation_s: float | None
    reasons: dict[str, str]

    def figures(self) -> dict[str, float | None]:
        """Return the four figures by name, in this order."""
        return {name: value for name, value in self._asdict().items() if name != "reasons"}


class _NoMeaningError(Exception):
    """A figure has no meaning for this run; the text says why."""


def tracking_metrics(t_s: Series, planar_m: Series) -> Tracking:
    """Return the tracking figures of a run.

    Args:
        t_s: scenario time [s], ascending, shape (n,); rows before t = 0 do not count.
        planar_m: distance [m] between truth and reference, shape (n,); NaN where there was no truth.
    """
    active = t_s >= 0.0
    t_s, planar_m = t_s[active], planar_m[active]
    computations: dict[str, Callable[[], float]] = {
        "tracked_s": lambda: _tracked(t_s, planar_m),
        "t10_s": lambda: _settled(t_s, planar_m, TRACKED_DISTANCE_M),
        "steady_rms_m": lambda: float(np.sqrt(np.mean(_steady(t_s, planar_m) ** 2))),
        "steady_max_m": lambda: float(np.max(_steady(t_s, planar_m))),
    }
    values, reasons = _each(computations)
    return Tracking(**values, reasons=reasons)


def demand_metrics(t_s: Series, error_m: Series, torque_n_m: Series | None, saturated: Series) -> Demand:
    """Return overshoot, effort, torque variation and time at the limits of a run.

    A torque holds until the next sample. What is between two samples is not seen: the variation that a firmware's speed
    loop makes faster than the ticks, for one.

    Args:
        t_s: scenario time [s], ascending, shape (n,); rows before t = 0 do not count.
        error_m: truth minus reference, x and y [m], shape (n, 2); NaN where there was no truth.
        torque_n_m: of each wheel, shape (n, 4); None where it cannot be told. Rows in which none was measured, as
            before the first feedback or while the robot is away, are left out of effort and variation.
        saturated: not 0 where a command is at its limit, shape (n,).
    """
    active = t_s >= 0.0
    t_s, error_m, saturated = t_s[active], error_m[active], saturated[active]
    torque_n_m = None if torque_n_m is None else torque_n_m[active]
    values, reasons = _each(
        {
            "overshoot_m": lambda: _overshoot(t_s, error_m),
            "effort_n_m_s": lambda: float(_held_s(t_s) @ np.nansum(np.abs(_torque(t_s, torque_n_m)), axis=1)),
            "torque_variation_n_m_per_s": lambda: _variation(t_s, _torque(t_s, torque_n_m)),
            "saturation_s": lambda: float(_held_s(t_s) @ (saturated != 0.0)),
        }
    )
    return Demand(**values, reasons=reasons)


def signal_figures(
    signals: Mapping[str, Series],
    torque_constant_n_m_a: float | None = None,
    limits: CommandLimits | None = None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the figures that follow from the signals alone, by name, and for each None the reason.

    They are those of ``tracking_metrics`` and ``demand_metrics``, ``estimation_error`` as of ``estimation_metrics``,
    ``ticks``, ``tick_us`` with ``p50`` and ``p99``, and ``deadline_misses``. ``torque_constant_n_m_a`` [N·m/A at the
    wheel] makes torques of the measured currents: in speed mode nothing else tells them. Without ``limits`` only
    what the guard scaled counts as saturated: a law that keeps the limits itself is then never. Raises KeyError for a
    signal that is not there.
    """
    t_s = signals["loop.t_s"]
    tracking = tracking_metrics(t_s, signals["error.planar_m"])
    error_m = np.column_stack([signals["error.x_m"], signals["error.y_m"]])
    current_a = np.column_stack([signals[f"wheel.{wheel}.current_a"] for wheel in WHEEL_NAMES])
    torque_n_m = None if torque_constant_n_m_a is None else torque_constant_n_m_a * current_a
    demand = demand_metrics(t_s, error_m, torque_n_m, _at_limit(signals, limits))
    reasons = tracking.reasons | demand.reasons
    estimation = estimation_metrics(signals)
    if estimation is None:
        reasons["estimation_error"] = "there is no tick with both an estimated and a true pose"
    tick_us = percentiles(signals["loop.tick_us"])
    if tick_us is None:
        reasons["tick_us"] = "the run has fewer than two ticks"
    misses = signals["loop.deadline_misses"]
    figures = {
        **tracking.figures(),
        **demand.figures(),
        "estimation_error": estimation,
        "ticks": len(signals["loop.t_s"]),
        "tick_us": None if tick_us is None else tick_us._asdict(),
        "deadline_misses": int(misses[-1]) if len(misses) else 0,
    }
    return figures, reasons


def estimation_metrics(signals: Mapping[str, Series]) -> dict[str, float] | None:
    """Return how far the pose that the controller acted on was from the truth, over all ticks that have both.

    They are ``rms_m`` and ``max_m`` of the distance, and ``heading_rms_rad``; None where there is no such tick. Raises
    KeyError for a signal that is not there.
    """
    x_m, y_m, heading_rad = (
        signals[f"pose.{name}"] - signals[f"truth.{name}"] for name in ("x_m", "y_m", "heading_rad")
    )
    heading_rad = np.remainder(heading_rad + np.pi, 2 * np.pi) - np.pi
    square_m2 = x_m**2 + y_m**2
    there = np.isfinite(square_m2 + heading_rad) & (signals["loop.t_s"] >= 0.0)
    if not there.any():
        return None
    return {
        "rms_m": float(np.sqrt(np.mean(square_m2[there]))),
        "max_m": float(np.sqrt(np.max(square_m2[there]))),
        "heading_rms_rad": float(np.sqrt(np.mean(heading_rad[there] ** 2))),
    }


def percentiles(series: Series) -> Percentiles | None:
    """Return median and 99th percentile of the values that are there, or None when there are none."""
    there = series[np.isfinite(series)]
    if not len(there):
        return None
    p50, p99 = np.percentile(there, [50.0, 99.0])
    return Percentiles(float(p50), float(p99))


def _each(computations: Mapping[str, Callable[[], float]]) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return each figure by name, None for one without a meaning, and for those the reasons."""
    values: dict[str, float | None] = {}
    reasons: dict[str, str] = {}
    for name, compute in computations.items():
        try:
            values[name] = compute()
        except _NoMeaningError as no_meaning:
            values[name] = None
            reasons[name] = str(no_meaning)
    return values, reasons


def _tracked(t_s: Series, planar_m: Series) -> float:
    _require_truth(t_s, planar_m)
    initial_m = float(planar_m[0])
    if initial_m < RESOLUTION_M:
        raise _NoMeaningError(
            f"the run began {initial_m * 1e3:.3g} mm from the reference: 2 % of less than "
            f"{RESOLUTION_M * 1e3:g} mm says nothing"
        )
    return _settled(t_s, planar_m, TRACKED_RATIO * initial_m)


def _settled(t_s: Series, planar_m: Series, limit_m: float) -> float:
    """Return the first time from which the error stays below a limit, to the end of the run."""
    _require_truth(t_s, planar_m)
    outside = np.flatnonzero(planar_m >= limit_m)
    first = int(outside[-1]) + 1 if len(outside) else 0
    if first == len(t_s):
        raise _NoMeaningError(
            f"the planar error did not stay below {limit_m * 1e3:.3g} mm: it was {planar_m[-1] * 1e3:.3g} mm at the end"
        )
    return float(t_s[first])


def _steady(t_s: Series, planar_m: Series) -> Series:
    """Return the errors of the last 5 s."""
    if len(t_s) < 2:
        raise _NoMeaningError("the run has fewer than two samples")
    # n samples cover n periods; the window's own length must not be refused for half of one.
    period_s = float(np.median(np.diff(t_s)))
    covered_s = float(t_s[-1] - t_s[0]) + period_s
    if covered_s < STEADY_WINDOW_S - period_s / 2:
        raise _NoMeaningError(f"the run lasted {covered_s:.3g} s, less than the window of {STEADY_WINDOW_S:g} s")
    start = int(np.searchsorted(t_s, t_s[-1] - STEADY_WINDOW_S + period_s / 2))
    _require_truth(t_s[start:], planar_m[start:])
    return planar_m[start:]


def _overshoot(t_s: Series, error_m: Series) -> float:
    _require_truth(t_s, np.hypot(error_m[:, 0], error_m[:, 1]))
    initial_m = float(np.hypot(*error_m[0]))
    if initial_m < RESOLUTION_M:
        raise _NoMeaningError(
            f"the run began {initial_m * 1e3:.3g} mm from the reference: less than {RESOLUTION_M * 1e3:g} mm has no "
            "direction in which it could go past it"
        )
    return max(0.0, float(np.max(-error_m @ (error_m[0] / initial_m))))


def _variation(t_s: Series, torque_n_m: Series) -> float:
    if len(t_s) < 2:
        raise _NoMeaningError("the run has fewer than two samples")
    slew_n_m = np.abs(np.diff(torque_n_m, axis=0)).sum(axis=1)
    there = np.isfinite(slew_n_m)
    if not there.any():
        raise _NoMeaningError("no two ticks in a row have measured motor currents")
    return float(slew_n_m[there].sum()) / len(WHEEL_NAMES) / float(np.diff(t_s)[there].sum())


def _at_limit(signals: Mapping[str, Series], limits: CommandLimits | None) -> Series:
    """Return 1 where a wheel is told its limit of speed or, where it is told no speed, of torque."""
    at_limit = signals["guard.saturated"] != 0.0
    if limits is not None:
        speed, torque = (
            np.abs(np.column_stack([signals[f"wheel.{wheel}.{name}"] for wheel in WHEEL_NAMES])).max(axis=1)
            for name in ("speed_command_rad_s", "torque_command_n_m")
        )
        in_speed_mode = np.isfinite(speed)
        at_limit |= np.where(in_speed_mode, speed / limits.speed_rad_s, torque / limits.torque_n_m) >= AT_LIMIT
    return np.asarray(at_limit, dtype=np.float64)


def _held_s(t_s: Series) -> Series:
    """Return for how long each sample holds; nobody tells how long the last one does."""
    if len(t_s) < 2:
        raise _NoMeaningError("the run has fewer than two samples")
    return np.append(np.diff(t_s), 0.0)


def _torque(t_s: Series, torque_n_m: Series | None) -> Series:
    """Return the torques; a row of NaN is one in which the robot was not heard: before its first feedback, or away."""
    if torque_n_m is None:
        raise _NoMeaningError("nothing says which torque the motors make of a current")
    measured = np.isfinite(torque_n_m)
    gaps = np.flatnonzero(measured.any(axis=1) & ~measured.all(axis=1))
    if not measured.any():
        raise _NoMeaningError("the robot measured no motor currents")
    if len(gaps):
        raise _NoMeaningError(f"the motor currents are missing at t = {t_s[gaps[0]]:.6g} s")
    return torque_n_m


def _require_truth(t_s: Series, planar_m: Series) -> None:
    if not len(t_s):
        raise _NoMeaningError("the run has no samples")
    gaps = np.flatnonzero(~np.isfinite(planar_m))
    if len(gaps) == len(planar_m):
        raise _NoMeaningError("the run has no ground truth")
    if len(gaps):
        raise _NoMeaningError(f"the ground truth is missing at t = {t_s[gaps[0]]:.6g} s")
