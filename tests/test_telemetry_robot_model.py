"""The robot that a recording draws: its URDF and the rollers of its wheels."""

import struct
from pathlib import Path
from typing import Any

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


def urdf_file(folder: Path) -> Path:
    """Write the robot as rerun's own reader of URDFs takes it."""
    text, meshes = SHAPE.drawn()
    for name, mesh in meshes.items():
        (folder / name).write_bytes(mesh)
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def static_components(path: Path) -> dict[tuple[str, str], list[Any]]:
    """Return the static components of a recording, by entity and name."""
    import rerun.chunk as rrc

    found = {}
    for chunk in rrc.RrdReader(path).stream().filter(content=["/world/**", "/tf_static"]):
        batch = chunk.to_record_batch()
        assert chunk.is_static
        for name in batch.schema.names:
            if ":" in name:
                found[chunk.entity_path, name] = batch.column(name).to_pylist()
    return found


def test_the_robot_is_drawn_without_a_file_as_reruns_reader_of_urdfs_draws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rerun as rr

    from hil.record.robot_drawing import draw_robot

    paths = tmp_path / "ours.rrd", tmp_path / "reruns.rrd"
    ours, reruns = (rr.RecordingStream("robot", recording_id="robot") for _ in paths)
    for recording, path in zip((ours, reruns), paths, strict=True):
        recording.save(path)
    rr.urdf.UrdfTree.from_file_path(urdf_file(tmp_path), entity_path_prefix="world").log_urdf_to_recording(reruns)
    with monkeypatch.context() as patch:
        patch.setattr("tempfile.tempdir", str(tmp_path / "there is none"))
        draw_robot(ours, SHAPE, "/world/robot")
    for recording in (ours, reruns):
        recording.disconnect()
    drawn, wanted = map(static_components, paths)
    assert len(wanted) > 50
    assert drawn.keys() == wanted.keys()
    for what, values in wanted.items():
        if isinstance(values[0][0], str | bytes | int):
            assert drawn[what] == values, what
        else:
            np.testing.assert_allclose(drawn[what], values, atol=1e-6, err_msg=str(what))


def test_the_wheels_turn_as_reruns_reader_of_urdfs_turns_them(tmp_path: Path) -> None:
    import rerun as rr

    from hil.record.robot_drawing import turned_wheels

    joints = {joint.name: joint for joint in rr.urdf.UrdfTree.from_file_path(urdf_file(tmp_path)).joints()}
    angles = np.array([-7.0, 0.0, 1.0, 6.0])
    for wheel, name in enumerate(WHEEL_JOINTS):
        theirs = joints[name].compute_transform_columns(np.remainder(angles, 2 * np.pi))
        found, wanted = (
            {str(one.component_descriptor()): one.as_arrow_array().to_pylist() for one in columns}
            for columns in (turned_wheels(SHAPE, wheel, angles), theirs)
        )
        assert found.keys() == wanted.keys()
        for what, values in wanted.items():
            if isinstance(values[0][0], str):
                assert found[what] == values
            else:
                np.testing.assert_allclose(found[what], values, atol=1e-6)


def test_the_urdf_is_read_with_each_wheel_where_the_scenario_has_it(tmp_path: Path) -> None:
    import rerun as rr

    tree = rr.urdf.UrdfTree.from_file_path(urdf_file(tmp_path))
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
def test_the_rollers_make_a_round_wheel_and_lie_along_the_force_on_the_floor(side: str, sideways: float) -> None:
    mesh = triangles(SHAPE.drawn()[1][f"rollers_{side}.stl"])
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
