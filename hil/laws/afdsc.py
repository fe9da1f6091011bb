"""AFDSC, dynamic surface control with fuzzy gains: K1 and K2 of one axis from its tracking error and the error's rate.

Nguyen Minh et al. 2023, AFDSC, section III.B: five triangular sets an input (table I), singleton outputs
(table II), rules of tables III and IV. The memberships of an input add up to 1. So product inference with
weighted average equals bilinear interpolation in the table of outputs, and that is how it is computed.

The paper's text does not give the ranges of the inputs: they are parameters.
"""

import itertools
from array import array
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from firmware_protocol.built import BuildError
from firmware_protocol.extension import wheel
from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.options import Range
from hil.core.types import CommandMode
from hil.laws.surface import SurfaceLaw

Tables = Literal["printed", "corrected"]
Rules = tuple[tuple[str, ...], ...]

K1_1_S = {"VS": 3.0, "S": 5.0, "M": 10.0, "B": 12.0, "VB": 15.0}
K2_1_S = {"VS": 10.0, "S": 15.0, "M": 20.0, "B": 30.0, "VB": 40.0}  # Table II: output levels [1/s]

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

FIRING = ("error", "rate", "rule", "degree")
"""Names of the four values that ``FuzzyGains.firing`` returns for each block."""


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

    @property
    def table(self) -> tuple[float, ...]:
        """The numbers of ``wheel.Tables``: 2 cells are a range; in each K = a + b p + c q + d p q, p and q 0 to 4."""
        cells = [(*_cell(self.k1_1_s, i, j), *_cell(self.k2_1_s, i, j)) for j in range(4) for i in range(4)]
        return (2.0 / self.error_range, 2.0 / self.rate_range, *itertools.chain(*cells))

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
    """Fuzzy blocks, such as one per axis. They are looked up in the host library, because it costs a tenth there.

    Attributes:
        at: returns (K1, ..., K2, ...) [1/s] at the errors of all blocks, followed by their rates. NaN counts as NB: the
            gains are always finite.
        firing: returns ``FIRING`` of each block, at the inputs of the last gains; NaN before the first. The first two
            values locate error and rate among the sets: -2 is NB, 0 is Z, 2 is PB, and a value in between belongs to
            both neighbours, more to the nearer one. The third is the strongest rule: 5 times the row (rate) plus the
            column (error) of tables III and IV, 0 to 24. The fourth is that rule's degree, the product of its two
            memberships, 0.25 to 1.

    Raises BadInputError when the library cannot be loaded.
    """

    def __init__(self, *blocks: FuzzyBlock) -> None:
        try:
            tables = wheel.Tables(array("d", itertools.chain(*(block.table for block in blocks))).tobytes())
        except BuildError as error:
            raise BadInputError(str(error)) from error
        self.at, self.firing = tables.look_up, tables.nearest


class FuzzyLaw(SurfaceLaw):
    """Base of a law whose gains come from one fuzzy block per axis at every tick. It records ``FIRING`` of each."""

    signals = tuple(f"fuzzy.{axis}.{name}" for axis in ("x", "y", "heading") for name in FIRING)

    def _tune(self, tables: Tables, ranges: FuzzyRanges) -> None:
        """Set the blocks; x and y share one."""
        planar = FuzzyBlock.from_tables(tables, ranges.error_range_m, ranges.error_rate_range_m_s)
        heading = FuzzyBlock.from_tables(tables, ranges.heading_error_range_rad, ranges.heading_rate_range_rad_s)
        gains = FuzzyGains(planar, planar, heading)
        self._gains_at, self._firing = gains.at, gains.firing

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Values of ``signals``."""
        return self._firing()


class Afdsc(FuzzyLaw):
    """Adaptive fuzzy dynamic surface control: DSC with fuzzy gains, by the paper's tables as printed.

    One fuzzy block per axis sets the gains at every tick: K1 from 3 to 15 1/s and K2 from 10 to 40 1/s. SPEED mode
    uses K1 alone.
    """

    tables: ClassVar[Tables] = "printed"

    @dataclass(frozen=True, slots=True)
    class Options(FuzzyRanges):
        """The ranges of the fuzzy inputs, and the filter's time constant ς [s].

        The paper's text gives none of them. ς is that of ``Dsc``. The defaults suit a start about 0.3 m and 0.8 rad
        away. With the default ς the convergence time hardly depends on the ranges, as long as the range of the rate is
        more than about 2 1/s times the range of the error. Below that K1 stays small longer, the robot no longer
        overshoots, and the convergence time jumps.
        """

        filter_s: Annotated[float, Range(gt=0, le=10)] = 0.0675

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        super().__init__(model, mode, options.filter_s)
        self._tune(self.tables, options)


class AfdscCorrected(Afdsc):
    """AFDSC with the paper's tables corrected: at a large steady error the print has VS and VB swapped."""

    tables: ClassVar[Tables] = "corrected"
