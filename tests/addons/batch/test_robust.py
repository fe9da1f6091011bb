"""hil compare --robust: the command of a run repeats it, verdicts are what they say, and an interrupt loses nothing."""

import csv
import json
import math
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.addons.batch.comparison.comparison import entries
from hil.addons.batch.comparison.random_cases import cases
from hil.addons.batch.comparison.robust import Robust, Tried, _needed_a, run, verdict_of
from hil.addons.batch.job import ENDED, LOST, REFUSED
from hil.addons.batch.keys import make_job
from hil.addons.batch.store import read_rows
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.runtime.run_parts import RunParts
from hil.scenario import load

SCENARIO = "compare_circle"
SHORT = "loop.duration_s=1.5"


def tried_in(folder: Path, laws: list[str], count: int, sets: list[str], seed: int) -> Robust:
    tried = Robust(laws, SCENARIO, count, sets, seed)
    for _ in tried.perform(folder, 1):
        pass
    return tried


def test_the_command_of_a_run_repeats_it(tmp_path: Path) -> None:
    tried = tried_in(tmp_path, ["pid,speed.kp_1_s=6", "dsc"], 2, [SHORT], 5).trials
    assert [trial.case.number for trial in tried] == [0, 1, 0, 1]
    for trial in tried[1::2]:
        words = list(trial.command)
        assert words[:4] == ["hil", "run", SCENARIO, "--lenient"]
        sets = [words[at + 1] for at, word in enumerate(words) if word == "--set"]
        again = hil.run(SCENARIO, set=sets, seed=5, lenient=True)
        t_s, error_m = again.signals["loop.t_s"], again.signals["error.planar_m"]
        last = error_m[t_s >= t_s[-1] * 2.0 / 3.0]
        assert trial.error_m == float(np.sqrt(np.mean(last**2)))
        currents = [again.signals[f"wheel.{wheel}.current_a"][-len(last) :] for wheel in ("fl", "fr", "rr", "rl")]
        torques = load(SCENARIO, set=sets).firmware.torque_constant_n_m_a * np.array(currents)
        slewed_s = t_s[-1] - t_s[-len(last)]
        varied = np.abs(np.diff(torques)).sum(axis=1) / slewed_s
        assert trial.row is not None
        assert trial.row["variation"] == pytest.approx(varied.mean())
        told_m = np.nan_to_num(again.signals["estimator.sigma_position_m"][-len(last) :])
        assert trial.row["told_m"] == pytest.approx(np.sqrt(np.mean(told_m**2)))
        printed = CliRunner().invoke(app, [*words[1:], "--json"])
        assert json.loads(printed.stdout)["wire_sha256"] == again.metrics["wire_sha256"]


def test_what_a_reference_needs_is_that_of_the_circle_by_hand() -> None:
    radius_m, period_s, rate_hz = 1.0, 3.0, 1000
    sets = {
        "reference": {"kind": "circle", "radius_m": radius_m, "period_s": period_s, "heading_rad": 0.3},
        "plant.start.friction_coefficient": 0.0,
        "plant.start.mass_kg": 25.0,
        "loop.duration_s": 4.5,
        "loop.rate_hz": rate_hz,
    }
    scenario = load(SCENARIO, set=sets)
    outcome = run(make_job(scenario, "tests:none"), scenario)
    # Each wheel's torque turns with the acceleration: a sine of this size, whose slew is 2 / π of its largest.
    omega = 2.0 * math.pi / period_s
    robot = scenario.robot
    force_n = (25.0 + robot.wheels_mass_kg) * radius_m * omega**2
    largest = robot.wheel_radius_m / 4.0 * math.sqrt(2.0) * force_n * omega
    # Over the last third, half a turn, two wheels have any phase; on average over the four the mean is that of a turn.
    assert outcome.figures["needed"] == pytest.approx(2.0 / math.pi * largest, rel=0.01)


