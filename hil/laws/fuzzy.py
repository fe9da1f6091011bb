"""The paper's fuzzy tuner: gains K1 and K2 of one axis from its tracking error and the error's rate.

Nguyen Minh et al. 2023, AFDSC, section III.B: five triangular sets an input (table I), singleton outputs
(table II), rules of tables III and IV. The sets overlap so that the memberships of an input add up to 1;
product inference with weighted average is then bilinear interpolation in the table of outputs, and that is
how it is computed.

The paper's text does not give the ranges of the inputs: they are parameters.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from hil.core.options import Range
from hil.core.types import NAN, Pairs
from hil.laws.surface import SurfaceLaw

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Tables = Literal["printed", "corrected"]
Rules = tuple[tuple[str, ...], ...]

K1_1_S = {"VS": 3.0, "S": 5.0, "M": 10.0, "B": 12.0, "VB": 15.0}
K2_1_S = {"VS": 10.0, "S": 15.0, "M": 20.0, "B": 30.0, "VB": 40.0}
"""Table II: output levels [1/s]."""

# Tables III and IV as printed: rows are the error's rate, columns the error, each from NB to PB.
_K1_PRINTED = ("M  S  VS S  M ", "B  M  S  M  B ", "VS B  M  B  VS", "B  M  S  M  B ", "M  S  VS S  M ")
_K2_PRINTED = ("M  B  VB B  M ", "S  M  B  M  S ", "VB S  M  S  VB", "S  M  B  M  S ", "M  B  VB B  M ")
# Everywhere but at a big error with rate zero, the level of K1 rises with the size of the error and falls
# with that of the rate, and K2's does the opposite. There the print has VS and VB the other way round.
_K1_CORRECTED = (*_K1_PRINTED[:2], "VB B  M  B  VB", *_K1_PRINTED[3:])
_K2_CORRECTED = (*_K2_PRINTED[:2], "VS S  M  S  VS", *_K2_PRINTED[3:])


def _rules(table: tuple[str, ...]) -> Rules:
    return tuple(tuple(row.split()) for row in table)


RULES: dict[Tables, tuple[Rules, Rules]] = {
    "printed": (_rules(_K1_PRINTED), _rules(_K2_PRINTED)),
    "corrected": (_rules(_K1_CORRECTED), _rules(_K2_CORRECTED)),
}
"""Rules for K1 and for K2: names of levels, [rate][error]."""

Cell = tuple[float, float, float, float, float, float, float, float]


FIRING = ("error", "rate", "rule", "degree")
"""Names of the four values that ``FuzzyBlock.firing`` returns."""


@dataclass(frozen=True, slots=True)
class FuzzyBlock:
    """The tuner of one axis.

    ``error_range`` and ``rate_range`` (in the units of the axis, greater than zero) are where NB and PB peak. Beyond
    them the inputs saturate. The other sets peak at half the range and at zero.
    """

    error_range: float
    rate_range: float
    k1_1_s: tuple[float, ...]
    """25 outputs for K1, row by row (rate), each row from error NB to PB."""
    k2_1_s: tuple[float, ...]
    _sets_an_error: float = field(init=False, repr=False, compare=False)
    _sets_a_rate: float = field(init=False, repr=False, compare=False)
    _cells: tuple[Cell, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_sets_an_error", 2.0 / self.error_range)
        object.__setattr__(self, "_sets_a_rate", 2.0 / self.rate_range)
        object.__setattr__(self, "_cells", _cells_of(self.k1_1_s, self.k2_1_s))

    @classmethod
    def from_tables(cls, tables: Tables, error_range: float, rate_range: float) -> "FuzzyBlock":
        """Return the block with the paper's tables as printed, or corrected."""
        k1_rules, k2_rules = RULES[tables]
        return cls(
            error_range,
            rate_range,
            tuple(K1_1_S[level] for row in k1_rules for level in row),
            tuple(K2_1_S[level] for row in k2_rules for level in row),
        )

    def gains(self, error: float, rate: float) -> tuple[float, float]:
        """Return (K1, K2) [1/s] at an error and its rate. NaN counts as NB: the gains are always finite."""
        p = self._sets_an_error * error + 2.0
        q = self._sets_a_rate * rate + 2.0
        # The cell of the table, found by comparisons because they cost less than int(). PB belongs to the last cell.
        if p >= 3.0:
            cell = 3
            if p > 4.0:
                p = 4.0
        elif p >= 2.0:
            cell = 2
        elif p >= 1.0:
            cell = 1
        else:
            cell = 0
            if not p > 0.0:
                p = 0.0
        if q >= 3.0:
            cell += 12
            if q > 4.0:
                q = 4.0
        elif q >= 2.0:
            cell += 8
        elif q >= 1.0:
            cell += 4
        elif not q > 0.0:
            q = 0.0
        a, b, c, d, e, f, g, h = self._cells[cell]
        return a + b * p + q * (c + d * p), e + f * p + q * (g + h * p)

    def firing(self, error: float, rate: float) -> tuple[float, float, float, float]:
        """Return the state of the inference at an error and its rate (``FIRING``). NaN counts as NB.

        The first two values locate error and rate among the sets: -2 is NB, 0 is Z, 2 is PB, and a value in between
        belongs to both neighbours, more to the nearer one. The third is the strongest rule: 5 times the row (rate)
        plus the column (error) of tables III and IV, 0 to 24. The fourth is that rule's degree, the product of its
        two memberships, 0.25 to 1.
        """
        p = self._sets_an_error * error + 2.0
        q = self._sets_a_rate * rate + 2.0
        p = 4.0 if p >= 4.0 else p if p > 0.0 else 0.0
        q = 4.0 if q >= 4.0 else q if q > 0.0 else 0.0
        # Whole numbers as floats: mixing int and float costs twice as much.
        column, row = (p + 0.5) // 1.0, (q + 0.5) // 1.0
        return p - 2.0, q - 2.0, 5.0 * row + column, (1.0 - abs(p - column)) * (1.0 - abs(q - row))

    def gains_batch(
        self, error: "NDArray[np.float64]", rate: "NDArray[np.float64]"
    ) -> "tuple[NDArray[np.float64], NDArray[np.float64]]":
        """Return (K1, K2) [1/s] for arrays that broadcast together, for plots and sweeps. NaN counts as NB."""
        import numpy as np

        # fmax comes first because it turns NaN into -2.
        p = np.fmin(np.fmax(self._sets_an_error * np.asarray(error), -2.0), 2.0) + 2.0
        q = np.fmin(np.fmax(self._sets_a_rate * np.asarray(rate), -2.0), 2.0) + 2.0
        i, j = np.minimum(p.astype(np.intp), 3), np.minimum(q.astype(np.intp), 3)
        a, b, c, d, e, f, g, h = np.moveaxis(np.array(self._cells)[4 * j + i], -1, 0)
        return a + b * p + q * (c + d * p), e + f * p + q * (g + h * p)


