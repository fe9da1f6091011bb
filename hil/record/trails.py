"""Where the robot was: trails of reference, estimate and truth, on the floor of the 3D scene and in the plan.

A trail is a segment at each time, so that a view shows as much of it as its range of time takes.
"""

import numpy as np
import rerun as rr

from hil.record.decimate import Decimator
from hil.record.layout import ESTIMATE_COLOUR, REFERENCE_COLOUR, TRUTH_COLOUR, X_COLOUR, Y_COLOUR, Colour
from hil.record.poses import drawn_pose, turned
from hil.record.ring import Rows
from hil.record.timeline import Times, indexes

TRAIL_PERIOD_S = 0.04
PLAN = "/xy"
FLOOR = "/world/trail"
TRAILS: tuple[tuple[str, str, Colour, float], ...] = (
    # name, group of signals, colour, line width [px]; drawn in this order, the reference widest and lowest
    ("reference", "reference", REFERENCE_COLOUR, 6.0),
    ("estimate", "pose", ESTIMATE_COLOUR, 3.5),
    ("truth", "truth", TRUTH_COLOUR, 1.5),
)
# The robot's symbol in the body frame, its nose forward; not to scale with a particular robot.
_BODY_M = np.array([(-0.1, -0.08), (0.04, -0.08), (0.17, 0.0), (0.04, 0.08), (-0.1, 0.08), (-0.1, -0.08)])
_FLOOR_STEP_M = 0.001
"""Height of a trail over the one before it, so that none hides another."""


class Trails:
    """Draws the trails and, in the plan, the robot's symbol."""

    def __init__(self, recording: rr.RecordingStream, column: dict[str, int]) -> None:
        self._rerun = recording
        self._column = column
        self._decimator = Decimator(TRAIL_PERIOD_S)
        self._end: dict[str, Rows] = {}

    def describe(self) -> None:
        """Log what does not change: colours, widths and the axes."""
        # A 2D view counts y downwards; the world's y points up. The data stay as they are.
        self._rerun.log(PLAN, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
        for order, (name, _, colour, width_px) in enumerate(TRAILS):
            # A negative radius is in pixels, whatever the zoom.
            flat = rr.LineStrips2D.from_fields(colors=[colour], radii=[-width_px / 2], draw_order=30.0 + order)
            self._rerun.log(f"{PLAN}/{name}", flat, static=True)
            solid = rr.LineStrips3D.from_fields(colors=[colour], radii=[-width_px / 2])
            self._rerun.log(f"{FLOOR}/{name}", solid, static=True)
        body = rr.LineStrips2D.from_fields(colors=[TRUTH_COLOUR], radii=[-1.5], draw_order=40.0)
        self._rerun.log(f"{PLAN}/robot", body, static=True)
        axes = rr.LineStrips2D(
            [[(0.0, 0.0), (0.5, 0.0)], [(0.0, 0.0), (0.0, 0.5)]],
            colors=[X_COLOUR, Y_COLOUR],
            labels=["x: 0.5 m", "y: 0.5 m"],
            radii=-0.75,
            draw_order=20.0,
        )
        self._rerun.log(f"{PLAN}/axes", axes, static=True)

    def rows(self, rows: Rows, times: Times) -> None:
        """Draw what rows of shape (n, signals) add."""
        keep = self._decimator.keep(times[:, 0])
        if not len(keep):
            return
        rows, times = rows[keep], times[keep]
        for order, (name, group, _, _) in enumerate(TRAILS):
            self._trail(name, rows[:, [self._column[f"{group}.x_m"], self._column[f"{group}.y_m"]]], times, order)
        poses = drawn_pose(rows, self._column)
        seen = np.isfinite(poses).all(axis=1)
        if seen.any():
            bodies = rr.LineStrips2D.columns(strips=list(_outlines(poses[seen])))
            self._rerun.send_columns(f"{PLAN}/robot", indexes=indexes(times[seen]), columns=bodies)

    def _trail(self, name: str, points: Rows, times: Times, order: int) -> None:
        ends = np.vstack([self._end.get(name, points[0]), points])
        self._end[name] = points[-1]
        segments = np.stack([ends[:-1], ends[1:]], axis=1)
        seen = np.isfinite(segments).all(axis=(1, 2))
        if not seen.any():
            return
        segments, index = segments[seen], indexes(times[seen])
        flat = rr.LineStrips2D.columns(strips=list(segments))
        self._rerun.send_columns(f"{PLAN}/{name}", indexes=index, columns=flat)
        height = np.full((*segments.shape[:2], 1), (order + 1) * _FLOOR_STEP_M)
        solid = rr.LineStrips3D.columns(strips=list(np.concatenate([segments, height], axis=2)))
        self._rerun.send_columns(f"{FLOOR}/{name}", indexes=index, columns=solid)


def _outlines(poses: Rows) -> Rows:
    """Outline of the robot's symbol at poses (n, 3) in the world frame, shape (n, 6, 2)."""
    outlines = np.broadcast_to(_BODY_M, (len(poses), *_BODY_M.shape))
    return poses[:, None, :2] + turned(outlines, poses[:, 2])
