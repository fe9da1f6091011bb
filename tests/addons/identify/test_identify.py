"""hil identify from a user's side: a robot that nobody knows is driven over the wire, fitted, and predicted."""

import functools
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import hil as package
import plant_fmu
from hil.addons.identify import drives as recorded
from hil.addons.identify import identify_command
from hil.addons.identify.before import fit_blocks
from hil.addons.identify.drives import Drive
from hil.addons.identify.excitation import STEPS, Plan, perform, plan_step
from hil.addons.identify.gauss_newton import solve
from hil.addons.identify.squeeze import grip_of
from hil.addons.identify.windows import BIN_S, GYRO_BIAS, MEASURED, SETTLING_BINS, WINDOW_S, Floor, cut, variable
from hil.core.errors import BadInputError
from hil.plant.description import start_defaults
from hil.runtime.assembly import RunOptions
from hil.scenario import load
from tests.support.hidden_robots import hidden_robot, scenario_text, write_scenario
from tests.support.processes import hil

read_drive = functools.cache(recorded.read_drive)
SEED = 7
ROBOT = hidden_robot(SEED)
HALVES = ("half_length_m", "half_width_m")
SHORT = Plan(floor_s=24.0, blocks_s=14.0, held_out_s=14.0, seed=SEED)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the recordings of all steps; the contact slips."""
    folder = tmp_path_factory.mktemp("drives")
    scenario = write_scenario(folder, ROBOT, {"contact": "slip"}, SEED)
    for name in STEPS:
        result = perform(plan_step(name, scenario, SHORT), folder / f"{name}.rrd", RunOptions(keep_signals=False))
        assert result.failure is None
    return folder


def arguments(drives: Path) -> list[str | Path]:
    others = [part for name in ("blocks", "squeeze") for part in (f"--{name}", drives / f"{name}.rrd")]
    return [drives / "floor.rrd", *others, "--held-out", drives / "held_out.rrd"]


def test_a_robot_that_nobody_knows_is_found_and_its_plant_predicts(drives: Path, tmp_path: Path) -> None:
    weighed = str(ROBOT.true["mass_kg"])
    done = hil("identify", "fit", *arguments(drives), "--mass-kg", weighed, "--out", tmp_path / "mine", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    jsonschema.validate(found, json.loads(Path(recorded.__file__).with_name("identify.schema.json").read_text()))
    assert found["contact"] == "slip", "the truth slips, and the held-out drive shows it"
    assert found["held_out"]["slip_rms_m"] < 0.003 < 0.02 < found["held_out"]["before_rms_m"]
    true = ROBOT.true | {
        "torque_constant_n_m_a": ROBOT.true["motor_constant_n_m_a"],
        "lever_m": ROBOT.true["half_length_m"] + ROBOT.true["half_width_m"],
        "roller_stiffness_n_m": start_defaults(plant_fmu.path(2))["roller_stiffness_n_m"],
    }
    off = {one["name"]: one["value"] / true[one["name"]] - 1.0 for one in found["estimates"] if one["name"] in true}
    for name, most in (
        ("torque_constant_n_m_a", 0.02), ("inertia_kg_m2", 0.04), ("wheel_inertia_kg_m2", 0.03),
        ("friction_coefficient", 0.04), ("viscous_n_m_s_rad", 0.05), ("wheel_radius_m", 0.015), ("lever_m", 0.015),
        ("grip_coefficient", 0.02), ("roller_stiffness_n_m", 0.1),
    ):  # fmt: skip
        assert abs(off[name]) < most, (name, off[name])
    com_m = {one["name"]: one["value"] for one in found["estimates"]}
    assert com_m["com_x_m"] == pytest.approx(true["com_x_m"], abs=2e-3)
    assert com_m["com_y_m"] == pytest.approx(true["com_y_m"], abs=2e-3)
    # The written files are a robot that every command takes, and a plant that a scenario extends.
    plant, robot = tmp_path / "mine" / "plant.toml", tmp_path / "mine" / "robot.toml"
    mine = tmp_path / "mine" / "circle.toml"
    mine.write_text(
        'extends = "plant.toml"\n\n[controller]\nlaw = "pid"\n\n[reference]\nkind = "circle"\nperiod_s = 20.0\n'
        "\n[loop]\nrate_hz = 200\nduration_s = 1.0\n",
        encoding="utf-8",
    )
    assert load(mine).plant.start["com_x_m"] == pytest.approx(com_m["com_x_m"], rel=1e-4)
    assert load("paper_circle", robot=robot).robot.mass_kg == pytest.approx(true["mass_kg"], rel=1e-5)
    assert package.run(mine, lenient=True).failure is None
    assert "SHA-256" in robot.read_text("utf-8")
    assert "identified, 95 %" in plant.read_text("utf-8")
    # And evidence is never replaced.
    again = hil("identify", "fit", *arguments(drives), "--out", tmp_path / "mine")
    assert (again.returncode, "exists already" in again.stderr) == (2, True)


def test_without_scale_blocks_and_squeeze_the_values_are_called_effective(drives: Path, tmp_path: Path) -> None:
    floor = (drives / "floor.rrd", "--held-out", drives / "held_out.rrd")
    done = hil("identify", "fit", *floor, "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    found = {one["name"]: one for one in json.loads(done.stdout)["estimates"]}
    for name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", "viscous_n_m_s_rad"):
        assert found[name]["status"] == "effective"
        assert "--mass-kg" in found[name]["why"]
    assert found["torque_constant_n_m_a"]["status"] == "believed"
    assert found["wheel_radius_m"]["status"] == "identified", "there were pose fixes"


def test_a_circle_at_one_speed_is_refused(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {"start_x_m": 1.0, "start_heading_rad": np.pi / 2}, SEED)
    circle = {
        "reference.kind": "circle", "reference.period_s": 12.0, "reference.heading": "path", "reference.ramp_s": 2.0,
        "loop.duration_s": 20.0, "estimator.source": "odometry",
    }  # fmt: skip
    package.run(scenario, set=circle, record=tmp_path / "circle.rrd", lenient=True)
    done = hil(
        "identify", "fit", tmp_path / "circle.rrd", "--held-out", tmp_path / "circle.rrd", "--out", tmp_path / "mine"
    )
    assert done.returncode == 2
    assert "a circle or a line at one speed does not" in done.stderr
    assert "hil identify drive" in done.stderr
    assert not (tmp_path / "mine").exists()


def test_a_fit_that_predicts_no_better_writes_nothing(drives: Path, tmp_path: Path) -> None:
    """The held-out drive is of a robot that is exactly as the other one was believed to be."""
    other = ROBOT._replace(true=ROBOT.true | ROBOT.believed | {"com_x_m": 0.0, "com_y_m": 0.0, "viscous_n_m_s_rad": 0.0,
                                                              "friction_coefficient": 0.02})  # fmt: skip
    scenario = tmp_path / "other.toml"
    scenario.write_text(scenario_text(other, {"contact": "rigid"}, SEED), encoding="utf-8")
    perform(plan_step("held_out", scenario, SHORT), tmp_path / "other.rrd", RunOptions(keep_signals=False))
    words = [
        drives / "floor.rrd",
        "--held-out",
        tmp_path / "other.rrd",
        "--out",
        tmp_path / "mine",
    ]
    done = hil("identify", "fit", *words)
    assert done.returncode == 1, done.stderr
    assert "nothing was written" in done.stdout
    assert not (tmp_path / "mine").exists()


def test_wheels_on_blocks_give_inertia_and_friction_over_the_torque_constant(drives: Path) -> None:
    scale = ROBOT.believed["motor_constant_n_m_a"] / ROBOT.true["motor_constant_n_m_a"]
    found = fit_blocks(read_drive(drives / "blocks.rrd"), ROBOT.believed["motor_constant_n_m_a"])
    assert found.inertia_kg_m2 == pytest.approx(ROBOT.true["wheel_inertia_kg_m2"] * scale, rel=0.02)
    assert found.viscous_n_m_s_rad == pytest.approx(ROBOT.true["viscous_n_m_s_rad"] * scale, rel=0.03)
    with pytest.raises(BadInputError, match=r"wheel \w\w turned for .* s; expected at least 4 s on blocks"):
        fit_blocks(read_drive(drives / "squeeze.rrd"), 1.0)


def test_a_squeeze_gives_the_grip_and_a_robot_that_cannot_slide_says_so(drives: Path) -> None:
    scale = ROBOT.believed["motor_constant_n_m_a"] / ROBOT.true["motor_constant_n_m_a"]
    values = {
        name: value * (scale if name in ("mass_kg", "viscous_n_m_s_rad") else 1.0) for name, value in ROBOT.true.items()
    }
    values["gyro_bias_rad_s"] = ROBOT.gyro_bias_rad_s
    constant = ROBOT.believed["motor_constant_n_m_a"]
    squeeze = read_drive(drives / "squeeze.rrd")
    robot = replace(squeeze.robot, **{name: ROBOT.true[name] for name in HALVES})
    found = grip_of(squeeze, robot, values, constant)
    assert found.grip is not None, found.sentence
    assert found.grip == pytest.approx(ROBOT.true["grip_coefficient"], rel=0.005)
    stood = grip_of(read_drive(drives / "blocks.rrd"), robot, values, constant)
    assert stood.grip is None
    assert "not found" in stood.sentence


@pytest.mark.parametrize("settling_bins", [0, SETTLING_BINS])
def test_rollers_bend_before_the_bins_that_are_compared(drives: Path, settling_bins: int) -> None:
    """A window begins with unbent rollers: with the true values, the remaining error then follows the torque."""
    drive = read_drive(drives / "floor.rrd")
    robot = replace(drive.robot, **{name: ROBOT.true[name] for name in ("wheel_radius_m", *HALVES)})
    compared_s = WINDOW_S + (SETTLING_BINS - settling_bins) * BIN_S  # of the same windows
    windows = cut(drive, robot, compared_s, settling_bins).thinned(40)
    start = {"drive": "torque", "contact": "slip"} | {
        k: v for k, v in ROBOT.true.items() if k != "motor_constant_n_m_a"
    }
    constant = ROBOT.true["motor_constant_n_m_a"]
    parameters = [variable("mass_kg"), GYRO_BIAS]
    true = np.array([np.log(ROBOT.true["mass_kg"]), GYRO_BIAS.internal(ROBOT.gyro_bias_rad_s)])
    with Floor(start, parameters, windows, constant) as floor:
        found = solve(floor, true, bounds=(true, true))
        left = floor.measured - floor.predict(found.parameters[None], found.starts[None])[0]
    first = left.reshape(len(windows.first), -1, MEASURED)[:, 0, :4].ravel()
    torque = constant * windows.current_a[:, : windows.rows_a_bin].mean(axis=1).ravel()
    by_torque = (torque @ first) / (torque @ torque)
    sigma = float(np.std(first - by_torque * torque) / np.sqrt(torque @ torque))
    assert bool(abs(by_torque) > 3.5 * sigma) is (settling_bins == 0), (by_torque, sigma)


def test_the_angles_of_the_wheels_have_no_delay(drives: Path) -> None:
    """Without it the firmware's filter would shift them by 13 ms, which looks like friction."""
    drive = read_drive(drives / "held_out.rrd")
    moved = np.diff(drive.truth, axis=0)
    turned = np.gradient(drive.truth[:, 2], drive.period_s)
    by_wheels = drive.speed_rad_s @ np.array([-1.0, 1.0, 1.0, -1.0])
    shifts = np.arange(-6, 7)
    likeness = [np.corrcoef(np.roll(turned, shift)[50:-50], by_wheels[50:-50])[0, 1] for shift in shifts]
    assert shifts[int(np.argmax(likeness))] == 0
    assert len(moved) == len(drive.time_s) - 1


