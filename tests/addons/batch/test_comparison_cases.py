"""hil compare --robust: a case is its number's, the command of a run repeats it, and verdicts are what they say."""

import json
import math
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.addons.batch.comparison.comparison import entries
from hil.addons.batch.comparison.random_cases import Tried, _needed_a, cases, run, try_laws
from hil.addons.batch.job import ENDED, LOST, PASSED, REFUSED, Outcome
from hil.addons.batch.keys import make_job
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.runtime.run_parts import RunParts
from hil.scenario import load, set_texts
from tests.support.processes import ROOT

SCENARIO = "compare_circle"
SHORT = "loop.duration_s=1.5"


def test_a_case_is_the_same_among_ten_as_among_fifty_and_another_with_another_seed() -> None:
    base = load(SCENARIO)
    few, many = cases(base, 10, 3, []), cases(base, 50, 3, [])
    assert many[:10] == few
    assert len({json.dumps(case.sets) for case in many}) == 50
    assert cases(base, 10, 4, [])[0] != few[0]


def test_cases_go_where_they_say_and_each_is_a_scenario() -> None:
    base = load(SCENARIO, set={"loop.duration_s": 0.5, "expect": []})
    drawn = cases(base, 120, 1, [])
    scenarios = [load(SCENARIO, set=case.sets) for case in drawn]
    start = [one.plant.start for one in scenarios]
    masses = [float(one["mass_kg"]) / base.robot.mass_kg for one in start]
    assert 0.5 <= min(masses) < 0.6
    assert 1.8 < max(masses) <= 2.0
    slips = [one for one in start if one["contact"] == "slip"]
    assert 45 <= len(slips) <= 75
    assert all(0.3 <= float(one["grip_coefficient"]) <= 1.0 for one in slips)
    hidden = [one.fault[0].value for one in scenarios if one.fault]
    assert 45 <= len(hidden) <= 75
    assert max(hidden) <= 0.02
    assert {one.controller.mode.name for one in scenarios} == {"SPEED", "TORQUE"}
    assert {one.reference.kind for one in scenarios} == {"circle", "figure_eight", "rounded_square", "spin"}
    assert {one.device.driver for one in scenarios} == {"stm32", "odrive", "vesc"}
    ideal = [one["drive"] == "torque" for one in start]
    assert [one.robot.speed_limit_rad_s for one in scenarios] == [20.0 if is_ideal else 17.28 for is_ideal in ideal]
    assert 60 <= sum(case.can_follow for case in drawn) < 120


def test_the_battery_that_is_believed_is_that_of_the_shipped_plant() -> None:
    tables = tomllib.loads((ROOT / "plant_fmu" / "variables.toml").read_text(encoding="utf-8"))
    [start] = [one["start"] for one in tables["variable"] if one["name"] == BATTERY_VARIABLE]
    assert start == BATTERY_V


def test_what_is_given_is_not_drawn() -> None:
    given = ["plant.start.contact", "reference.radius_m", "fault", "controller.command"]
    for case in cases(load(SCENARIO), 20, 1, given):
        assert not {"plant.start.contact", "reference", "fault", "controller.command"} & set(case.sets)


def test_the_command_of_a_run_repeats_it() -> None:
    _, tried = try_laws(["pid,speed.kp_1_s=6", "dsc"], SCENARIO, 2, [SHORT], seed=5, workers=1)
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
        assert trial.outcome.figures["variation"] == pytest.approx(varied.mean())
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


OF_THE_REFERENCE = 4.0


@pytest.mark.parametrize(
    ("outcome", "verdict"),
    [
        ({"error_m": 0.002, "variation": 19.0}, "held"),
        ({"error_m": 0.0031, "variation": 19.0}, "over 3 mm"),
        ({"error_m": 0.0002, "variation": 21.0}, "limit cycle"),
        ({"error_m": 0.2, "variation": 21.0}, "diverged"),
        ({"error_m": math.nan, "variation": 1.0}, "diverged"),
        (ENDED, "stopped"),
        (LOST, "failed"),
        (REFUSED, "refused"),
    ],
)
def test_a_run_has_the_worst_verdict_that_fits(outcome: dict[str, float] | str, verdict: str) -> None:
    base = load(SCENARIO)
    (case,), (entry,) = cases(base, 1, 1, []), entries(["pid"], SCENARIO, [])
    figures = {} if isinstance(outcome, str) else {**outcome, "needed": OF_THE_REFERENCE}
    status = outcome if isinstance(outcome, str) else PASSED
    assert Tried(entry, case, Outcome("key", status, None, figures), ()).verdict == verdict


def test_a_reference_that_needs_much_slew_itself_is_no_limit_cycle() -> None:
    (case,), (entry,) = cases(load(SCENARIO), 1, 1, []), entries(["pid"], SCENARIO, [])
    outcome = Outcome("key", PASSED, None, {"error_m": 0.0, "variation": 55.0, "needed": 30.0})
    assert Tried(entry, case, outcome, ()).verdict == "held"


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
    words = ["compare", law, SCENARIO, "--robust", "2", "--set", SHORT, "--seed", "3", "--jobs", "1"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    _, head, *rows = done.stdout.splitlines()
    assert head.split()[:3] == ["law", "the", "wheels"]
    assert ", case 0" in done.stdout
    repeats = [row for row in rows if row.startswith(f"  hil run {SCENARIO} --lenient --set {SHORT} --set ")]
    assert [row.endswith(" --seed 3") for row in repeats] == [True, True]
    assert "diverged" in done.stdout
    assert shlex.quote(f'controller.law="{law}"') in done.stdout
    assert any(row.split()[0] == law for row in rows)


@pytest.mark.parametrize("more", [["--torque", "5"], ["--quick"]])
def test_tables_and_cases_are_not_asked_for_together(more: list[str]) -> None:
    done = CliRunner().invoke(app, ["compare", "pid", SCENARIO, "--robust", "2", *more])
    assert isinstance(done.exception, BadInputError)
    assert str(done.exception).startswith(f"{more[0]}: --robust draws its own cases; leave {more[0]} out")


def test_a_law_among_sets_is_refused() -> None:
    with pytest.raises(BadInputError, match="laws and gains are named together"):
        try_laws(["pid"], SCENARIO, 1, ["controller.law='pid'"])
    with pytest.raises(BadInputError, match="it runs in lockstep over memory"):
        try_laws(["pid"], SCENARIO, 1, ["loop.mode='realtime'"])


def test_set_texts_of_a_case_are_what_the_command_line_takes() -> None:
    (case,) = cases(load(SCENARIO), 1, 2, [])
    assert load(SCENARIO, set=set_texts(case.sets)) == load(SCENARIO, set=case.sets)
