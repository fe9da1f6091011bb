"""How the mass of a robot is shared between its body and its wheels: a URDF wants the inertia of each link.

``[robot]`` gives three facts, which hold exactly: the mass m and the yaw inertia I of the whole robot, and the inertia
Ib of a wheel about its axle, with its motor. The rest is chosen. A wheel is a disc of 2 Ib / r², but all four have at
most half of m and of I: with a geared motor Ib is more than the wheel's mass explains. The body's centre of mass is in
its middle, and its moments have the ratios of a uniform box.
"""

from math import hypot
from typing import TYPE_CHECKING, NamedTuple

from hil.core.errors import BadInputError

if TYPE_CHECKING:
    from hil.core.model import RobotModel  # see robot_model.py

_MOST = 0.5
"""The share of m and of I that the four wheels have at most."""


class Inertia(NamedTuple):
    """Mass of a link, and its moments of inertia about the axes through its centre of mass."""

    mass_kg: float
    x_kg_m2: float
    y_kg_m2: float
    z_kg_m2: float

    def urdf(self) -> str:
        """Return the ``inertial`` element of a URDF; the centre of mass is the origin of the link's frame."""
        return (
            f'    <inertial>\n      <mass value="{self.mass_kg}"/>\n'
            f'      <inertia ixx="{self.x_kg_m2}" iyy="{self.y_kg_m2}" izz="{self.z_kg_m2}" ixy="0" ixz="0" iyz="0"/>\n'
            "    </inertial>"
        )


class Inertias(NamedTuple):
    """The body and one wheel, whose axle is y."""

    body: Inertia
    wheel: Inertia


def inertias(robot: "RobotModel", body_m: tuple[float, float, float], wheel_width_m: float) -> Inertias:
    """Return the inertias of a robot whose body has this length, width and height.

    Raises BadInputError for a robot whose wheels leave nothing for the body, or have no inertia.
    """
    axial, yaw = robot.wheel_inertia_kg_m2, robot.inertia_kg_m2
    if not axial > 0.0:
        raise BadInputError(
            f"robot.wheel_inertia_kg_m2 = {axial:g}: the wheels of a URDF turn, so they need an inertia; "
            "expected more than 0"
        )
    wheels = robot.half_length_m**2 + robot.half_width_m**2
    # About the upright a disc has half of its inertia about the axle, and more with its width.
    left = _MOST * yaw - 4 * axial / 2
    if not left > 0.0:
        raise BadInputError(
            f"robot.inertia_kg_m2 = {yaw:g}: four wheels of wheel_inertia_kg_m2 = {axial:g} leave too little for "
            f"the body; expected more than {4 * axial:g}"
        )
    mass = min(
        2 * axial / robot.wheel_radius_m**2, _MOST * robot.mass_kg / 4, left / (4 * (wheels + wheel_width_m**2 / 12))
    )
    across = axial / 2 + mass * wheel_width_m**2 / 12
    body_yaw = yaw - 4 * (across + mass * wheels)
    length, width, height = body_m
    ratio = body_yaw / hypot(length, width) ** 2
    body = Inertia(
        robot.mass_kg - 4 * mass, ratio * hypot(width, height) ** 2, ratio * hypot(length, height) ** 2, body_yaw
    )
    return Inertias(body, Inertia(mass, across, axial, across))
