"""The robot that a recording draws: its URDF and the rollers of its wheels."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.robot_frames import RobotFrames
from hil.addons.report.urdf import (
    ROLLERS,
    SIDEWAYS,
    WHEEL_JOINTS,
    WHEEL_LINKS,
    RobotShape,
    WheelAngles,
    drive_directions,
)
from hil.core.kinematics import body_wrench
from hil.core.signals import INDEX, SIGNAL_NAMES
from hil.core.types import Wheels
from tests.support.examples import share_of_examples
from tests.support.recorded_circle import circle_table

SHAPE = RobotShape(mass_kg=20.0, wheel_radius_m=0.075, half_length_m=0.3, half_width_m=0.25)
lengths = st.floats(0.01, 1.0)


def urdf_file(folder: Path) -> Path:
    """Write the robot as rerun's own reader of URDFs takes it."""
    path = folder / "robot.urdf"
    path.write_text(SHAPE.urdf())
    return path


def drawn_bodies(path: Path) -> dict[str, list[tuple[float, ...]]]:
    """Return by link the boxes and cylinders that a recording draws: place, quaternion and sizes, in order."""
    import rerun.chunk as rrc

    parts: dict[str, dict[str, list[Any]]] = {}
    for chunk in rrc.RrdReader(path).stream().filter(content="/world/robot/**"):
        batch = chunk.to_record_batch()
        assert chunk.is_static
        for name in batch.schema.names:
            if ":" in name:
                parts.setdefault(chunk.entity_path, {})[name.partition(":")[2]] = batch.column(name).to_pylist()[0]
    found: dict[str, list[tuple[float, ...]]] = {}
    for part in parts.values():
        sizes = part.get("half_sizes") or list(zip(part.get("lengths", []), part.get("radii", []), strict=True))
        places = part.get("translations") or part.get("centers") or []
        for place, turn, size in zip(places, part.get("quaternions", []), sizes, strict=True):
            sign = -1.0 if turn[3] < 0.0 else 1.0
            body = (*place, *(sign * one for one in turn), *size)
            found.setdefault(part["frame"][0], []).append(tuple(round(one, 5) + 0.0 for one in body))
    return {link: sorted(bodies) for link, bodies in found.items()}


def test_the_robot_is_drawn_as_reruns_reader_of_urdfs_draws_it(tmp_path: Path) -> None:
    import rerun as rr

    from hil.addons.report.scene import draw_robot

    paths = tmp_path / "ours.rrd", tmp_path / "reruns.rrd"
    ours, reruns = (rr.RecordingStream("robot", recording_id="robot") for _ in paths)
    for recording, path in zip((ours, reruns), paths, strict=True):
        recording.save(path)
    rr.urdf.UrdfTree.from_file_path(urdf_file(tmp_path), entity_path_prefix="world").log_urdf_to_recording(reruns)
    draw_robot(ours, SHAPE, "/world/robot")
    for recording in (ours, reruns):
        recording.disconnect()
    drawn, wanted = map(drawn_bodies, paths)
    assert {link: len(bodies) for link, bodies in wanted.items()} == {
        "base_link": 2,
        **dict.fromkeys(WHEEL_LINKS, 1 + ROLLERS),
    }
    assert drawn.keys() == wanted.keys()
    for link, bodies in wanted.items():
        np.testing.assert_allclose(drawn[link], bodies, atol=2e-5, err_msg=link)


def test_the_wheels_turn_as_reruns_reader_of_urdfs_turns_them(tmp_path: Path) -> None:
    import rerun as rr

    from hil.addons.report.scene import turned_wheels

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
    assert all(len(tree.get_visual_geometry_paths(link)) == 1 + ROLLERS for link in WHEEL_LINKS)


@share_of_examples(0.2)
@given(radius=lengths, length=lengths, width=lengths)
def test_a_robot_of_any_size_is_drawn_with_positive_sizes(radius: float, length: float, width: float) -> None:
    import xml.etree.ElementTree as ElementTree

    urdf = ElementTree.fromstring(RobotShape(20.0, radius, length, width).urdf())
    sizes = [float(word) for box in urdf.iter("box") for word in box.attrib["size"].split()]
    sizes += [float(value) for cylinder in urdf.iter("cylinder") for value in cylinder.attrib.values()]
    assert len(sizes) == 6 + 8 + 8 * ROLLERS
    assert min(sizes) > 0