def test_drives_are_announced_and_wait_for_enter(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze")
    told = "hil: stdin is not a terminal; --yes begins each drive without waiting for Enter\n"
    assert (done.returncode, done.stderr) == (2, told)
    assert not (tmp_path / "out").exists()
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze", "--yes")
    assert done.returncode == 0, done.stderr
    assert "squeeze, 8 s: Leave the robot on the floor" in done.stderr
    squeeze = tmp_path / "out" / "squeeze.rrd"
    recorded_line, following, command = done.stdout.splitlines()
    assert (recorded_line, following) == (f"  recorded {squeeze}", "Next:")
    assert command.split()[-8:] == ["hil", "identify", "fit", "RECORDING", "--squeeze", str(squeeze), "--mass-kg", "KG"]
    assert isinstance(read_drive(tmp_path / "out" / "squeeze.rrd"), Drive)
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze", "--yes")
    assert (done.returncode, "exists already" in done.stderr) == (2, True)


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need a POSIX system")
def test_a_terminal_whose_input_ends_begins_no_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    keyboard, screen = os.openpty()
    os.write(keyboard, b"\x04")  # Ctrl-D
    with os.fdopen(keyboard, "wb"), os.fdopen(screen, encoding="utf-8") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with pytest.raises(BadInputError, match=r"^the input ended; this drive and those after it were not driven$"):
            identify_command.drive(str(scenario), out=tmp_path / "out", step=["squeeze"])
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--room", "0.1"], "--room 0.1: expected 0.5 to 100 m"),
        (["--grip", "70"], "--grip 70: expected 0.05 to 2"),
        (["--step", "swim"], "step 'swim': expected blocks, floor, squeeze, held_out"),
    ],
)
def test_a_drive_that_cannot_be_planned_is_refused(tmp_path: Path, words: list[str], sentence: str) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    done = hil("identify", "drive", scenario, "--yes", *words)
    assert done.returncode == 2
    assert sentence in done.stderr
