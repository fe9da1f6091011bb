"""The robot as a URDF: drawn by recordings, Foxglove and RViz, simulated with the masses and inertias of [robot]."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hil.core.kinematics import BodyTwist, wheel_speeds
from hil.core.types import Wheels
from hil.record.inertias import Inertia, Inertias, inertias
from hil.record.rollers import ROLLER_RADIUS, cylinders, mesh, mesh_visual

if TYPE_CHECKING:
    from hil.core.model import RobotModel  # it loads the library of the wire, which a recorder does not need

Points = npt.NDArray[np.float64]

BASE_LINK = "base_link"
_PLACES = ("front_left", "front_right", "rear_right", "rear_left")
WHEEL_LINKS = tuple(f"{place}_wheel_link" for place in _PLACES)
WHEEL_JOINTS = tuple(f"{place}_wheel_joint" for place in _PLACES)
"""Links and joints of the wheels in the order of ``WHEEL_NAMES``."""

_TEMPLATES = Path(__file__).parent
_WHEEL_WIDTH = 0.62  # of its radius
_PLAIN_ACCELERATION_M_S2 = 0.5
_ROUND_TO = (5.0, 2.0, 1.0)


@dataclass(frozen=True, slots=True)
class RobotShape:
    """Sizes [m] and mass [kg] of a robot, from the scenario's ``[robot]``; the body is drawn to fit them."""

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
    def wheel_width_m(self) -> float:
        """Width of a wheel as it is drawn."""
        return _WHEEL_WIDTH * self.wheel_radius_m

    @property
    def body_m(self) -> tuple[float, float, float]:
        """Length, width and height of the body as it is drawn."""
        width = max(2 * self.half_width_m - 1.3 * self.wheel_width_m, 0.5 * self.half_width_m)
        return 2 * self.half_length_m + 0.6 * self.wheel_radius_m, width, 0.9 * self.wheel_radius_m

    @property
    def force_scale_m_n(self) -> float:
        """Length of a force arrow [m/N], rounded down to 1, 2 or 5 times a power of ten.

        The arrow of a force that gives the robot 0.5 m/s² is half as long as the robot.
        """
        exact = self.half_length_m / (_PLAIN_ACCELERATION_M_S2 * self.mass_kg)
        power = 10.0 ** math.floor(math.log10(exact))
        return next(digit for digit in _ROUND_TO if digit * power <= exact * (1 + 1e-9)) * power

    def urdf(self, name: str = "robot", solid: Inertias | None = None) -> str:
        """Return the URDF, in one file with cylinders as rollers. Without inertias it is for drawing alone."""
        return self._urdf(name, solid, {side: cylinders(self.wheel_radius_m, side) for side in _SIDES})

    def drawn(self) -> tuple[str, dict[str, bytes]]:
        """Return the URDF with meshes as rollers, and these (binary STL) by the names of their files."""
        files = {side: f"rollers_{word}.stl" for side, word in _SIDES.items()}
        meshes = {file: mesh(self.wheel_radius_m, side) for side, file in files.items()}
        return self._urdf("robot", None, {side: mesh_visual(file) for side, file in files.items()}), meshes

    def _urdf(self, name: str, solid: Inertias | None, rollers: Mapping[float, str]) -> str:
        """Return the URDF; ``rollers`` are the visuals of a wheel's rollers by the key of ``_SIDES``."""
        radius = self.wheel_radius_m
        length, width, height = self.body_m
        middle = 1.1 * radius
        wheels = "".join(
            _template("robot_wheel.urdf").substitute(
                joint=joint,
                link=link,
                x_m=x,
                y_m=y,
                radius_m=radius,
                hub_radius_m=(1 - 2.1 * ROLLER_RADIUS) * radius,
                width_m=self.wheel_width_m,
                rollers=rollers[sideways],
                solid="" if solid is None else _solid_wheel(solid.wheel, radius, self.wheel_width_m),
            )
            for joint, link, (x, y), sideways in zip(WHEEL_JOINTS, WHEEL_LINKS, self.centres_m, SIDEWAYS, strict=True)
        )
        return _template("robot.urdf").substitute(
            name=escape(name),
            body_length_m=length,
            body_width_m=width,
            body_height_m=height,
            body_z_m=middle,
            nose_length_m=0.12 * length,
            nose_width_m=0.7 * width,
            nose_height_m=0.3 * height,
            nose_x_m=0.44 * length,
            nose_z_m=middle + 0.65 * height,
            solid="" if solid is None else _solid_body(solid.body, self.body_m, middle),
            wheels=wheels,
        )


def robot_description(robot: "RobotModel", name: str) -> str:
    """Return the URDF of a robot with its masses and inertias. Raises BadInputError as ``inertias``."""
    shape = RobotShape(robot.mass_kg, robot.wheel_radius_m, robot.half_length_m, robot.half_width_m)
    return shape.urdf(name, inertias(robot, shape.body_m, shape.wheel_width_m))


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


def _solid_body(inertia: Inertia, size_m: tuple[float, float, float], middle_m: float) -> str:
    """Return the link that has the body's inertia and collisions.

    It is not base_link: KDL, with which robot_state_publisher computes, ignores the inertia of a root.
    """
    box = '<box size="{} {} {}"/>'.format(*size_m)
    return (
        '  <joint name="body_joint" type="fixed">\n    <parent link="base_link"/>\n    <child link="body_link"/>\n'
        f'    <origin xyz="0 0 {middle_m}"/>\n  </joint>\n  <link name="body_link">\n'
        f"    <collision>\n      <geometry>{box}</geometry>\n    </collision>\n{inertia.urdf()}\n  </link>\n"
    )


def _solid_wheel(inertia: Inertia, radius_m: float, width_m: float) -> str:
    """Return what a wheel's link needs to be simulated: a cylinder, since a URDF knows no rollers that roll."""
    cylinder = f'<cylinder radius="{radius_m}" length="{width_m}"/>'
    return (
        f'    <collision>\n      <origin rpy="{math.pi / 2} 0 0"/>\n      <geometry>{cylinder}</geometry>\n'
        f"    </collision>\n{inertia.urdf()}"
    )
