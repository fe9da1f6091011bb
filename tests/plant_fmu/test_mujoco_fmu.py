"""MuJoCo as an FMU: the numbers of MuJoCo itself, states that come back whole, errors that name the remedy."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import lief
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from hil.addons.fmu_check.check import check
from hil.core.errors import DeviceError
from hil.core.types import Wheels
from hil.plant.archive import sha256
from hil.plant.fmu import FmuPlant
from tests.support.mujoco_testbed import (
    FIRST_WHEEL,
    FMU,
    RIGID,
    WHEEL_JOINTS,
    WHEELS,
    Robot,
    build,
    model,
    mujoco,
    robot,
)

AXLES = [FIRST_WHEEL + WHEEL_JOINTS * wheel for wheel in range(4)]


def excite(plant: Robot, first: int, last: int) -> list[list[float]]:
    """Take steps with torques that depend on the step alone, and return every output after each."""
    rows = []
    for step in range(first, last):
        plant.torque(np.sin([0.05 * step, 0.03 * step + 1.0, 0.02 * step + 2.0, 0.07 * step]))
        plant.step()
        rows.append(plant.everything)
    return rows


def test_the_fmu_is_valid_and_keeps_every_claim() -> None:
    assert validate_fmu(str(FMU)) == []
    assert [part.findings for part in check(FMU).parts if part.findings] == []


def test_the_fmu_gives_the_bits_of_mujoco_in_this_process(tmp_path: Path) -> None:
    start = {"start_vx_m_s": 0.3, "start_heading_rad": 0.5, "friction_coefficient": 0.03, "mass_kg": 23.0}
    with robot(**start) as plant:
        model.write(plant.slave, tmp_path / "robot.mjb")
        m = mujoco.MjModel.from_binary_path(str(tmp_path / "robot.mjb"))
        data = mujoco.MjData(m)
        mujoco.mj_resetDataKeyframe(m, data, 0)
        for step in range(300):
            torque = np.sin([0.05 * step, 0.03 * step + 1.0, 0.02 * step + 2.0, 0.07 * step])
            plant.torque(torque)
            plant.step()
            data.ctrl[:] = torque
            mujoco.mj_step(m, data)
            assert plant.pose[:2].tolist() == data.qpos[:2].tolist()
            assert plant.twist[:2].tolist() == data.qvel[:2].tolist()
            assert plant.get(*(f"gyro.{a}_rad_s" for a in "xyz")).tolist() == data.qvel[3:6].tolist()
            assert plant.get(*(f"accelerometer.{a}_m_s2" for a in "xyz")).tolist() == data.sensordata.tolist()
            assert plant.wheels("speed_rad_s").tolist() == data.qvel[AXLES].tolist()
            assert plant.wheels("angle_rad").tolist() == data.qpos[[axle + 1 for axle in AXLES]].tolist()


def test_a_state_saved_in_mid_run_continues_bit_for_bit_also_in_another_instance() -> None:
    with robot() as plant, robot(mass_kg=30.0) as other:
        excite(plant, 0, 100)
        state = plant.slave.getFMUstate()
        saved, time_s = plant.slave.serializeFMUstate(state), plant.time_s
        expected = excite(plant, 100, 200)
        plant.slave.setFMUstate(state)
        plant.time_s = time_s
        assert excite(plant, 100, 200) == expected
        excite(other, 0, 20)
        copy = other.slave.deSerializeFMUstate(saved)
        other.slave.setFMUstate(copy)
        other.time_s = time_s
        assert excite(other, 100, 200) == expected
        plant.slave.freeFMUstate(state)
        other.slave.freeFMUstate(copy)


def test_instances_of_different_robots_take_turns_without_touching_each_other() -> None:
    kinds: list[dict[str, float]] = [{}, {"wheel_radius_m": 0.05, "mass_kg": 10.0, "rollers": 2}]
    alone = []
    for kind in kinds:
        with robot(**kind) as plant:
            alone.append(excite(plant, 0, 50))
    with robot(**kinds[0]) as one, robot(**kinds[1]) as two:
        for step in range(50):
            for plant, expected in zip((one, two), alone, strict=True):
                assert excite(plant, step, step + 1) == [expected[step]]


def test_long_steps_are_so_many_short_ones() -> None:
    with robot(longest_step_s=2.0**-10) as fine, robot(longest_step_s=2.0**-10) as coarse:
        for plant in (fine, coarse):
            plant.torque(np.array([1.0, 0.5, -0.2, 0.8]))
        fine.step(64, step_s=2.0**-10)
        coarse.slave.doStep(0.0, 2.0**-4)
        assert fine.everything == coarse.everything


def test_a_load_that_is_put_on_between_steps_slows_the_robot() -> None:
    with robot() as plant:
        gained = []
        for mass in (20.0, 40.0):
            plant.set(mass_kg=mass, inertia_kg_m2=0.028 * mass)
            before = plant.twist[0]
            plant.torque(np.full(4, 1.2))
            plant.step(200)
            gained.append(plant.twist[0] - before)
        added = 4 * 0.005 / 0.075**2
        assert gained[1] / gained[0] == pytest.approx((20 + added) / (40 + added), rel=0.03)


def test_the_sensors_err_as_those_of_the_shipped_plant_do() -> None:
    """The same seed, biases and scale: both plants at rest read the same beside what the robot itself does."""
    wrong = {"gyro_noise_rad_s": 0.02, "accelerometer_noise_m_s2": 0.3, "seed": 7, "gyro_scale": 1.5}
    wrong |= {"gyro_bias_z_rad_s": 0.1, "accelerometer_bias_x_m_s2": -0.2}
    axes = [f"gyro.{axis}_rad_s" for axis in "xyz"] + [f"accelerometer.{axis}_m_s2" for axis in "xyz"]
    with robot(**wrong) as plant, robot() as quiet, robot(RIGID, **wrong) as shipped, robot(RIGID) as silent:
        for each in (plant, quiet, shipped, silent):
            each.step(3)
        true = quiet.get(*axes) * ([1.5] * 3 + [1.0] * 3)
        assert plant.get(*axes) - true == pytest.approx(shipped.get(*axes) - silent.get(*axes), abs=1e-12)
        assert np.all(plant.get(*axes) != quiet.get(*axes))


def test_encoder_counts_and_current_follow_from_angle_and_torque() -> None:
    with robot(counts_per_revolution=1000, motor_constant_n_m_a=0.5) as plant:
        plant.torque(np.array([1.5, -1.5, 1.5, -1.5]))
        plant.step(800)
        turns = plant.wheels("angle_rad") / (2 * np.pi)
        for signal, factor in (("count", 1000), ("index", 1)):
            references = [plant.variables[f"wheel.{wheel}.{signal}"].valueReference for wheel in WHEELS]
            assert plant.slave.getInteger(references) == np.floor(turns * factor).astype(int).tolist()
        assert min(abs(turns)) > 1
        assert plant.wheels("current_a").tolist() == [3.0, -3.0, 3.0, -3.0]


def test_geometry_is_fixed_after_initialization() -> None:
    with robot() as plant, pytest.raises(FMICallException):
        plant.set(wheel_radius_m=0.05)


def test_the_library_exports_the_functions_of_fmi_and_the_one_that_writes_the_model() -> None:
    with zipfile.ZipFile(FMU) as archive:
        name = next(name for name in archive.namelist() if "/mecanum_mujoco" in name)
        library = lief.parse(list(archive.read(name)))
    assert isinstance(library, lief.Binary)
    exported = {str(function.name).removeprefix("_") for function in library.abstract.exported_functions}
    others = {name for name in exported if not name.startswith("fmi2")}
    assert others - {"mh_dylib_header", "_dso_handle", "init", "fini"} == {"mecanum_mujoco_save"}


def test_a_torque_beyond_all_bounds_is_an_error_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with (
        FmuPlant(FMU, {}) as bridge,
        pytest.raises(
            DeviceError, match=r"finite after \S+ s; look at the torques; far from usual: wheel\.\S+ = 1000000, wheel"
        ),
    ):
        bridge.step(Wheels(1e6, 1e6, 1e6, 1e6), 1000)
    with robot() as plant:
        plant.torque(np.full(4, 1e6))
        with pytest.raises(FMICallException):
            plant.step(1000)
        assert capfd.readouterr().err == ""
        plant.slave.reset()  # and the instance can be used again
        plant.slave.setupExperiment(startTime=0.0)
        plant.slave.enterInitializationMode()
        plant.slave.exitInitializationMode()
        plant.time_s = 0.0
        again = excite(plant, 0, 20)
    with robot() as fresh:
        assert again == excite(fresh, 0, 20)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="reads the memory in use from /proc")
def test_resets_do_not_let_the_process_grow() -> None:
    def pages() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1])

    with robot() as plant:
        sizes = []
        for _ in range(3):
            for _ in range(50):  # a model that is not freed is 300 pages
                plant.slave.reset()
                plant.slave.setupExperiment(startTime=0.0)
                plant.slave.enterInitializationMode()
                plant.slave.exitInitializationMode()
            sizes.append(pages())
    assert sizes[-1] - sizes[0] < 1000


def test_the_fmu_is_made_again_bit_for_bit_and_carries_the_licences(tmp_path: Path) -> None:
    copies = [build.build(tmp_path / name) for name in ("one.fmu", "two.fmu")]
    assert sha256(copies[0]) == sha256(copies[1]) == sha256(FMU)
    with zipfile.ZipFile(FMU) as archive:
        texts = [archive.read(name) for name in archive.namelist() if "licenses/" in name]
    assert any(b"Apache License" in text for text in texts)
    assert any(b"MIT" in text for text in texts)


def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, env={**os.environ})


def test_the_command_builds_the_fmu_and_writes_the_model(tmp_path: Path) -> None:
    done = run("-m", "tools.build.mujoco_fmu", "--model", str(tmp_path / "robot.xml"), "--set", "wheel_radius_m=0.05")
    assert (done.returncode, done.stderr) == (0, "")
    assert 'pos="0 0 0.05"' in (tmp_path / "robot.xml").read_text()
    done = run("-m", "tools.build.mujoco_fmu", "--model", str(tmp_path / "no" / "robot.xml"))
    assert done.returncode == 1
    assert "cannot be written (No such file or directory); choose another file" in done.stderr


def test_without_mujoco_the_build_says_what_to_install() -> None:
    code = "import sys; sys.modules['mujoco'] = None; from tools.build.mujoco_fmu import main; main()"
    done = run("-c", code)
    assert done.returncode == 1
    assert done.stderr == 'tools.build.mujoco_fmu: MuJoCo is not installed; run: pip install "mecanum-hil[mujoco]"\n'
