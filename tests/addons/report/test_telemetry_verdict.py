"""A run's verdict in its recording: as text, in the lanes of expectations and faults, in plots and layout."""

import json
import math
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.report.blueprint import blueprint
from hil.addons.report.claim_watch import ClaimWatch, Standing, claims
from hil.addons.report.entities import layout
from hil.addons.report.review_windows import Course, Moment, windows
from hil.addons.report.verdict_text import running, verdict
from hil.core.signals import INDEX, SIGNAL_NAMES, pack_row
from hil.judge.claims import Watch
from hil.record.recording import Recording
from hil.runtime.provenance import properties
from hil.scenario import Scenario, load
from tests.addons.report.test_telemetry_drawings import batches, read, states
from tests.record.test_telemetry_recording import has_ended
from tests.support.processes import wait_for
from tests.support.recorded_circle import circle_table

CLAIMS: Mapping[str, Mapping[str, Any]] = {
    "below": {"signal": "error.planar_m", "below": 0.5, "from_s": 0.2, "to_s": 0.8},
    "above": {"signal": "error.planar_m", "above": -0.5},
    "both": {"signal": "error.planar_m", "above": -0.5, "below": 0.5},
    "within": {"signal": "error.planar_m", "within": [-0.5, 0.5], "to_s": 0.6},
    "equals": {"signal": "error.planar_m", "equals": 0.0, "tolerance": 0.5},
    "exactly": {"signal": "error.planar_m", "equals": 0.25},
    "settles": {"signal": "error.planar_m", "settles_to": 0.0, "tolerance": 0.5, "to_s": 0.7},
    "of": {"signal": "truth.x_m", "of": "reference.x_m", "below": 0.5},
    "heading": {"signal": "truth.heading_rad", "of": "reference.heading_rad", "within": [-0.5, 0.5]},
    "at rest": {"at_rest": True, "below": 0.5, "from_s": 0.3},
}
NUMBERS = st.one_of(st.sampled_from([math.nan, -1.0, -0.5, 0.0, 0.25, 0.5, 6.0]), st.floats(-1.0, 1.0, width=32))


def scenario_with(folder: Path, expect: Sequence[Mapping[str, Any]], rest: str = "") -> Scenario:
    rows = "\n".join(f"[[expect]]\n{_toml(row)}" for row in expect)
    path = folder / "claimed.toml"
    path.write_text(f'extends = "circle_speed"\n[loop]\nduration_s = 1.6\n{rest}\n{rows}')
    return load(path, set={"expect": []}) if not expect else load(path)


def _toml(row: Mapping[str, Any]) -> str:
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in row.items())


