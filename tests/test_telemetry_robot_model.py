"""The robot that a recording draws: its URDF and the rollers of its wheels."""

import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.kinematics import body_wrench
from hil.core.types import Wheels
from hil.record.robot_model import SIDEWAYS, WHEEL_JOINTS, WHEEL_LINKS, RobotShape, drive_directions
from hil.record.rollers import ROLLERS
from tests.examples import share_of_examples

SHAPE = RobotShape(mass_kg=20.0, wheel_radius_m=0.075, half_length_m=0.3, half_width_m=0.25)
lengths = st.floats(0.01, 1.0)


def triangles(stl: bytes) -> npt.NDArray[np.float64]:
    """Read a binary STL: triangles of shape (n, 3, 3)."""
    (count,) = struct.unpack_from("<I", stl, 80)
    held = np.frombuffer(stl, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")], offset=84)
    assert len(held) == count
    return held["corners"].astype(float)


def test_the_urdf_is_read_with_each_wheel_where_the_scenario_has_it(tmp_path: Path) -> None:
    import rerun as rr

    tree = rr.urdf.UrdfTree.from_file_path(SHAPE.write(tmp_path))
    wheels = [joint for joint in tree.joints() if joint.joint_type == "continuous"]
    places = {joint.name: joint.origin_xyz for joint in wheels}
    assert tuple(places) == WHEEL_JOINTS
    assert places["front_left_wheel_joint"] == pytest.approx((0.3, 0.25, 0.075))
    assert places["rear_right_wheel_joint"] == pytest.approx((-0.3, -0.25, 0.075))
    assert {joint.axis for joint in wheels} == {(0.0, 1.0, 0.0)}
    assert all(len(tree.get_visual_geometry_paths(link)) == 2 for link in WHEEL_LINKS)


@share_of_examples(0.2)
@given(radius=lengths, length=lengths, width=lengths)
def test_a_robot_of_any_size_is_drawn_with_positive_sizes(radius: float, length: float, width: float) -> None:
    import xml.etree.ElementTree as ElementTree

    urdf = ElementTree.fromstring(RobotShape(20.0, radius, length, width).urdf())
    sizes = [float(word) for box in urdf.iter("box") for word in box.attrib["size"].split()]
    sizes += [float(value) for cylinder in urdf.iter("cylinder") for value in cylinder.attrib.values()]
    assert len(sizes) == 6 + 8 + 8 * ROLLERS
    assert min(sizes) > 0


@pytest.mark.parametrize(("side", "sideways"), [("left", 1.0), ("right", -1.0)])
def test_the_rollers_make_a_round_wheel_and_lie_along_the_force_on_the_floor(
    side: str, sideways: float, tmp_path: Path
) -> None:
    mesh = triangles((SHAPE.write(tmp_path).parent / f"rollers_{side}.stl").read_bytes())
    reach = np.hypot(mesh[..., 0], mesh[..., 2])
    assert 0.97 * 0.075 < reach.max() <= 0.075
    # Closed and with its outside out: the volume by the divergence theorem is that of nine rollers, not less than 0.
    volume = np.einsum("ij,ij->", mesh[:, 0], np.cross(mesh[:, 1], mesh[:, 2])) / 6
    thickest = np.pi * (0.17 * 0.075) ** 2 * 0.85 * 0.075 * ROLLERS
    assert 0.5 * thickest < volume < thickest
    lowest = mesh.reshape(ROLLERS, -1, 3)[0]
    assert lowest[:, 2].max() < 0
    spread, axes = np.linalg.eigh(np.cov((lowest - lowest.mean(axis=0)).T))
    longest = axes[:, np.argmax(spread)]
    assert abs(longest @ np.array([1.0, sideways, 0.0])) / np.sqrt(2) == pytest.approx(1.0, abs=1e-4)


@given(st.tuples(*[st.floats(-5, 5)] * 4))
def test_the_arrows_of_the_wheels_add_up_to_the_force_on_the_body(torques: tuple[float, float, float, float]) -> None:
    arrows = np.array(torques)[:, None] * drive_directions() / SHAPE.wheel_radius_m
    force = body_wrench(Wheels(*torques), SHAPE.wheel_radius_m, 0.55)
    np.testing.assert_allclose(arrows.sum(axis=0), [force.forward_n, force.left_n], atol=1e-9)


def test_seen_from_above_the_rollers_make_an_x() -> None:
    # The upper rollers are those of the floor in a mirror; at FL they point to the robot's centre.
    upper = -np.array(SIDEWAYS)
    towards_centre = np.sign(SHAPE.centres_m.prod(axis=1))
    assert (upper == towards_centre).all()


def test_a_robot_whose_sizes_are_not_known_is_not_drawn() -> None:
    assert RobotShape.of({"robot.mass_kg": 20.0, "robot.wheel_radius_m": 0.1}) is None


@pytest.mark.parametrize(("mass_kg", "scale"), [(20.0, 0.02), (1.0, 0.5), (1000.0, 5e-4)])
def test_the_scale_of_the_forces_is_a_round_number(mass_kg: float, scale: float) -> None:
    assert RobotShape(mass_kg, 0.075, 0.3, 0.3).force_scale_m_n == pytest.approx(scale)
