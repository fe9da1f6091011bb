"""Baselines: the figures of a scenario's accepted runs, and the result of a run against them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.batch import baselines as batch
from hil.addons.batch.baselines import baseline as command
from hil.addons.batch.baselines import make_baselines
from hil.addons.batch.campaign.campaign_file import load_plan
from hil.addons.batch.job import PASSED
from hil.addons.batch.keys import key_of, make_job
from hil.addons.batch.run import run as run_job
from hil.addons.testing.checked_run import run_as_test
from hil.core.errors import BadInputError
from hil.core.json_lines import json_safe
from hil.judge.baselines import (
    SHARE,
    SPREADS,
    against_baseline,
    band_of,
    baseline_figures,
    baseline_of,
    baseline_words,
    moved,
)
from hil.judge.expectations import figure_result
from hil.judge.judged_run import JudgedRun
from hil.judge.measure import NO_TRUTH, Figure
from hil.judge.recorded import judged_run, read_for_figures
from hil.judge.run_json import from_json, to_json
from hil.judge.run_text import outcome_rows, why_not_passed
from hil.scenario import from_plain, load, shipped_scenarios, to_plain
from hil.scenario.baseline import Band, Baseline, asked_sha256, find, place, text_of
from hil.scenario.load import SHIPPED_DIRECTORY
from hil.scenario.trial import ExpectTable

ALONE: dict[str, Any] = {"workers": 1, "limit_s": 60.0, "allow_motion": False, "on_progress": None}
SCENARIO = """
extends = "circle_speed"
expect = []
[loop]
duration_s = 1.0
"""
SCHEMA = Path(hil.__file__).parent / "judge" / "run.schema.json"
VALUES = st.floats(1e-6, 1e6)


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    """A user's scenario of a second, with a baseline made of one run and its own seed."""
    path = tmp_path / "mine.toml"
    path.write_text(SCENARIO)
    accept(path)
    return str(path)


def accept(path: Path, **changes: Any) -> Baseline:
    """Write the baseline of a scenario from one run, without worker processes."""
    made = replace(load(str(path)), baseline=None)
    result = hil.run(str(path), lenient=True)
    new = replace(baseline_of(made, {made.loop.seed: result.run}), **changes)
    path.with_name("mine.baseline.toml").write_text(text_of(new), encoding="utf-8")
    return new


def told(result: hil.RunResult) -> list[str]:
    return [text for label, text in outcome_rows(result.run) if label == "baseline"]


# Bands


@given(VALUES, st.lists(VALUES, max_size=9), st.floats(0, 1))
def test_a_band_is_the_largest_of_three_spreads_a_share_and_the_resolution(
    value: float, others: list[float], resolution: float
) -> None:
    band = band_of(Figure("x", "x", "", 1, "x", resolution=resolution), [value, *others])
    every = [value, *others]
    wide = max(SPREADS * (max(every) - min(every)), SHARE * value, resolution)
    assert band.band == pytest.approx(wide, rel=1e-6)
    assert all(abs(one - band.value) <= band.band for one in every), "what made it is inside it"


def test_a_time_may_differ_by_a_tick_where_chance_matters() -> None:
    trip = baseline_figures()["round_trip_p99_ms"]
    assert band_of(trip, [10.0, 10.0]).band == pytest.approx(0.2)
    assert band_of(trip, [10.0, 10.0], tick_s=0.005).band == pytest.approx(5.0)
    assert band_of(baseline_figures()["t10_s"], [1.0], tick_s=0.1).band == pytest.approx(0.1)


@given(VALUES, st.floats(0, 10), st.floats(-30, 30))
def test_a_figure_has_moved_where_it_is_outside_its_band(value: float, band: float, away: float) -> None:
    baseline = Baseline("x", "", "lockstep", "", (1,), "", {"t10_s": Band(value, 0.0, band)})
    rows = moved(baseline, JudgedRun(figures={"t10_s": value + away}))
    assert bool(rows) == (abs((value + away) - value) > band)