@pytest.fixture(scope="module")
def claimed(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return scenario_with(tmp_path_factory.mktemp("claims"), list(CLAIMS.values()))


@given(data=st.data(), cut=st.integers(1, 9))
def test_a_lane_says_of_each_claim_what_the_judge_says(claimed: Scenario, data: st.DataObject, cut: int) -> None:
    """Whatever the signals are, and wherever the rows are cut into pieces."""
    table = circle_table(10)
    table[:, INDEX["loop.t_s"]] = np.arange(10) / 10
    for name in (
        "error.planar_m",
        "truth.x_m",
        "truth.y_m",
        "truth.heading_rad",
        "reference.x_m",
        "reference.heading_rad",
    ):
        table[:, INDEX[name]] = data.draw(st.lists(NUMBERS, min_size=10, max_size=10))
    for wheel in ("fl", "fr", "rr", "rl"):
        table[:, INDEX[f"wheel.{wheel}.speed_rad_s"]] = data.draw(st.lists(NUMBERS, min_size=10, max_size=10))
    values = json.loads(properties(claimed, {})["scenario"])
    found = claims(values)[-len(CLAIMS) :]
    for claim, expect, name in zip(found, claimed.expect[-len(CLAIMS) :], CLAIMS, strict=True):
        judge = Watch(expect, claimed.fault, claimed.robot)
        for row in table:
            if judge.from_s <= row[INDEX["loop.t_s"]] <= judge.to_s:
                judge.add(row[INDEX["loop.t_s"]], [row[INDEX[signal]] for signal in judge.signals])
        watch = ClaimWatch(claim, INDEX, values)
        pieces = [watch(piece) for piece in (table[:cut], table[cut:])]
        outcome = judge.result()
        assert watch.has_held == outcome.passed, name
        if not claim.settles:
            violated_s = None if watch.violation_s is None else watch.violation_s[0]
            assert violated_s == outcome.violation_s, name
        standing = np.concatenate([piece.standing for piece in pieces])
        violated = np.concatenate([piece.violated for piece in pieces])
        t_s = table[:, INDEX["loop.t_s"]]
        assert violated.tolist() == (standing == Standing.VIOLATED).tolist()
        if not claim.is_rest:
            bad = Standing.SETTLING if claim.settles else Standing.VIOLATED
            for row in np.flatnonzero((t_s >= claim.from_s) & (t_s <= claim.to_s)):
                alone = Watch(expect, claimed.fault, claimed.robot)
                alone.add(t_s[row], [table[row][INDEX[signal]] for signal in alone.signals])
                assert standing[row] == (Standing.HOLDING if alone.result().passed else bad), name
        assert set(standing[t_s < claim.from_s]) <= {Standing.WAITING}
        over = {Standing.HELD if outcome.passed else Standing.FAILED}
        assert set(standing[t_s > claim.to_s]) <= over, name


VIOLATED = (
    {"signal": "error.planar_m", "from_s": 0.5, "to_s": 1.2, "below": 0.005},
    {"signal": "wheel.fr.speed_rad_s", "within": [-4.0, 20.0]},
    {"figure": "steady_rms_m", "below": 1.0},
    {"signal": "error.heading_rad", "from_s": 1.0, "to_s": 1.2, "below": 1.0},
)
FAULTS = """
[[fault]]
kind = "drop"
target = "command"
value = 0.1
start_s = 1.599

[[fault]]
kind = "drop"
target = "feedback"
value = 0.1
start_s = 9.0
"""


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a made-up run that failed; without round trips, and with fixes that begin late."""
    folder = tmp_path_factory.mktemp("verdict")
    scenario = scenario_with(folder, VIOLATED, FAULTS)
    table = circle_table(1599)
    for name in ("link.rtt_ms", "link.latency_ms", "link.load_percent"):
        table[:, INDEX[name]] = np.nan
    table[1000:1200, [INDEX[f"{group}.x_m"] for group in ("pose", "truth")]] = np.nan
    table[:, INDEX["estimator.fix_age_ms"]] = np.nan
    path = folder / "run.rrd"
    with Recording(path, properties=properties(scenario), blocking=True, capacity=64) as recorder:
        for row in table:
            recorder.put(pack_row(tuple(row)))
        recorder.event(0.5, "error", "error.planar_m below 0.005: failed")
        row = {"passed": False, "violation_s": 0.5}
        outcomes = [dict(row) for _ in range(len(scenario.expect))]
        outcomes[-2]["passed"] = True
        faults = [{"applied": count, "text": "drop", "end_s": None} for count in (3, 0)]
        why = [("expectation", "error.planar_m below 0.005: failed, 0.01 at t = 0.5 s")]
        summary = {"passed": False, "why": why, "failure": None, "expect": outcomes, "fault": faults}
        assert recorder.finish(summary).complete
    return path


def words(recording: Path) -> str:
    """Return the verdict that a viewer shows: the newest one."""
    import rerun.chunk as rrc

    chunks = [chunk.to_record_batch() for chunk in rrc.RrdReader(recording).stream().filter(content="/verdict")]
    texts = [
        (one.column("rerun.controls.RowId")[-1].as_py(), one.column("TextDocument:text")[-1].as_py()) for one in chunks
    ]
    return str(max(texts)[1][0])


def test_the_first_words_are_the_verdict_when_and_why(failed: Path) -> None:
    assert words(failed).splitlines()[0] == "# FAILED at t = 0.5 s (claimed, law dsc)"
    assert "- error.planar_m below 0.005: failed, 0.01 at t = 0.5 s" in words(failed)


def test_the_lanes_are_in_order_and_an_idle_fault_has_none(failed: Path) -> None:
    import rerun.chunk as rrc

    lanes = sorted({chunk.entity_path for chunk in rrc.RrdReader(failed).stream().filter(content="/state/**")})
    kinds = [lane.split("/")[2].split("_")[1] for lane in lanes]
    order = ["verdict", "robot", "link", "estimator", "expect", "fault"]
    assert list(dict.fromkeys(kinds)) == order
    assert [lane for lane in lanes if "fault" in lane] == ["/state/6_fault_0_drop_command"]
    assert states(failed, "/state/1_verdict") == [(0.0, "RUNNING"), (0.5, "FAILED")]


def test_a_fault_that_ended_the_run_before_a_row_of_its_time_shows_at_the_last_instant(failed: Path) -> None:
    ((at_s, state),) = states(failed, "/state/6_fault_0_drop_command")
    assert at_s == pytest.approx(1.598)
    assert state == "IN FORCE"


def test_an_expectation_waits_holds_and_is_violated(failed: Path) -> None:
    lanes = {0: "00_error.planar_m_below_0.005", 2: "02_steady_rms_m_below_1", 3: "03_error.heading_rad_below_1"}
    planar, figure, heading = (states(failed, f"/state/5_expect_{lane}") for lane in lanes.values())
    assert [state for _, state in planar] == ["WAITING", "VIOLATED", "HOLDING", "FAILED"]
    assert [t_s for t_s, _ in planar] == pytest.approx([0.0, 0.5, planar[2][0], 1.201])
    assert figure == [(0.0, "HELD")]
    assert [state for _, state in heading] == ["WAITING", "HOLDING", "HELD"]


def test_a_violation_is_marked_in_the_plot_of_its_signal(failed: Path) -> None:
    t_s, values = read(failed, "/violations/ctrl/error/position/0", "Scalars:scalars", 1)
    table = circle_table(1599)
    planar = table[:, INDEX["error.planar_m"]]
    bad = [row for row in range(500, 1201) if planar[row] >= 0.005]
    assert bad == list(range(500, bad[-1] + 1))
    marked = list(range(500, bad[-1] + 1, 50))  # the first row of each 50 ms
    assert np.rint(1000 * t_s).astype(int).tolist() == marked
    assert values[:, 0].tolist() == planar[marked].tolist()
    assert states(failed, "/state/5_expect_00_error.planar_m_below_0.005")[2][0] == (bad[-1] + 1) / 1000
    _, values = read(failed, "/violations/ctrl/wheel/speed/1", "Scalars:scalars", 1)
    assert (values < -4.0).all()


def test_a_signal_without_a_value_has_no_curve(failed: Path) -> None:
    assert not list(batches(failed, "/link/delay"))
    assert not list(batches(failed, "/link/load"))
    assert not list(batches(failed, "/ctrl/estimator/fix_age"))
    # Of this entity one signal of two is known.
    _, values = read(failed, "/link/age", "Scalars:scalars", 2)
    assert np.isfinite(values).all()


def test_an_outage_is_a_gap_in_the_plan(failed: Path) -> None:
    for trail in ("estimate", "truth"):
        t_s, _ = read(failed, f"/xy/{trail}", "LineStrips2D:strips", 4)
        assert np.diff(t_s).max() == pytest.approx(0.28, abs=1e-6), trail
    t_s, _ = read(failed, "/xy/reference", "LineStrips2D:strips", 4)
    assert np.diff(t_s).max() == pytest.approx(0.04, abs=1e-6)


def test_missing_rows_are_a_gap_in_the_plots_and_in_the_plan(tmp_path: Path) -> None:
    path, table = tmp_path / "run.rrd", circle_table(1500)
    with Recording(path, properties={}, blocking=True) as recorder:
        for row in np.delete(table, np.s_[600:1000], axis=0):
            recorder.put(pack_row(tuple(row)))
        recorder.finish({})
    t_s, values = read(path, "/ctrl/error/heading", "Scalars:scalars", 1)
    (gap,) = np.flatnonzero(np.isnan(values[:, 0]))
    assert (t_s[gap - 1], t_s[gap + 1]) == pytest.approx((0.595, 1.0))
    t_s, strips = read(path, "/xy/reference", "LineStrips2D:strips", 4)
    assert np.hypot(*(strips[:, 2:] - strips[:, :2]).T).max() < 0.05


@pytest.mark.parametrize("kept", [None, {"passed": None}, {}])
def test_a_run_without_a_verdict_says_so(tmp_path: Path, kept: Mapping[str, object] | None) -> None:
    told = verdict({}, kept, end_s=1.5, failed_s=None, next_part=None, troubles=["it broke"])
    assert told.startswith("# NO VERDICT" if kept is None else "# NOT JUDGED")
    assert "t = 1.5 s" in told
    assert "- it broke" in told


def test_a_run_that_is_killed_has_no_verdict(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with Recording(path, properties={}, blocking=True) as recorder:
        for row in circle_table(300):
            recorder.put(pack_row(tuple(row)))
        os.kill(recorder.pid, signal.SIGTERM)  # as when the run has gone
        wait_for(lambda: has_ended(recorder.pid))
    assert words(path).startswith(
        "# NO VERDICT\n\nThe run was killed or interrupted: its recording ends at t = 0.299 s"
    )
    assert states(path, "/state/1_verdict") == [(0.0, "RUNNING")]


def test_the_verdict_of_parts_of_a_run_under_way_and_of_one_that_passed() -> None:
    part = verdict({}, None, end_s=1.5, failed_s=None, next_part=3, troubles=())
    assert part.startswith("# RUNNING")
    assert "file 3" in part
    assert "- late" in running({}, ["late"])
    assert running({"scenario_name": "one"}, []).startswith("# RUNNING (one)")
    passed = {"passed": True, "expect": [{"text": "a"}, {"text": "b"}], "fault": [{"text": "drop", "applied": 2}]}
    said = verdict({}, passed, end_s=1.5, failed_s=None, next_part=None, troubles=())
    assert said.startswith("# PASSED")
    assert "All 2 expectations held" in said
    assert "drop, applied 2 times" in said
    many = {"passed": False, "failure": None, "why": [("expectation", f"reason {n}") for n in range(9)]}
    assert "and 5 more: see the tab Run" in verdict({}, many, end_s=1, failed_s=None, next_part=None, troubles=())


def test_a_failure_names_the_faults_in_force_then() -> None:
    faults = [
        {"text": "reset robot from 6 s", "applied": 1, "end_s": None},
        {"text": "drop command from 1 s to 2 s", "applied": 9, "end_s": 2.0},
        {"text": "push from 9 s", "applied": 0, "end_s": None},
    ]
    summary = {"passed": False, "failure": "gone", "why": [("failure", "gone")], "fault": faults}
    told = verdict({}, summary, end_s=5.995, failed_s=None, next_part=None, troubles=())
    assert told.splitlines()[0] == "# FAILED at t = 5.995 s"
    assert "In force then: the fault reset robot from 6 s." in told
    assert "drop" not in told
    assert "push" not in told


def test_each_event_of_a_long_run_has_a_window_and_the_start_ends_before_the_first() -> None:
    found = windows(0.0, 1200.0, {"tracked_s": 0.6}, [Moment(300.0, "drop command", 2.0), Moment(300.1, "violated")])
    start, event = found
    assert (start.from_s, start.to_s) == pytest.approx((0.0, 0.9))
    assert (event.from_s, event.to_s) == pytest.approx((299.25, 303.0))
    assert event.words == "drop command at 300 s; violated"
    (start, *_) = windows(0.0, 6.0, {"tracked_s": 4.0}, [Moment(2.0, "disconnect", 0.8)])
    assert start.to_s == 2.0


def test_the_run_tells_its_recording_why_it_did_not_pass(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    late = [{"signal": "error.planar_m", "below": 1e-9, "from_s": 0.05}]
    result = hil.run("circle_speed", record=path, set={"loop.duration_s": 0.1, "expect": late})
    assert not result.passed
    assert words(path).startswith("# FAILED at t = 0.05 s (circle_speed, law dsc)\n\n- error.planar_m below 1e-09 from")
    assert set(SIGNAL_NAMES) <= set(result.signals)


def test_a_long_run_has_a_window_for_each_event_four_to_a_tab() -> None:
    happened = [Moment(100.0 * number, f"drop {number}") for number in range(1, 7)]
    found = windows(0.0, 1200.0, None, happened)
    assert [window.words for window in found[:2]] == ["start", "drop 1 at 100 s"]
    entities = layout(["error.planar_m", "loop.t_s"])
    course = Course(0.0, 1200.0, ("/ctrl/error/position",), (100.0, 101.0), found, 5, 1)
    shown: Any = blueprint(entities, limits={}, shape=None, live=False, course=course).root_container
    tabs = shown.contents
    transients = {tab.name: [column.name for column in tab.contents] for tab in tabs if "Transients" in str(tab.name)}
    assert list(transients) == ["Transients 1", "Transients 2"]
    assert sum(map(len, transients.values())) == 7
    assert not [tab.name for tab in tabs if tab.name in ("Wheels", "Link and loop")], "it has none of their signals"
