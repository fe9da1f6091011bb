"""DSC with feedforward bypass and extended state observer."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import POSITIVE
from hil.core.types import Applied, CommandMode, Gains, Reference, State, WheelCommand
from hil.laws.observed_surface import ObservedSurface
from hil.laws.surface import tracking_error, without_k2


class DscEso:
    """DSC with constant gains, feedforward bypass, extended state observer and latency compensation.

    In SPEED mode only ``k1_1_s`` is in force.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes [1/s], the filter's time constant ς [s], and the observer's ωo [rad/s]."""

        k1_1_s: Annotated[float, POSITIVE] = 8.0
        k2_1_s: Annotated[float, POSITIVE] = 30.0
        filter_s: Annotated[float, POSITIVE] = 0.01
        observer_rad_s: Annotated[float, POSITIVE] = 60.0

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        k1, k2 = options.k1_1_s, options.k2_1_s
        self._surface = ObservedSurface(model, mode, options.filter_s, options.observer_rad_s)
        self._gains = Gains(k1, k1, k1, k2, k2, k2)
        self.gains = self._gains if mode is CommandMode.TORQUE else without_k2(self._gains)

    def reset(self, state: State, reference: Reference) -> None:
        """Start filter and observer from this state and reference."""
        self._surface.reset(state, tracking_error(reference, state), self._gains)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited."""
        predicted = self._surface.predict(reference, state, applied, dt_s)
        return self._surface.command(reference, predicted, self._gains, dt_s)
