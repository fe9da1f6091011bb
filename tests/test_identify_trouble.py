"""What goes wrong with hil identify: each failure has its sentence, and nothing is written that was not found."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.identify.drive import Plan, perform, plan_step
from hil.identify.fit import fit
from hil.identify.kinematics import fit_kinematics
from hil.identify.recorded import SIGNALS, drive_of, read_drive
from hil.record.properties import scenario_values
from hil.review.reader import read
from hil.runtime.assembly import RunOptions
from tests.hidden_robots import hidden_robot, write_scenario
from tests.processes import device, hil, hil_process

SEED = 7
ROBOT = hidden_robot(SEED)
SHORT = Plan(floor_s=24.0, blocks_s=14.0, held_out_s=14.0, seed=SEED)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with recordings of a sound robot."""
    folder = tmp_path_factory.mktemp("drives")
    scenario = write_scenario(folder, ROBOT, {"contact": "rigid"}, SEED)
    for name in ("blocks", "floor", "held_out"):
        perform(plan_step(name, scenario, SHORT), folder / f"{name}.rrd", RunOptions(keep_signals=False))
    return folder


def test_the_fit_ends_in_the_same_optimum_from_two_beliefs(drives: Path) -> None:
    """It once gave up on the way, 3 % off, where the first belief was poor."""
    sound = {name: read_drive(drives / f"{name}.rrd") for name in ("floor", "blocks", "held_out")}
    robot = sound["floor"].robot
    other = replace(robot, mass_kg=1.7 * robot.mass_kg, inertia_kg_m2=0.5 * robot.inertia_kg_m2)
    first, second = (
        fit([replace(sound["floor"], robot=one)], sound["held_out"], blocks=sound["blocks"], contacts=["rigid"]).chosen
        for one in (robot, other)
    )
    sigma = np.sqrt(np.diag(first.solution.covariance))
    known = sigma > 0.0
    off = (first.solution.parameters - second.solution.parameters)[known] / sigma[known]
    assert np.abs(off).max() < 0.3  # of a standard deviation, of each of the 35 and more values


def test_feedbacks_that_a_line_lost_are_interpolated_and_a_long_gap_ends_a_drive(drives: Path) -> None:
    run = read(drives / "floor.rrd", SIGNALS)
    values, rows = scenario_values(run.properties), len(run.signals["robot.time_s"])
    whole = drive_of(drives, values, run.signals)
    kept = np.random.default_rng(1).random(rows) > 0.01
    kept[[0, 1]] = kept[[-2, -1]] = True
    few = drive_of(drives, values, {name: series[kept] for name, series in run.signals.items()})
    assert few.time_s == pytest.approx(whole.time_s)
    assert few.angle_rad == pytest.approx(whole.angle_rad, abs=0.005)
    assert fit_kinematics(few).radius_m == pytest.approx(fit_kinematics(whole).radius_m, rel=1e-3)
    kept[2000:2010] = False
    later = drive_of(drives, values, {name: series[kept] for name, series in run.signals.items()})
    assert later.time_s[0] == pytest.approx(run.signals["robot.time_s"][2010])
    missing_s = run.signals["robot.time_s"][2010] - whole.time_s[0]
    assert (whole.unused_s, few.unused_s, later.unused_s) == pytest.approx((0.0, 0.0, missing_s), abs=1e-6)


@pytest.mark.parametrize("driver", ["rosmaster", "wheeltec"])
def test_a_board_that_closes_its_loops_itself_is_refused_and_why(tmp_path: Path, driver: str) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    scenario.write_text(f'{scenario.read_text("utf-8")}\n[device]\ndriver = "{driver}"\n', encoding="utf-8")
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--yes")
    assert done.returncode == 2
    assert f'device.driver = "{driver}": it takes speeds alone' in done.stderr
    assert "friction and grip need torque: they are not identifiable here. hil commission finds" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (
            "nothing",
            "the robot measured no currents. Without them mass, inertia, friction and grip are not identifiable",
        ),
        ("current", "wheel fr turned, but its current sensor shows next to nothing: it is dead"),
        ("wheel", "wheel fr turned next to nothing while the others did: it is blocked"),
    ],
)
@pytest.mark.parametrize("step", ["floor", "blocks"])
def test_what_is_broken_is_named_and_nothing_is_fitted(drives: Path, step: str, broken: str, words: str) -> None:
    sound = {name: read_drive(drives / f"{name}.rrd") for name in ("floor", "blocks", "held_out")}
    current, angle = sound[step].current_a.copy(), sound[step].angle_rad.copy()
    current[:, slice(None) if broken == "nothing" else 1 if broken == "current" else slice(0, 0)] = 0.0
    angle[:, 1 if broken == "wheel" else slice(0, 0)] = 0.0
    found = sound | {step: replace(sound[step], current_a=current, angle_rad=angle)}
    with pytest.raises(BadInputError, match=words):
        fit([found["floor"]], found["held_out"], blocks=found["blocks"], contacts=["rigid"])


def test_a_floor_that_slopes_is_named_and_nothing_is_written(drives: Path, tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {"contact": "rigid", "slope_rad": 0.03}, SEED)
    perform(plan_step("floor", scenario, SHORT), tmp_path / "floor.rrd", RunOptions(keep_signals=False))
    words = [
        "--contact",
        "rigid",
        "--held-out",
        drives / "held_out.rrd",
        "--blocks",
        drives / "blocks.rrd",
        "--out",
        tmp_path / "mine",
    ]
    done = hil("identify", "fit", tmp_path / "floor.rrd", *words)
    assert done.returncode == 2
    assert "something pushed the robot one way all the time, as a floor does that slopes by" in done.stderr
    assert not (tmp_path / "mine").exists()


def test_a_link_that_is_lost_ends_the_drives(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    lost = '\n[[fault]]\nkind = "disconnect"\ntarget = "link"\nstart_s = 0.5\n'
    scenario.write_text(scenario.read_text("utf-8") + lost, encoding="utf-8")
    done = hil("identify", "drive", scenario, "--out", tmp_path, "--step", "floor", "--step", "held_out", "--yes")
    assert done.returncode == 3
    assert "held_out" not in done.stderr, "the next drive does not begin"
    assert "Next:" not in done.stdout


@pytest.mark.alone
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_a_robot_at_a_serial_line_is_driven_in_real_time(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {"contact": "slip"}, SEED)
    with device(str(scenario), "--mode", "realtime", "--link", "serial:pty") as robot:
        there = ("--mode", "realtime", "--link", robot.link, "--allow-motion", "--yes", "--step", "squeeze")
        done = hil_process("identify", "drive", str(scenario), *there, "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    run = read(tmp_path / "out" / "squeeze.rrd", SIGNALS)
    time_s, current_a = run.signals["robot.time_s"], run.signals["wheel.fl.current_a"]
    known = np.isfinite(time_s)
    assert time_s[known][-1] - time_s[known][0] > 7.0
    assert np.median(np.diff(np.unique(time_s[known]))) == pytest.approx(0.005, rel=1e-3)
    assert np.abs(current_a[known]).max() > 0.1, "the wheels pressed against one another"
    assert not np.isfinite(run.signals["truth.x_m"]).any(), "a real robot's pose is not known"