@given(st.tuples(*[st.floats(-5, 5)] * 4))
def test_the_arrows_of_the_wheels_add_up_to_the_force_on_the_body(torques: tuple[float, float, float, float]) -> None:
    arrows = np.array(torques)[:, None] * drive_directions() / SHAPE.wheel_radius_m
    force = body_wrench(Wheels(*torques), SHAPE.wheel_radius_m, 0.55)
    np.testing.assert_allclose(arrows.sum(axis=0), [force.forward_n, force.left_n], atol=1e-9)


def angles_of(speeds: list[tuple[float, ...]], t_s: list[float]) -> list[list[float]]:
    """Return the integrals of wheel speeds, step by step."""
    angles, before, found = [0.0] * 4, t_s[0], []
    for at_s, row in zip(t_s, speeds, strict=True):
        step_s = max(at_s - before, 0.0)
        angles = [a if np.isnan(s) else a + s * step_s for a, s in zip(angles, row, strict=True)]
        before = at_s
        found.append(angles)
    return found


@share_of_examples(0.4)
@given(
    rows=st.lists(
        st.tuples(st.floats(-0.01, 0.1), *[st.one_of(st.just(np.nan), st.floats(-9, 9))] * 4), min_size=1, max_size=12
    ),
    cuts=st.lists(st.integers(1, 11), max_size=3, unique=True).map(sorted),
)
def test_wheels_turn_by_the_integral_of_their_speeds_wherever_the_rows_are_cut(
    rows: list[tuple[float, ...]], cuts: list[int]
) -> None:
    t_s = np.cumsum([row[0] for row in rows]).tolist()
    column = {
        "wheel.rl.speed_rad_s": 1,
        "wheel.rr.speed_rad_s": 4,
        "wheel.fl.speed_rad_s": 3,
        "wheel.fr.speed_rad_s": 2,
    }
    table, angles = np.array(rows), WheelAngles(column)
    cut = [one for one in cuts if one < len(rows)]
    pieces = zip(np.split(table, cut), np.split(np.array(t_s), cut), strict=True)
    found = np.concatenate([angles(piece, piece_s) for piece, piece_s in pieces])
    expected = angles_of([(row[3], row[2], row[4], row[1]) for row in rows], t_s)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@share_of_examples(0.2)
@given(cuts=st.lists(st.integers(1, 69), max_size=4, unique=True).map(sorted))
def test_the_frames_of_a_file_are_the_same_wherever_the_rows_are_cut(cuts: list[int]) -> None:
    """What is not known has no frame: the truth from row 10 on, the estimate from row 30 on, a time, for a while."""
    scenario = {
        "robot.mass_kg": 1.0,
        "robot.wheel_radius_m": 0.1,
        "robot.half_length_m": 0.3,
        "robot.half_width_m": 0.2,
    }
    table = circle_table(70)
    for begin, end, name in ((10, 30, "truth.y_m"), (30, 50, "pose.heading_rad"), (55, 60, "loop.t_s")):
        table[begin:end, INDEX[name]] = np.nan
    whole, pieces = (RobotFrames.of(SIGNAL_NAMES, scenario) for _ in range(2))
    assert whole is not None
    assert pieces is not None
    expected = list(whole.messages(table, 10**18))
    found = [message for piece in np.split(table, cuts) for message in pieces.messages(piece, 10**18)]
    assert [told[:2] for told in found] == [told[:2] for told in expected]
    for (*_, ours), (*_, theirs) in zip(found, expected, strict=True):
        words = [np.frombuffer(data, "<f8", offset=4) for data in (ours, theirs)]  # texts are among them, and are alike
        np.testing.assert_allclose(words[0], words[1], rtol=1e-12)
    stamps = [(stamp_ns - 10**18) // 10**6 for _, stamp_ns, _ in expected]
    sizes = sorted({len(data) for *_, data in expected})
    assert len(sizes) == 2, "the truth alone, and the estimate with the wheels"
    assert [(at_ms, sizes.index(len(data))) for at_ms, (*_, data) in zip(stamps, expected, strict=True)] == [
        (0, 1), (0, 0), (20, 1), (40, 0), (60, 1), (60, 0),
    ]  # fmt: skip
    assert RobotFrames.of(SIGNAL_NAMES, scenario | {"robot.half_width_m": None}) is None
    assert RobotFrames.of([name for name in SIGNAL_NAMES if name != "truth.y_m"], scenario) is None


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
