"""What the viewer draws of a run besides its signals: trails of the robot, and the robot itself in 3D.

The reference, the estimate and the truth each leave a trail on the floor of the 3D scene and in the plan. A trail has
one segment for each time, so a view shows the part that its time range covers.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import rerun as rr

from hil.addons.report.decimate import Decimator
from hil.addons.report.urdf import (
    BASE_LINK,
    SCENE_PERIOD_S,
    WHEEL_LINKS,
    RobotShape,
    WheelAngles,
    drive_directions,
    pose,
)
from hil.core.types import WHEEL_NAMES
from hil.pages.plots import (
    ALARM_COLOUR,
    ESTIMATE_COLOUR,
    REFERENCE_COLOUR,
    TRUTH_COLOUR,
    WHEEL_COLOURS,
    X_COLOUR,
    Y_COLOUR,
    Colour,
)
from hil.record.ring import Rows
from hil.record.stream import Times, indexes

_GAP_S = 0.1
_GAP_PERIODS = 10.0


class Gaps:
    """Finds rows that do not follow those before them: more than 0.1 s and ten periods later, across calls too."""

    def __init__(self) -> None:
        self._last_s = np.nan

    def __call__(self, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Return for ascending times [s] of shape (n,) which are after a gap."""
        steps = np.diff(t_s, prepend=self._last_s)
        self._last_s = t_s[-1]
        period_s = np.median(steps[1:]) if len(steps) > 1 else 0.0
        found: npt.NDArray[np.bool_] = steps > max(_GAP_S, _GAP_PERIODS * period_s)
        return found


def drawn_pose(rows: Rows, column: Mapping[str, int]) -> Rows:
    """Return where the robot is drawn: at the truth, or at the estimate where there is no truth; shape (n, 3)."""
    truth = pose(rows, column, "truth")
    known = np.isfinite(truth).all(axis=1, keepdims=True)
    return np.where(known, truth, pose(rows, column, "pose"))


def turned(vectors: Rows, heading_rad: Rows) -> Rows:
    """Turn vectors of shape (n, k, 2), or (1, k, 2) for all, from the body frame into the world frame.

    Headings have shape (n,).
    """
    cosine, sine = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _strips(points: Rows) -> pa.Array:
    """Return lines of shape (n, points, 2 or 3) as rerun stores them. It would look into each line, for 0.1 ms."""
    count, each, axes = points.shape
    kind = (rr.components.LineStrip2DBatch if axes == 2 else rr.components.LineStrip3DBatch)([]).as_arrow_array().type
    flat = pa.array(points.reshape(-1), pa.float32())
    places = pa.array(np.arange(0, each * count + 1, each), pa.int32())
    return pa.ListArray.from_arrays(places, pa.FixedSizeListArray.from_arrays(flat, type=kind.value_type), type=kind)


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
        self._gaps = Gaps()
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
        """Draw rows of shape (n, signals)."""
        keep = self._decimator.keep(times[:, 0])
        if not len(keep):
            return
        rows, times = rows[keep], times[keep]
        follows = ~self._gaps(times[:, 0])
        for order, (name, group, _, _) in enumerate(TRAILS):
            points = rows[:, [self._column[f"{group}.x_m"], self._column[f"{group}.y_m"]]]
            self._trail(name, points, times, order, follows)
        poses = drawn_pose(rows, self._column)
        seen = np.isfinite(poses).all(axis=1)
        if seen.any():
            poses = poses[seen]
            outlines = poses[:, None, :2] + turned(_BODY_M[None], poses[:, 2])
            bodies = rr.LineStrips2D.columns(strips=_strips(outlines))
            self._rerun.send_columns(f"{PLAN}/robot", indexes(times[seen]), bodies)

    def _trail(self, name: str, points: Rows, times: Times, order: int, follows: npt.NDArray[np.bool_]) -> None:
        ends = np.vstack([self._end.get(name, points[0]), points])
        self._end[name] = points[-1]
        segments = np.stack([ends[:-1], ends[1:]], axis=1)
        seen = np.isfinite(segments).all(axis=(1, 2)) & follows
        if not seen.any():
            return
        segments, index = segments[seen], indexes(times[seen])
        self._rerun.send_columns(f"{PLAN}/{name}", index, rr.LineStrips2D.columns(strips=_strips(segments)))
        solid = rr.LineStrips3D.columns(strips=_strips(_raised(segments, (order + 1) * _FLOOR_STEP_M)))
        self._rerun.send_columns(f"{FLOOR}/{name}", index, solid)


SCENE = "/world"
BODY = f"{SCENE}/robot/{BASE_LINK}/body"
"""The camera follows this entity."""

