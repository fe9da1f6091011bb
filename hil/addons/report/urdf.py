"""The robot as a URDF, without masses: drawn by recordings, Foxglove and RViz."""

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
from hil.core.types import WHEEL_NAMES, Wheels
from hil.record.ring import Rows

if TYPE_CHECKING:
    from hil.core.model import RobotModel  # it loads the library of the wire, which a recorder does not need

Points = npt.NDArray[np.float64]

BASE_LINK = "base_link"
_PLACES = ("front_left", "front_right", "rear_right", "rear_left")
WHEEL_LINKS = tuple(f"{place}_wheel_link" for place in _PLACES)
WHEEL_JOINTS = tuple(f"{place}_wheel_joint" for place in _PLACES)
"""Links and joints of the wheels in the order of ``WHEEL_NAMES``."""

ROLLERS = 9
_TEMPLATES = Path(__file__).parent
# Shares of the wheel's radius.
_WHEEL_WIDTH, _HUB_RADIUS = 0.62, 0.643
_ROLLER_RADIUS, _ROLLER_LENGTH = 0.15, 0.72
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

    @classmethod
    def of_model(cls, robot: "RobotModel") -> "RobotShape":
        """Return the shape of a robot."""
        return cls(robot.mass_kg, robot.wheel_radius_m, robot.half_length_m, robot.half_width_m)

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

    def urdf(self, name: str = "robot") -> str:
        """Return the URDF, in one file with cylinders as rollers."""
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
                hub_radius_m=_HUB_RADIUS * radius,
                width_m=self.wheel_width_m,
                rollers=_rollers(radius, sideways),
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
            wheels=wheels,
        )


def drive_directions() -> Points:
    """Return the force of the rollers on the floor for a torque of 1 N·m at r = 1 m, shape (4, 2), body frame.

    Row i is the derivative of the body's force by the torque of wheel i, F = Hᵀ τ / r (``hil.core.kinematics``).
    """
    forward, left = (wheel_speeds(BodyTwist(*unit), 1.0, 1.0) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    return np.array([forward, left]).T


SIDEWAYS = Wheels(*drive_directions()[:, 1])
"""The side to which a wheel that drives forward also pushes the robot: 1 for left, -1 for right."""


def _template(name: str) -> Template:
    return Template((_TEMPLATES / name).read_text(encoding="utf-8"))


def _rollers(radius_m: float, sideways: float) -> str:
    """Return the rollers of a wheel as ``visual`` elements of a URDF: cylinders whose ends reach the wheel's radius.

    A wheel turns about y, and its rollers are at 45 degrees to the axle. ``sideways`` is the side to which a wheel that
    rolls forward also pushes the robot; the roller on the floor lies along (1, sideways). A cylinder lies along z, and
    its pitch and yaw turn z to the roller's axis.
    """
    ring = math.sqrt((1 - _ROLLER_RADIUS) ** 2 - (_ROLLER_LENGTH / 2) ** 2 / 2) * radius_m
    sizes = f'radius="{_ROLLER_RADIUS * radius_m:.10g}" length="{_ROLLER_LENGTH * radius_m:.10g}"'
    visuals = []
    for number in range(ROLLERS):
        turn = 2 * math.pi * number / ROLLERS
        c, s = math.cos(turn), math.sin(turn)
        xyz = f"{-s * ring:.10g} 0 {-c * ring:.10g}"
        x, y, z = (share / math.sqrt(2) for share in (c, sideways, -s))
        visuals.append(
            f'    <visual name="roller_{number + 1}">\n'
            f'      <origin xyz="{xyz}" rpy="0 {math.acos(z):.10g} {math.atan2(y, x):.10g}"/>\n'
            f'      <geometry><cylinder {sizes}/></geometry>\n      <material name="roller"/>\n    </visual>'
        )
    return "\n".join(visuals)


SCENE_PERIOD_S = 0.02
"""The robot is shown once in this time."""


def pose(rows: Rows, column: Mapping[str, int], group: str) -> Rows:
    """Return a group's x [m], y [m] and heading [rad], shape (n, 3)."""
    return rows[:, [column[f"{group}.{name}"] for name in ("x_m", "y_m", "heading_rad")]]


class WheelAngles:
    """Angles of the wheels: the integral of their speeds at full rate, since the first row, also across calls."""

    def __init__(self, column: Mapping[str, int]) -> None:
        self._speeds = [column[f"wheel.{wheel}.speed_rad_s"] for wheel in WHEEL_NAMES]
        self._angles_rad = np.zeros(len(WHEEL_NAMES))
        self._last_s: float | None = None

    def __call__(self, rows: Rows, t_s: npt.NDArray[np.float64]) -> Rows:
        """Return the angles [rad] at rows with these times [s], shape (n, 4); a wheel of unknown speed stands still."""
        before = t_s[0] if self._last_s is None else self._last_s
        steps = np.maximum(np.diff(t_s, prepend=before), 0.0)
        angles: Rows = self._angles_rad + np.cumsum(np.nan_to_num(rows[:, self._speeds]) * steps[:, None], axis=0)
        self._angles_rad, self._last_s = angles[-1], float(t_s[-1])
        return angles
