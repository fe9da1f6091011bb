"""The robot as a recording draws it: a URDF with its own sizes, and the rollers of its wheels as meshes."""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt

from hil.core.kinematics import BodyTwist, wheel_speeds
from hil.core.types import WHEEL_NAMES, Wheels

Points = npt.NDArray[np.float64]

_TEMPLATES = Path(__file__).parent
_ROLLERS = 9
# Shares of the wheel's radius.
_ROLLER_RADIUS = 0.17
_ROLLER_LENGTH = 0.85
_WHEEL_WIDTH = 0.62
# A roller as it is drawn: rings along its axis, corners of a ring.
_RINGS = 3
_CORNERS = 6
_PLAIN_ACCELERATION_M_S2 = 0.5
_ROUND_TO = (5.0, 2.0, 1.0)


@dataclass(frozen=True, slots=True)
class RobotShape:
    """Sizes [m] and mass [kg] of a robot, from the scenario's ``[robot]``."""

    mass_kg: float
    wheel_radius_m: float
    half_length_m: float
    half_width_m: float

    @classmethod
    def of(cls, scenario: Mapping[str, object]) -> "RobotShape | None":
        """Return the shape by a scenario's values (by dotted key), or None when they lack a size."""
        values = [scenario.get(f"robot.{name}") for name in cls.__slots__]
        numbers = [float(value) for value in values if isinstance(value, int | float)]
        return cls(*numbers) if len(numbers) == len(values) else None

    @property
    def centres_m(self) -> Points:
        """Positions of the wheels in the body frame, shape (4, 2), in the order of ``WHEEL_NAMES``."""
        x, y = self.half_length_m, self.half_width_m
        return np.array([(x, y), (x, -y), (-x, -y), (-x, y)])

    @property
    def force_scale_m_n(self) -> float:
        """Length of a force arrow [m/N], rounded down to 1, 2 or 5 times a power of ten.

        The arrow of a force that gives the robot 0.5 m/s² is half as long as the robot.
        """
        exact = self.half_length_m / (_PLAIN_ACCELERATION_M_S2 * self.mass_kg)
        power = 10.0 ** math.floor(math.log10(exact))
        return next(digit for digit in _ROUND_TO if digit * power <= exact * (1 + 1e-9)) * power

    def urdf(self) -> str:
        """Return the URDF; ``write`` writes the meshes that it names."""
        radius = self.wheel_radius_m
        wheel_width = _WHEEL_WIDTH * radius
        length = 2 * self.half_length_m + 0.6 * radius
        width = max(2 * self.half_width_m - 1.3 * wheel_width, 0.5 * self.half_width_m)
        height = 0.9 * radius
        wheels = "".join(
            _template("robot_wheel.urdf").substitute(
                wheel=name,
                x_m=x,
                y_m=y,
                radius_m=radius,
                hub_radius_m=(1 - 2.1 * _ROLLER_RADIUS) * radius,
                hub_length_m=wheel_width,
                rollers=_SIDES[sideways],
            )
            for name, (x, y), sideways in zip(WHEEL_NAMES, self.centres_m, SIDEWAYS, strict=True)
        )
        return _template("robot.urdf").substitute(
            body_length_m=length,
            body_width_m=width,
            body_height_m=height,
            body_z_m=1.1 * radius,
            nose_length_m=0.12 * length,
            nose_width_m=0.7 * width,
            nose_height_m=0.3 * height,
            nose_x_m=0.44 * length,
            nose_z_m=1.1 * radius + 0.65 * height,
            wheels=wheels,
        )

    def write(self, directory: Path) -> Path:
        """Write the URDF and its meshes (binary STL) to a folder and return the path of the URDF."""
        for sign, side in _SIDES.items():
            (directory / f"rollers_{side}.stl").write_bytes(_stl(_rollers(self.wheel_radius_m, sign)))
        path = directory / "robot.urdf"
        path.write_text(self.urdf(), encoding="utf-8")
        return path


def drive_directions() -> Points:
    """Return the force of the rollers on the floor for a torque of 1 N·m at r = 1 m, shape (4, 2), body frame.

    Row i is the derivative of the body's force by the torque of wheel i, F = Hᵀ τ / r (``hil.core.kinematics``).
    """
    forward, left = (wheel_speeds(BodyTwist(*unit), 1.0, 1.0) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    return np.array([forward, left]).T


SIDEWAYS = Wheels(*drive_directions()[:, 1])
"""The side to which a wheel that drives forward also pushes the robot: 1 for left, -1 for right."""
_SIDES = {1.0: "left", -1.0: "right"}


def _template(name: str) -> Template:
    return Template((_TEMPLATES / name).read_text(encoding="utf-8"))


def _rollers(radius_m: float, sideways: float) -> Points:
    """Return the triangles of a wheel's rollers, shape (n, 3 corners, 3), about its centre, axle along y.

    The envelope of the rollers is a cylinder of the wheel's radius r: where a roller's axis, at 45 degrees to the axle,
    is s from its middle, its own radius is r - √((r - ρ)² + s² / 2), where ρ is its radius in the middle.
    """
    middle = (1 - _ROLLER_RADIUS) * radius_m
    along = np.linspace(-0.5, 0.5, _RINGS) * _ROLLER_LENGTH * radius_m
    thick = radius_m - np.sqrt(middle**2 + along**2 / 2)
    angle = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    axis = np.array([1.0, sideways, 0.0]) / math.sqrt(2)
    across = np.array([-sideways, 1.0, 0.0]) / math.sqrt(2)
    down = np.array([0.0, 0.0, -1.0])
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * down
    rings = middle * down + along[:, None, None] * axis + thick[:, None, None] * ring
    lowest = np.array([*_sides(rings), *_cap(rings[0]), *_cap(rings[-1][::-1])])
    turns = np.arange(_ROLLERS) * (2 * np.pi / _ROLLERS)
    return np.concatenate([lowest @ _about_y(turn).T for turn in turns])


def _sides(rings: Points) -> Points:
    """Return the triangles between each ring, shape (corners, 3), and the next one."""
    one, other = rings[:-1], rings[1:]
    one_next, other_next = np.roll(one, -1, axis=1), np.roll(other, -1, axis=1)
    pairs = [np.stack(corners, axis=2) for corners in ((one, other_next, one_next), (one, other, other_next))]
    return np.concatenate(pairs).reshape(-1, 3, 3)


def _cap(ring: Points) -> list[Points]:
    return [np.array([ring[0], ring[i], ring[i + 1]]) for i in range(1, _CORNERS - 1)]


def _about_y(angle_rad: float) -> Points:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([(c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)])


def _stl(triangles: Points) -> bytes:
    """Return triangles as binary STL: a header of 80 bytes, their number, then each with its normal."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    packed = np.zeros(len(triangles), dtype=[("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    packed["vectors"] = np.concatenate([normals[:, None], triangles], axis=1)
    return bytes(80) + struct.pack("<I", len(triangles)) + packed.tobytes()
