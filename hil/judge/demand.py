"""How far a run went past the reference, and what it took from the motors: figures from blocks of rows."""

from typing import NamedTuple

import numpy as np

from hil.core.types import WHEEL_NAMES
from hil.judge.so_far import RESOLUTION_M, NoMeaningError, Series, TruthGaps, figures_or_reasons


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


class DemandSoFar:
    """Overshoot, effort, torque variation and time at the limits of the rows that were taken.

    A torque holds until the next sample. What is between two samples is not seen: the variation that a firmware's speed
    loop makes faster than the ticks, for one.
    """

    def __init__(self) -> None:
        self._gaps = TruthGaps()
        self._initial_m = 0.0
        self._direction = np.zeros(2)
        self._overshoot_m = 0.0
        self._knows_torque = True
        self._measured = False
        self._torque_gap_s: float | None = None
        self._last: tuple[Series, Series, Series] | None = None  # the newest row: nobody tells yet how long it holds
        self._spans = 0
        self._effort_n_m_s = 0.0
        self._saturation_s = 0.0
        self._slew_n_m = 0.0
        self._slewed_s = 0.0

    def take(self, t_s: Series, error_m: Series, torque_n_m: Series | None, saturated: Series) -> None:
        """Take rows; those before t = 0 do not count.

        Args:
            t_s: scenario time [s], ascending, after that of the rows before, shape (n,).
            error_m: truth minus reference, x and y [m], shape (n, 2); NaN where there was no truth.
            torque_n_m: of each wheel, shape (n, 4); None where it cannot be told. Rows in which none was measured, as
                before the first feedback or while the robot is away, are left out of effort and variation.
            saturated: not 0 where a command is at its limit, shape (n,).
        """
        active = t_s >= 0.0
        self._knows_torque = torque_n_m is not None
        torque_n_m = np.full((len(t_s), 1), np.nan) if torque_n_m is None else torque_n_m
        t_s, error_m, torque_n_m, saturated = (series[active] for series in (t_s, error_m, torque_n_m, saturated))
        if not len(t_s):
            return
        self._take_errors(t_s, error_m)
        # Sums over four columns: as a product they cost a fifth.
        each = np.ones(torque_n_m.shape[1])
        measured = np.isfinite(torque_n_m) @ each
        self._measured |= bool(measured.any())
        gaps = np.flatnonzero((measured > 0.0) & (measured < len(each)))
        if len(gaps) and self._torque_gap_s is None:
            self._torque_gap_s = float(t_s[gaps[0]])
        rows = (t_s, torque_n_m, saturated)
        if self._last is not None:
            rows = tuple(np.concatenate(both) for both in zip(self._last, rows, strict=True))  # type: ignore[assignment]
        t_s, torque_n_m, saturated = rows
        self._last = (t_s[-1:], torque_n_m[-1:], saturated[-1:])
        held_s = np.diff(t_s)
        self._spans += len(held_s)
        sizes_n_m = np.abs(torque_n_m[:-1]) @ each
        there = np.isfinite(sizes_n_m)
        self._effort_n_m_s += float(held_s[there] @ sizes_n_m[there])
        self._saturation_s += float(held_s @ (saturated[:-1] != 0.0))
        slew_n_m = np.abs(np.diff(torque_n_m, axis=0)) @ each
        there = np.isfinite(slew_n_m)
        self._slew_n_m += float(slew_n_m[there].sum())
        self._slewed_s += float(held_s[there].sum())

    def demand(self) -> Demand:
        """Return the figures."""
        values, reasons = figures_or_reasons(
            {
                "overshoot_m": self._overshoot,
                "effort_n_m_s": self._effort,
                "torque_variation_n_m_per_s": self._variation,
                "saturation_s": self._saturation,
            }
        )
        return Demand(**values, reasons=reasons)

    def _take_errors(self, t_s: Series, error_m: Series) -> None:
        if self._last is None:
            self._initial_m = float(np.hypot(*error_m[0]))
            if self._initial_m >= RESOLUTION_M:
                self._direction = error_m[0] / self._initial_m
        self._gaps.take(t_s, error_m.sum(axis=1))
        past_m = -error_m @ self._direction
        self._overshoot_m = max(self._overshoot_m, float(np.max(past_m)))

    def _overshoot(self) -> float:
        self._gaps.require_truth()
        if self._initial_m < RESOLUTION_M:
            raise NoMeaningError(
                f"the run began {self._initial_m * 1e3:.3g} mm from the reference: less than {RESOLUTION_M * 1e3:g} mm "
                "has no direction in which it could go past it"
            )
        return self._overshoot_m

    def _effort(self) -> float:
        self._require_spans()
        self._require_torque()
        return self._effort_n_m_s

    def _variation(self) -> float:
        self._require_torque()
        self._require_spans()
        if not self._slewed_s:
            raise NoMeaningError("no two ticks in a row have measured motor currents")
        return self._slew_n_m / len(WHEEL_NAMES) / self._slewed_s

    def _saturation(self) -> float:
        self._require_spans()
        return self._saturation_s

    def _require_spans(self) -> None:
        if not self._spans:
            raise NoMeaningError("the run has fewer than two samples")

    def _require_torque(self) -> None:
        """A row of NaN is one in which the robot was not heard: before its first feedback, or away."""
        if not self._knows_torque:
            raise NoMeaningError("nothing says which torque the motors make of a current")
        if not self._measured:
            raise NoMeaningError("the robot measured no motor currents")
        if self._torque_gap_s is not None:
            raise NoMeaningError(f"the motor currents are missing at t = {self._torque_gap_s:.6g} s")
