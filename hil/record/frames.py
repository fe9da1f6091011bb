"""The frames of the robot along a recording, as ROS names them (REP 105), for the URDF of ``hil.record.robot_model``.

``odom`` holds ``base_link`` where the estimate has it, and ``ground_truth`` where the robot truly is; the axes of the
world frame are those of ``odom``. The links of the wheels turn in ``base_link``. The fixed links are in the URDF.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import cos, isfinite, sin

import numpy as np

from hil.record.decimate import Decimator
from hil.record.motion import SCENE_PERIOD_S, WheelAngles, pose
from hil.record.ring import Rows
from hil.record.robot_model import BASE_LINK, WHEEL_LINKS, RobotShape
from hil.record.ros_messages import TransformMessages

ODOM, TRUTH = "odom", "ground_truth"


_NEEDED = frozenset(f"{group}.{name}" for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad"))


class RobotFrames:
    """The robot's URDF, and the messages on /tf of the rows of a recording: 50 a second."""

    def __init__(self, column: Mapping[str, int], shape: RobotShape) -> None:
        self.urdf = shape.urdf()
        self._column = column
        self._t = column["loop.t_s"]
        self._centres = [(x, y, shape.wheel_radius_m) for x, y in shape.centres_m.tolist()]
        self._angles = WheelAngles(column)
        self._decimator = Decimator(SCENE_PERIOD_S)
        frames = [(ODOM, BASE_LINK), *((BASE_LINK, link) for link in WHEEL_LINKS)]
        self._estimated = TransformMessages(frames)
        self._true = TransformMessages([(ODOM, TRUTH)])

    @classmethod
    def of(cls, signals: Sequence[str], scenario: Mapping[str, object]) -> "RobotFrames | None":
        """Return the frames for rows with these signals, by a scenario's values; None when either lacks something."""
        shape = RobotShape.of(scenario)
        return (
            None
            if shape is None or not set(signals) >= _NEEDED
            else cls({name: i for i, name in enumerate(signals)}, shape)
        )

    def messages(self, rows: Rows, zero_unix_ns: int) -> Iterator[tuple[int, bytes]]:
        """Yield Unix time [ns] and message for rows of shape (n, signals); a pose that is not known has none."""
        rows = rows[np.isfinite(rows[:, self._t])]
        if not len(rows):
            return
        angles = self._angles(rows, rows[:, self._t])
        keep = self._decimator.keep(rows[:, self._t])
        rows, halves = rows[keep], angles[keep] / 2
        wheels = np.stack([np.sin(halves), 0 * halves, np.cos(halves)], axis=-1).tolist()  # about y
        estimates, truths = (pose(rows, self._column, group).tolist() for group in ("pose", "truth"))
        for t_s, estimate, truth, turned in zip(rows[:, self._t].tolist(), estimates, truths, wheels, strict=True):
            stamp_ns = zero_unix_ns + round(t_s * 1e9)
            if all(map(isfinite, estimate)):
                links = [(*at, 0.0, *turn) for at, turn in zip(self._centres, turned, strict=True)]
                yield stamp_ns, self._estimated.message(stamp_ns, [_standing(*estimate), *links])
            if all(map(isfinite, truth)):
                yield stamp_ns, self._true.message(stamp_ns, [_standing(*truth)])


def _standing(x_m: float, y_m: float, heading_rad: float) -> tuple[float, ...]:
    """Return the transform to a frame on the floor, turned about z."""
    return x_m, y_m, 0.0, 0.0, 0.0, sin(heading_rad / 2), cos(heading_rad / 2)
