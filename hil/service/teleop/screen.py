"""The screen of teleop, as lines of text. Pure."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.core.kinematics import BodyTwist, to_body
from hil.core.types import Twist
from hil.service.teleop.held import RepeatedKeys
from hil.service.teleop.operator import Speeds

_REPORTS_RELEASES = "this terminal reports when a key is released: the robot is stopped at once"
_REPEATS = (
    f"this terminal does not report when a key is released. A press drives for {RepeatedKeys.FIRST_S:g} s at "
    f"{RepeatedKeys.FIRST_SHARE:.0%} of the speed,",
    f"and on as long as the key repeats; the robot is stopped {RepeatedKeys.REPEAT_S:g} s after the last repeat. "
    "One key at a time.",
)
_HELP = (
    "  u  i  o       or arrows        s f  turn left, right        Space Esc k  stop",
    "  j  k  l                        + -  faster, slower          e            emergency stop",
    "  m  ,  .                        a, then Enter  arm           d disarm     c clear     q quit",
)


class View(NamedTuple):
    """Content of the screen. ``asked``: None if no dead-man switch is held; ``gamepad``: None if not used."""

    status: Mapping[str, Any] | None
    status_age_s: float
    requested: BodyTwist | None
    speeds: Speeds
    reports_releases: bool
    gamepad: str | None
    message: str


def lines(view: View) -> list[str]:
    """Return the lines of the screen."""
    status, requested = view.status, view.requested
    shown = [
        "hil teleop: hold a key to run, let go to stop",
        "",
        *(_status(status, view.status_age_s) if status is not None else ["phase     not known yet"]),
        f"asked     {'nothing: nobody holds a key or the button' if requested is None else _twist(requested)}",
        f"got       {_got(status)}",
        f"speed     {view.speeds.speed_m_s:.2f} m/s, {view.speeds.yaw_rate_rad_s:.2f} rad/s",
    ]
    if view.gamepad is not None:
        shown.append(f"gamepad   {view.gamepad}")
    return [*shown, "", *_HELP, "", *((_REPORTS_RELEASES,) if view.reports_releases else _REPEATS), "", view.message]


def _status(status: Mapping[str, Any], age_s: float) -> list[str]:
    task = "" if status["task"] is None else f", {status['task']}"
    why = f" ({status['why']})" if status["why"] else ""
    ages = (("twist", _ms(status["twist_age_s"])), ("feedback", status["feedback_age_ms"]), ("status", age_s * 1000.0))
    return [
        f"phase     {status['phase']}{task}{why}",
        f"age       {', '.join(f'{name} {age:.0f} ms' for name, age in ages if age is not None)}",
    ]


def _ms(time_s: float | None) -> float | None:
    return None if time_s is None else time_s * 1000.0


def _got(status: Mapping[str, Any] | None) -> str:
    """Return the robot's twist in its body frame, like the wanted one."""
    if status is None or status["twist"] is None or status["pose"] is None:
        return "not known"
    return _twist(to_body(Twist(*status["twist"]), status["pose"][2]))


def _twist(twist: BodyTwist) -> str:
    # To avoid -0.000.
    forward, left, yaw_rate = (value if abs(value) >= 0.0005 else math.fabs(value) for value in twist)
    return f"{forward:6.3f} m/s forward, {left:6.3f} m/s to the left, {yaw_rate:6.3f} rad/s"
