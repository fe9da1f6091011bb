"""What is wrong with a robot or its floor, as far as its drives show it: each is refused with a sentence."""

import numpy as np

from hil.core.errors import BadInputError
from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import WHEEL_NAMES
from hil.identify.recorded import Array, Drive, integral
from hil.identify.windows import MEASURED, Windows, twists

_SHARE = 0.1  # of what the other wheels do
_SLOPE_M_S2 = 0.06
_SIGMAS = 6.0


def check_motors(drive: Drive) -> None:
    """Raise BadInputError for a drive without currents, with a blocked wheel, or with a dead current sensor.

    All four wheels are driven alike in the drives of an identification, so one that does next to nothing stands out.
    """
    if not drive.has_currents:
        raise BadInputError(
            f"{drive.path}: the robot measured no currents. Without them mass, inertia, friction and grip are not "
            "identifiable; hil commission finds the radius of the wheels and the lever"
        )
    turned, drawn = drive.speed_rad_s.std(axis=0), drive.current_a.std(axis=0)
    for wheel, speed, current in zip(WHEEL_NAMES, turned, drawn, strict=True):
        if speed < _SHARE * np.median(turned):
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned next to nothing while the others did: it is blocked, or its "
                "encoder is dead; nothing was fitted"
            )
        if current < _SHARE * np.median(drawn):
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned, but its current sensor shows next to nothing: it is dead, or the "
                "motor is not driven; nothing was fitted"
            )


def check_level(drive: Drive, windows: Windows, left: Array, robot: RobotModel) -> None:
    """Raise BadInputError for a floor that slopes: in all windows, something pushed the robot the same way.

    ``left`` (W, B * 5) is what a fitted model leaves of the windows. Its trend within a window is an acceleration that
    no motor made.
    """
    by_bin = left.reshape(len(left), -1, MEASURED)[..., : len(WHEEL_NAMES)]
    time_s = windows.rows_a_bin * windows.period_s * np.arange(by_bin.shape[1])
    time_s -= time_s.mean()
    trend = np.einsum("b,wbi->wi", time_s, by_bin) / np.sum(time_s**2)
    heading = integral(drive.yaw_rate_rad_s, drive.period_s)[windows.first]
    along, aside, _ = twists(trend, robot).T
    c, s = np.cos(heading), np.sin(heading)
    pushed = np.stack([c * along - s * aside, s * along + c * aside], axis=1)
    usual = np.median(pushed, axis=0)
    spread = 1.4826 * np.median(np.abs(pushed - usual), axis=0)
    size, doubt = float(np.hypot(*usual)), float(np.hypot(*spread)) / np.sqrt(len(pushed))
    if size > max(_SLOPE_M_S2, _SIGMAS * doubt):
        degrees = np.degrees(np.arcsin(min(1.0, size / GRAVITY_M_S2)))
        raise BadInputError(
            f"{drive.path}: something pushed the robot one way all the time, as a floor does that slopes by "
            f"{degrees:.1f} degrees or more; drive where it is level. Nothing was fitted"
        )
