"""The parts of a campaign: its runs, their keys, the robot that is kept, the results on the disk, the statistics."""

import json
from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hil.addons.batch.campaign import campaign as campaigns
from hil.addons.batch.campaign.campaign import Campaign
from hil.addons.batch.campaign.campaign_file import load_plan, points
from hil.addons.batch.campaign.judged import (
    paired_difference,
    share_of,
    unit_means,
    wilson,
)
from hil.addons.batch.columns import KEY, MACHINE, run_columns
from hil.addons.batch.job import PASSED, Job, Outcome
from hil.addons.batch.keys import key_of
from hil.addons.batch.run import run
from hil.addons.batch.store import RECORDINGS, ROWS, Store, read_rows
from hil.core.errors import BadInputError
from hil.robot.virtual import KeptRobot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import from_plain, load, shipped_scenarios, to_plain
from tests.support.campaigns import write_plan

RANDOM = "[axes]\nplant.start.mass_kg = {{ uniform = [16, 24] }}\n{more}"


def test_runs_are_each_with_each_laws_fastest_and_lists_go_in_step(tmp_path: Path) -> None:
    axes = "robot.mass_kg = { list = [16, 24] }\nrobot.inertia_kg_m2 = { list = [0.4, 0.6] }\n"
    axes += "firmware.ramp_s = { grid = [0.1, 0.2, 0.4] }"
    faults = '[[fault]]\nname = "a"\n[[fault]]\nname = "b"\nrows = [{ kind = "drop", target = "command", value = 0.1 }]'
    plan = load_plan(write_plan(tmp_path, 'laws = ["afdsc", "dsc"]\nseeds = [4, 2]', f"{faults}\n[axes]\n{axes}"))
    runs = list(points(plan))
    assert len(runs) == 2 * 3 * 2 * 2 * 2
    assert [run.law for run in runs[:4]] == ["afdsc", "dsc"] * 2
    assert [run.seed for run in runs] == [4] * 24 + [2] * 24
    assert {(run.axes["robot.mass_kg"], run.axes["robot.inertia_kg_m2"]) for run in runs} == {(16, 0.4), (24, 0.6)}
    scenario = plan.scenario(runs[-1].sets)
    assert [row.kind for row in scenario.fault] == ["drop"]
    assert (scenario.firmware.ramp_s, scenario.loop.seed, scenario.controller.law) == (0.4, 2, "dsc")


def test_rows_of_a_campaign_are_added_to_those_of_its_scenario(tmp_path: Path) -> None:
    scenario = tmp_path / "base.toml"
    rows = '[[fault]]\nkind = "drop"\ntarget = "command"\nvalue = 0.1\n[[expect]]\nsignal = "truth.x_m"\nbelow = 9.0\n'
    scenario.write_text(f'extends = "circle_speed"\n{rows}', encoding="utf-8")
    more = '[[fault]]\nname = "more"\nrows = [{ kind = "reset", target = "robot", start_s = 0.1 }]\n'
    file = write_plan(tmp_path, tables=more + rows[rows.index("[[expect") :])
    text = file.read_text(encoding="utf-8").replace('"circle_speed"', '"base.toml"').replace("expect = []\n", "")
    file.write_text(text, encoding="utf-8")
    campaign = Campaign(file)
    (run,) = campaign.runs
    assert campaign.repeat(run.point)[:3] == ["hil", "run", str(scenario)]
    assert [row["kind"] for row in run.point.sets["fault"]] == ["drop", "reset"]
    assert run.point.sets["expect"] == [
        {"signal": "truth.x_m", "from_s": 0.0, "below": 9.0},
        {"signal": "truth.x_m", "below": 9.0},
    ]


def test_the_first_the_middle_and_the_last_run_are_timed_for_an_estimate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    class Timed:
        def run(self, job: Job) -> Outcome:
            done.append(job.key)
            return Outcome(job.key, PASSED, None, wall_s=float(keys.index(job.key)) + 100.0 * (len(done) == 1))

        def close(self) -> None:
            done.append("closed")

    monkeypatch.setattr(campaigns, "Runner", Timed)
    masses = "[axes]\nrobot.mass_kg = { grid = [16, 17, 18, 19, 20, 21, 22, 23] }"
    campaign = Campaign(write_plan(tmp_path, tables=masses))
    keys = [run.key for run in campaign.runs]
    assert campaign.estimate_s(7, 3) == (pytest.approx(10.0 / 3.0), pytest.approx(10.0))
    assert done == [keys[0], keys[0], keys[3], keys[7], "closed"], "the first one also opens the FMU"
    done.clear()
    timed = write_plan(tmp_path, tables='loop.mode = "realtime"\n' + masses.replace(", 23", ""), name="real.toml")
    assert Campaign(timed).estimate_s(7, 1) == (pytest.approx(1.2), pytest.approx(8.4))
    assert done == [], "nothing moves for an estimate"