_ABOVE_WHEEL = 2.15
"""Height of the force arrows over the floor, in wheel radii."""


class Scene:
    """Draws the robot at 50 Hz.

    The force of a wheel is F = Hᵀ τ / r (``hil.core.kinematics``), where τ is the torque of this wheel alone, by its
    motor current. So the four arrows add up to the force on the body.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        column: Mapping[str, int],
        shape: RobotShape,
        torque_constant_n_m_a: float | None,
    ) -> None:
        self._rerun = recording
        self._column = column
        self._shape = shape
        self._torque_constant = torque_constant_n_m_a
        self._angles = WheelAngles(column)
        self._currents = [column[f"wheel.{wheel}.current_a"] for wheel in WHEEL_NAMES]
        self._decimator = Decimator(SCENE_PERIOD_S)

    def describe(self) -> None:
        """Log what does not change: the robot's shape, colours and sizes."""
        self._rerun.log(SCENE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        draw_robot(self._rerun, self._shape, f"{SCENE}/robot")
        thick = self._shape.wheel_radius_m * 0.12
        names = [wheel.upper() for wheel in WHEEL_NAMES]
        forces = rr.Arrows3D.from_fields(colors=WHEEL_COLOURS, radii=[thick], labels=names, show_labels=True)
        self._rerun.log(f"{SCENE}/force", forces, static=True)
        for name, colour in (("error", ALARM_COLOUR), ("reference", REFERENCE_COLOUR)):
            self._rerun.log(f"{SCENE}/{name}", rr.Arrows3D.from_fields(colors=[colour], radii=[thick]), static=True)

    def rows(self, rows: Rows, times: Times) -> None:
        """Draw rows of shape (n, signals)."""
        angles = self._angles(rows, times[:, 0])
        keep = self._decimator.keep(times[:, 0])
        keep = keep[np.isfinite(drawn_pose(rows[keep], self._column)).all(axis=1)]
        if not len(keep):
            return
        rows, times = rows[keep], times[keep]
        drawn = drawn_pose(rows, self._column)
        self._robot(drawn, angles[keep], times)
        self._forces(drawn, rows, times)
        self._reference(drawn, pose(rows, self._column, "reference"), times)

    def _robot(self, poses: Rows, angles_rad: Rows, times: Times) -> None:
        index, half = indexes(times), poses[:, 2] / 2
        zero = np.zeros(len(poses))
        columns = rr.Transform3D.columns(
            translation=np.stack([poses[:, 0], poses[:, 1], zero], axis=1),
            quaternion=np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1),
            parent_frame=[f"tf#{SCENE}"] * len(poses),
            child_frame=[BASE_LINK] * len(poses),
        )
        self._rerun.send_columns(f"{SCENE}/pose", index, columns)
        for number, (wheel, angle) in enumerate(zip(WHEEL_NAMES, angles_rad.T, strict=True)):
            self._rerun.send_columns(f"{SCENE}/wheel/{wheel}", index, turned_wheels(self._shape, number, angle))

    def _forces(self, poses: Rows, rows: Rows, times: Times) -> None:
        if self._torque_constant is None:
            return
        torques = rows[:, self._currents] * self._torque_constant
        known = np.isfinite(torques).all(axis=1)
        if not known.any():
            return
        poses, torques = poses[known], torques[known]
        scale = self._shape.force_scale_m_n / self._shape.wheel_radius_m
        vectors = turned(torques[:, :, None] * drive_directions() * scale, poses[:, 2])
        origins = poses[:, None, :2] + turned(self._shape.centres_m[None], poses[:, 2])
        height_m = _ABOVE_WHEEL * self._shape.wheel_radius_m
        self._arrows("force", _raised(origins, height_m), _raised(vectors, 0.0), times[known])

    def _reference(self, poses: Rows, reference: Rows, times: Times) -> None:
        """Draw the reference as an arrow along its heading, and the error as one from it to the robot."""
        known = np.isfinite(reference).all(axis=1)
        if not known.any():
            return
        poses, reference, times = poses[known], reference[known], times[known]
        height = 3 * self._shape.wheel_radius_m
        origins = _raised(reference[:, None, :2], height)
        nose = turned(np.array([[[self._shape.half_length_m, 0.0]]]), reference[:, 2])
        self._arrows("reference", origins, _raised(nose, 0.0), times)
        self._arrows("error", origins, _raised((poses - reference)[:, None, :2], 0.0), times)

    def _arrows(self, name: str, origins: Rows, vectors: Rows, times: Times) -> None:
        """Log arrows of shape (n, k, 3)."""
        count = vectors.shape[1]
        columns = rr.Arrows3D.columns(origins=origins.reshape(-1, 3), vectors=vectors.reshape(-1, 3))
        self._rerun.send_columns(f"{SCENE}/{name}", indexes(times), columns.partition([count] * len(vectors)))