def test_a_figure_that_is_gone_has_moved_unless_it_needs_a_truth_that_a_robot_does_not_have() -> None:
    baseline = Baseline("x", "", "lockstep", "", (1,), "", {"t10_s": Band(1.0, 0.0, 0.1)})
    assert "no value (it never settled)" in moved(baseline, JudgedRun(reasons={"t10_s": "it never settled"}))[0].text
    assert moved(baseline, JudgedRun(reasons={"t10_s": NO_TRUTH})) == []


def test_no_baseline_has_a_figure_of_the_machine() -> None:
    assert {"tick_us.p50", "realtime_factor", "deadline_misses"}.isdisjoint(baseline_figures())
    assert {"t10_s", "steady_rms_m", "rejected", "refused", "unmatched", "latency_p99_ms"} <= baseline_figures().keys()


@given(st.dictionaries(st.sampled_from(sorted(baseline_figures())), st.tuples(VALUES, VALUES, VALUES), min_size=1))
def test_a_baseline_is_the_same_after_it_was_written_and_read(bands: dict[str, tuple[float, float, float]]) -> None:
    from tempfile import TemporaryDirectory

    figure = {name: Band(*band) for name, band in bands.items()}
    made = Baseline("some", "ab", "realtime", 'a "platform"', (3, 4), "", figure)
    with TemporaryDirectory() as folder:
        (Path(folder) / "some.baseline.toml").write_text(text_of(made), encoding="utf-8")
        read = find("some", Path(folder) / "some.toml", Path(folder))
    assert read is not None
    assert replace(read, file="") == made


# What a run is compared with


@pytest.mark.parametrize(
    ("change", "is_other"),
    [
        ({"controller.gains.k1_1_s": 9.0}, True),
        ({"loop.duration_s": 1.5}, True),
        ({"reference.radius_m": 1.1}, True),
        ({"robot.mass_kg": 21.0}, True),
        ({"link.command_latency_s": 0.004}, True),
        ({"fault": [{"kind": "drop", "target": "command", "value": 0.1}]}, True),
        ({"plant.start.mass_kg": 21.0}, False),
        ({"firmware.speed_kp_n_m_s_rad": 1.0}, False),
        ({"device.reversed": ["fl"]}, False),
        ({"link.url": "serial:pty"}, False),
        ({"loop.seed": 9}, False),
        ({"expect": [], "allow.rejected": 5}, False),
        ({"controller.gains.k1_1_s": 8}, False),
    ],
)
def test_the_hash_is_of_what_a_scenario_asks_and_not_of_the_other_side(change: dict[str, Any], is_other: bool) -> None:
    assert (asked_sha256(load("circle_speed", set=change)) != asked_sha256(load("circle_speed"))) is is_other


