"""AFDSC: dynamic surface control with fuzzy gains (Nguyen Minh et al. 2023, section III.B)."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hil.core.model import RobotModel
from hil.core.options import POSITIVE
from hil.core.types import Applied, CommandMode, Reference, State, WheelCommand
from hil.laws.fuzzy import FuzzyLaw, FuzzyRanges, Tables
from hil.laws.surface import DynamicSurface, tracking_error


class Afdsc(FuzzyLaw):
    """Adaptive fuzzy dynamic surface control: DSC with fuzzy gains, by the paper's tables as printed.

    One fuzzy block per axis sets the gains at every tick: K1 from 3 to 15 1/s and K2 from 10 to 40 1/s. In SPEED mode
    only K1 is in force.
    """

    tables: ClassVar[Tables] = "printed"

    @dataclass(frozen=True, slots=True)
    class Options(FuzzyRanges):
        """The ranges of the fuzzy inputs, and the filter's time constant ς [s].

        The paper's text gives none of them. ς is that of ``Dsc``. The defaults suit a start about 0.3 m and 0.8 rad
        away. With the default ς the convergence time hardly depends on the ranges, as long as the range of the rate is
        more than about 2 1/s times the range of the error. Below that K1 stays small for so long that the robot no
        longer overshoots, and the convergence time jumps.
        """

        filter_s: Annotated[float, POSITIVE] = 0.0675

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        super().__init__(mode, self.tables, options)
        self._surface = DynamicSurface(model, mode, options.filter_s)

    def reset(self, state: State, reference: Reference) -> None:
        """Start the filter from this state and reference."""
        error = tracking_error(reference, state)
        self._last = self._tuner.at(error)
        self._surface.reset(reference, error, self._last)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited. The paper's law does not use ``applied``."""
        error = tracking_error(reference, state)
        self._last = gains = self._tuner.at(error)
        return self._surface.command(reference, state, error, gains, dt_s)
