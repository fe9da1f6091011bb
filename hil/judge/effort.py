"""Overshoot, control effort, torque variation and saturation of a run."""

from collections.abc import Mapping
from functools import reduce

import numpy as np

from hil.core.errors import apart
from hil.core.types import WHEEL_NAMES
from hil.judge.measure import RESOLUTION_M, Figure, Measure, NoFigureError, RunSetup, Series, TruthGaps, since_start

AT_LIMIT = 0.999
"""A command counts as at its limit from this share of it on, because codecs and rounding reduce it slightly."""
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)


class Overshoot(Measure):
    """How far the position error went past zero, along the line on which it began.

    That is the largest -e(t)·e(0)/|e(0)|, at least 0, with e = (x, y) of truth minus reference.
    """

    figures = (
        Figure("overshoot_m", "overshoot", "mm", 1e3, "how far past the reference, along the line of the initial error",
               column="overshoot_m", resolution=1e-4),
    )  # fmt: skip
    signals = ("loop.t_s", "error.x_m", "error.y_m")

    def __init__(self, _setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._gaps = TruthGaps()
        self._initial_m: float | None = None
        self._direction = np.zeros(2)
        self._overshoot_m = 0.0

    def add(self, signals: Mapping[str, Series]) -> None:
        begun = since_start(signals)
        t_s = begun["loop.t_s"]
        if not len(t_s):
            return
        error_m = np.column_stack([begun["error.x_m"], begun["error.y_m"]])
        if self._initial_m is None:
            self._initial_m = float(np.hypot(*error_m[0]))
            if self._initial_m >= RESOLUTION_M:
                self._direction = error_m[0] / self._initial_m
        self._gaps.add(t_s, error_m.sum(axis=1))
        self._overshoot_m = max(self._overshoot_m, float(np.max(-error_m @ self._direction)))

    def value(self, _name: str) -> float:
        self._gaps.require_truth()
        if self._initial_m is not None and self._initial_m < RESOLUTION_M:
            began_mm = apart(self._initial_m * 1e3, RESOLUTION_M * 1e3)
            raise NoFigureError(
                f"the run began {began_mm} mm from the reference: less than {RESOLUTION_M * 1e3:g} mm "
                "has no direction in which it could go past it"
            )
        return self._overshoot_m


class _Held:
    """Pairs each row with the time until the next one: a value holds until the next row.

    The newest row is kept until rows follow it, because its duration is not known before.
    """

    def __init__(self) -> None:
        self._last: tuple[Series, Series] | None = None
        self.spans = 0

    def add(self, t_s: Series, values: Series) -> tuple[Series, Series]:
        """Add times of shape (n,) and values of shape (n, ...).

        Returns the durations [s] of all rows but the newest, shape (m,), and the values of all rows, shape (m + 1,
        ...), beginning with the row kept before.
        """
        if self._last is not None:
            t_s, values = (np.concatenate(both) for both in zip(self._last, (t_s, values), strict=True))
        self._last = (t_s[-1:], values[-1:])
        held_s = np.diff(t_s)
        self.spans += len(held_s)
        return held_s, values

    def require_spans(self) -> None:
        """Raise NoFigureError for fewer than two rows."""
        if not self.spans:
            raise NoFigureError("the run has fewer than two samples")


class Effort(Measure):
    """Control effort and torque variation of the four wheels, from the measured motor currents.

    Effort is ∫ Σ|τ| dt. Variation is the mean absolute slew of a wheel's torque: the total variation Σ|τ(t + T) - τ(t)|
    over the time that it took, mean of the four wheels. Changes between two rows are not seen, such as those by a
    firmware's speed loop, which is faster than the ticks. Rows without any measured current, as before the first
    feedback or while the link is lost, are left out.
    """

    figures = (
        Figure("effort_n_m_s", "effort", "N·m·s", 1.0, "∫ Σ abs(τ) dt over the four wheels, by the measured currents",
               column="effort_n_m_s", resolution=0.01),
        Figure("torque_variation_n_m_per_s", "torque variation", "N·m/s a wheel", 1.0,
               "mean absolute slew of a wheel's torque", column="torque_variation_n_m_per_s", resolution=0.01),
    )  # fmt: skip
    signals = ("loop.t_s", *_CURRENTS)

    def __init__(self, setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._torque_constant_n_m_a = setup.torque_constant_n_m_a
        self._held = _Held()
        self._measured = False
        self._gap_s: float | None = None
        self._effort_n_m_s = 0.0
        self._slew_n_m = 0.0
        self._slewed_s = 0.0

    def add(self, signals: Mapping[str, Series]) -> None:
        begun = since_start(signals)
        t_s = begun["loop.t_s"]
        if not len(t_s) or self._torque_constant_n_m_a is None:
            return
        torque_n_m = self._torque_constant_n_m_a * np.column_stack([begun[name] for name in _CURRENTS])
        # Sums over four columns: a matrix product takes a fifth of the time.
        ones = np.ones(torque_n_m.shape[1])
        measured = np.isfinite(torque_n_m) @ ones
        self._measured |= bool(measured.any())
        gaps = np.flatnonzero((measured > 0.0) & (measured < len(ones)))
        if len(gaps) and self._gap_s is None:
            self._gap_s = float(t_s[gaps[0]])
        held_s, torque_n_m = self._held.add(t_s, torque_n_m)
        sizes_n_m = np.abs(torque_n_m[:-1]) @ ones
        there = np.isfinite(sizes_n_m)
        self._effort_n_m_s += float(held_s[there] @ sizes_n_m[there])
        slew_n_m = np.abs(np.diff(torque_n_m, axis=0)) @ ones
        there = np.isfinite(slew_n_m)
        self._slew_n_m += float(slew_n_m[there].sum())
        self._slewed_s += float(held_s[there].sum())

    def value(self, name: str) -> float:
        if self._torque_constant_n_m_a is None:
            raise NoFigureError("the torque constant of the motors is not known")
        self._held.require_spans()
        if not self._measured:
            raise NoFigureError("the robot measured no motor currents")
        if self._gap_s is not None:
            raise NoFigureError(f"the motor currents are missing at t = {self._gap_s:.6g} s")
        if name == "effort_n_m_s":
            return self._effort_n_m_s
        if not self._slewed_s:
            raise NoFigureError("no two ticks in a row have measured motor currents")
        return self._slew_n_m / len(WHEEL_NAMES) / self._slewed_s


class Saturation(Measure):
    """For how long in all a wheel's command was at its limit, whether the guard or the law kept it there.

    Without known limits only ticks in which the guard scaled the command count.
    """

    figures = (
        Figure("saturation_s", "saturated for", "s", 1.0, "how long a wheel's command was at its limit",
               column="saturation_s", resolution=0.005, resolution_ticks=1),
    )  # fmt: skip
    signals = (
        "loop.t_s",
        "guard.saturated",
        *(f"wheel.{wheel}.{name}" for wheel in WHEEL_NAMES for name in ("speed_command_rad_s", "torque_command_n_m")),
    )

    def __init__(self, setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._limits = setup.limits
        self._held = _Held()
        self._saturation_s = 0.0

    def add(self, signals: Mapping[str, Series]) -> None:
        begun = since_start(signals)
        if len(begun["loop.t_s"]):
            held_s, at_limit = self._held.add(begun["loop.t_s"], self._at_limit(begun))
            self._saturation_s += float(held_s @ at_limit[:-1])

    def value(self, _name: str) -> float:
        self._held.require_spans()
        return self._saturation_s

    def _at_limit(self, signals: Mapping[str, Series]) -> Series:
        """Return 1 for each row in which a wheel is commanded its limit of speed or, without a speed, of torque."""
        at_limit = signals["guard.saturated"] != 0.0
        if self._limits is not None:
            speed, torque = (
                reduce(np.maximum, [np.abs(signals[f"wheel.{wheel}.{name}"]) for wheel in WHEEL_NAMES])
                for name in ("speed_command_rad_s", "torque_command_n_m")
            )
            share = np.where(np.isfinite(speed), speed / self._limits.speed_rad_s, torque / self._limits.torque_n_m)
            at_limit |= share >= AT_LIMIT
        return np.asarray(at_limit, dtype=np.float64)


class Taken(Measure):
    """What the limiter of motion took from the law's torques: ∫ Σ|τ| dt over the four wheels."""

    figures = (
        Figure("taken_n_m_s", "torque taken", "N·m·s", 1.0, "∫ Σ abs(τ) dt that limits of motion took from commands",
               printed=False, resolution=0.01),
    )  # fmt: skip
    signals = ("loop.t_s", "guard.taken_n_m")

    def __init__(self, _setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._held = _Held()
        self._taken_n_m_s = 0.0

    def add(self, signals: Mapping[str, Series]) -> None:
        begun = since_start(signals)
        if len(begun["loop.t_s"]):
            held_s, taken_n_m = self._held.add(begun["loop.t_s"], begun["guard.taken_n_m"])
            self._taken_n_m_s += float(held_s @ taken_n_m[:-1])

    def value(self, _name: str) -> float:
        self._held.require_spans()
        return self._taken_n_m_s
