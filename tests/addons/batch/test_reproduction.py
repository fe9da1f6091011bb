"""``hil reproduce``: its statements on the paper follow from its runs, and its page names things that exist."""

import ast
import importlib
import json
import math
import pkgutil
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from typer.testing import CliRunner

from hil.addons.batch.reproduction import paper_claims as claims
from hil.addons.batch.reproduction import published
from hil.addons.batch.reproduction.published import delay_margin
from hil.addons.batch.reproduction.reproduction import oscillation, reproduce
from hil.addons.batch.reproduction.section_iv import EXPERIMENT, EXPERIMENT_PERIOD_S, PaperRun, Result, cases
from hil.addons.batch.reproduction.section_iv_page import circle, tables
from hil.addons.batch.results_page import Page, Results, as_text
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.judge.recorded import judged_run
from hil.record.reader import read
from hil.scenario import load
from tests.support.examples import share_of_examples
from tools import reproduction_page as page

ROOT = Path(__file__).parents[3]
PAPER = ROOT / "hil/addons/batch/reproduction/PAPER.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduction")


@pytest.fixture(scope="module")
def summary(folder: Path) -> dict[str, Any]:
    """The JSON of a quick run, as the command prints it."""
    result = CliRunner().invoke(app, ["reproduce", "--quick", "--json", "--jobs", "1", "--out", str(folder)])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


# ---------------------------------------------------------------------------------------- by the equations


@share_of_examples(0.1)
@given(st.floats(0.01, 0.1), st.floats(3.0, 20.0))
def test_the_steady_error_follows_from_equation_17(filter_s, k1_1_s):
    """The periodic solution of ς (ë + q̈_d) + ė + K1 e = 0 with q_d = r0 exp(j ω t), by putting it in."""
    rate = math.tau / published.PERIOD_S
    j = 1j * rate
    error = filter_s * rate**2 * published.RADIUS_M / (filter_s * j**2 + j + k1_1_s)
    assert filter_s * (j**2 * error + j**2 * published.RADIUS_M) + j * error + k1_1_s * error == pytest.approx(0.0)
    assert published.steady_error_m(filter_s, k1_1_s) == pytest.approx(abs(error))
    assert published.steady_error_m(published.filter_for(5e-4, k1_1_s), k1_1_s) == pytest.approx(5e-4, rel=0.02)
    assert published.gain_for(5e-4, published.filter_for(5e-4, k1_1_s)) == pytest.approx(k1_1_s)


