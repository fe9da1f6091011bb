"""The parts of a campaign: its runs, their keys, the robot that is kept, the results on the disk, the statistics."""

import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hil.batch.campaign.campaign import Campaign
from hil.batch.campaign.load import load_plan
from hil.batch.campaign.points import points
from hil.batch.campaign.statistics import (
    binned,
    paired_difference,
    ranked,
    share_explained,
    share_of,
    unit_means,
    wilson,
)
from hil.batch.figures import KEY, MACHINE, run_columns
from hil.batch.keys import is_current, key_of
from hil.batch.run import run
from hil.batch.store import ROWS, Store, read_rows
from hil.core.errors import BadInputError
from hil.robot.virtual import KeptRobot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import Unpacked, from_plain, load, shipped_scenarios, to_plain
from tests.campaigns import write_plan

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
    (campaign,) = Campaign(file).runs
    assert [row["kind"] for row in campaign.point.sets["fault"]] == ["drop", "reset"]
    assert campaign.point.sets["expect"] == [
        {"signal": "truth.x_m", "from_s": 0.0, "below": 9.0},
        {"signal": "truth.x_m", "below": 9.0},
    ]


@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_a_latin_hypercube_has_one_draw_in_each_part_of_each_axis(
    tmp_path_factory: pytest.TempPathFactory, samples: int, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("plan")
    more = "plant.start.friction_coefficient = { log_uniform = [0.001, 0.1] }"
    plan = load_plan(write_plan(folder, f"samples = {samples}\nlatin = true\nseed = {seed}", RANDOM.format(more=more)))
    runs = list(points(plan))
    masses = sorted((run.axes["plant.start.mass_kg"] - 16.0) / 8.0 for run in runs)
    logs = sorted(np.log(run.axes["plant.start.friction_coefficient"] / 0.001) / np.log(100.0) for run in runs)
    for shares in (masses, logs):
        for place, share in enumerate(shares):
            assert place - 1e-6 <= share * samples <= place + 1 + 1e-6


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


DRAWN = {
    "plant.start.mass_kg": st.sampled_from([16.0, 24.0, 1, 1.0, True]),
    "link.command_latency_s": st.sampled_from([0.0, -0.0]),
    "robot.mass_kg": st.sampled_from([20.0, 21.0]),
    "controller.law": st.sampled_from(["afdsc", "pid"]),
    "fault": st.sampled_from([[], [{"kind": "drop", "target": "command", "value": 0.1}]]),
    "loop.seed": st.integers(0, 2),
}


@given(st.fixed_dictionaries(DRAWN), st.fixed_dictionaries(DRAWN))
def test_a_scenario_is_the_same_whichever_one_was_unpacked_before(one: dict[str, Any], other: dict[str, Any]) -> None:
    before, scenario = (load("paper_circle", set=values) for values in (one, other))
    given_before, given = (json.loads(json.dumps(to_plain(made))) for made in (before, scenario))
    again = from_plain(given, Unpacked(given_before, before))
    assert again == scenario
    assert key_of(again) == key_of(scenario)
    assert json.dumps(to_plain(again)) == json.dumps(to_plain(scenario))


def test_a_key_follows_from_what_a_run_is_made_of_and_not_from_where_that_is(tmp_path: Path) -> None:
    law = "class Law:\n    def reset(self, state, reference): ...\n"
    law += "    def update(self, reference, state, applied, dt_s): ..."
    keys = []
    for folder, text in (("one", law), ("two", law), ("three", f"{law}\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "law.py").write_text(text, encoding="utf-8")
        plan = Campaign(write_plan(tmp_path / folder, 'laws = ["./law.py:Law"]'))
        keys.append(plan.runs[0].key)
    assert keys[0] == keys[1] != keys[2]
    (tmp_path / "four").mkdir()
    (tmp_path / "four" / "tuning.py").write_text("K = 1", encoding="utf-8")
    (tmp_path / "four" / "law.py").write_text(f"{law}\n    import tuning", encoding="utf-8")
    at_four = {"controller.law": str(tmp_path / "four" / "law.py:Law")}
    covers_imports = key_of(load("circle_speed", set=at_four))
    (tmp_path / "five").mkdir()
    (tmp_path / "five" / "tuning.py").write_text("K = 2", encoding="utf-8")
    (tmp_path / "five" / "law.py").write_text(f"{law}\n    import tuning", encoding="utf-8")
    assert key_of(load("circle_speed", set={"controller.law": str(tmp_path / "five" / "law.py:Law")})) != covers_imports
    (tmp_path / "two" / "law.py").write_text(f"{law}\n# another", encoding="utf-8")
    shadowed = {"controller.shadow": [str(tmp_path / "three" / "law.py:Law")]}
    one, two = (shadowed | {"controller.law": str(tmp_path / folder / "law.py:Law")} for folder in ("one", "two"))
    assert key_of(load("circle_speed", set=one)) != key_of(load("circle_speed", set=two))  # all of one name
    base = load("circle_speed")
    other = [{"loop.seed": 2}, {"robot.mass_kg": 21.0}, {"controller.gains.k1_1_s": 1.5}, {"loop.duration_s": 1.0}]
    scenarios = [base, *(load("circle_speed", set={"controller.law": "dsc"} | more) for more in other)]
    assert len({key_of(scenario) for scenario in scenarios}) == len(scenarios)
    for key, whole in (("robot.mass_kg", 20), ("reference.radius_m", 1), ("controller.gains.k1_1_s", 9)):
        laws = {"controller.law": "dsc"}
        same = [key_of(load("circle_speed", set={**laws, key: value})) for value in (whole, float(whole))]
        assert same[0] == same[1], key


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


def test_the_job_of_a_run_has_the_scenario_that_was_checked(tmp_path: Path) -> None:
    axes = (
        "[axes]\nplant.start.mass_kg = { uniform = [16, 24] }\nlink.command_latency_s = { grid = [0.0, 0.005] }\n"
        "loop.tick_limit_s = { grid = [1.0, 2.0] }"
    )
    campaign = Campaign(write_plan(tmp_path, 'laws = ["afdsc", "pid"]\nsamples = 4\nkeep = "none"', axes))
    assert len({run.scenario for run in campaign.runs}) == len(campaign.runs) == 32
    for run_of_plan in campaign.runs:
        job = campaign.job(run_of_plan)
        scenario = campaign.plan.scenario(run_of_plan.point.sets)
        assert json.dumps(job.scenario) == json.dumps(to_plain(scenario))
        assert from_plain(job.scenario) == scenario
        assert is_current(job, from_plain(job.scenario))
        assert len(run_of_plan.scenario) < 0.2 * len(json.dumps(job.scenario))


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
            assert run_columns(one.metrics) | CLOCKED == run_columns(new.metrics) | CLOCKED
            assert one.metrics["fault"] == new.metrics["fault"]
            assert str(one.failure) == str(new.failure)
    finally:
        kept.close()


def test_rows_that_a_kill_left_twice_count_once_and_what_was_not_finished_counts_not(tmp_path: Path) -> None:
    schema = pa.schema([(KEY, pa.string()), ("figure", pa.float64())])
    written = [{KEY: f"k{number}", "figure": float(number)} for number in range(100)]
    with Store(tmp_path, schema) as store:
        for number, row in enumerate(written):
            if number == 31:
                shutil.copytree(tmp_path / ROWS, tmp_path / "before")  # the next puts them into one
            store.append([row])
    files = list((tmp_path / ROWS).iterdir())
    assert len(files) < 40
    shutil.copytree(tmp_path / "before", tmp_path / ROWS, dirs_exist_ok=True)  # killed before they were removed
    (tmp_path / ROWS / "0-abc.parquet.unfinished").write_bytes(b"PAR1")
    assert sorted(read_rows(tmp_path).to_pylist(), key=lambda row: row["figure"]) == written
    with Store(tmp_path, schema) as store, pytest.raises(BadInputError, match="another process writes to it"):
        Store(tmp_path, schema)
    assert len(list((tmp_path / ROWS).iterdir())) == len(files)
    assert pq.read_table(tmp_path / ROWS).num_rows == 100  # as any other program reads them
    with pytest.raises(BadInputError, match="have figure as double, and now it is string; name another"):
        Store(tmp_path, pa.schema([(KEY, pa.string()), ("figure", pa.string())]))


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
    assert 0.91 * 300 <= held <= 299


def test_a_share_of_drawn_runs_has_wilsons_interval_and_few_draws_have_none() -> None:
    assert share_of(range(30), [True] * 21 + [False] * 9) == wilson(0.7, 30)
    assert share_of([1] * 30 + [2] * 30, [True] * 60) == (1.0, None, None)
    twenty = share_of([draw for draw in range(20) for _ in range(9)], [True] * 180)
    assert twenty.low == pytest.approx(wilson(1.0, 20 * (1.96 / 2.093) ** 2).low, abs=1e-3)


@given(st.lists(st.integers(0, 20), min_size=1, max_size=50))
def test_ranks_are_those_of_scipy(values: list[int]) -> None:
    assert ranked(np.array(values, dtype=float)).tolist() == stats.rankdata(values).tolist()


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


def test_an_axis_explains_what_it_does_and_draws_nothing_by_chance() -> None:
    generator = np.random.default_rng(3)
    law, mass = (np.array(list(itertools.product(range(2), range(4), range(50))))[:, place] for place in (0, 1))
    noise = generator.normal(0.0, 1.0, len(law))
    assert share_explained(law.tolist(), 100.0 * law + noise) == pytest.approx(0.75, abs=0.01)  # of ranks: 3/4
    assert share_explained(mass.tolist(), 100.0 * law + noise) == pytest.approx(0.0, abs=0.01)
    assert share_explained(law.tolist(), np.ones(len(law))) is None
    assert share_explained([1] * len(law), noise) is None
    one_each = generator.uniform(16.0, 24.0, 100)  # a hundred draws of one run each, as most campaigns have
    assert share_explained(binned(one_each), one_each**2, list(range(100))) == pytest.approx(0.98, abs=0.02)
    # Ten draws, each of forty runs: their own scatter is not the effect of another axis in two parts.
    draws = np.repeat(np.arange(10), 40)
    parts = np.repeat(generator.permutation(10) % 2, 40)
    scatter = np.repeat(generator.normal(0.0, 1.0, 10), 40) + generator.normal(0.0, 0.01, 400)
    alone = share_explained(parts.tolist(), scatter)
    of_draws = share_explained(parts.tolist(), scatter, draws.tolist())
    assert alone is not None
    assert of_draws is not None
    assert of_draws <= max(alone, 0.2)
