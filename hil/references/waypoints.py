"""Waypoints from a CSV file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from hil.core.errors import BadInputError, apart
from hil.core.options import POSITIVE, Range
from hil.references.double_s import Limits
from hil.references.route import Waypoint, plan
from hil.references.source import ReferenceSource
from hil.references.table import Format, read_table

_OPTIONAL = {"speed_m_s": math.inf, "dwell_s": 0.0}
FORMAT = Format(("x_m", "y_m", "heading_rad"), _OPTIONAL, fewest_rows=2, most_rows=10_000, others=False)

SLOWEST_M_S = 0.001
NEAREST_M = 0.001


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Straight from pose to pose of a CSV file, as fast as limits of speed, acceleration and jerk allow, then rest.

    Columns: x_m, y_m, heading_rad, and optionally speed_m_s (top speed on the way to the row) and dwell_s (time at
    rest there). The robot stops at each corner, or with ``corners = "blend"`` cuts it by ``blend_m`` of either leg.
    """

    file: str
    corners: Literal["stop", "blend"] = "stop"
    blend_m: Annotated[float, POSITIVE] = 0.2
    max_speed_m_s: Annotated[float, Range(gt=0, le=1000)] = 0.5
    max_acceleration_m_s2: Annotated[float, POSITIVE] = 0.5
    max_jerk_m_s3: Annotated[float, POSITIVE] = 2.0
    max_yaw_rate_rad_s: Annotated[float, Range(gt=0, le=1000)] = 1.0
    max_yaw_acceleration_rad_s2: Annotated[float, POSITIVE] = 2.0
    max_yaw_jerk_rad_s3: Annotated[float, POSITIVE] = 10.0

    def read(self, directory: Path) -> ReferenceSource:
        """Return the motion along the file's waypoints; a relative path starts from ``directory``.

        Raises BadInputError for a file that cannot be used.
        """
        name = f"reference.file = {self.file!r}"
        rows = read_table(directory, self.file, FORMAT)
        waypoints = [Waypoint(*values) for _, values in rows]
        for (line, _), waypoint, before in zip(rows, waypoints, [None, *waypoints], strict=False):
            where = f"{name}, line {line}"
            if waypoint.speed_m_s < SLOWEST_M_S:
                raise BadInputError(f"{where}: speed_m_s = {waypoint.speed_m_s:g}; expected at least {SLOWEST_M_S:g}")
            if waypoint.dwell_s < 0.0:
                raise BadInputError(f"{where}: dwell_s = {waypoint.dwell_s:g}; expected 0 or more")
            if before is not None and before[:3] == waypoint[:3]:
                raise BadInputError(
                    f"{where}: the same pose as in the row before; leave it out, and give the one before a dwell_s to "
                    "rest there"
                )
            if before is not None and 0.0 < (gap_m := math.dist(before[:2], waypoint[:2])) < NEAREST_M:
                raise BadInputError(
                    f"{where}: {apart(gap_m, NEAREST_M, digits=2)} m from the row before; expected at least "
                    f"{NEAREST_M:g} m, or the same place to turn on the spot"
                )
        limits = Limits(self.max_speed_m_s, self.max_acceleration_m_s2, self.max_jerk_m_s3)
        yaw = Limits(self.max_yaw_rate_rad_s, self.max_yaw_acceleration_rad_s2, self.max_yaw_jerk_rad_s3)
        return plan(waypoints, limits, yaw, self.blend_m if self.corners == "blend" else 0.0)
