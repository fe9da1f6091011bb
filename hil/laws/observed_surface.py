"""Dynamic surface control without its lag: the feedforward goes past the filter, an observer takes what is left.

The paper's filter delays x̄2 = q̇_d - K1 e whole, and with it the reference's own speed: hence the steady error
ς ω² r0 / K1. Here only its feedback -K1 e is filtered, ς ẋ + x = -K1 e, and the acceleration asked for is

    u = q̈_d + ẋ - K2 (ė - x) - ẑ

with ẑ the acceleration that the commands do not explain, as an extended state observer sees it: friction beyond the
model's, a wrong mass. All are taken for the moment at which the command takes effect.
"""

from hil.core.model import RobotModel
from hil.core.types import Applied, Axes, CommandMode, Pairs, Reference, State, WheelCommand
from hil.laws.ahead import Ahead, TorquePrediction, carried_on
from hil.laws.observer import ExtendedStateObserver
from hil.laws.surface import FirstOrderFilter
from hil.laws.wheel_commands import speed_command

_LIMIT_M_S2 = 3.0
_LIMIT_RAD_S2 = 10.0


class ObservedSurface:
    """Surface, filter, observer and wheel map. The gains come from outside; the guard limits the command.

    In SPEED mode the set points are x̄2, and the firmware's speed loop takes the place of the inner surface, of the
    filter and of the observer: which torque acts, it alone knows.
    """

    __slots__ = ("_filter", "_model", "_prediction", "_torque")

    def __init__(self, model: RobotModel, mode: CommandMode, filter_s: float, observer_rad_s: float) -> None:
        self._model = model
        self._torque = mode is CommandMode.TORQUE
        self._filter = FirstOrderFilter(filter_s)
        limits = (_LIMIT_M_S2, _LIMIT_M_S2, _LIMIT_RAD_S2)
        observers = tuple(ExtendedStateObserver(observer_rad_s, limit) for limit in limits)
        self._prediction = TorquePrediction(model, observers)

    def reset(self, state: State, error: Pairs, gains: Pairs) -> None:
        """Start the filter at rest on its input, and the observer at this state."""
        self._filter.value = _feedback(error, gains)
        self._prediction.reset(state)

    def ahead(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> Ahead:
        """Return where robot and reference will be when this tick's command takes effect: once a tick."""
        if self._torque:
            return self._prediction.ahead(reference, state, applied, dt_s)
        return carried_on(reference, state, applied.latency_s)

    def command(self, reference: Reference, ahead: Ahead, gains: Pairs, dt_s: float) -> WheelCommand:
        """Return the command of this tick, of ``dt_s`` [s]."""
        error = ahead.error
        feedback = _feedback(error, gains)
        if not self._torque:
            vx_d, vy_d, yaw_rate_d = ahead.moving
            x, y, heading = feedback
            wanted = vx_d + x, vy_d + y, yaw_rate_d + heading
            return speed_command(self._model, wanted, ahead.heading_rad, ahead.moving, reference.acceleration)
        _, _, _, vx, vy, yaw_rate = error
        _, _, _, k2_x, k2_y, k2_heading = gains
        x, y, heading = self._filter.value
        slope_x, slope_y, slope_heading = self._filter.step(feedback, dt_s)
        ax, ay, ah = reference.acceleration
        zx, zy, zh = self._prediction.disturbance
        asked = (
            ax + slope_x - k2_x * (vx - x) - zx,
            ay + slope_y - k2_y * (vy - y) - zy,
            ah + slope_heading - k2_heading * (yaw_rate - heading) - zh,
        )
        return self._prediction.command(asked, ahead)


def _feedback(error: Pairs, gains: Pairs) -> Axes:
    """Return -K1 e."""
    x, y, heading, _, _, _ = error
    k1_x, k1_y, k1_heading, _, _, _ = gains
    return -k1_x * x, -k1_y * y, -k1_heading * heading