def test_a_law_s_code_and_the_folder_of_a_scenario_are_not_part_of_the_hash(tmp_path: Path) -> None:
    law = "class Law:\n    def reset(self, state, reference): ...\n"
    hashes = []
    for folder, more in (("one", ""), ("two", "    # another\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "law.py").write_text(f"{law}{more}    def update(self, r, s, a, dt_s): ...\n")
        path = tmp_path / folder / "mine.toml"
        path.write_text('extends = "circle_speed"\n[controller]\nlaw = "./law.py:Law"\n')
        hashes.append(asked_sha256(load(str(path))))
    assert hashes[0] == hashes[1]


def test_a_run_as_accepted_passes_and_so_does_its_review(scenario: str, tmp_path: Path) -> None:
    result = hil.run(scenario, record=tmp_path / "run.mcap")
    assert result.passed, result
    judged = result.metrics["baseline"]["judged"]
    assert told(result) == [f"{judged} of {judged} figures as accepted, and the same frames"]
    reviewed = to_json(judged_run(read_for_figures(tmp_path / "run.mcap")))
    assert (reviewed["passed"], reviewed["baseline"]) == (True, result.metrics["baseline"])


@pytest.mark.parametrize(
    "change",
    [
        {"plant.start.mass_kg": 23.0},
        {"plant.start.friction_coefficient": 0.2},
        {"firmware.speed_kp_n_m_s_rad": 0.7},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_changes_on_the_other_side_fails_the_run(scenario: str, change: dict[str, Any]) -> None:
    result = hil.run(scenario, set=change)
    assert (result.passed, result.exit_code) == (False, 1)
    reasons = [text for kind, text in why_not_passed(result.run) if kind == "baseline"]
    assert any(" in place of " in text and " ± " in text and text.endswith(" %") for text in reasons)
    assert any("the frames on the wire are others" in text for text in reasons)
    assert "accept it with `hil baseline --accept`" in told(result)[-1]
    assert hil.run(scenario, set=change, lenient=True).passed


@pytest.mark.parametrize("change", [{}, {"plant.start.mass_kg": 23.0}, {"loop.duration_s": 0.5}], ids=str)
def test_the_json_of_a_run_is_as_its_schema_says(scenario: str, change: dict[str, Any]) -> None:
    faults = [{"kind": "drop", "target": "command", "value": 0.2}]
    rows = [{"figure": "t10_s", "baseline": "5%"}, {"at_rest": True}, {"signal": "error.x_m", "below": 9}]
    for sets in (change, {**change, "fault": faults, "expect": rows}):
        table = json.loads(json.dumps(json_safe(hil.run(scenario, set=sets).metrics)))
        jsonschema.validate(table, json.loads(SCHEMA.read_text()))
        assert to_json(from_json(table)) == table, "it is read back as it was"


def test_a_law_s_code_that_changes_fails_the_run(tmp_path: Path) -> None:
    path, law = tmp_path / "mine.toml", tmp_path / "law.py"
    source = "from hil.laws.surface import Dsc\n\nclass Law(Dsc):\n    pass\n"
    law.write_text(source)
    path.write_text(SCENARIO.replace("[loop]", '[controller]\nlaw = "./law.py:Law"\n[loop]'))
    accept(path)
    assert hil.run(str(path)).passed
    law.write_text(
        source.replace("    pass", "    def update(self, r, s, a, dt_s):\n        c = super().update(r, s, a, dt_s)\n"
        "        return c._replace(speed_rad_s=type(c.speed_rad_s)(*(0.9 * v for v in c.speed_rad_s)))")
    )  # fmt: skip
    assert not hil.run(str(path)).passed


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"set": {"loop.duration_s": 0.5}}, "the run differs from those that made it, in loop.duration_s"),
        pytest.param(
            {"set": {"loop.duration_s": 0.2}, "mode": "realtime"},
            "made in lockstep, and the run is in real time",
            marks=pytest.mark.alone,
        ),
    ],
)
def test_a_run_of_something_else_says_that_it_is_not_judged_and_why(scenario: str, more: Any, why: str) -> None:
    result = hil.run(scenario, **{**more, "set": {**more["set"], "allow.held_ticks": "100%"}})
    assert result.passed, result
    (text,) = told(result)
    assert text.startswith("not judged against the baseline: ")
    assert why in text


def test_a_scenario_that_was_changed_says_how_to_accept_it(scenario: str) -> None:
    Path(scenario).write_text(SCENARIO.replace("1.0", "0.5"))
    assert "its scenario was another one; if the change is meant, accept it with" in told(hil.run(scenario))[0]


def test_other_seeds_and_links_are_judged_by_the_same_figures(scenario: str) -> None:
    assert hil.run(scenario, link="can:virtual/baseline").metrics["baseline"]["frames"]["passed"]
    assert baseline_words(load(scenario)).endswith("figures")
    assert baseline_words(load(scenario, mode="realtime")).startswith("not judged against it: it was made in lockstep")
    other = hil.run(scenario, seed=77)
    assert other.passed
    assert other.metrics["baseline"]["frames"] is None, "another seed has other frames"


def test_the_frames_are_judged_on_the_same_platform_only(scenario: str) -> None:
    path = Path(scenario)
    accept(path, wire_sha256="0" * 64)
    assert not hil.run(scenario).passed
    accept(path, wire_sha256="0" * 64, platform="Plan 9 vax")
    result = hil.run(scenario)
    assert result.passed
    assert "not judged: made on Plan 9 vax, and this is " in told(result)[0]


def test_a_baseline_whose_hash_was_taken_out_judges_figures_and_stays_without(scenario: str) -> None:
    path = Path(scenario)
    accept(path, wire_sha256="")
    assert hil.run(scenario).metrics["baseline"]["frames"] is None
    (made,) = make_baselines([load(scenario)], 1, **ALONE)
    assert made.new is not None
    assert (made.has_moved, made.new.wire_sha256) == (False, "")
    path.with_name("mine.baseline.toml").unlink()
    (made,) = make_baselines([load(scenario)], 1, **ALONE)
    assert made.new is not None
    assert made.new.wire_sha256


