"""hil identify from a user's side: a robot that nobody knows is driven over the wire, fitted, and predicted."""

import functools
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import hil as package
import plant_fmu
from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES, Wheels
from hil.identify import recorded
from hil.identify.blocks import fit_blocks
from hil.identify.drive import STEPS, Plan, perform, plan_step
from hil.identify.floor import GYRO_BIAS, Floor, variable
from hil.identify.gauss_newton import solve
from hil.identify.held_out import predict
from hil.identify.identifiability import check_excitation
from hil.identify.kinematics import Tape, fit_kinematics
from hil.identify.mapped import fit_mapped
from hil.identify.recorded import Drive, split
from hil.identify.squeeze import grip_of
from hil.identify.windows import BIN_S, MEASURED, SETTLING_BINS, WINDOW_S, cut
from hil.plant.description import start_defaults
from hil.plant.fmu import FmuPlant
from hil.plant.signals import OUTPUTS
from hil.runtime.assembly import RunOptions
from hil.scenario import load
from tests.foreign_fmu import foreign_fmu, foreign_map
from tests.hidden_robots import hidden_robot, scenario_text, write_scenario
from tests.processes import hil

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
    assert (tmp_path / "mine" / "held_out.png").stat().st_size > 10_000
    # What was written is a robot that every command takes, and a plant that a scenario extends.
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
    done = hil("identify", "fit", drives / "floor.rrd", "--contact", "rigid", "--out", tmp_path, "--json")
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
    done = hil("identify", "fit", tmp_path / "circle.rrd", "--out", tmp_path / "mine")
    assert done.returncode == 2
    assert "a circle or a line at one speed does not" in done.stderr
    assert "hil identify drive" in done.stderr
    assert not (tmp_path / "mine").exists()


def test_a_fit_that_predicts_no_better_writes_nothing(drives: Path, tmp_path: Path) -> None:
    """The held-out drive is of a robot that is just what was believed of the other one."""
    other = ROBOT._replace(true=ROBOT.true | ROBOT.believed | {"com_x_m": 0.0, "com_y_m": 0.0, "viscous_n_m_s_rad": 0.0,
                                                              "friction_coefficient": 0.02})  # fmt: skip
    scenario = tmp_path / "other.toml"
    scenario.write_text(scenario_text(other, {"contact": "rigid"}, SEED), encoding="utf-8")
    perform(plan_step("held_out", scenario, SHORT), tmp_path / "other.rrd", RunOptions(keep_signals=False))
    words = [
        drives / "floor.rrd",
        "--contact",
        "rigid",
        "--held-out",
        tmp_path / "other.rrd",
        "--out",
        tmp_path / "mine",
    ]
    done = hil("identify", "fit", *words)
    assert done.returncode == 1, done.stderr
    assert "nothing was written" in done.stdout
    assert not (tmp_path / "mine").exists()


def test_the_kinematics_come_from_fixes_and_gyro(drives: Path) -> None:
    found = fit_kinematics(read_drive(drives / "floor.rrd"))
    assert found.scale_known
    assert found.radius_m == pytest.approx(ROBOT.true["wheel_radius_m"], rel=0.015)
    lever = ROBOT.true["half_length_m"] + ROBOT.true["half_width_m"]
    assert found.lever_m / found.radius_m == pytest.approx(lever / ROBOT.true["wheel_radius_m"], rel=3e-3)
    assert found.gyro_bias_rad_s == pytest.approx(ROBOT.gyro_bias_rad_s, abs=1e-3)


def test_wheels_on_blocks_give_inertia_and_friction_over_the_torque_constant(drives: Path) -> None:
    scale = ROBOT.believed["motor_constant_n_m_a"] / ROBOT.true["motor_constant_n_m_a"]
    found = fit_blocks(read_drive(drives / "blocks.rrd"), ROBOT.believed["motor_constant_n_m_a"])
    assert found.inertia_kg_m2 == pytest.approx(ROBOT.true["wheel_inertia_kg_m2"] * scale, rel=0.02)
    assert found.viscous_n_m_s_rad == pytest.approx(ROBOT.true["viscous_n_m_s_rad"] * scale, rel=0.03)
    with pytest.raises(BadInputError, match=r"wheel \w\w turned for .* s; expected at least 4 s on blocks"):
        fit_blocks(read_drive(drives / "squeeze.rrd"), 1.0)