def test_more_draws_and_another_axis_leave_the_draws_that_there_were(tmp_path: Path) -> None:
    few = Campaign(write_plan(tmp_path, "samples = 3", RANDOM.format(more="")))
    many = Campaign(write_plan(tmp_path, "samples = 9", RANDOM.format(more="")))
    assert [run.key for run in many.runs[:3]] == [run.key for run in few.runs]
    more = "plant.start.friction_coefficient = { uniform = [0, 0.1] }"
    both = Campaign(write_plan(tmp_path, "samples = 3", RANDOM.format(more=more)))
    name = "plant.start.mass_kg"
    assert [run.point.axes[name] for run in both.runs] == [run.point.axes[name] for run in few.runs]
    other = Campaign(write_plan(tmp_path, "samples = 3\nseed = 2", RANDOM.format(more="")))
    assert not {run.key for run in other.runs} & {run.key for run in few.runs}


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_scenario_is_the_same_after_a_way_as_json(name: str) -> None:
    scenario = load(name, set={"fault": [{"kind": "drop", "target": "command", "value": 0.1}]})
    again = from_plain(json.loads(json.dumps(to_plain(scenario))))
    assert again == scenario
    assert key_of(again) == key_of(scenario)


LAW = """
from hil.core.types import WheelCommand, Wheels


class Law:
    runs = 0

    def __init__(self, model, mode):
        self.mode = mode
        Law.runs += 1

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        rest = Wheels(0.0, 0.0, 0.0, 0.0)
        return WheelCommand(self.mode, rest, rest._replace(fl=0.1 * Law.runs))
"""