def test_a_run_that_ended_early_is_not_judged_against_the_baseline(scenario: str) -> None:
    judged = load(scenario)
    found = against_baseline(judged, JudgedRun(), is_cut=True)
    assert found is not None
    assert found.why == "the run ended early"
    row = ExpectTable(figure="t10_s", baseline="5%")
    outcome = figure_result(row, JudgedRun(baseline=found), 0.4, judged.baseline)
    assert (outcome.passed, outcome.text) == (
        None,
        "t10_s within 5% of the baseline: not judged, the run ended at t = 0.4 s",
    )


# An expectation relative to the baseline


@given(VALUES, st.floats(0, 50), st.floats(0.5, 1.5))
def test_a_share_of_the_baseline_is_a_band_around_its_value(value: float, percent: float, factor: float) -> None:
    baseline = Baseline("x", "", "lockstep", "", (1,), "", {"t10_s": Band(value, 0.0, 0.0)})
    row = ExpectTable(figure="t10_s", baseline=f"{percent:.3f}%")
    outcome = figure_result(row, JudgedRun(figures={"t10_s": factor * value}), None, baseline)
    if abs(abs(factor - 1.0) - percent / 100) > 1e-3:
        assert outcome.passed is (abs(factor - 1.0) < percent / 100)
    absolute = figure_result(replace(row, baseline=value), JudgedRun(figures={"t10_s": factor * value}), None, baseline)
    assert absolute.passed


def test_an_expectation_relative_to_the_baseline_is_in_place_of_its_band(scenario: str) -> None:
    change = {"plant.start.mass_kg": 20.3, "plant.start.friction_coefficient": 0.0504}
    before = hil.run(scenario, set=change)
    names = [row["key"] for row in before.metrics["baseline"]["figures"]] + ["overshoot_m"]
    rows = [{"figure": name, "baseline": "60%"} for name in dict.fromkeys(names)]
    accept(Path(scenario), wire_sha256="")
    after = hil.run(scenario, set={**change, "expect": rows})
    assert after.passed, after
    assert not hil.run(scenario, set={**change, "expect": [{"figure": "overshoot_m", "baseline": 0}]}).passed


def test_without_a_baseline_what_is_relative_to_it_fails_and_one_of_something_else_does_not_judge_it(
    scenario: str, tmp_path: Path
) -> None:
    rows = {"expect": [{"figure": "overshoot_m", "baseline": "10%"}]}
    other = hil.run(scenario, set={**rows, "loop.duration_s": 0.5})
    assert other.passed
    assert [row["passed"] for row in other.metrics["expect"]] == [None]
    (tmp_path / "mine.baseline.toml").unlink()
    result = hil.run(scenario, set=rows)
    assert not result.passed
    assert "failed, there is none; `hil baseline` makes it" in result.metrics["expect"][0]["text"]


# Where they are


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_has_the_baseline_of_what_it_asks(name: str) -> None:
    scenario = load(name)
    assert scenario.baseline is not None
    assert scenario.baseline.scenario_sha256 == asked_sha256(scenario)
    assert len(scenario.baseline.seeds) >= 10
    assert from_plain(to_plain(scenario)) == scenario


@pytest.mark.parametrize("name", ["circle_speed", "waypoints"])
def test_a_shipped_scenario_runs_as_accepted_with_a_seed_that_made_no_baseline(name: str) -> None:
    result = hil.run(name, seed=4711)
    assert result.passed, result
    assert told(result)


