"""AFDSC: dynamic surface control with fuzzy gains (Nguyen Minh et al. 2023, section III.B).

One fuzzy block per axis sets the gains at every tick: K1 from 3 to 15 1/s and K2 from 10 to 40 1/s. SPEED mode uses
K1 alone.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.types import CommandMode
from hil.laws.fuzzy import FuzzyLaw, FuzzyRanges, Tables
from hil.laws.surface import ObservedSurfaceLaw


class Afdsc(FuzzyLaw):
    """Adaptive fuzzy dynamic surface control: DSC with fuzzy gains, by the paper's tables as printed."""

    tables: ClassVar[Tables] = "printed"

    @dataclass(frozen=True, slots=True)
    class Options(FuzzyRanges):
        """The ranges of the fuzzy inputs, and the filter's time constant ς [s].

        The paper's text gives none of them. ς is that of ``Dsc``. The defaults suit a start about 0.3 m and 0.8 rad
        away. With the default ς the convergence time hardly depends on the ranges, as long as the range of the rate is
        more than about 2 1/s times the range of the error. Below that K1 stays small for so long that the robot no
        longer overshoots, and the convergence time jumps.
        """

        filter_s: Annotated[float, Range(gt=0, le=10)] = 0.0675

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        super().__init__(model, mode, options.filter_s)
        self._tune(self.tables, options)


class AfdscCorrected(Afdsc):
    """AFDSC with the paper's tables corrected: at a large steady error the print has VS and VB swapped."""

    tables: ClassVar[Tables] = "corrected"


class AfdscEso(FuzzyLaw, ObservedSurfaceLaw):
    """AFDSC with feedforward bypass, extended state observer and latency compensation.

    The gains are AFDSC's, at the error predicted for when the command takes effect.
    """

    @dataclass(frozen=True, slots=True)
    class Options(FuzzyRanges):
        """Ranges of the fuzzy inputs, the tables, the filter's time constant ς [s] and the observer's ωo [rad/s]."""

        tables: Tables = "corrected"
        filter_s: Annotated[float, Range(gt=0, le=10)] = 0.01
        observer_rad_s: Annotated[float, RATE] = 60.0

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        super().__init__(model, mode, options.filter_s, options.observer_rad_s)
        self._tune(options.tables, options)
