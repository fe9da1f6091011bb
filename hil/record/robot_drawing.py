"""Draws the robot of a URDF in a recording.

rerun's own reader of URDFs wants them in a folder, which a recorder that is killed meanwhile would leave behind.
"""

import math
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.record.robot_model import BASE_LINK, WHEEL_LINKS, RobotShape

_STATIC_FRAMES = "/tf_static"


def draw_robot(recording: rr.RecordingStream, shape: RobotShape, path: str) -> None:
    """Log the robot's visuals below the entity ``path``, each in the frame of its link, and the links at rest.

    It reads what ``RobotShape.drawn`` makes: boxes, cylinders and meshes with a colour, turned about x if at all.
    """
    text, meshes = shape.drawn()
    robot = ElementTree.fromstring(text)
    colours = {_of(one, "name"): _rgba(_of(one.find("color"), "rgba")) for one in robot.findall("material")}
    recording.log(path, rr.CoordinateFrame(BASE_LINK), static=True)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            colour = colours[_of(visual.find("material"), "name")]
            entity = f"{path}/visual_geometries/{_of(link, 'name')}/{_of(visual, 'name')}"
            place, turn = _origin(visual)
            poses = rr.InstancePoses3D(translations=[place], quaternions=[turn])
            body = _body(visual.find("geometry/*"), colour, meshes)
            recording.log(entity, body, poses, rr.CoordinateFrame(_of(link, "name")), static=True)
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
    roll, *_ = _numbers(origin.get("rpy", "0 0 0"))
    return _numbers(origin.get("xyz", "0 0 0")), [math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2)]


def _body(geometry: ElementTree.Element | None, colour: list[int], meshes: Mapping[str, bytes]) -> rr.AsComponents:
    assert geometry is not None
    if geometry.tag == "mesh":
        return rr.Asset3D(contents=meshes[geometry.attrib["filename"]], media_type="model/stl", albedo_factor=colour)
    if geometry.tag == "box":
        return rr.Boxes3D.from_fields(
            half_sizes=[[size / 2 for size in _numbers(_of(geometry, "size"))]], colors=[colour]
        )
    length, radius = (float(_of(geometry, name)) for name in ("length", "radius"))
    return rr.Cylinders3D.from_fields(lengths=[length], radii=[radius], colors=[colour])
