"""DSC and AFDSC with feedforward bypass, extended state observer (ESO) and latency compensation."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.tuples import difference
from hil.core.types import NO_GAINS, Applied, CommandMode, Pairs, Reference, State, WheelCommand
from hil.laws.afdsc import FuzzyLaw, FuzzyRanges, Tables
from hil.laws.prediction import DelayPredictor, ExtendedStateObserver, Prediction, extrapolate
from hil.laws.surface import SurfaceLaw, virtual_control

_DISTURBANCE_LIMITS = (3.0, 3.0, 10.0)  # [m/s², m/s², rad/s²]


class ObservedSurfaceLaw(SurfaceLaw):
    """Dynamic surface control without its lag: the feedforward bypasses the filter, an observer removes steady errors.

    The paper filters all of x̄2 = q̇_d - K1 e, so it delays the reference's own speed too. That causes the steady error
    ς ω² r0 / K1. Here the filter acts on the feedback -K1 e alone: ς ẋ + x = -K1 e. The commanded acceleration is

        u = q̈_d + ẋ - K2 (ė - x) - ẑ

    An extended state observer of bandwidth ``observer_rad_s`` estimates the disturbance ẑ: the acceleration that the
    commands do not explain, for example from friction or a wrong mass. All values are predicted for the time when the
    command takes effect. SPEED mode does not use the observer, because only the firmware knows the torques there.
    """

    def __init__(
        self, model: RobotModel, mode: CommandMode, filter_s: float, observer_rad_s: float, gains: Pairs = NO_GAINS
    ) -> None:
        super().__init__(model, mode, filter_s, gains)
        observers = tuple(ExtendedStateObserver(observer_rad_s, limit) for limit in _DISTURBANCE_LIMITS)
        self._predictor = DelayPredictor(model, observers)

    def reset(self, state: State, reference: Reference) -> None:
        """Start the filter at rest on its input, and the observer at this state."""
        error, *_ = difference(state, reference)
        self._gains = self._gains_at(error)
        self._filter.value = virtual_control((0.0, 0.0, 0.0), error, self._gains)
        self._predictor.reset(state)

    def _predict(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Prediction:
        if self._torque:
            return self._predictor.predict(reference, state, applied, dt_s)
        return extrapolate(reference, state, applied.latency_s)

    def _torque_command(self, reference: Reference, predicted: Prediction, dt_s: float) -> WheelCommand:
        error, *_ = predicted
        _, _, _, vx, vy, yaw_rate = error
        _, _, _, k2_x, k2_y, k2_heading = self._gains
        x, y, heading = self._filter.value
        feedback = virtual_control((0.0, 0.0, 0.0), error, self._gains)
        slope_x, slope_y, slope_heading = self._filter.step(feedback, dt_s)
        ax, ay, ah = reference.acceleration
        zx, zy, zh = self._predictor.disturbance
        commanded = (
            ax + slope_x - k2_x * (vx - x) - zx,
            ay + slope_y - k2_y * (vy - y) - zy,
            ah + slope_heading - k2_heading * (yaw_rate - heading) - zh,
        )
        return self._predictor.command(commanded, predicted)


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