def test_a_baseline_in_the_current_folder_comes_before_the_one_in_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = load("circle_speed").baseline
    assert ours is not None
    assert Path(ours.file).parent == SHIPPED_DIRECTORY
    (tmp_path / "circle_speed.baseline.toml").write_text(text_of(replace(ours, wire_sha256="00")), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert place(load("circle_speed")) == tmp_path / "circle_speed.baseline.toml"
    found = load("circle_speed").baseline
    assert found is not None
    assert found.wire_sha256 == "00"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scenario = 3\n", "mine.baseline.toml:1: scenario = 3; expected text"),
        ("figure = 1", "mine.baseline.toml:1: figure = 1; expected a table"),
        ("[[[", "mine.baseline.toml"),
        ("scenarios = 'x'\n", "unknown key scenarios; did you mean 'scenario'"),
    ],
)
def test_a_broken_baseline_is_refused_with_its_line(scenario: str, tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "mine.baseline.toml").write_text(text)
    with pytest.raises(BadInputError) as error:
        load(scenario)
    assert words in str(error.value)


def test_batches_judge_by_it_and_it_is_part_of_their_key(scenario: str, pytestconfig: pytest.Config) -> None:
    heavy = load(scenario, set={"plant.start.mass_kg": 23.0})
    outcome = run_job(make_job(heavy), heavy)
    assert outcome.status != PASSED
    assert " in place of " in str(outcome.reason)
    assert key_of(heavy) != key_of(replace(heavy, baseline=None))
    verdict = run_as_test(heavy, None, None, "hil run ...", pytestconfig)
    assert not verdict.passed
    assert verdict.text().startswith("baseline: ")


def test_a_campaign_that_varies_the_other_side_on_purpose_is_not_judged_by_it(scenario: str, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text('scenario = "./mine.toml"\n[axes]\nplant.start.mass_kg = { grid = [20, 24] }\n')
    loaded = load_plan(plan)
    assert loaded.scenario({"plant.start.mass_kg": 24}).baseline is None
    assert loaded.scenario({"loop.seed": 3}).baseline is not None


# The command


@pytest.mark.slow
def test_the_command_writes_shows_what_moved_and_writes_again_only_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, file = tmp_path / "mine.toml", tmp_path / "mine.baseline.toml"

    def called(**options: bool) -> tuple[int, str]:
        with pytest.raises(typer.Exit) as ended:
            command([str(path)], seeds=2, jobs=1, **options)
        return ended.value.exit_code, capsys.readouterr().out

    path.write_text(SCENARIO.replace("1.0", "0.4"))
    code, text = called()
    assert (code, f"figures of 2 seeds in {file}" in text) == (0, True)
    first = file.read_text()
    assert hil.run(str(path)).passed
    assert called() == (0, f"mine\n  {'baseline':<22} nothing has moved from {file}\n")
    path.write_text(path.read_text() + "[plant.start]\nfriction_coefficient = 0.2\n")
    code, text = called()
    assert (code, file.read_text()) == (1, first)
    assert " in place of " in text
    assert "stays as it is; if the change is meant, add --accept" in text
    code, text = called(accept=True, as_json=True)
    assert code == 0
    table = json.loads(text)
    jsonschema.validate(table, json.loads(Path(batch.__file__).with_suffix(".schema.json").read_text()))
    (told,) = table["baselines"]
    assert told["written"]
    assert all(" in place of " in row["text"] for row in told["moved"])
    assert told["moved"]
    assert file.read_text() != first
    assert hil.run(str(path)).passed


@pytest.mark.slow
def test_no_baseline_is_made_of_runs_that_did_not_pass(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        SCENARIO.replace("1.0", "0.4").replace("expect = []", "") + '[[expect]]\nfigure = "ticks"\nbelow = 9\n'
    )
    (made,) = make_baselines([load(str(path))], 2, **ALONE)
    assert made.new is None
    assert [one.partition(":")[0] for one in made.failed] == ["seed 1", "seed 2"]
    assert "ticks below 9: failed, 80" in made.failed[0]


def test_a_time_whose_band_goes_on_to_the_end_is_left_out() -> None:
    scenario = load("circle_speed", set=["loop.duration_s=3"])
    runs = {
        seed: JudgedRun(wire_sha256="0", figures={"tracked_s": 0.5, "t10_s": t10_s})
        for seed, t10_s in enumerate((0.5, 1.4))
    }
    assert "t10_s" not in baseline_of(scenario, runs).figure
    longer = load("circle_speed", set=["loop.duration_s=4"])
    assert baseline_of(longer, runs).figure["t10_s"].band == pytest.approx(2.7)
    assert "tracked_s" in baseline_of(scenario, runs).figure