def _raised(points: Rows, height_m: float) -> Rows:
    """Add a height to points of shape (..., 2)."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height_m)], axis=-1)


_STATIC_FRAMES = "/tf_static"


def draw_robot(recording: rr.RecordingStream, shape: RobotShape, path: str) -> None:
    """Log the robot below the entity ``path``, each link in its frame, and the links at rest.

    This reads what ``RobotShape.urdf`` makes: boxes and cylinders with a colour. rerun's own reader of URDFs would make
    three times as many entities as a run has besides.
    """
    robot = ElementTree.fromstring(shape.urdf())
    recording.log(path, rr.CoordinateFrame(BASE_LINK), static=True)
    colours = {_of(one, "name"): _rgba(_of(one.find("color"), "rgba")) for one in robot.findall("material")}
    for link in robot.findall("link"):
        frame, entity = rr.CoordinateFrame(_of(link, "name")), f"{path}/{_of(link, 'name')}"
        for box in (one for one in link.findall("visual") if one.find("geometry/box") is not None):
            recording.log(f"{entity}/{_of(box, 'name')}", _bodies("box", [box], colours), frame, static=True)
        if cylinders := [one for one in link.findall("visual") if one.find("geometry/cylinder") is not None]:
            recording.log(f"{entity}/cylinder", _bodies("cylinder", cylinders, colours), frame, static=True)
    joints = robot.findall("joint")
    origins = [_origin(joint) for joint in joints]
    columns = rr.Transform3D.columns(
        translation=[place for place, _ in origins],
        quaternion=[turn for _, turn in origins],
        parent_frame=[_of(joint.find("parent"), "link") for joint in joints],
        child_frame=[_of(joint.find("child"), "link") for joint in joints],
    )
    recording.send_columns(_STATIC_FRAMES, [], columns)


def turned_wheels(shape: RobotShape, wheel: int, angles_rad: npt.NDArray[np.float64]) -> Any:
    """Return rerun's columns for a wheel's frame, turned about its axle by angles of shape (n,)."""
    half, zero = np.remainder(angles_rad, 2 * np.pi) / 2, np.zeros(len(angles_rad))
    return rr.Transform3D.columns(
        translation=np.tile([*shape.centres_m[wheel], shape.wheel_radius_m], (len(half), 1)),
        quaternion=np.stack([zero, np.sin(half), zero, np.cos(half)], axis=1),
        parent_frame=[BASE_LINK] * len(half),
        child_frame=[WHEEL_LINKS[wheel]] * len(half),
    )


def _of(element: ElementTree.Element | None, name: str) -> str:
    assert element is not None
    return element.attrib[name]


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def _rgba(text: str) -> list[int]:
    """Return a colour as rerun has it, in sRGB. A URDF's is taken for a linear one, as rerun's reader takes it."""
    *colour, alpha = _numbers(text)
    return [round(255 * share) for share in (*(1.055 * one ** (1 / 2.4) - 0.055 for one in colour), alpha)]


def _origin(element: ElementTree.Element) -> tuple[list[float], list[float]]:
    """Return position and quaternion (x, y, z, w) of an element."""
    origin = element.find("origin")
    assert origin is not None
    angles = _numbers(origin.get("rpy", "0 0 0"))
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in angles)
    turn = [sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
    return _numbers(origin.get("xyz", "0 0 0")), [*turn, cr * cp * cy + sr * sp * sy]


def _bodies(
    kind: str, visuals: Sequence[ElementTree.Element], colours: Mapping[str, list[int]]
) -> rr.Boxes3D | rr.Cylinders3D:
    """Return boxes or cylinders as one entity."""
    shapes = [one.find(f"geometry/{kind}") for one in visuals]
    centers, quaternions = zip(*map(_origin, visuals), strict=True)
    style: dict[str, Any] = {"colors": [colours[_of(one.find("material"), "name")] for one in visuals]}
    style |= {"centers": centers, "quaternions": quaternions}
    if kind == "box":
        return rr.Boxes3D(sizes=[_numbers(_of(one, "size")) for one in shapes], **style)
    lengths, radii = ([float(_of(one, name)) for one in shapes] for name in ("length", "radius"))
    return rr.Cylinders3D(lengths=lengths, radii=radii, fill_mode=rr.components.FillMode.Solid, **style)
