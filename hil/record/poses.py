"""Poses as arrays: which one of a run is drawn, and turning by them."""

from collections.abc import Mapping

import numpy as np

from hil.record.ring import Rows

_POSE = ("x_m", "y_m", "heading_rad")


def pose(rows: Rows, column: Mapping[str, int], group: str) -> Rows:
    """Return a group's x [m], y [m] and heading [rad], shape (n, 3)."""
    return rows[:, [column[f"{group}.{name}"] for name in _POSE]]


def drawn_pose(rows: Rows, column: Mapping[str, int]) -> Rows:
    """Return where the robot is drawn: at the truth, or at the estimate where there is no truth; shape (n, 3)."""
    truth = pose(rows, column, "truth")
    known = np.isfinite(truth).all(axis=1, keepdims=True)
    return np.where(known, truth, pose(rows, column, "pose"))


def turned(vectors: Rows, heading_rad: Rows) -> Rows:
    """Turn vectors of shape (n, k, 2) from the body frame into the world frame, headings of shape (n,)."""
    cosine, sine = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
