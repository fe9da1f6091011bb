"""What goes wrong with hil identify: each failure has its sentence, and nothing is written that was not found."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.addons.identify.drives import SIGNALS
from hil.addons.identify.fit import fit
from hil.record.reader import read
from tests.addons.identify.test_fit import driven
from tests.support.hidden_robots import hidden_robot, write_scenario
from tests.support.processes import device, hil, hil_process

SEED = 7
ROBOT = hidden_robot(SEED)


def test_the_fit_ends_in_the_same_optimum_from_two_beliefs() -> None:
    """It once gave up on the way, 3 % off, where the first belief was poor."""
    noise = np.random.default_rng(SEED)
    floor, held_out = driven(12.0, 1), driven(4.0, 2)
    floor = replace(
        floor,
        current_a=floor.current_a + noise.normal(0.0, 0.05, floor.current_a.shape),
        angle_rad=floor.angle_rad + noise.normal(0.0, 5e-4, floor.angle_rad.shape),
    )
    other = replace(floor.robot, mass_kg=1.7 * floor.robot.mass_kg, inertia_kg_m2=0.5 * floor.robot.inertia_kg_m2)
    first, second = (
        fit(replace(floor, robot=one), held_out, contacts=["rigid"]).chosen for one in (floor.robot, other)
    )
    sigma = np.sqrt(np.diag(first.solution.covariance))
    known = sigma > 0.0
    off = (first.solution.parameters - second.solution.parameters)[known] / sigma[known]
    assert np.abs(off).max() < 0.3  # of a standard deviation, of each value


@pytest.mark.parametrize("driver", ["rosmaster", "wheeltec"])
def test_a_board_that_closes_its_loops_itself_is_refused_and_why(tmp_path: Path, driver: str) -> None:
    scenario = write_scenario(tmp_path, ROBOT, {}, SEED)
    scenario.write_text(f'{scenario.read_text("utf-8")}\n[device]\ndriver = "{driver}"\n', encoding="utf-8")
    done = hil("identify", "drive", scenario, "--out", tmp_path / "out", "--yes")
    assert done.returncode == 2
    assert f'device.driver = "{driver}": it takes speeds alone' in done.stderr
    assert "friction and grip need torque: they are not identifiable here. Measure the radius" in done.stderr
    assert not (tmp_path / "out").exists()


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
