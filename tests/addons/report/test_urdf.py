"""The URDF of a robot: MuJoCo, which has a reader of its own, finds wheels that roll."""

import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.urdf import ROLLERS, WHEEL_JOINTS, WHEEL_LINKS, RobotShape
from hil.core.kinematics import wheel_speeds
from hil.scenario import load
from tests.support.examples import share_of_examples
from tests.support.processes import hil

mujoco = pytest.importorskip("mujoco", reason='MuJoCo is not installed; run: pip install "mecanum-hil[mujoco]"')

Numbers = npt.NDArray[np.float64]
LENGTHS = st.floats(0.02, 0.5)


SHAPES = st.builds(RobotShape, st.floats(1.0, 200.0), st.floats(0.02, 0.2), LENGTHS, LENGTHS)


def floating(urdf: str) -> tuple[Any, Any]:
    """Return the robot as MuJoCo reads it, free to move, with its data at the start; MuJoCo needs masses."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.body("base_link").add_freejoint()
    for body in spec.bodies[1:]:
        body.mass, body.inertia, body.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def roller_axes(urdf: str) -> dict[str, Numbers]:
    """Return the axis of the lowest roller of each wheel's link, from the drawn cylinders."""
    found = {}
    for link in ElementTree.fromstring(urdf).iter("link"):
        rollers = [link.find(f"visual[@name='roller_{number}']/origin") for number in range(1, ROLLERS + 1)]
        origins = [origin.attrib for origin in rollers if origin is not None]
        if origins:
            lowest = min(origins, key=lambda origin: float(origin["xyz"].split()[2]))
            roll, pitch, yaw = (float(word) for word in lowest["rpy"].split())
            assert roll == 0.0
            found[link.attrib["name"]] = np.array(
                [np.cos(yaw) * np.sin(pitch), np.sin(yaw) * np.sin(pitch), np.cos(pitch)]
            )
    return found


@share_of_examples(0.4)
@given(robot=SHAPES, twist=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_wheels_that_turn_as_our_kinematics_say_slip_on_none_of_their_rollers(
    robot: RobotShape, twist: tuple[float, float, float]
) -> None:
    urdf = robot.urdf()
    model, data = floating(urdf)
    data.qvel[:6] = [twist[0], twist[1], 0.0, 0.0, 0.0, twist[2]]
    speeds = wheel_speeds(twist, robot.wheel_radius_m, robot.half_length_m + robot.half_width_m)
    axes = roller_axes(urdf)
    for joint, speed in zip(WHEEL_JOINTS, speeds, strict=True):
        data.qvel[model.joint(joint).dofadr[0]] = speed
    for link, ahead, left in zip(WHEEL_LINKS, (1, 1, -1, -1), (1, -1, -1, 1), strict=True):
        body = model.body(link)
        contact = data.body(link).xpos - [0.0, 0.0, robot.wheel_radius_m]
        assert contact == pytest.approx([ahead * robot.half_length_m, left * robot.half_width_m, 0.0], abs=1e-9)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, contact, body.id)
        assert axes[link][2] == pytest.approx(0.0, abs=1e-9)
        # A roller turns freely about its axis: only along it can the ground hold the wheel.
        assert axes[link] @ jacobian @ data.qvel == pytest.approx(0.0, abs=1e-6)


def test_the_parser_of_ros_reads_it_as_a_tree_from_base_link(tmp_path: Path) -> None:
    if shutil.which("check_urdf") is None:
        pytest.skip("check_urdf is not installed; on Debian: apt install liburdfdom-tools")
    file = tmp_path / "circle.urdf"
    done = hil("export", "urdf", "paper_circle", "--out", file)
    assert (done.returncode, done.stdout) == (0, f"{file}\n")
    checked = subprocess.run(["check_urdf", file], capture_output=True, text=True, check=True).stdout
    assert "root Link: base_link has 5 child(ren)" in checked
    assert all(link in checked for link in (*WHEEL_LINKS, "imu_link"))


def test_the_file_of_a_robot_has_its_own_numbers(tmp_path: Path) -> None:
    assert hil("init", tmp_path, "--defaults", "--mass-kg", "12.5", "--wheel-radius-m", "0.05").returncode == 0
    done = hil("export", "urdf", "circle_speed", "--robot", tmp_path / "robot.toml")
    assert done.returncode == 0
    model, _ = floating(done.stdout)
    assert model.body(WHEEL_LINKS[0]).pos[2] == 0.05
    assert ElementTree.fromstring(done.stdout).attrib["name"] == "robot"


def test_a_file_that_is_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.urdf").write_text("mine")
    done = hil("export", "urdf", "circle_speed", "--out", tmp_path / "mine.urdf")
    assert (done.returncode, (tmp_path / "mine.urdf").read_text()) == (2, "mine")
    assert hil("export", "urdf", "circle_speed", "--out", tmp_path / "mine.urdf", "--force").returncode == 0
    assert (tmp_path / "mine.urdf").read_text().startswith("<?xml")


def test_a_name_is_text_not_markup() -> None:
    urdf = RobotShape.of_model(load("circle_speed").robot).urdf('a "b" <c>')
    assert ElementTree.fromstring(urdf).attrib["name"] == 'a "b" <c>'
