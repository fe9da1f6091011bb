"""The figures of a run from its signals alone: a run and a review compute them alike.

Pure: NumPy arrays in, plain numbers out. A figure that has no meaning for a run is None, with a reason. All of them are
made from blocks of rows that are not kept, so that a run of hours needs no more memory than one of minutes.
"""

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.samples import Samples
from hil.core.types import WHEEL_NAMES
from hil.judge.demand import DemandSoFar
from hil.judge.tracking import TrackingSoFar

Series = npt.NDArray[np.float64]

BLOCK_ROWS = 1024
"""Rows that are taken at once: sums are the same, to the last bit, only with the same blocks."""
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


class CommandLimits(NamedTuple):
    """What the scenario's ``[robot]`` allows one wheel to be told, in SPEED mode [rad/s] and in TORQUE mode [N·m]."""

    speed_rad_s: float
    torque_n_m: float


class EstimationSoFar:
    """How far the pose that the controller acted on was from the truth, over all ticks that have both."""

    def __init__(self) -> None:
        self._there = 0
        self._square_m2 = 0.0
        self._largest_m2 = 0.0
        self._square_rad2 = 0.0

    def take(self, signals: Mapping[str, Series]) -> None:
        """Take rows. Raises KeyError for a signal that is not there."""
        x_m, y_m, heading_rad = (
            signals[f"pose.{name}"] - signals[f"truth.{name}"] for name in ("x_m", "y_m", "heading_rad")
        )
        heading_rad = np.remainder(heading_rad + np.pi, 2 * np.pi) - np.pi
        square_m2 = x_m**2 + y_m**2
        there = np.isfinite(square_m2 + heading_rad) & (signals["loop.t_s"] >= 0.0)
        if there.any():
            self._there += int(np.count_nonzero(there))
            self._square_m2 += float(square_m2[there].sum())
            self._largest_m2 = max(self._largest_m2, float(square_m2[there].max()))
            self._square_rad2 += float((heading_rad[there] ** 2).sum())

    def figures(self) -> dict[str, float] | None:
        """Return ``rms_m`` and ``max_m`` of the distance, and ``heading_rms_rad``; None where no tick has both."""
        if not self._there:
            return None
        return {
            "rms_m": float(np.sqrt(self._square_m2 / self._there)),
            "max_m": float(np.sqrt(self._largest_m2)),
            "heading_rms_rad": float(np.sqrt(self._square_rad2 / self._there)),
        }


class SignalFigures:
    """The figures that follow from the signals alone.

    They are those of ``Tracking`` and ``Demand``, ``estimation_error`` as of ``EstimationSoFar``, ``ticks``,
    ``tick_us`` with ``p50`` and ``p99``, and ``deadline_misses``. ``torque_constant_n_m_a`` [N·m/A at the wheel] makes
    torques of the measured currents: in speed mode nothing else tells them. Without ``limits`` only what the guard
    scaled counts as saturated: a law that keeps the limits itself is then never.
    """

    def __init__(self, torque_constant_n_m_a: float | None = None, limits: CommandLimits | None = None) -> None:
        self._torque_constant_n_m_a = torque_constant_n_m_a
        self._limits = limits
        self._tracking = TrackingSoFar()
        self._demand = DemandSoFar()
        self._estimation = EstimationSoFar()
        self._tick_us = Samples()
        self._ticks = 0
        self._misses = 0

    def take(self, signals: Mapping[str, Series]) -> Iterator[None]:
        """Take the next rows by the names of ``FIGURE_SIGNALS``, each of shape (n,), in a few steps of like length.

        Raises KeyError for a signal that is not there.
        """
        t_s = signals["loop.t_s"]
        self._tracking.take(t_s, signals["error.planar_m"])
        yield
        saturated = _at_limit(signals, self._limits)
        yield
        error_m = np.column_stack([signals["error.x_m"], signals["error.y_m"]])
        torque_n_m = None
        if self._torque_constant_n_m_a is not None:
            current_a = np.column_stack([signals[f"wheel.{wheel}.current_a"] for wheel in WHEEL_NAMES])
            torque_n_m = self._torque_constant_n_m_a * current_a
        yield
        self._demand.take(t_s, error_m, torque_n_m, saturated)
        yield
        self._estimation.take(signals)
        yield
        self._tick_us.take(signals["loop.tick_us"])
        misses = signals["loop.deadline_misses"]
        self._ticks += len(t_s)
        self._misses = int(misses[-1]) if len(misses) else self._misses

    def figures(self, cut: str | None = None) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the figures by name, and for each None the reason.

        ``cut`` says when and of how much a run ended before its time: those of its end are then None.
        """
        tracking, demand = self._tracking.tracking(cut), self._demand.demand()
        reasons = tracking.reasons | demand.reasons
        estimation = self._estimation.figures()
        if estimation is None:
            reasons["estimation_error"] = "there is no tick with both an estimated and a true pose"
        tick_us = self._tick_us.percentiles()
        if tick_us is None:
            reasons["tick_us"] = "the run has fewer than two ticks"
        figures = {
            **tracking.figures(),
            **demand.figures(),
            "estimation_error": estimation,
            "ticks": self._ticks,
            "tick_us": None if tick_us is None else tick_us._asdict(),
            "deadline_misses": self._misses,
        }
        return figures, reasons


def signal_figures(
    signals: Mapping[str, Series],
    torque_constant_n_m_a: float | None = None,
    limits: CommandLimits | None = None,
    cut: str | None = None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the figures of a whole run at once, see ``SignalFigures``. Raises KeyError for a missing signal."""
    so_far = SignalFigures(torque_constant_n_m_a, limits)
    needed = {name for names in FIGURE_SIGNALS.values() for name in names} & signals.keys()
    for start in range(0, len(signals["loop.t_s"]), BLOCK_ROWS):
        for _ in so_far.take({name: signals[name][start : start + BLOCK_ROWS] for name in needed}):
            pass
    return so_far.figures(cut)


def cut_words(t_s: float, duration_s: float | None) -> str:
    """Return the reason why a run that ended before its time, where that is known, has no figures of its end."""
    whole = "" if duration_s is None else f" of {duration_s:g} s"
    return f"there is nothing after t = {t_s:.6g} s{whole}, and this is a figure of the run's end"


def _at_limit(signals: Mapping[str, Series], limits: CommandLimits | None) -> Series:
    """Return 1 where a wheel is told its limit of speed or, where it is told no speed, of torque."""
    at_limit = signals["guard.saturated"] != 0.0
    if limits is not None:
        speed, torque = (
            reduce(np.maximum, [np.abs(signals[f"wheel.{wheel}.{name}"]) for wheel in WHEEL_NAMES])
            for name in ("speed_command_rad_s", "torque_command_n_m")
        )
        in_speed_mode = np.isfinite(speed)
        at_limit |= np.where(in_speed_mode, speed / limits.speed_rad_s, torque / limits.torque_n_m) >= AT_LIMIT
    return np.asarray(at_limit, dtype=np.float64)