@pytest.mark.parametrize(("k1", "k2", "filter_s"), [(10.0, 20.0, 0.0675), (15.0, 40.0, 0.0675), (15.0, 40.0, 0.0217)])
def test_the_loop_swings_up_beyond_the_delay_margin_and_dies_away_below_it(k1, k2, filter_s):
    """One axis as a double integrator with a delayed command, step by step."""
    margin = delay_margin(k1, k2, filter_s)
    for share, grows in ((0.95, False), (1.05, True)):
        swing = _delayed(k1, k2, filter_s, margin.latency_s * share)
        half = len(swing) // 2
        early, late = np.abs(swing[half // 2 : half]).max(), np.abs(swing[-half // 2 :]).max()
        assert bool(late > early) is grows
    crossings = np.flatnonzero(np.diff(np.sign(_delayed(k1, k2, filter_s, margin.latency_s)[-20000:])))
    assert 1.0 / (2e-4 * np.diff(crossings).mean()) == pytest.approx(margin.frequency_hz, rel=0.02)
    assert margin.latency_s - delay_margin(k1, k2, filter_s, 0.005).latency_s == pytest.approx(0.0025)


def _delayed(k1: float, k2: float, filter_s: float, latency_s: float) -> np.ndarray:
    """Return the error of one axis over 6 s, from 1, with its command late by so much."""
    dt = 1e-4
    late = [0.0] * round(latency_s / dt)
    error, rate, virtual = 1.0, 0.0, -k1
    found = []
    for _ in range(60000):
        slope = (-k1 * error - virtual) / filter_s
        late.append(slope - k2 * (rate - virtual))
        virtual += slope * dt
        rate += late.pop(0) * dt
        error += rate * dt
        found.append(error)
    return np.array(found)


def test_no_rule_is_as_stiff_as_dsc():
    assert published.stiffest_rule_1_s2() == 10.0 * 20.0
    assert max(published.K1_1_S.values()) == published.DSC_GAINS[0]


def test_the_scenarios_have_the_numbers_of_the_paper():
    afdsc, dsc, experiment = load("paper_circle"), load("paper_circle_dsc"), load(EXPERIMENT)
    robot = afdsc.robot
    assert (robot.mass_kg, robot.inertia_kg_m2, robot.wheel_radius_m) == (20.0, 0.56, 0.075)
    assert (robot.half_length_m, robot.half_width_m) == (0.3, 0.3)
    assert (dsc.controller.gains["k1_1_s"], dsc.controller.gains["k2_1_s"]) == published.DSC_GAINS
    for scenario in (afdsc, dsc, experiment):
        assert scenario.controller.gains["filter_s"] == published.COMMON_FILTER_S
        assert scenario.reference.options["radius_m"] == published.RADIUS_M
        assert scenario.reference.options["period_s"] == published.PERIOD_S
    assert experiment.loop.period_ns == round(EXPERIMENT_PERIOD_S * 1e9)
    assert experiment.fault[0].end_s == published.SILENT_TO_S - published.SILENT_FROM_S


@share_of_examples(0.1)
@given(st.floats(0.001, 0.1), st.floats(2.0, 20.0), st.floats(-0.01, 0.01), st.floats(0.0, 6.0))
def test_an_oscillation_is_found_beside_what_turns_with_the_path(amplitude_m, frequency_hz, lag_m, phase):
    t = np.arange(1700) * 0.01
    path = lag_m + lag_m * np.cos(3.0 * math.tau / 15.0 * t)
    swing = amplitude_m * np.sin(math.tau * frequency_hz * t + phase)
    found = oscillation(signals(t, path + swing, path), 15.0)
    assert found is not None
    assert found[0] == pytest.approx(amplitude_m, rel=0.15)
    assert found[1] == pytest.approx(frequency_hz, abs=1.0 / 15.0)


def signals(t: np.ndarray, x: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
    return {"loop.t_s": t, "error.x_m": x, "error.y_m": y}


def test_less_than_a_lap_has_no_oscillation():
    t = np.arange(100) * 0.1
    assert oscillation(signals(t, t, t), 15.0) is None
    assert oscillation(signals(t[:0], t[:0], t[:0]), 15.0) is None


# ---------------------------------------------------------------------------------------- verdicts on made-up numbers


CASE_FIGURES: dict[str, float | None] = {
    "heading_rad": 0.0,
    "amplitude_m": 0.001,
    "frequency_hz": 3.0,
    "tracked_s": 0.6,
    "steady_rms_m": 0.00038,
    "steady_max_m": 0.002,
    "driven_s": 7.1,
    "from_m": 1.0,
    "transition_s": 4.2,
}


def made_up(change: dict[str, dict[str, float | None]]) -> dict[str, claims.Claim]:
    """Return the verdicts by claim for runs that agree with the paper but for ``change``, by name of the case."""
    results = []
    for case in cases():
        figures = dict(CASE_FIGURES)
        if str(case.row.get("law")) == "dsc":
            figures |= {"tracked_s": 1.1, "steady_rms_m": 0.00079}
        if str(case.row.get("law")) == "constant":
            figures["tracked_s"] = 0.9
        if case.row.get("latency_ms") == 70.0:
            figures["amplitude_m"] = 0.02
        results.append(Result(case, figures | change.get(case.name, {}), None))
    return {verdict.claim: verdict for verdict in claims.judge(claims.CaseResults(results))}


def test_a_run_that_agrees_comes_out():
    found = made_up({})
    assert {verdict.verdict for verdict in found.values()} == {claims.COMES_OUT, claims.FITTED, claims.NO_NUMBER}
    swings = found["a slight oscillation from the delay"]
    assert (swings.verdict, swings.ours) == (claims.NO_NUMBER, 0.02)  # there is one, and no number of the paper's
    fitted = [claim for claim, verdict in found.items() if verdict.verdict == claims.FITTED]
    assert fitted == [
        "DSC tracks after",
        "AFDSC tracks after",
        "DSC steady error",
        "AFDSC steady error, with a filter of its own",
        "AFDSC tracks sooner than DSC, by",
        "no control signal for",
    ]


@pytest.mark.parametrize(
    ("case", "figures", "claim"),
    [
        ("dsc common together", {"tracked_s": 1.21}, "DSC tracks after"),
        ("dsc common together", {"tracked_s": None}, "DSC tracks after"),
        ("afdsc common together", {"tracked_s": 0.49}, "AFDSC tracks after"),
        ("dsc common together", {"steady_rms_m": 0.00081}, "DSC steady error"),
        ("afdsc common together", {"steady_rms_m": 0.00119}, "AFDSC steady error"),
        ("afdsc common together", {"steady_rms_m": 0.0008}, "AFDSC's steady error is smaller than DSC's, by"),
        ("afdsc common together", {"steady_rms_m": None}, "AFDSC's steady error is smaller than DSC's, by"),
        ("dsc common together", {"steady_rms_m": None}, "AFDSC's steady error is smaller than DSC's, by"),
        ("afdsc short together", {"steady_rms_m": 0.0004}, "AFDSC steady error, with a filter of its own"),
        ("dsc common together", {"tracked_s": 0.5}, "AFDSC tracks sooner than DSC, by"),
        (
            "constant common together",
            {"tracked_s": 0.65},
            "the fuzzy tuner makes it sooner than its middle gains held constant, by",
        ),
        ("dsc common together", {"heading_rad": 0.02}, "the heading converges with both laws"),
        ("experiment", {"driven_s": 0.0}, "no control signal for"),
        ("experiment", {"transition_s": 2.1}, "the transition takes about"),
        ("experiment", {"transition_s": 5.01}, "the transition takes about"),
        ("experiment", {"driven_s": 8.01}, "no control signal for"),
        ("experiment", {"steady_max_m": 0.01}, "then it stays on the reference"),
        ("experiment", {"steady_max_m": 0.011}, "then it stays on the reference"),
        ("afdsc torque 70 ms", {"amplitude_m": 0.002}, "a slight oscillation from the delay"),
    ],
)
def test_each_verdict_turns_with_its_figure(case, figures, claim):
    assert made_up({})[claim].verdict != claims.DOES_NOT
    assert made_up({case: figures})[claim].verdict == claims.DOES_NOT


@pytest.mark.parametrize(("name", "count"), [("dsc common together", 9), ("experiment", 4)])
def test_a_run_that_failed_says_nothing_of_the_paper(name, count):
    failed = [Result(case, {}, "hung" if case.name == name else None) for case in cases()]
    found = claims.judge(claims.CaseResults(failed))
    of_it = [verdict.verdict for verdict in found if f"{name}: hung" in verdict.why]
    assert of_it == [claims.NO_NUMBER] * count


def test_a_variant_that_failed_feeds_no_verdict() -> None:
    """What it came to before it ended is not held against the paper, nor for it."""
    names = ("constant common together", "dsc short each", "afdsc torque 70 ms", "from x = 0 m")
    results = [Result(case, dict(CASE_FIGURES, tracked_s=0.12345, transition_s=0.12345), None) for case in cases()]
    broken = [one._replace(failure="hung") if one.case.name in names else one for one in results]
    blank = [one._replace(failure="hung", figures={}) if one.case.name in names else one for one in results]
    assert claims.judge(claims.CaseResults(broken)) == claims.judge(claims.CaseResults(blank))
    tuner = {verdict.claim: verdict for verdict in claims.judge(claims.CaseResults(broken))}[
        "the fuzzy tuner makes it sooner than its middle gains held constant, by"
    ]
    assert (tuner.verdict, tuner.why) == (claims.NO_NUMBER, "a run is missing, constant common together: hung")


def test_the_command_fails_when_a_run_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real worker is given one run that cannot begin; what an earlier reproduction recorded is gone."""
    (stale := tmp_path / "dsc_common_together.rrd").touch()
    row = {"law": "dsc", "filter": "common", "limit": "together"}
    sets = {"plant.start.no_such": 1.0}
    planned = [PaperRun("dsc common together", "circle", row, "paper_circle_dsc", sets, records=True)]
    monkeypatch.setattr("hil.addons.batch.reproduction.reproduction.cases", lambda *, quick: planned)
    result = CliRunner().invoke(app, ["reproduce", "--json", "--force", "--out", str(tmp_path)])
    assert result.exit_code == 1, result.output
    assert json.loads(result.stdout)["recordings"] == []
    assert not stale.exists()
    assert "plant.start.no_such" in json.loads(result.stdout)["circle"][0]["failure"]


@pytest.mark.parametrize("figures", [{"transition_s": 3.0, "driven_s": 6.0}, {"transition_s": 5.0, "driven_s": 8.0}])
def test_what_is_off_by_all_that_the_papers_digits_leave_open_comes_out(figures):
    found = made_up({"experiment": figures})
    assert found["the transition takes about"].verdict == claims.COMES_OUT
    assert found["no control signal for"].verdict == claims.FITTED


def test_without_the_calm_run_an_oscillation_cannot_be_compared():
    found = made_up({"afdsc torque 0 ms": {"amplitude_m": None}})["a slight oscillation from the delay"]
    assert (found.verdict, found.ours) == (claims.NO_NUMBER, None)


def test_a_law_that_did_not_track_has_no_lead_to_tell():
    claim = "the fuzzy tuner makes it sooner than its middle gains held constant, by"
    found = made_up({"constant common together": {"tracked_s": None}})[claim]
    assert (found.verdict, found.ours) == (claims.NO_NUMBER, None)
    assert found.why.startswith("one of the two did not track; tracked: AFDSC 0.60 s, ")


def test_what_a_quick_reproduction_leaves_out_has_no_verdict():
    results = [Result(case, {"tracked_s": 0.6, "heading_rad": None}, None) for case in cases(quick=True)]
    found = {verdict.claim: verdict for verdict in claims.judge(claims.CaseResults(results))}
    tuner = found["the fuzzy tuner makes it sooner than its middle gains held constant, by"]
    assert (tuner.verdict, tuner.ours) == (claims.NO_NUMBER, None)
    assert "constant common together: it was not run" in tuner.why
    for claim in ("the heading converges with both laws", "no control signal for"):
        assert found[claim].verdict == claims.NO_NUMBER


def test_a_verdict_says_where_the_lead_is_lost():
    found = made_up({"dsc short each": {"tracked_s": 0.5}})["AFDSC tracks sooner than DSC, by"]
    assert found.verdict == claims.FITTED
    assert "0.0217 s and 5 N·m, each motor by itself -0.10 s" in found.why


# ---------------------------------------------------------------------------------------- a quick run


def test_the_json_keeps_its_form(summary: dict[str, Any], folder: Path) -> None:
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8")) == summary
    assert (summary["format"], summary["quick"]) == (1, True)
    expected = "format source quick paper filters_s assumptions circle experiment delay transition verdicts"
    assert list(summary) == [*expected.split(), "folder", "pictures", "recordings", "wall_s"]
    figures = ["tracked_s", "t10_s", "steady_rms_m", "steady_max_m", "heading_rad"]
    assert list(summary["circle"][0]) == ["name", "law", "filter", "limit", *figures, "failure"]
    swing = ["transition_s", "steady_rms_m", "steady_max_m", "amplitude_m", "frequency_hz"]
    assert list(summary["delay"][0]) == ["name", "driven", "latency_ms", *swing, "failure"]
    assert list(summary["verdicts"][0]) == list(claims.Claim._fields)
    assert [row["failure"] for group in ("circle", "experiment", "delay") for row in summary[group]] == [None] * 6
    assert all(row["what"] and row["value"] and row["why"] for row in summary["assumptions"])


def test_the_pictures_open(summary: dict[str, Any], folder: Path) -> None:
    sizes = {"figure_8.png": (1300, 1040), "figure_10.png": (728, 728), "figure_11.png": (1040, 780)}
    sizes |= {"delay.png": (1300, 585)}
    assert sorted(summary["pictures"]) == sorted(sizes)
    for name, size in sizes.items():
        with Image.open(folder / name) as picture:
            assert picture.size == size
            assert len(picture.convert("RGB").getcolors(1 << 20) or ()) > 10  # something is drawn


def test_nothing_is_commanded_until_the_host_comes(summary: dict[str, Any], folder: Path) -> None:
    (row,) = summary["experiment"]
    assert 7.0 <= row["driven_s"] < 7.5
    recorded = read(folder / "experiment.rrd")
    signals = recorded.signals
    assert judged_run(recorded).figures["steady_max_m"] == row["steady_max_m"]
    silent = (signals["loop.t_s"] > 0.0) & (signals["loop.t_s"] < row["driven_s"])
    for wheel in ("fl", "fr", "rr", "rl"):
        assert np.isnan(signals[f"wheel.{wheel}.torque_command_n_m"][silent]).all()
        assert np.isfinite(signals[f"wheel.{wheel}.torque_command_n_m"][signals["loop.t_s"] >= row["driven_s"]]).all()
    assert np.abs(signals["truth.x_m"][silent]).max() < 1e-6
    assert row["from_m"] == pytest.approx(1.0, abs=1e-3)


def test_the_main_runs_are_recorded(summary: dict[str, Any], folder: Path) -> None:
    assert summary["recordings"] == ["afdsc_common_together.rrd", "experiment.rrd"]
    whole = [case.name for case in cases() if case.records]
    assert whole == [*(row["name"] for row in summary["circle"]), "experiment"]
    assert all((folder / name).stat().st_size > 100_000 for name in summary["recordings"])


def test_the_page_and_the_text_have_every_verdict(summary: dict[str, Any], folder: Path) -> None:
    results = Results("", True, "", [], tables(summary), [], summary)
    printed, shown = "\n".join(as_text(results)), (folder / "report.html").read_text(encoding="utf-8")
    assert shown.count("<svg") == 4
    for row in summary["verdicts"]:
        for cell in (row["claim"], row["verdict"], row["why"]):
            assert cell in printed
            assert escape(cell) in shown


def test_a_folder_that_cannot_be_made_is_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match=r"^--out .*file.*: it cannot be written to .*; name a folder"):
        reproduce(Page(tmp_path / "file" / "out" / "report.html", "png", "refuse"), quick=True)


# ---------------------------------------------------------------------------------------- the page


def rows() -> Iterator[tuple[str, list[str]]]:
    """Yield the rows of the page's tables of places: the place, and what is named as its symbols and tests."""
    for line in PAPER.read_text(encoding="utf-8").splitlines():
        cells = line.strip("| ").split(" | ")
        if line.startswith("| ") and len(cells) == 5 and cells[0] != "place":
            yield cells[0], re.findall(r"`([^`]+)`", " ".join(cells[2:4]))


def named() -> list[tuple[str, str]]:
    return [(place, name) for place, names in rows() for name in names]


@pytest.mark.parametrize(("place", "name"), named())
def test_what_the_page_names_exists(place: str, name: str) -> None:
    if "::" in name:
        file, _, function = name.partition("::")
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    elif "/" in name:
        assert (ROOT / name).is_file()
    else:
        pkgutil.resolve_name(name)
        importlib.import_module(name.split(".")[0])


def test_the_page_has_every_equation_table_and_figure() -> None:
    places = [place for place, names in rows() if names]
    equations = {int(number) for place in places for number in re.findall(r"\((\d+)\)", place)}
    assert equations | {4, 5} == set(range(1, 23))  # 3 to 6 share a row
    assert [place for place in places if place.startswith("Table")] == [
        f"Table {n}" for n in ("I", "II", "III", "IV", "V")
    ]
    figures = {int(number) for place in places for number in re.findall(r"Fig\. (\d+)", place)}
    assert figures == set(range(1, 12))


def test_the_page_has_the_figures_of_a_run(summary: dict[str, Any]) -> None:
    """Every run of the quick plan is on the page with the same figures, and every verdict has its row."""
    text = page.page()
    for row in circle(summary).rows[1:]:
        assert f"| {' | '.join(row)} |" in text
    for case in cases():
        if case.group == "transition":
            assert f" | {case.name} | " in text
    for verdict in summary["verdicts"]:
        assert f"| {verdict['place']} | {verdict['claim']} |" in text


def test_a_whole_summary_is_kept_for_the_page_without_what_belongs_to_one_run(tmp_path, monkeypatch) -> None:
    (given := tmp_path / "summary.json").write_text(json.dumps({**page.kept(), "wall_s": 1.0}), encoding="utf-8")
    before = page.KEPT.read_text(encoding="utf-8")
    monkeypatch.setattr(page, "KEPT", tmp_path / "kept.json")
    assert page.main([str(given)]) == 0
    assert page.KEPT.read_text(encoding="utf-8") == before
    given.write_text(json.dumps({"quick": True}), encoding="utf-8")
    assert page.main([str(given)]) == 2


def test_the_verdicts_of_the_page_follow_from_its_figures() -> None:
    summary = page.kept()
    rows = {row["name"]: row for group in ("circle", "experiment", "delay", "transition") for row in summary[group]}
    results = [Result(case, rows[case.name], rows[case.name]["failure"]) for case in cases()]
    again = [verdict._asdict() for verdict in claims.judge(claims.CaseResults(results))]
    assert json.loads(json.dumps(again)) == summary["verdicts"]
