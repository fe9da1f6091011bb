"""The rollers of a Mecanum wheel as they are drawn: nine at 45 degrees to the axle, as cylinders or as a mesh.

A wheel turns about y. ``sideways`` is the side to which a wheel that rolls forward also pushes the robot: 1 for left,
-1 for right; the rollers on the floor lie along (1, sideways).
"""

import math
import struct

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

ROLLERS = 9
# Shares of the wheel's radius.
ROLLER_RADIUS = 0.17
_MESH_LENGTH = 0.85
_CYLINDER_RADIUS, _CYLINDER_LENGTH = 0.15, 0.72
# A roller of the mesh: rings along its axis, corners of a ring.
_RINGS = 3
_CORNERS = 6


def _visual(name: str, place: str, geometry: str) -> str:
    return (
        f'    <visual name="{name}">\n      <origin {place}/>\n      <geometry>{geometry}</geometry>\n'
        '      <material name="roller"/>\n    </visual>'
    )


def cylinders(radius_m: float, sideways: float) -> str:
    """Return the rollers of a wheel as ``visual`` elements of a URDF: cylinders whose ends reach the wheel's radius.

    A cylinder lies along z, and its pitch and yaw turn z to the roller's axis.
    """
    ring = math.sqrt((1 - _CYLINDER_RADIUS) ** 2 - (_CYLINDER_LENGTH / 2) ** 2 / 2) * radius_m
    sizes = f'radius="{_CYLINDER_RADIUS * radius_m:.10g}" length="{_CYLINDER_LENGTH * radius_m:.10g}"'
    visuals = []
    for number, turn in enumerate(_turns(), 1):
        x, y, z = _about_y(turn) @ _axis(sideways)
        xyz = " ".join(f"{value:.10g}" for value in _about_y(turn) @ (0.0, 0.0, -ring))
        place = f'xyz="{xyz}" rpy="0 {math.acos(z):.10g} {math.atan2(y, x):.10g}"'
        visuals.append(_visual(f"roller_{number}", place, f"<cylinder {sizes}/>"))
    return "\n".join(visuals)


def mesh_visual(file: str) -> str:
    """Return the ``visual`` element of a URDF for a wheel's rollers in a file that ``mesh`` fills."""
    return _visual("rollers", 'xyz="0 0 0"', f'<mesh filename="{file}"/>')


def mesh(radius_m: float, sideways: float) -> bytes:
    """Return the rollers of a wheel as one binary STL, rounder than cylinders are."""
    return _stl(_triangles(radius_m, sideways))


def _turns() -> Points:
    return np.linspace(0.0, 2 * np.pi, ROLLERS, endpoint=False)


def _axis(sideways: float) -> Points:
    """Return the axis of the roller on the floor."""
    return np.array([1.0, sideways, 0.0]) / math.sqrt(2)


def _triangles(radius_m: float, sideways: float) -> Points:
    """Return the triangles of a wheel's rollers, shape (n, 3 corners, 3), about its centre, axle along y.

    The envelope of the rollers is a cylinder of the wheel's radius r: where a roller's axis, at 45 degrees to the axle,
    is s from its middle, its own radius is r - √((r - ρ)² + s² / 2), where ρ is its radius in the middle.
    """
    middle = (1 - ROLLER_RADIUS) * radius_m
    along = np.linspace(-0.5, 0.5, _RINGS) * _MESH_LENGTH * radius_m
    thick = radius_m - np.sqrt(middle**2 + along**2 / 2)
    angle = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    axis = _axis(sideways)
    across = np.array([-sideways, 1.0, 0.0]) / math.sqrt(2)
    down = np.array([0.0, 0.0, -1.0])
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * down
    rings = middle * down + along[:, None, None] * axis + thick[:, None, None] * ring
    lowest = np.array([*_sides(rings), *_cap(rings[0]), *_cap(rings[-1][::-1])])
    return np.concatenate([lowest @ _about_y(turn).T for turn in _turns()])


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
