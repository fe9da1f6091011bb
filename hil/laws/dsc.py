"""DSC, the baseline in Nguyen Minh et al. 2023, and DSC with feedforward bypass and observer. Their gains are constant.

In SPEED mode only K1 is in force.
"""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.types import CommandMode
from hil.laws.surface import ObservedSurfaceLaw, SurfaceLaw


class Dsc(SurfaceLaw):
    """Dynamic surface control with constant gains.

    The default K1 of 15 1/s is the paper's, for torque at 1 kHz, in both modes. A scenario in SPEED mode has to set the
    gain that its rate and latency allow: 8 1/s at 200 Hz and 5 ms.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes [1/s] (table V), and the filter's time constant ς [s].

        ς is not in the paper; 0.0675 s follows from its steady error of 0.79 mm.
        """

        k1_1_s: Annotated[float, RATE] = 15.0
        k2_1_s: Annotated[float, RATE] = 40.0
        filter_s: Annotated[float, Range(gt=0, le=10)] = 0.0675

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        k1, k2 = options.k1_1_s, options.k2_1_s
        super().__init__(model, mode, options.filter_s, (k1, k1, k1, k2, k2, k2))


class DscEso(ObservedSurfaceLaw):
    """DSC with constant gains, feedforward bypass, extended state observer and latency compensation."""

    @dataclass(frozen=True, slots=True)
    class Options:
        """Gains of all three axes [1/s], the filter's time constant ς [s], and the observer's ωo [rad/s]."""

        k1_1_s: Annotated[float, RATE] = 8.0
        k2_1_s: Annotated[float, RATE] = 30.0
        filter_s: Annotated[float, Range(gt=0, le=10)] = 0.01
        observer_rad_s: Annotated[float, RATE] = 60.0

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        k1, k2 = options.k1_1_s, options.k2_1_s
        super().__init__(model, mode, options.filter_s, options.observer_rad_s, (k1, k1, k1, k2, k2, k2))
