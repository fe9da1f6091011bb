"""DSC, dynamic surface control of the robot's pose, the baseline in Nguyen Minh et al. 2023, and the base of AFDSC.

With S1 = q - q_d, the virtual control is x̄2 = q̇_d - K1 S1. Its first-order filter is ς ẋ2d + x2d = x̄2.
With S2 = q̇ - x2d, the commanded acceleration is u = ẋ2d - K2 S2 (Nguyen Minh et al. 2023, AFDSC, equations 16
to 18). The paper never states x̄2, and prints x2 for it in u. K1 and K2 are diagonal: one gain per axis.

The filter makes the robot lag: on a circle of radius r0 at rate ω the steady error is ς ω² r0 / K1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from hil.core.model import RobotModel
from hil.core.options import RATE, Range
from hil.core.tuples import difference
from hil.core.types import NAN, NO_GAINS, Applied, Axes, CommandMode, Pairs, Reference, State, WheelCommand
from hil.laws.prediction import Prediction, speed_command, torque_command


class FirstOrderFilter:
    """The filter ς ẋ + x = u along three axes; ``value`` is x and ``filter_s`` is ς [s].

    The step is exact for an input that is held over the tick. So a plant that holds its acceleration over the tick
    follows the filter exactly. With the slope at the beginning of the tick, (u - x) / ς, it would not.
    """

    __slots__ = ("_dt_s", "_filter_s", "_rate_1_s", "value")

    def __init__(self, filter_s: float) -> None:
        self._filter_s = filter_s
        self._dt_s = self._rate_1_s = NAN
        self.value: Axes

    def step(self, desired: Axes, dt_s: float) -> Axes:
        """Advance by ``dt_s`` [s] with this input, and return the mean slope over the step."""
        if dt_s != self._dt_s:
            self._dt_s, self._rate_1_s = dt_s, -math.expm1(-dt_s / self._filter_s) / dt_s
        rate = self._rate_1_s
        x, y, heading = self.value
        to_x, to_y, to_heading = desired
        slope_x, slope_y, slope_heading = rate * (to_x - x), rate * (to_y - y), rate * (to_heading - heading)
        self.value = x + dt_s * slope_x, y + dt_s * slope_y, heading + dt_s * slope_heading
        return slope_x, slope_y, slope_heading


class SurfaceLaw:
    """The paper's law, without limits on its command; the guard limits it. It does not use ``applied``.

    In TORQUE mode the command is τ = B⁺ (M u + C) + ξ (equation 18 with the model's C). In SPEED mode the firmware's
    speed loop replaces the inner surface: the set points are ω = H Rᵀ x̄2 / r with the torque feedforward
    B⁺ (M q̈_d + C) + ξ of the reference. K2 and ς are not used there: to filter x̄2 would only add lag.

    ``gains`` are K1 and K2 [1/s]; a subclass whose gains change sets ``_gains_at``.
    """

    def __init__(self, model: RobotModel, mode: CommandMode, filter_s: float, gains: Pairs = NO_GAINS) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._filter = FirstOrderFilter(filter_s)
        self._gains = gains
        self._gains_at: Callable[[Pairs], Pairs] = lambda _: gains  # of the error and its rate

    @property
    def gains(self) -> Pairs:
        """Gains of the last update. In SPEED mode K2 is not in force and NaN."""
        if self._torque:
            return self._gains
        x, y, heading, _, _, _ = self._gains
        return x, y, heading, NAN, NAN, NAN

    def reset(self, state: State, reference: Reference) -> None:
        """Start the filter at rest on its input for this state and reference: x2d(0) = x̄2(0) (equation 17)."""
        error, _, twist_d, _ = difference(state, reference)
        self._gains = self._gains_at(error)
        self._filter.value = virtual_control(twist_d, error, self._gains)

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, not limited; ``dt_s`` [s] is the time since the last tick."""
        predicted = self._predict(reference, state, applied, dt_s)
        error, _, twist_d, _ = predicted
        gains_at = self._gains_at
        self._gains = gains = gains_at(error)
        if self._torque:
            return self._torque_command(reference, predicted, dt_s)
        desired = virtual_control(twist_d, error, gains)
        return speed_command(self._model, desired, predicted, reference.acceleration)

    def _predict(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Prediction:
        """Return the robot and the reference for which the command is computed: here the present ones."""
        return difference(state, reference)

    def _torque_command(self, reference: Reference, predicted: Prediction, dt_s: float) -> WheelCommand:
        error, _, twist_d, (vx, vy, yaw_rate) = predicted
        x, y, heading = self._filter.value
        desired = virtual_control(twist_d, error, self._gains)
        slope_x, slope_y, slope_heading = self._filter.step(desired, dt_s)
        _, _, _, k2_x, k2_y, k2_heading = self._gains
        commanded = (
            slope_x - k2_x * (vx - x),
            slope_y - k2_y * (vy - y),
            slope_heading - k2_heading * (yaw_rate - heading),
        )
        return torque_command(self._model, commanded, predicted)


def virtual_control(reference_twist: Axes, error: Pairs, gains: Pairs) -> Axes:
    """Return x̄2 = q̇_d - K1 S1; with a reference at rest, the feedback -K1 S1."""
    x, y, heading, _, _, _ = error
    vx, vy, yaw_rate = reference_twist
    k1_x, k1_y, k1_heading, _, _, _ = gains
    return vx - k1_x * x, vy - k1_y * y, yaw_rate - k1_heading * heading


class Dsc(SurfaceLaw):
    """Dynamic surface control with constant gains. In SPEED mode only K1 is in force.

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