def test_bearings_with_next_to_no_friction_are_no_error_and_a_wrong_sign_is(drives: Path) -> None:
    drive, constant = read_drive(drives / "blocks.rrd"), ROBOT.believed["motor_constant_n_m_a"]
    sound = fit_blocks(drive, constant)
    error = float(np.sqrt(sound.covariance[1, 1]))

    def found(viscous_n_m_s_rad: float) -> float:
        """Return what is found where the currents are those of this friction."""
        less = (sound.viscous_n_m_s_rad - viscous_n_m_s_rad) / constant
        return fit_blocks(
            replace(drive, current_a=drive.current_a - less * drive.speed_rad_s), constant
        ).viscous_n_m_s_rad

    assert found(-error) == pytest.approx(error, rel=0.2)
    with pytest.raises(BadInputError, match="expected positive numbers: check the signs of currents and speeds"):
        found(-20.0 * error)


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
    assert found.grip[0] == pytest.approx(ROBOT.true["grip_coefficient"], rel=0.005)
    stood = grip_of(read_drive(drives / "blocks.rrd"), robot, values, constant)
    assert stood.grip is None
    assert "not found" in stood.sentence


@pytest.mark.parametrize("settling_bins", [0, SETTLING_BINS])
def test_rollers_bend_before_the_bins_that_are_compared(drives: Path, settling_bins: int) -> None:
    """A window begins with rollers that are not bent yet: by the true values, what is left then follows the torque."""
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
    with Floor(plant_fmu.path(2), start, parameters, windows, constant) as floor:
        found = solve([floor], true, bounds=(true, true))
        left = floor.measured - floor.predict(found.parameters[None], found.starts[0][None])[0]
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


def test_a_drive_is_split_for_the_verdict_and_a_short_one_is_not(drives: Path) -> None:
    drive = read_drive(drives / "floor.rrd")
    first, last = split(drive)
    assert len(first.time_s) + len(last.time_s) == len(drive.time_s)
    assert first.time_s[-1] < last.time_s[0]
    assert len(first.fixes) + len(last.fixes) == len(drive.fixes)
    check_excitation(first)
    with pytest.raises(BadInputError, match="too short to hold a part of them out"):
        split(split(last)[0])