def test_the_currents_that_a_reference_needs_are_those_of_its_heading_on_the_way() -> None:
    sets = {
        "reference.heading": "path",
        "reference.heading_rad": 0.4,
        "plant.start.mass_kg": 25.0,
        "robot.friction_coefficient": 0.0,
    }
    scenario = load(SCENARIO, set=sets | {"plant.start.friction_coefficient": 0.0})
    robot, t_s = scenario.robot, np.array([6.0, 8.5, 11.0])
    source, found = RunParts(scenario).reference, _needed_a(scenario, t_s, 2.0)
    lever_m, k_kg = robot.half_length_m + robot.half_width_m, 4.0 * robot.wheel_inertia_kg_m2 / robot.wheel_radius_m**2
    for place, one in enumerate(t_s):
        pose, twist, acceleration = source.at(float(one))
        c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        vx, vy, yaw_rate = twist
        force = np.array(
            [
                (25.0 + k_kg) * acceleration[0] + k_kg * yaw_rate * vy,
                (25.0 + k_kg) * acceleration[1] - k_kg * yaw_rate * vx,
                (robot.inertia_kg_m2 + k_kg * lever_m**2) * acceleration[2],
            ]
        )
        body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ force
        # Body forces of wheel torques: rows forward, left, turn; wheels FL, FR, RR, RL.
        of_wheels = (
            np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-lever_m, lever_m, lever_m, -lever_m]]) / robot.wheel_radius_m
        )
        torques = np.linalg.pinv(of_wheels) @ body
        assert [series[place] for series in found.values()] == pytest.approx(torques / 2.0)
    assert np.ptp([source.at(float(one)).pose.heading_rad for one in t_s]) > 0.5


@pytest.mark.parametrize(
    ("error_m", "told_m", "variation", "needed", "verdict"),
    [
        (0.002, 0.0, 19.0, 4.0, "held"),
        (0.0031, 0.0, 19.0, 4.0, "over bound"),
        (0.0089, 0.002, 19.0, 4.0, "held"),
        (0.0091, 0.002, 19.0, 4.0, "over bound"),
        (0.0002, 0.0, 21.0, 4.0, "limit cycle"),
        (0.0, 0.0, 55.0, 30.0, "held"),  # the reference itself needs much slew
        (0.2, 1.0, 21.0, 4.0, "diverged"),
        (math.nan, 0.0, 1.0, 4.0, "diverged"),
    ],
)
def test_a_run_has_the_worst_verdict_that_fits(
    error_m: float, told_m: float, variation: float, needed: float, verdict: str
) -> None:
    assert verdict_of({"error_m": error_m, "told_m": told_m, "variation": variation, "needed": needed}) == verdict


@pytest.mark.parametrize(("status", "verdict"), [(ENDED, "stopped"), (LOST, "failed"), (REFUSED, "refused")])
def test_a_run_without_figures_has_the_verdict_of_its_end(status: str, verdict: str) -> None:
    base = load(SCENARIO)
    (case,), (entry,) = cases(base, 1, 1, []), entries(["pid"], SCENARIO, [])
    tried = Tried(entry, case, make_job(base), ())
    assert tried.verdict == "not done"
    assert tried._replace(row={"outcome": status, "reason": "why"}).verdict == verdict


