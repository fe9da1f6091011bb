"""Messages of ROS 2 by which other viewers draw the robot of a recording: its URDF, and its frames (REP 105).

``odom`` holds ``base_link`` where the estimate has it, and ``ground_truth`` where the robot truly is; the axes of the
world frame are those of ``odom``. The links of the wheels turn in ``base_link``. The fixed links are in the URDF.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import cos, isfinite, sin

import numpy as np

from hil.addons.report.decimate import Decimator
from hil.addons.report.urdf import BASE_LINK, SCENE_PERIOD_S, WHEEL_LINKS, RobotShape, WheelAngles, pose
from hil.record.mcap_file import CDR_HEADER, LENGTH, STAMP, TIME, Definition, cdr_grown, cdr_string, definition
from hil.record.ring import Rows

ODOM, TRUTH = "odom", "ground_truth"
ROBOT_TOPIC, FRAMES_TOPIC = "/robot_description", "/tf"
_TRANSFORM = struct.Struct("<7d")
STRING = definition("std_msgs/msg/String", fields="string data")
TF_MESSAGE = definition(
    "tf2_msgs/msg/TFMessage",
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    ),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
    TIME,
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    fields="geometry_msgs/TransformStamped[] transforms",
)


_NEEDED = frozenset(f"{group}.{name}" for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad"))


class RobotFrames:
    """The robot's URDF, and its frames 50 times a second; a ``hil.record.viewing.Frames``, registered as ``frames``."""

    topics: Mapping[str, Definition] = {FRAMES_TOPIC: TF_MESSAGE, ROBOT_TOPIC: STRING}

    def __init__(self, column: Mapping[str, int], shape: RobotShape) -> None:
        self._urdf = shape.urdf()
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

    def begin(self, zero_unix_ns: int) -> Iterator[tuple[str, int, bytes]]:
        """Yield the message with the URDF."""
        yield ROBOT_TOPIC, zero_unix_ns, CDR_HEADER + cdr_string(self._urdf)

    def messages(self, rows: Rows, zero_unix_ns: int) -> Iterator[tuple[str, int, bytes]]:
        """Yield the frames at rows of shape (n, signals); a pose that is not known has none."""
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
                yield FRAMES_TOPIC, stamp_ns, self._estimated.message(stamp_ns, [_standing(*estimate), *links])
            if all(map(isfinite, truth)):
                yield FRAMES_TOPIC, stamp_ns, self._true.message(stamp_ns, [_standing(*truth)])


def _standing(x_m: float, y_m: float, heading_rad: float) -> tuple[float, ...]:
    """Return the transform to a frame on the floor, turned about z."""
    return x_m, y_m, 0.0, 0.0, 0.0, sin(heading_rad / 2), cos(heading_rad / 2)


class TransformMessages:
    """Makes the bytes of ``tf2_msgs/msg/TFMessage`` for the same frames again and again.

    Args:
        frames: parent and child of each transform.
    """

    def __init__(self, frames: Iterable[tuple[str, str]]) -> None:
        body = bytearray()
        self._stamps: list[int] = []
        self._transforms: list[int] = []
        pairs = list(frames)
        body += LENGTH.pack(len(pairs))
        for parent, child in pairs:
            self._stamps.append(cdr_grown(body, 4, STAMP.size))
            body += cdr_string(parent)
            cdr_grown(body, 4, 0)
            body += cdr_string(child)
            self._transforms.append(cdr_grown(body, 8, _TRANSFORM.size))
        self._body = body

    def message(self, stamp_ns: int, transforms: Iterable[Sequence[float]]) -> bytes:
        """Return a message at a Unix time; each transform is x, y, z [m] and the quaternion x, y, z, w."""
        stamp = divmod(stamp_ns, 1_000_000_000)
        for at in self._stamps:
            STAMP.pack_into(self._body, at, *stamp)
        for at, transform in zip(self._transforms, transforms, strict=True):
            _TRANSFORM.pack_into(self._body, at, *transform)
        return CDR_HEADER + bytes(self._body)
