"""Dynamic surface control without its lag: the feedforward bypasses the filter, an observer removes the steady error.

The paper's filter delays all of x̄2 = q̇_d - K1 e, also the reference's own speed. That causes the steady error
ς ω² r0 / K1. Here only the feedback -K1 e is filtered, ς ẋ + x = -K1 e, and the commanded acceleration is

    u = q̈_d + ẋ - K2 (ė - x) - ẑ

with ẑ the acceleration that the commands do not explain, such as that of unmodelled friction or a wrong mass, as an
extended state observer estimates it. All values are predicted for the time when the command takes effect.
"""

from hil.core.model import RobotModel
from hil.core.types import Applied, Axes, CommandMode, Pairs, Reference, State, WheelCommand
from hil.laws.prediction import DelayPredictor, ExtendedStateObserver, Prediction, extrapolate
from hil.laws.surface import FirstOrderFilter, speed_command

_LIMIT_M_S2 = 3.0
_LIMIT_RAD_S2 = 10.0


class ObservedSurface:
    """Surface, filter, observer and map to the wheels. The caller gives the gains. The guard limits the command.

    In SPEED mode the set points are x̄2. The firmware's speed loop then replaces the inner surface, the filter and the
    observer, because only the firmware knows which torque acts.
    """

    __slots__ = ("_filter", "_model", "_predictor", "_torque")

    def __init__(self, model: RobotModel, mode: CommandMode, filter_s: float, observer_rad_s: float) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._filter = FirstOrderFilter(filter_s)
        limits = (_LIMIT_M_S2, _LIMIT_M_S2, _LIMIT_RAD_S2)
        observers = tuple(ExtendedStateObserver(observer_rad_s, limit) for limit in limits)
        self._predictor = DelayPredictor(model, observers)

    def reset(self, state: State, error: Pairs, gains: Pairs) -> None:
        """Start the filter at rest on its input, and the observer at this state."""
        self._filter.value = _feedback(error, gains)
        self._predictor.reset(state)

    def predict(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Prediction:
        """Return the prediction for this tick's command. Call it once a tick."""
        if self._torque:
            return self._predictor.predict(reference, state, applied, dt_s)
        return extrapolate(reference, state, applied.latency_s)

    def command(self, reference: Reference, predicted: Prediction, gains: Pairs, dt_s: float) -> WheelCommand:
        """Return the command of this tick, which lasts ``dt_s`` [s]."""
        error = predicted.error
        feedback = _feedback(error, gains)
        if not self._torque:
            vx_d, vy_d, yaw_rate_d = predicted.reference_twist
            x, y, heading = feedback
            desired = vx_d + x, vy_d + y, yaw_rate_d + heading
            return speed_command(
                self._model, desired, predicted.heading_rad, predicted.reference_twist, reference.acceleration
            )
        _, _, _, vx, vy, yaw_rate = error
        _, _, _, k2_x, k2_y, k2_heading = gains
        x, y, heading = self._filter.value
        slope_x, slope_y, slope_heading = self._filter.step(feedback, dt_s)
        ax, ay, ah = reference.acceleration
        zx, zy, zh = self._predictor.disturbance
        commanded = (
            ax + slope_x - k2_x * (vx - x) - zx,
            ay + slope_y - k2_y * (vy - y) - zy,
            ah + slope_heading - k2_heading * (yaw_rate - heading) - zh,
        )
        return self._predictor.command(commanded, predicted)


def _feedback(error: Pairs, gains: Pairs) -> Axes:
    """Return -K1 e."""
    x, y, heading, _, _, _ = error
    k1_x, k1_y, k1_heading, _, _, _ = gains
    return -k1_x * x, -k1_y * y, -k1_heading * heading
