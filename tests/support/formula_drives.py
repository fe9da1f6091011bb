"""Drives for hil identify that are made of formulas: nothing in them is noisy, and everything is known."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.addons.identify.drives import Drive
from hil.core.model import RobotModel

PERIOD_S = 0.005
ROBOT = RobotModel(14.0, 0.7, 0.06, 0.24, 0.17, 0.004, 0.02, torque_limit_n_m=2.0, speed_limit_rad_s=30.0)
"""Neither square, nor with a number that another one has too."""


class Tones(NamedTuple):
    """A sum of tones for each of some columns, of which derivatives and integrals are known."""

    size: np.ndarray  # (tones, columns)
    rate_rad_s: np.ndarray  # (tones, 1)
    phase_rad: np.ndarray  # (tones, columns)

    @classmethod
    def of(cls, seed: int, sizes: object, lowest_hz: float, highest_hz: float, tones: int = 4) -> "Tones":
        """Return tones at random, of these sizes together, a column each."""
        random, each = np.random.default_rng(seed), np.atleast_1d(np.asarray(sizes, dtype=float))
        rate = 2.0 * np.pi * np.geomspace(lowest_hz, highest_hz, tones)[:, None]
        return cls(np.tile(each / tones, (tones, 1)), rate, random.uniform(0.0, 6.0, (tones, len(each))))

    def at(self, time_s: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return the values, or a derivative (-1: the integral), of shape (n, columns)."""
        rate = self.rate_rad_s[:, None]
        turned = rate * time_s[None, :, None] + self.phase_rad[:, None] + derivative * np.pi / 2.0
        return np.sum(self.size[:, None] * rate**derivative * np.sin(turned), axis=0)


def formula_drive(angle_rad: np.ndarray, *, robot: RobotModel = ROBOT, **others: Any) -> Drive:
    """Return a drive of these wheel angles (n, 4), at rest in all that ``others`` do not say."""
    rows = len(angle_rad)
    values: Mapping[str, Any] = {"firmware.torque_constant_n_m_a": 1.3}
    given: dict[str, Any] = {
        "path": Path("floor.rrd"),
        "robot": robot,
        "values": values,
        "period_s": PERIOD_S,
        "time_s": 7.0 + PERIOD_S * np.arange(rows),
        "angle_rad": angle_rad,
        "current_a": np.zeros((rows, 4)),
        "torque_command_n_m": np.full((rows, 4), np.nan),
        "yaw_rate_rad_s": np.zeros(rows),
        "fixes": np.zeros((0, 4)),
        "truth": np.full((rows, 3), np.nan),
        "unused_s": 0.0,
    }
    return Drive(**given | others)


def wheel_angles(ways: np.ndarray, radius_m: float, lever_m: float) -> np.ndarray:
    """Return the angles of FL, FR, RR and RL (n, 4) for the body's ways forward, left and round (n, 3)."""
    forward, left, turned = ways.T
    turn = lever_m * turned
    parts = (forward - left - turn, forward + left + turn, forward - left + turn, forward + left - turn)
    return np.stack(parts, axis=1) / radius_m
