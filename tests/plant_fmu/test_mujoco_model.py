"""The robot that MuJoCo sees has the parameters' masses, in MuJoCo's own sums over its bodies."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.mujoco_testbed import FIRST_WHEEL, FMU, WHEEL_JOINTS, compiled, model, mujoco

BODIES = st.fixed_dictionaries(
    {
        "mass_kg": st.floats(5.0, 100.0),
        "com_x_m": st.floats(-0.1, 0.1),
        "com_y_m": st.floats(-0.1, 0.1),
        "com_height_m": st.floats(0.0, 0.5),
        "wheel_radius_m": st.floats(0.04, 0.15),
        "half_length_m": st.floats(0.1, 0.4),
        "half_width_m": st.floats(0.1, 0.4),
        "wheel_inertia_kg_m2": st.floats(1e-4, 0.005),
        "rollers": st.integers(1, 2),
    }
)


@share_of_examples(0.2)
@given(parameters=BODIES, roundness=st.floats(0.3, 1.0), angle_rad=st.floats(-10.0, 10.0))
def test_masses_and_inertias_are_the_parameters(
    tmp_path_factory: pytest.TempPathFactory, parameters: dict[str, float], roundness: float, angle_rad: float
) -> None:
    arm2 = parameters["half_length_m"] ** 2 + parameters["half_width_m"] ** 2
    inertia = roundness * parameters["mass_kg"] * arm2 + 0.05
    m = compiled(tmp_path_factory.mktemp("model"), **parameters, inertia_kg_m2=inertia)
    data = mujoco.MjData(m)
    axles = [FIRST_WHEEL + WHEEL_JOINTS * wheel for wheel in range(4)]
    data.qpos[[axle + 1 for axle in axles]] = angle_rad  # a free joint has one position more than velocities
    mujoco.mj_forward(m, data)
    matrix = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, data, matrix)
    mass, com = parameters["mass_kg"], (parameters["com_x_m"], parameters["com_y_m"])
    assert mujoco.mj_getTotalmass(m) == pytest.approx(mass, rel=1e-12)
    # MuJoCo takes an inertial frame that is less than 1e-10 m off the body's for the same (body_sameframe).
    assert data.subtree_com[1] == pytest.approx([*com, parameters["com_height_m"]], abs=1e-10)
    assert matrix[5, 5] - mass * (com[0] ** 2 + com[1] ** 2) == pytest.approx(inertia, rel=1e-9)
    assert np.diag(matrix)[axles] == pytest.approx([parameters["wheel_inertia_kg_m2"]] * 4, rel=1e-9)


def test_the_text_for_reading_is_the_same_robot_but_for_rounding(tmp_path: Path) -> None:
    exact = compiled(tmp_path)
    model.save(FMU, tmp_path / "robot.xml", {})
    text = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert (text.nq, text.nv, text.nu) == (exact.nq, exact.nv, exact.nu) == (59, 58, 4)
    for field in ("body_mass", "body_inertia", "geom_size", "geom_friction", "jnt_axis", "key_qpos"):
        assert getattr(text, field) == pytest.approx(getattr(exact, field), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"inertia_kg_m2": 0.05}, "inertia_kg_m2 = 0.05; the wheels where they are have"),
        ({"mass_kg": 0.1}, "mass_kg = 0.1; wheels of this inertia and radius weigh"),
        ({"wheel_radius_m": -1.0}, "wheel_radius_m = -1; expected a number from"),
        ({"rollers": 1.5}, "rollers = 1.5; expected a whole number"),
        ({"mass": 1.0}, "mass is not a parameter; expected one of mass_kg"),
    ],
)
def test_parameters_that_are_no_robot_are_refused_by_name(
    tmp_path: Path, parameters: dict[str, float], words: str
) -> None:
    with pytest.raises(model.ModelError, match=words):
        model.save(FMU, tmp_path / "robot.mjb", parameters)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, as Linux has it")
def test_a_file_that_is_no_model_or_cannot_be_written_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes MUJOCO_LOG.TXT where it is run
    (tmp_path / "folder.mjb").mkdir()
    for name in ("full.xml", "full.mjb"):
        (tmp_path / name).symlink_to("/dev/full")
    for name, words in (
        ("robot.stl", "robot.stl: the name of a model ends in .xml or .mjb"),
        ("folder.mjb", "folder.mjb cannot be written (Is a directory); choose another file"),
        ("full.xml", "full.xml: the FMU could not write its model"),
        ("full.mjb", "full.mjb: the FMU could not write its model"),
    ):
        with pytest.raises(model.ModelError) as refused:
            model.save(FMU, tmp_path / name, {})
        assert str(refused.value) == str(tmp_path / words)