def _cells_of(k1_1_s: tuple[float, ...], k2_1_s: tuple[float, ...]) -> tuple[Cell, ...]:
    """Return the 16 cells between the peaks, row by row; in each K = a + b p + c q + d p q with p and q from 0 to 4."""
    return tuple((*_cell(k1_1_s, i, j), *_cell(k2_1_s, i, j)) for j in range(4) for i in range(4))


def _cell(outputs: tuple[float, ...], i: int, j: int) -> tuple[float, float, float, float]:
    """Return a, b, c and d of the cell whose near corner is the output of error ``i`` and rate ``j``."""
    n = 5 * j + i
    near, along, across, far = outputs[n], outputs[n + 1], outputs[n + 5], outputs[n + 6]
    b, c, d = along - near, across - near, near - along - across + far
    return near - b * i - c * j + d * i * j, b - d * j, c - d * i, d


@dataclass(frozen=True, slots=True)
class FuzzyRanges:
    """Ranges of the fuzzy inputs: where the sets NB and PB peak. x and y share one pair, the heading has its own."""

    error_range_m: Annotated[float, Range(gt=0, le=1000)] = 0.2
    error_rate_range_m_s: Annotated[float, Range(gt=0, le=1000)] = 0.7
    heading_error_range_rad: Annotated[float, Range(gt=0, le=100)] = 0.8
    heading_rate_range_rad_s: Annotated[float, Range(gt=0, le=1000)] = 4.0


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


class FuzzyLaw(SurfaceLaw):
    """Base of a law whose gains come from ``FuzzyGains`` at every tick. Its signals are those of ``FuzzyGains``."""

    signals = FuzzyGains.signals
    _tuner: FuzzyGains

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Values of ``signals``."""
        return self._tuner.telemetry

    def _gains_at(self, error: Pairs) -> Pairs:
        return self._tuner.at(error)
