"""How a recording shows the robot to move: where it stands, and how far its wheels have turned. Needs no rerun."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hil.core.types import WHEEL_NAMES
from hil.record.ring import Rows

SCENE_PERIOD_S = 0.02
"""The robot is shown once in this time."""


def pose(rows: Rows, column: Mapping[str, int], group: str) -> Rows:
    """Return a group's x [m], y [m] and heading [rad], shape (n, 3)."""
    return rows[:, [column[f"{group}.{name}"] for name in ("x_m", "y_m", "heading_rad")]]


class WheelAngles:
    """Angles of the wheels: the integral of their speeds at full rate, since the first row, also across calls."""

    def __init__(self, column: Mapping[str, int]) -> None:
        self._speeds = [column[f"wheel.{wheel}.speed_rad_s"] for wheel in WHEEL_NAMES]
        self._angles_rad = np.zeros(len(WHEEL_NAMES))
        self._last_s: float | None = None

    def __call__(self, rows: Rows, t_s: npt.NDArray[np.float64]) -> Rows:
        """Return the angles [rad] at rows with these times [s], shape (n, 4); a wheel of unknown speed stands still."""
        before = t_s[0] if self._last_s is None else self._last_s
        steps = np.maximum(np.diff(t_s, prepend=before), 0.0)
        angles: Rows = self._angles_rad + np.cumsum(np.nan_to_num(rows[:, self._speeds]) * steps[:, None], axis=0)
        self._angles_rad, self._last_s = angles[-1], float(t_s[-1])
        return angles
