"""Fuzzy gains of all three axes, shared by AFDSC and its variants."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.options import POSITIVE
from hil.core.types import NAN, NO_GAINS, CommandMode, Gains, Pairs, make_gains
from hil.laws.fuzzy import FIRING, FuzzyBlock, Tables
from hil.laws.surface import without_k2


@dataclass(frozen=True, slots=True)
class FuzzyRanges:
    """Ranges of the fuzzy inputs: where the sets NB and PB peak. x and y share one pair, the heading has its own."""

    error_range_m: Annotated[float, POSITIVE] = 0.2
    error_rate_range_m_s: Annotated[float, POSITIVE] = 0.7
    heading_error_range_rad: Annotated[float, POSITIVE] = 0.8
    heading_rate_range_rad_s: Annotated[float, POSITIVE] = 4.0


class FuzzyGains:
    """One fuzzy block per axis. Its own signals are those of ``hil.laws.fuzzy.FuzzyBlock.firing`` for each axis."""

    __slots__ = ("_error", "_heading", "_planar")

    signals = tuple(f"fuzzy.{axis}.{name}" for axis in ("x", "y", "heading") for name in FIRING)

    def __init__(self, tables: Tables, ranges: FuzzyRanges) -> None:
        self._planar = FuzzyBlock.from_tables(tables, ranges.error_range_m, ranges.error_rate_range_m_s)
        self._heading = FuzzyBlock.from_tables(tables, ranges.heading_error_range_rad, ranges.heading_rate_range_rad_s)
        self._error: Pairs | None = None

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Values of ``signals`` at the error of the last gains; NaN before the first."""
        if self._error is None:
            return (NAN,) * len(self.signals)
        x, y, heading, vx, vy, yaw_rate = self._error
        firing = self._planar.firing
        return firing(x, vx) + firing(y, vy) + self._heading.firing(heading, yaw_rate)

    def at(self, error: Pairs) -> Pairs:
        """Return K1 and K2 [1/s] at this error and its rate."""
        self._error = error
        x, y, heading, vx, vy, yaw_rate = error
        k1_x, k2_x = self._planar.gains(x, vx)
        k1_y, k2_y = self._planar.gains(y, vy)
        k1_heading, k2_heading = self._heading.gains(heading, yaw_rate)
        return k1_x, k1_y, k1_heading, k2_x, k2_y, k2_heading


class FuzzyLaw:
    """Base of a law whose gains come from ``FuzzyGains`` at every tick; it offers them as signals."""

    signals = FuzzyGains.signals

    def __init__(self, mode: CommandMode, tables: Tables, ranges: FuzzyRanges) -> None:
        self._torque = mode is CommandMode.TORQUE
        self._tuner = FuzzyGains(tables, ranges)
        self._last: Pairs = NO_GAINS

    @property
    def gains(self) -> Gains:
        """Gains of the last update. In SPEED mode K2 is not in force and NaN."""
        gains = make_gains(self._last)
        return gains if self._torque else without_k2(gains)

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Values of ``signals``."""
        return self._tuner.telemetry