def test_drives_are_announced_and_wait_for_enter(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze")
    assert (done.returncode, "--yes" in done.stderr) == (2, True)
    assert not (tmp_path / "out").exists()
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze", "--yes")
    assert done.returncode == 0, done.stderr
    assert "Leave the robot on the floor" in done.stderr
    assert isinstance(read_drive(tmp_path / "out" / "squeeze.rrd"), Drive)
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--step", "squeeze", "--yes")
    assert (done.returncode, "exists already" in done.stderr) == (2, True)


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


def test_named_parameters_of_a_mapped_fmu_are_fitted(drives: Path, tmp_path: Path) -> None:
    """Our plant for FMI 3.0 by its path, as any FMU: mass and friction from the scenario's belief to the truth."""
    scenario = tmp_path / "mine.toml"
    text = scenario_text(ROBOT, {"contact": "slip"}, SEED)
    fmu = json.dumps(str(plant_fmu.path(3)))
    text = text.replace("[plant.start]", f"[plant]\nfmu = {fmu}\n\n[plant.start]")
    for name in ("inertia_kg_m2", "friction_coefficient"):
        text = text.replace(f"{name} = {ROBOT.true[name]}", f"{name} = {1.3 * ROBOT.true[name]}")
    true_constant = ROBOT.true["motor_constant_n_m_a"]
    text = text.replace(
        f"_constant_n_m_a = {ROBOT.believed['motor_constant_n_m_a']}", f"_constant_n_m_a = {true_constant}"
    )
    scenario.write_text(text, encoding="utf-8")
    names = ("--parameter", "inertia_kg_m2", "--parameter", "friction_coefficient")
    out = tmp_path / "fitted.toml"
    done = hil("identify", "fmu", scenario, drives / "floor.rrd", *names, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    jsonschema.validate(found, json.loads(Path(recorded.__file__).with_name("identify.schema.json").read_text()))
    for one in found["estimates"]:
        assert one["value"] == pytest.approx(ROBOT.true[one["name"]], rel=0.06)
    assert load(out).plant.start["inertia_kg_m2"] == pytest.approx(found["estimates"][0]["value"], rel=1e-5)
    done = hil(
        "identify",
        "fmu",
        scenario,
        drives / "floor.rrd",
        "--parameter",
        "inertai_kg_m2",
        "--out",
        tmp_path / "x.toml",
    )
    assert (done.returncode, "inertia_kg_m2" in done.stderr) == (2, True)


def test_an_fmu_without_a_twist_at_its_start_is_stepped_from_rest(tmp_path: Path) -> None:
    """The foreign robot of the tests: four wheels with an inertia, in its own units."""
    mapping, constant, true = foreign_map(2), 0.5, 0.05
    rows, period_ms = 800, 5
    torque = 0.4 * np.sin(np.outer(np.arange(rows) * 0.005, [7.0, 9.0, 11.0, 13.0]))
    torque[:10] = 0.0
    angles, places = [np.zeros(4)], [OUTPUTS.index(f"wheel.{wheel}.angle_rad") for wheel in WHEEL_NAMES]
    with FmuPlant(foreign_fmu(tmp_path, 2), {"J": true}, mapping) as plant:
        for row in torque:
            plant.step(Wheels(*map(float, row)), period_ms)
            angles.append(np.array([plant.context.signal[place] for place in places]))
    scenario = load("circle_speed")
    time_s = 0.005 * np.arange(rows + 1)
    drive = Drive(
        Path("foreign"), scenario.robot, {}, 0.005, time_s, np.array(angles),
        np.concatenate([np.zeros((1, 4)), torque]) / constant, np.full((rows + 1, 4), np.nan), np.zeros(rows + 1),
        np.zeros((0, 4)), np.full((rows + 1, 3), np.nan),
    )  # fmt: skip
    rows_of_map = {
        signal: {"name": row.name, "scale": row.scale, "sign": row.sign} for signal, row in mapping.rows.items()
    }
    given: dict[str, object] = {"plant.fmu": str(tmp_path / "wheels2.fmu"), "plant.start.J": 0.02}
    given |= {f"plant.map.{signal}.{key}": value for signal, row in rows_of_map.items() for key, value in row.items()}
    given |= {"firmware.torque_constant_n_m_a": constant, "firmware.counts_per_revolution": 1000}
    found = fit_mapped([drive], drive, load("circle_speed", set=given), ["J"])
    assert found.estimates[0].value == pytest.approx(true, rel=5e-3)
    assert found.after_rad_s < 0.05 * found.before_rad_s


def test_a_tape_measure_gives_the_scale_of_length_in_place_of_fixes(drives: Path) -> None:
    whole = replace(read_drive(drives / "floor.rrd"), fixes=np.zeros((0, 4)))
    far = np.hypot(*(whole.truth - whole.truth[0])[:, :2].T)
    end = int(np.argmax(far)) + 1
    names = ("time_s", "angle_rad", "current_a", "torque_command_n_m", "yaw_rate_rad_s", "truth")
    drive = replace(whole, **{name: getattr(whole, name)[:end] for name in names})
    unscaled = fit_kinematics(drive)
    assert not unscaled.scale_known
    assert unscaled.radius_m == ROBOT.believed["wheel_radius_m"]
    by_tape = replace(drive, robot=replace(drive.robot, wheel_radius_m=1.2 * ROBOT.true["wheel_radius_m"]))
    assert far.max() > 0.5
    found = fit_kinematics(by_tape, Tape(float(far.max()), 0.01))
    assert found.radius_m == pytest.approx(ROBOT.true["wheel_radius_m"], rel=0.02)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.01 / far.max())
    back = 2000 + int(np.argmin(far[2000:])) + 1
    near = replace(whole, **{name: getattr(whole, name)[:back] for name in names})
    with pytest.raises(BadInputError, match=r"expected at least 0\.5 m to compare with the tape"):
        fit_kinematics(near, Tape(0.2))


def test_without_the_truth_a_prediction_is_measured_against_wheels_and_gyro(drives: Path) -> None:
    drive = read_drive(drives / "held_out.rrd")
    real = replace(drive, truth=np.full_like(drive.truth, np.nan))
    lengths = {name: ROBOT.true[name] for name in ("wheel_radius_m", "half_length_m", "half_width_m")}
    robot = replace(drive.robot, **lengths)
    start = {name: value for name, value in ROBOT.true.items() if name != "motor_constant_n_m_a"}
    start |= {"contact": "slip", "longest_step_s": 0.01}
    given = (robot, ROBOT.gyro_bias_rad_s, plant_fmu.path(2), start, ROBOT.true["motor_constant_n_m_a"])
    by_truth, by_wheels = predict(drive, *given), predict(real, *given)
    assert (by_truth.against, by_wheels.against) == ("truth", "wheels and gyro")
    assert by_truth.rms_m < 0.002, "the true values, without noise of the currents"
    assert by_wheels.rms_m < 0.02, "wheels that slip a little are no better measure than this"
    wrong = predict(real, robot, 0.0, plant_fmu.path(2), start | {"mass_kg": 2.0 * ROBOT.true["mass_kg"]}, given[-1])
    assert wrong.rms_m > 3.0 * by_wheels.rms_m
