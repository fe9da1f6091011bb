"""The URDF of a robot: MuJoCo, which has a reader of its own, finds the masses of [robot] and wheels that roll."""

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

from hil.core.errors import BadInputError
from hil.core.kinematics import wheel_speeds
from hil.core.model import RobotModel
from hil.record.robot_model import WHEEL_JOINTS, WHEEL_LINKS, robot_description
from hil.record.rollers import ROLLERS
from hil.scenario import load
from tests.examples import share_of_examples
from tests.processes import hil

mujoco = pytest.importorskip("mujoco", reason='MuJoCo is not installed; run: pip install "mecanum-hil[mujoco]"')

Numbers = npt.NDArray[np.float64]
LENGTHS = st.floats(0.02, 0.5)


@st.composite
def robots(draw: st.DrawFn) -> RobotModel:
    """Robots from a plate to a rod, with wheels of a disc, or of a motor's rotor behind a gear."""
    length, width, radius, mass = draw(LENGTHS), draw(LENGTHS), draw(st.floats(0.02, 0.2)), draw(st.floats(1.0, 200.0))
    inertia = mass * (length**2 + width**2) * draw(st.floats(0.05, 2.0))
    axial = draw(st.floats(0.001, 0.24)) * inertia
    return RobotModel(mass, inertia, radius, length, width, axial, torque_limit_n_m=1.0, speed_limit_rad_s=10.0)


def floating(urdf: str) -> tuple[Any, Any]:
    """Return the robot as MuJoCo reads it, free to move, with its data at the start."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.body("base_link").add_freejoint()
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
@given(robot=robots(), angles_rad=st.tuples(*[st.floats(-10.0, 10.0)] * 4))
def test_mass_and_inertias_are_those_of_the_robot_wherever_its_wheels_stand(
    robot: RobotModel, angles_rad: tuple[float, ...]
) -> None:
    model, data = floating(robot_description(robot, "robot"))
    assert mujoco.mj_getTotalmass(model) == pytest.approx(robot.mass_kg, rel=1e-9)
    wheels = [model.joint(joint) for joint in WHEEL_JOINTS]
    assert len(wheels) == model.njnt - 1
    data.qpos[[joint.qposadr[0] for joint in wheels]] = angles_rad
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    assert matrix[5, 5] == pytest.approx(robot.inertia_kg_m2, rel=1e-9)
    axles = [joint.dofadr[0] for joint in wheels]
    assert matrix[axles, axles] == pytest.approx([robot.wheel_inertia_kg_m2] * 4, rel=1e-9)
    # Above the centre between the wheels, so that a turn moves no mass.
    assert data.subtree_com[0][:2] == pytest.approx([0.0, 0.0], abs=1e-9)


@share_of_examples(0.4)
@given(robot=robots(), twist=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_wheels_that_turn_as_our_kinematics_say_slip_on_none_of_their_rollers(
    robot: RobotModel, twist: tuple[float, float, float]
) -> None:
    urdf = robot_description(robot, "robot")
    model, data = floating(urdf)
    data.qvel[:6] = [twist[0], twist[1], 0.0, 0.0, 0.0, twist[2]]
    speeds = wheel_speeds(twist, robot.wheel_radius_m, robot.lever_m)
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
    assert "root Link: base_link has 6 child(ren)" in checked
    assert all(link in checked for link in (*WHEEL_LINKS, "imu_link", "body_link"))


def test_the_file_of_a_robot_will_do_and_has_its_own_numbers(tmp_path: Path) -> None:
    assert hil("init", tmp_path, "--defaults", "--mass-kg", "12.5", "--wheel-radius-m", "0.05").returncode == 0
    done = hil("export", "urdf", tmp_path / "robot.toml")
    assert done.returncode == 0
    model, _ = floating(done.stdout)
    assert mujoco.mj_getTotalmass(model) == pytest.approx(12.5)
    assert model.body(WHEEL_LINKS[0]).pos[2] == 0.05
    assert ElementTree.fromstring(done.stdout).attrib["name"] == "robot"


def test_a_file_without_a_robot_and_a_file_that_is_there_are_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[robot]\nmass_kg = 3\n")
    done = hil("export", "urdf", tmp_path / "bad.toml")
    assert done.returncode == 2
    assert "robot.wheel_radius_m is missing; expected a number from 0.001 to 1" in done.stderr
    (tmp_path / "mine.urdf").write_text("mine")
    done = hil("export", "urdf", "circle_speed", "--out", tmp_path / "mine.urdf")
    assert (done.returncode, (tmp_path / "mine.urdf").read_text()) == (2, "mine")
    assert hil("export", "urdf", "circle_speed", "--out", tmp_path / "mine.urdf", "--force").returncode == 0
    assert (tmp_path / "mine.urdf").read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("inertia", "wheel", "words"),
    [(0.019, 0.005, "inertia_kg_m2 = 0.019: .* expected more than 0.02"), (0.5, 0.0, "wheel_inertia_kg_m2 = 0: ")],
)
def test_a_robot_that_is_nothing_but_wheels_is_refused_by_its_numbers(inertia: float, wheel: float, words: str) -> None:
    robot = RobotModel(20.0, inertia, 0.075, 0.3, 0.3, wheel, torque_limit_n_m=1.0, speed_limit_rad_s=10.0)
    with pytest.raises(BadInputError, match=words):
        robot_description(robot, "robot")


def test_a_name_is_text_not_markup() -> None:
    urdf = robot_description(load("circle_speed").robot, 'a "b" <c>')
    assert ElementTree.fromstring(urdf).attrib["name"] == 'a "b" <c>'
