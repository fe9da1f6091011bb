"""The robot in 3D: its URDF on the floor with turning wheels, the reference, the error, and the wheels' forces."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from hil.core.types import WHEEL_NAMES
from hil.record.decimate import Decimator
from hil.record.layout import ALARM_COLOUR, REFERENCE_COLOUR, WHEEL_COLOURS
from hil.record.poses import drawn_pose, pose, turned
from hil.record.ring import Rows
from hil.record.robot_model import RobotShape, drive_directions
from hil.record.timeline import Times, indexes

SCENE = "/world"
BODY = f"{SCENE}/robot/visual_geometries/base_link/body"
"""What the eye follows."""

SCENE_PERIOD_S = 0.02
_ABOVE_WHEEL = 2.15
"""Height of the force arrows over the floor, in wheel radii."""


class Scene:
    """Draws the robot at 50 Hz; wheel angles are the integral of the wheel speeds at full rate.

    A wheel's force is what its motor current gives at the rollers on the floor, F = Hᵀ τ / r with τ of this wheel alone
    (``hil.core.kinematics``): the four arrows add up to the force on the body.
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
        self._speeds = [column[f"wheel.{wheel}.speed_rad_s"] for wheel in WHEEL_NAMES]
        self._currents = [column[f"wheel.{wheel}.current_a"] for wheel in WHEEL_NAMES]
        self._decimator = Decimator(SCENE_PERIOD_S)
        self._angles_rad = np.zeros(len(WHEEL_NAMES))
        self._last_s: float | None = None
        self._joints: dict[str, rr.urdf.UrdfJoint] = {}

    def describe(self) -> None:
        """Log the robot and what else does not change."""
        self._rerun.log(SCENE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        with tempfile.TemporaryDirectory() as directory:
            path = self._shape.write(Path(directory))
            tree = rr.urdf.UrdfTree.from_file_path(path, entity_path_prefix=SCENE.strip("/"))
            tree.log_urdf_to_recording(self._rerun)
        self._joints = {joint.name: joint for joint in tree.joints()}
        thick = self._shape.wheel_radius_m * 0.12
        names = [wheel.upper() for wheel in WHEEL_NAMES]
        forces = rr.Arrows3D.from_fields(colors=WHEEL_COLOURS, radii=[thick], labels=names, show_labels=True)
        self._rerun.log(f"{SCENE}/force", forces, static=True)
        error = rr.Arrows3D.from_fields(colors=[ALARM_COLOUR], radii=[thick])
        self._rerun.log(f"{SCENE}/error", error, static=True)
        reference = rr.Arrows3D.from_fields(colors=[REFERENCE_COLOUR], radii=[thick])
        self._rerun.log(f"{SCENE}/reference", reference, static=True)

    def rows(self, rows: Rows, times: Times) -> None:
        """Draw what rows of shape (n, signals) add."""
        angles = self._turn(rows[:, self._speeds], times[:, 0])
        keep = self._decimator.keep(times[:, 0])
        known = np.isfinite(drawn_pose(rows[keep], self._column)).all(axis=1)
        if not known.any():
            return
        keep = keep[known]
        rows, times = rows[keep], times[keep]
        drawn = drawn_pose(rows, self._column)
        self._robot(drawn, angles[keep], times)
        self._forces(drawn, rows, times)
        self._reference(drawn, pose(rows, self._column, "reference"), times)

    def _turn(self, speeds_rad_s: Rows, t_s: Rows) -> Rows:
        """Return the wheel angles at each row [rad], shape (n, 4); a wheel whose speed is not known stands."""
        before = t_s[0] if self._last_s is None else self._last_s
        steps = np.maximum(np.diff(t_s, prepend=before), 0.0)
        angles: Rows = self._angles_rad + np.cumsum(np.nan_to_num(speeds_rad_s) * steps[:, None], axis=0)
        self._angles_rad, self._last_s = angles[-1], float(t_s[-1])
        return angles

    def _robot(self, poses: Rows, angles_rad: Rows, times: Times) -> None:
        index, half = indexes(times), poses[:, 2] / 2
        zero = np.zeros(len(poses))
        columns = rr.Transform3D.columns(
            translation=np.stack([poses[:, 0], poses[:, 1], zero], axis=1),
            quaternion=np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1),
            parent_frame=[f"tf#{SCENE}"] * len(poses),
            child_frame=["base_link"] * len(poses),
        )
        self._rerun.send_columns(f"{SCENE}/pose", indexes=index, columns=columns)
        for wheel, angle in zip(WHEEL_NAMES, angles_rad.T, strict=True):
            turned_wheel = self._joints[wheel].compute_transform_columns(np.remainder(angle, 2 * np.pi))
            self._rerun.send_columns(f"{SCENE}/wheel/{wheel}", indexes=index, columns=turned_wheel)

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
        places = np.broadcast_to(self._shape.centres_m, vectors.shape)
        origins = poses[:, None, :2] + turned(places, poses[:, 2])
        self._arrows(
            "force", _raised(origins, _ABOVE_WHEEL * self._shape.wheel_radius_m), _raised(vectors, 0.0), times[known]
        )

    def _reference(self, poses: Rows, reference: Rows, times: Times) -> None:
        """Draw the reference as an arrow along its heading, and the error as one from it to the robot."""
        known = np.isfinite(reference).all(axis=1)
        if not known.any():
            return
        poses, reference, times = poses[known], reference[known], times[known]
        height = 3 * self._shape.wheel_radius_m
        origins = _raised(reference[:, None, :2], height)
        nose = np.broadcast_to(np.array([[self._shape.half_length_m, 0.0]]), (len(reference), 1, 2))
        self._arrows("reference", origins, _raised(turned(nose, reference[:, 2]), 0.0), times)
        self._arrows("error", origins, _raised((poses - reference)[:, None, :2], 0.0), times)

    def _arrows(self, name: str, origins: Rows, vectors: Rows, times: Times) -> None:
        """Log arrows of shape (n, k, 3)."""
        count = vectors.shape[1]
        columns = rr.Arrows3D.columns(origins=origins.reshape(-1, 3), vectors=vectors.reshape(-1, 3))
        self._rerun.send_columns(
            f"{SCENE}/{name}", indexes=indexes(times), columns=columns.partition([count] * len(vectors))
        )


def _raised(points: Rows, height_m: float) -> Rows:
    """Add a height to points of shape (..., 2)."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height_m)], axis=-1)
