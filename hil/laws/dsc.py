"""DSC: dynamic surface control with constant gains, the baseline in Nguyen Minh et al. 2023."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import POSITIVE
from hil.core.types import Applied, CommandMode, Gains, Reference, State, WheelCommand
from hil.laws.surface import DynamicSurface, tracking_error, without_k2


class Dsc:
    """Dynamic surface control with constant gains.

    In SPEED mode only ``k1_1_s`` is in force. Its default of 15 1/s is the paper's, for torque at 1 kHz, in both
    modes. A scenario in SPEED mode has to set the gain that its rate and latency allow: 8 1/s at 200 Hz and 5 ms.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes [1/s] (table V), and the filter's time constant ς [s].

        ς is not in the paper; 0.0675 s follows from its steady error of 0.79 mm.
        """

        k1_1_s: Annotated[float, POSITIVE] = 15.0
        k2_1_s: Annotated[float, POSITIVE] = 40.0
        filter_s: Annotated[float, POSITIVE] = 0.0675

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        k1, k2 = options.k1_1_s, options.k2_1_s
        self._surface = DynamicSurface(model, mode, options.filter_s)
        self._gains = Gains(k1, k1, k1, k2, k2, k2)
        self.gains = self._gains if mode is CommandMode.TORQUE else without_k2(self._gains)

    def reset(self, state: State, reference: Reference) -> None:
        """Start the filter from this state and reference."""
        self._surface.reset(reference, tracking_error(reference, state), self._gains)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited. The paper's law does not use ``applied``."""
        error = tracking_error(reference, state)
        return self._surface.command(reference, state, error, self._gains, dt_s)