def test_the_command_prints_how_laws_held_and_what_repeats_the_rest(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(
        "from hil.core.types import WheelCommand, ZERO_WHEELS\n"
        "class Rests:\n"
        "    def __init__(self, model, mode):\n        self.mode = mode\n"
        "    def reset(self, state, reference):\n        pass\n"
        "    def update(self, reference, state, applied, dt_s):\n"
        "        return WheelCommand(self.mode, ZERO_WHEELS, ZERO_WHEELS)\n"
    )
    law = f"{tmp_path / 'laws.py'}:Rests"
    out = tmp_path / "new" / "out"
    words = ["compare", law, SCENARIO, "--robust", "2", "--set", SHORT, "--seed", "3", "--jobs", "1"]
    done = CliRunner().invoke(app, [*words, "--out", str(out), "--pictures", "svg"])
    assert done.exit_code == 0, done.output
    _, head, *rows = done.stdout.splitlines()
    assert head.split()[:3] == ["law", "the", "wheels"]
    assert ", case 0" in done.stdout
    repeats = [row for row in rows if row.startswith(f"  hil run {SCENARIO} --lenient --set {SHORT} --set ")]
    assert [row.endswith(" --seed 3") for row in repeats] == [True, True]
    assert "diverged" in done.stdout
    assert shlex.quote(f'controller.law="{law}"') in done.stdout
    assert any(row.split()[0] == law for row in rows)
    lines = list(csv.DictReader((out / "cases.csv").open()))
    assert [(line["law"], line["case"], line["verdict"]) for line in lines] == [(law, n, "diverged") for n in "01"]
    assert [line["reason"].partition("; ")[0] for line in lines] == ["diverged", "diverged"]
    drawn = cases(load(SCENARIO, set=[SHORT], seed=3), 2, 3, ["loop.duration_s"])
    assert [float(line["mass_factor"]) for line in lines] == [case.axes["mass_factor"] for case in drawn]
    assert sorted(file.name for file in out.glob("*.svg")) == ["distributions.svg", "effects.svg"]
    assert "counts_per_revolution" in (out / "effects.svg").read_text()
    report = CliRunner().invoke(app, ["campaign", "report", str(out), "--html", str(tmp_path / "campaign.html")])
    assert report.exit_code == 0, report.output
    assert "0 of 2 runs passed" in report.stdout


def test_an_interrupted_comparison_has_table_page_and_csv_of_what_is_done_and_continues(tmp_path: Path) -> None:
    """A process of its own, which is interrupted when a third of its runs is on the disk."""
    out, count = tmp_path / "out", 12
    words = [sys.executable, "-m", "hil", "compare", "pid", SCENARIO, "--robust", str(count), "--set", SHORT]
    words += ["--seed", "3", "--jobs", "1", "--out", str(out)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (out / "rows.jsonl").exists() or len(read_rows(out)) < count // 3:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate()
    done = read_rows(out)
    assert process.returncode == 130
    assert count // 3 - 1 <= len(done) < count  # one that was being written is not done
    assert f"interrupted; {len(done)} of {count} runs are done and saved in {out}; run the same command with" in stderr
    assert f"({count - len(done)} of {count} are not done yet)" in stdout
    assert len(list(csv.DictReader((out / "cases.csv").open()))) == len(done)
    assert f"{count - len(done)} of {count} are not done yet" in (out / "report.html").read_text()
    again = CliRunner().invoke(app, words[3:])
    assert again.exit_code == 0, again.output
    rows = read_rows(out)
    assert len(rows) == count == len(list(csv.DictReader((out / "cases.csv").open())))
    assert {key: rows[key] for key in done} == done, "no run was done twice"
    assert "not done yet" not in again.stdout + (out / "report.html").read_text()


@pytest.mark.parametrize("more", [["--torque", "5"], ["--quick"]])
def test_tables_and_cases_are_not_asked_for_together(more: list[str]) -> None:
    done = CliRunner().invoke(app, ["compare", "pid", SCENARIO, "--robust", "2", *more])
    assert isinstance(done.exception, BadInputError)
    assert str(done.exception).startswith(f"{more[0]}: --robust draws its own cases; leave {more[0]} out")


def test_a_law_among_sets_is_refused() -> None:
    with pytest.raises(BadInputError, match="laws and gains are named together"):
        Robust(["pid"], SCENARIO, 1, ["controller.law='pid'"])
    with pytest.raises(BadInputError, match="it runs in lockstep over memory"):
        Robust(["pid"], SCENARIO, 1, ["loop.mode='realtime'"])


def test_a_folder_is_kept_by_random_cases_alone_and_must_be_one(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["compare", "pid", SCENARIO, "--out", str(tmp_path)])
    assert isinstance(done.exception, BadInputError)
    assert str(done.exception) == f"--out {tmp_path}: it keeps the runs of --robust N; give that too, or leave it out"
    (tmp_path / "file").touch()
    done = CliRunner().invoke(app, ["compare", "pid", SCENARIO, "--robust", "1", "--out", str(tmp_path / "file" / "x")])
    assert isinstance(done.exception, BadInputError)
    assert "it cannot be made (Not a directory); name another with --out" in str(done.exception)