def test_what_a_law_left_in_its_module_is_gone_in_the_next_run(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "package_of_laws").mkdir()
    (tmp_path / "package_of_laws" / "__init__.py").write_text("from package_of_laws.impl import Law", encoding="utf-8")
    (tmp_path / "package_of_laws" / "impl.py").write_text(LAW, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("./package_of_laws/impl.py:Law", "package_of_laws.impl:Law", "package_of_laws:Law"):
        campaign = Campaign(write_plan(tmp_path, f'laws = ["{name}"]\nkeep = "none"'))
        job = campaign.job(campaign.runs[0])
        first, second = (run(job, from_plain(job.scenario)).figures for _ in range(2))
        assert first["wire_sha256"] == second["wire_sha256"]
        assert first["effort_n_m_s"] > 0.0


CLOCKED = {f"{MACHINE}tick_p50_us": None}
MAKERS = {
    "moteus": "can:virtual/kept?fd=1&data_bitrate=5000000",
    "odrive": "can:virtual/kept",
    "vesc": "memory:",
    "rosmaster": "memory:",
}


def test_a_robot_that_is_kept_is_in_each_run_as_if_it_were_new() -> None:
    short = {"loop.duration_s": 0.15, "loop.rate_hz": 200, "expect": []}
    slip = {"kind": "slip_patch", "start_s": 0.05, "value": 0.1, "x_m": 0.0, "y_m": 0.0, "radius_m": 5.0}
    push = {"kind": "push", "target": "force_x_n", "start_s": 0.05, "value": 50.0}
    others = [
        {},
        {"plant.start.mass_kg": 26.0, "device.reversed": ["fl"], "device.wheels": ["fr", "fl", "rr", "rl"]},
        {"plant.start.contact": "slip", "plant.start.grip_coefficient": 0.5, "fault": [slip]},
        {"fault": [{"kind": "reset", "target": "robot", "start_s": 0.05}]},
        {"plant.fmu": "mecanum_fmi3", "firmware.torque_constant_n_m_a": 1.0},
        *({"device.driver": driver, "link.url": link, "fault": [push]} for driver, link in MAKERS.items()),
        {"fault": [{"kind": "parameter", "target": "friction_coefficient", "start_s": 0.05, "value": 0.3}]},
        {},
    ]
    kept = KeptRobot()
    try:
        for other in others:
            scenario = load("circle_speed", set=short | other)
            assert from_plain(json.loads(json.dumps(to_plain(scenario)))) == scenario
            one, new = (
                run_scenario(scenario, RunOptions(keep_signals=False, **way))
                for way in ({"make_robot": kept.robot}, {})
            )
            assert run_columns(one.run) | CLOCKED == run_columns(new.run) | CLOCKED
            assert one.metrics["fault"] == new.metrics["fault"]
            assert str(one.failure) == str(new.failure)
    finally:
        kept.close()


def test_of_rows_with_one_key_the_later_counts_and_what_was_not_finished_counts_not(tmp_path: Path) -> None:
    written = {f"k{number}": {KEY: f"k{number}", "figure": number / 3.0} for number in range(40)}
    with Store(tmp_path) as store:
        store.append([{**row, "figure": None} for row in written.values()])
        store.append(list(written.values()))
        with pytest.raises(BadInputError, match="another process writes to it"):
            Store(tmp_path)
    assert read_rows(tmp_path) == written
    whole = (tmp_path / ROWS).read_bytes()
    (tmp_path / ROWS).write_bytes(whole + b'{"key": "k0", "figure": 7')  # killed in the middle
    assert read_rows(tmp_path) == written
    (older := tmp_path / RECORDINGS / "k1.rrd").touch()
    others = tmp_path / RECORDINGS / "mine.rrd"
    others.touch()
    with Store(tmp_path) as again:
        assert (tmp_path / ROWS).read_bytes() == whole
        assert others.exists()
        assert again.without_recording("k1") == str(older)
        assert others.exists()
        assert not older.exists()
        assert again.without_recording("k1") == str(older), "there need not be one"
    frame = pandas.read_json(tmp_path / ROWS, lines=True)  # as any other program reads them
    assert len(frame) == 80


@given(st.integers(1, 2000).flatmap(lambda trials: st.tuples(st.integers(0, trials), st.just(trials))))
def test_the_interval_of_a_share_is_that_of_scipy(counts: tuple[int, int]) -> None:
    share, low, high = wilson(counts[0] / counts[1], counts[1])
    expected = stats.binomtest(*counts).proportion_ci(0.95, method="wilson")
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert low <= share <= high


@pytest.mark.parametrize(("draws", "runs"), [(10, 100), (40, 5)])
def test_the_interval_of_a_pass_rate_knows_which_runs_repeat_each_other(draws: int, runs: int) -> None:
    """Half of what decides a run is drawn for all runs of a draw: Wilson's interval of all runs held 0.7 rarely."""
    generator = np.random.default_rng(3)
    held = 0
    for _ in range(300):
        shares = generator.beta(1.4, 0.6, draws)  # of each draw; 0.7 in the mean
        passed = generator.random((draws, runs)) < shares[:, None]
        interval = share_of(np.repeat(np.arange(draws), runs).tolist(), passed.ravel().tolist())
        assert interval.low is not None
        assert interval.high is not None
        held += interval.low <= 0.7 <= interval.high
    assert held >= 0.95 * 300


def test_a_share_of_drawn_runs_has_wilsons_interval_and_few_draws_have_none() -> None:
    assert share_of(range(30), [True] * 21 + [False] * 9) == wilson(0.7, 30)
    assert share_of([1] * 30 + [2] * 30, [True] * 60) == (1.0, None, None)
    assert share_of([draw for draw in range(20) for _ in range(9)], [True] * 180) == wilson(1.0, 20)


def test_the_interval_of_a_difference_covers_the_truth_as_often_as_it_says() -> None:
    generator = np.random.default_rng(7)
    covered = 0
    for trial in range(120):
        draws = generator.normal(0.3, 1.0, 40)
        units = np.repeat(np.arange(40), 5)  # five pairs a draw, which repeat it
        value, low, high = paired_difference(units.tolist(), np.repeat(draws, 5), seed=trial)
        assert low is not None
        assert high is not None
        assert value == pytest.approx(draws.mean())
        assert low < value < high
        covered += low <= 0.3 <= high
    # 0.95 with 40 draws; were the pairs taken for 200 draws it would be 0.6.
    assert 0.9 <= covered / 120 <= 1.0
    assert paired_difference(["one"] * 3, np.array([1.0, 2.0, 3.0])) == (2.0, None, None)
    assert paired_difference(range(5), np.arange(5.0)) == (2.0, None, None)
    assert unit_means(["a", "b", "a"], np.array([1.0, 5.0, 3.0])).tolist() == [2.0, 5.0]
