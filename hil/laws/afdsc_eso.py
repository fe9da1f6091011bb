"""AFDSC with feedforward bypass and extended state observer."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import POSITIVE
from hil.core.types import Applied, CommandMode, Reference, State, WheelCommand
from hil.laws.fuzzy import FuzzyLaw, FuzzyRanges, Tables
from hil.laws.observed_surface import ObservedSurface
from hil.laws.surface import tracking_error


class AfdscEso(FuzzyLaw):
    """AFDSC with feedforward bypass, extended state observer and latency compensation.

    The gains are AFDSC's, at the error predicted for when the command takes effect. In SPEED mode only K1 is in force.
    """

    @dataclass(frozen=True, slots=True)
    class Options(FuzzyRanges):
        """Ranges of the fuzzy inputs, the tables, the filter's time constant ς [s] and the observer's ωo [rad/s]."""

        tables: Tables = "corrected"
        filter_s: Annotated[float, POSITIVE] = 0.01
        observer_rad_s: Annotated[float, POSITIVE] = 60.0

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        super().__init__(mode, options.tables, options)
        self._surface = ObservedSurface(model, mode, options.filter_s, options.observer_rad_s)

    def reset(self, state: State, reference: Reference) -> None:
        """Start filter and observer from this state and reference."""
        error = tracking_error(reference, state)
        self._last = self._tuner.at(error)
        self._surface.reset(state, error, self._last)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        predicted = self._surface.predict(reference, state, applied, dt_s)
        self._last = gains = self._tuner.at(predicted.error)
        return self._surface.command(reference, predicted, gains, dt_s)
