"""How the robot was when a run first failed, in words for the event log."""

import math
from collections.abc import Mapping

from hil.core.types import WHEEL_NAMES

STATE_BEGINS = "the robot then: "
"""How the event begins that tells how the robot was when a run first failed."""


_WHEELS = ("speed_command_rad_s", "torque_command_n_m", "speed_rad_s", "current_a")
STATE_SIGNALS = (
    *("error.x_m", "error.y_m", "error.heading_rad", "error.planar_m", "guard.held"),
    *(f"wheel.{wheel}.{quantity}" for quantity in _WHEELS for wheel in WHEEL_NAMES),
)
"""What ``state_words`` needs."""


def state_words(row: Mapping[str, float]) -> str:
    """Return where the robot was and what its wheels did, from the signals of a tick, for the event log."""

    def wheels(quantity: str, digits: int) -> str:
        values = [row[f"wheel.{wheel}.{quantity}"] for wheel in WHEEL_NAMES]
        return "" if all(map(math.isnan, values)) else ", ".join(_number(one, digits) for one in values)

    parts = []
    if not math.isnan(row["error.planar_m"]):
        x_mm, y_mm, heading_mrad = (_number(1e3 * row[f"error.{name}"], 1) for name in ("x_m", "y_m", "heading_rad"))
        parts.append(f"off by x {x_mm} mm, y {y_mm} mm, heading {heading_mrad} mrad")
    if row["guard.held"]:
        parts.append("held at rest, because its state was unknown or old")
    asked = [("speed_command_rad_s", 1, "rad/s"), ("torque_command_n_m", 2, "N·m")]
    words = [f"asked for {values} {unit}" for name, digits, unit in asked if (values := wheels(name, digits))][:1]
    words += [f"turned at {values} rad/s" for values in [wheels("speed_rad_s", 1)] if values]
    words += [f"drew {values} A" for values in [wheels("current_a", 2)] if values]
    parts += [f"wheels {', '.join(name.upper() for name in WHEEL_NAMES)} {'; '.join(words)}"] if words else []
    return STATE_BEGINS + "; ".join(parts)


def _number(value: float, digits: int) -> str:
    """Return a number with so many digits after the point, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"
