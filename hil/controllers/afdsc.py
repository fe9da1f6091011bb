"""AFDSC: dynamic surface control with fuzzy gains (Nguyen Minh et al. 2023, section III.B)."""

from dataclasses import dataclass

from hil.controllers.surface import DynamicSurface, TrackingError, tracking_error, without_inner
from hil.fuzzy import FuzzyBlock, Tables
from hil.model import RobotModel
from hil.options import require_positive
from hil.types import NO_GAINS, Applied, CommandMode, Gains, Reference, State, WheelCommand


class Afdsc:
    """Adaptive fuzzy dynamic surface control: DSC whose gains a fuzzy block an axis sets at every tick.

    The tables have K1 from 3 to 15 1/s and K2 from 10 to 40 1/s. In SPEED mode only K1 is in force.
    """

    @dataclass(frozen=True, slots=True)
    class Options:
        """The filter's time constant ς [s], which tables, and the ranges of the fuzzy inputs.

        None is in the paper's text. ς is DSC's. A range is where the sets NB and PB peak; x and y share
        theirs. The defaults suit a start about 0.3 m and 0.8 rad away. With ς at its default, the time to
        converge hardly depends on the ranges while the one of the rate is above about 2 1/s times the one of
        the error. Below, K1 stays small for so long that the robot no longer overshoots, and the time jumps.
        """

        filter_s: float = 0.0675
        tables: Tables = "printed"
        error_range_m: float = 0.2
        error_rate_range_m_s: float = 0.7
        heading_error_range_rad: float = 0.8
        heading_rate_range_rad_s: float = 4.0

        def __post_init__(self) -> None:
            require_positive(
                self,
                "filter_s",
                "error_range_m",
                "error_rate_range_m_s",
                "heading_error_range_rad",
                "heading_rate_range_rad_s",
            )

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._surface = DynamicSurface(model, mode, options.filter_s)
        self._torque = mode is CommandMode.TORQUE
        self._planar = FuzzyBlock.from_tables(options.tables, options.error_range_m, options.error_rate_range_m_s)
        self._heading = FuzzyBlock.from_tables(
            options.tables, options.heading_error_range_rad, options.heading_rate_range_rad_s
        )
        self._last = NO_GAINS

    @property
    def gains(self) -> Gains:
        """Gains of the last update."""
        return self._last if self._torque else without_inner(self._last)

    def reset(self, state: State, reference: Reference) -> None:
        """Start the filter from this state and reference."""
        error = tracking_error(reference, state)
        self._last = self._tuned(error)
        self._surface.reset(reference, error, self._last)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited; ``applied`` has no part in the paper's law."""
        error = tracking_error(reference, state)
        self._last = self._tuned(error)
        return self._surface.command(reference, state, error, self._last, dt_s)

    def _tuned(self, error: TrackingError) -> Gains:
        k1_x, k2_x = self._planar.gains(error.x_m, error.vx_m_s)
        k1_y, k2_y = self._planar.gains(error.y_m, error.vy_m_s)
        k1_heading, k2_heading = self._heading.gains(error.heading_rad, error.yaw_rate_rad_s)
        return Gains(k1_x, k1_y, k1_heading, k2_x, k2_y, k2_heading)
