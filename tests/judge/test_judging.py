"""Judged quantities other than a signal's value: figures, differences, rest after a fault, and strict limits."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.report.claim_watch import claims, limits
from hil.addons.report.entities import layout
from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.core.types import WHEEL_NAMES
from hil.faults.rows import REST_RAD_S, FaultRow
from hil.judge.claims import check_expectation
from hil.judge.expectations import Count, figure_result, figures_by_key, limit_results
from hil.judge.judged_run import JudgedRun
from hil.judge.recorded import judged_run, read_for_figures
from hil.judge.run_json import from_json, to_json
from hil.judge.run_text import LENIENT, outcome_rows, why_not_passed
from hil.runtime.run_parts import RunParts
from hil.runtime.sampling import Timing
from hil.runtime.unexplained import Rejections
from hil.scenario import load
from hil.scenario.baseline import Band, Baseline
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable, span_s
from tests.support.outside import outside_package

ROBOT = load("circle_speed").robot
NAN = float("nan")
NUMBER = st.floats(-100, 100).filter(lambda v: v == 0 or abs(v) >= 1e-30)  # smaller ones are refused
SHORT = {"loop.duration_s": 1.0}
CUT = {"kind": "disconnect", "start_s": 0.3, "end_s": 0.9}
BELOW_1_MM = {"signal": "error.planar_m", "below": 1e-3}


def expect(**row: Any) -> ExpectTable:
    return build(ExpectTable, row)


def run(*rows: dict[str, Any], scenario: str = "circle_speed", **more: Any) -> hil.RunResult:
    """Run for a second with these expectations."""
    record = more.pop("record", None)
    lenient = more.pop("lenient", False)
    sets = {**SHORT, **{key.replace("__", "."): value for key, value in more.items()}, "expect": list(rows)}
    return hil.run(scenario, set=sets, record=record, lenient=lenient)


# Figures


@given(NUMBER, st.one_of(st.just({}), NUMBER.map(lambda v: {"above": v})), NUMBER)
def test_a_claim_about_a_figure_holds_when_its_value_does(value: float, more: dict[str, float], below: float) -> None:
    if more.get("above", -math.inf) >= below:
        return
    outcome = figure_result(
        expect(figure="steady_rms_m", below=below, **more), JudgedRun(figures={"steady_rms_m": value})
    )
    assert outcome.passed is (more.get("above", -math.inf) < value < below)
    assert f"{value:.6g}" in outcome.text


@pytest.mark.parametrize("key", sorted(figures_by_key()))
def test_every_figure_can_be_judged_and_is_listed(key: str) -> None:
    assert figure_result(expect(figure=key, above=-1.0), from_json({})).text.startswith(
        f"{key} above -1: failed, the run has no"
    )
    assert key in [row[0] for row in listing("figures")[1]]


def test_the_figures_of_a_run_are_judged_and_those_that_it_lacks_fail_with_the_reason() -> None:
    known = ("t10_s", "overshoot_m", "effort_n_m_s", "torque_variation_n_m_per_s", "saturation_s", "estimation_rms_m",
             "latency_p99_ms", "feedback_age_p99_ms", "rejected", "refused", "unmatched")  # fmt: skip
    wide = [{"figure": name, "within": [-1e9, 1e9]} for name in known]
    result = run(*wide, {"figure": "steady_rms_m", "below": 1.0}, plant__start__start_x_m=0.0)
    outcome = {row["figure"]: row for row in result.metrics["expect"]}
    assert [name for name in known if not outcome[name]["passed"]] == ["t10_s"], "it does not settle in a second"
    assert "the run has no such figure: the planar error did not stay below 10 mm" in outcome["t10_s"]["text"]
    assert "less than the window of 5 s" in outcome["steady_rms_m"]["text"]
    assert [row["passed"] for row in result.metrics["expect"]].count(False) == 2
    assert not result.passed


def test_the_latency_of_a_run_is_that_of_its_link() -> None:
    result = run({"figure": "latency_p99_ms", "equals": 5.0, "tolerance": 1e-9})
    assert result.passed, result


def test_a_figure_of_a_run_that_ended_early_is_not_judged() -> None:
    result = run({"figure": "effort_n_m_s", "below": 1e9}, fault=[CUT])
    (row,) = result.metrics["expect"]
    assert (row["passed"], result.passed, result.exit_code) == (None, False, 3)
    assert "not judged, the run ended at t = 0.295 s" in row["text"]


def test_an_unknown_figure_is_refused_with_its_place_and_near_names(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text('extends = "paper_circle"\n[[expect]]\nfigure = "steady_rms"\nbelow = 1\n')
    words = r'expect.1.figure = "steady_rms"; expected the name of a figure; did you mean .*_rms_m'
    with pytest.raises(BadInputError, match=rf"^scenario .*wrong.toml:3: {words}"):
        RunParts(load(str(path)))
    with pytest.raises(BadInputError, match=rf"^--set: {words}"):
        RunParts(load("paper_circle", set={"expect": [{"figure": "steady_rms", "below": 1}]}))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ('signal = "error.x_m"\nfigure = "t10_s"\nbelow = 1', "needs one of"),
        ("at_rest = false\nbelow = 1", "needs one of"),
        ('figure = "t10_s"', "needs one claim"),
        ('figure = "t10_s"\nbelow = 1\nfrom_s = 2.0', "one number of the whole run"),
        ('figure = "t10_s"\nsettles_to = 1\ntolerance = 1', "one number of the whole run"),
        ('figure = "t10_s"\nof = "error.x_m"\nbelow = 1', "name it with signal"),
        ("at_rest = true\nabove = 1", "takes no claim but below"),
        (
            'signal = "error.x_m"\nof = "error.heading_rad"\nbelow = 1',
            "expected a signal in the unit of error.x_m (m), to compare them",
        ),
        ('signal = "error.x_m"\nof = "error.z_m"\nbelow = 1', "expected the name of a signal"),
        (
            'signal = "loop.tick"\nof = "error.x_m"\nbelow = 1',
            "expected a signal in the unit of loop.tick (without a unit), to compare them",
        ),
        (
            "at_rest = true\nwithin_s = 1",
            "after_fault and within_s belong together: after which fault, and by when; give both",
        ),
        ('signal = "error.x_m"\nbaseline = "5%"', "baseline = '5%' is for a figure; name it with figure"),
        (
            'at_rest = true\nwithin_s = 1\nafter_fault = "push"',
            "no fault has this name or kind; known: drop",
        ),
        ("at_rest = true\nwithin_s = 1\nafter_fault = 9", "expected a row from 1 to 3"),
        ("at_rest = true\nwithin_s = 1\nafter_fault = true", "expected the name of a fault, its kind, or its row"),
        ('at_rest = true\nwithin_s = 1\nafter_fault = "drop"', "2 faults are of this kind; name one of them"),
        (
            'at_rest = true\nwithin_s = 1\nafter_fault = "pull"\nfrom_s = 1',
            "says from when it is judged; remove from_s",
        ),
        ('at_rest = true\nwithin_s = 1\nafter_fault = "pull"\nto_s = 2.5', "expected a time after 3 s"),
    ],
)
def test_what_contradicts_itself_is_refused_in_one_sentence(tmp_path: Path, row: str, words: str) -> None:
    path = tmp_path / "wrong.toml"
    faults = '[[fault]]\nkind = "drop"\ntarget = "command"\n' * 2
    faults += '[[fault]]\nname = "pull"\nkind = "dead_motor"\ntarget = "fl"\nstart_s = 2\n'
    path.write_text(f'extends = "paper_circle"\n{faults}[[expect]]\n{row}\n')
    with pytest.raises(BadInputError) as error:
        load(str(path))
    assert words in str(error.value)
    assert "wrong.toml:" in str(error.value)


def test_a_claim_after_a_fault_needs_one(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text('extends = "paper_circle"\n[[expect]]\nat_rest = true\nwithin_s = 1\nafter_fault = 1\n')
    words = r"wrong.toml:5: .*; the scenario has no fault; add a row of \[\[fault\]\], or give from_s"
    with pytest.raises(BadInputError, match=words):
        load(str(path))


# Differences of signals

SERIES = st.lists(st.tuples(NUMBER, NUMBER), min_size=1, max_size=20)


@given(SERIES, NUMBER)
def test_a_claim_of_one_signal_of_another_is_on_the_difference(pairs: list[tuple[float, float]], below: float) -> None:
    one, other = (np.array(column) for column in zip(*pairs, strict=True))
    signals = {"loop.t_s": np.arange(len(one), dtype=float), "wheel.fl.speed_rad_s": one, "wheel.fr.speed_rad_s": other}
    claim = {"signal": "wheel.fl.speed_rad_s", "below": below}
    compared = check_expectation(expect(**claim, of="wheel.fr.speed_rad_s"), signals)
    direct = check_expectation(expect(**claim), {**signals, "wheel.fl.speed_rad_s": one - other})
    assert compared._replace(text="") == direct._replace(text="")


@given(st.floats(-20, 20), st.floats(-0.9, 0.9), st.integers(-3, 3))
def test_headings_are_compared_the_shorter_way_around(heading: float, apart: float, turns: int) -> None:
    signals = {
        "loop.t_s": np.zeros(1),
        "pose.heading_rad": np.array([heading + apart + turns * math.tau]),
        "truth.heading_rad": np.array([heading]),
    }
    row = expect(signal="pose.heading_rad", of="truth.heading_rad", within=[-1.0, 1.0])
    assert check_expectation(row, signals).passed


def test_wheels_are_compared_with_their_commands_in_a_run_and_in_its_review(tmp_path: Path) -> None:
    follows = {"signal": "wheel.fl.speed_rad_s", "of": "wheel.fl.speed_command_rad_s", "from_s": 0.5}
    result = run({**follows, "within": [-20, 20]}, {**follows, "within": [-1e-9, 1e-9]}, record=tmp_path / "run.mcap")
    assert [row["passed"] for row in result.metrics["expect"]] == [True, False]
    recorded = read_for_figures(tmp_path / "run.mcap", SIGNAL_NAMES)
    assert to_json(judged_run(recorded))["expect"] == result.metrics["expect"]
    again = to_json(judged_run(replace(recorded, summary=None)))["expect"]
    assert again == result.metrics["expect"], "a run that was killed is judged by its rows"


# At rest after a fault


def resting(wheels: float, metres_a_second: float, *, known: bool = True) -> dict[str, np.ndarray]:
    """The signals of a robot that moves evenly for a second, as measured and in truth."""
    t_s = np.arange(0.0, 1.0, 0.01)
    truth = {"truth.x_m": metres_a_second * t_s, "truth.y_m": 0 * t_s, "truth.heading_rad": 0 * t_s}
    truth = {name: values if known else values * NAN for name, values in truth.items()}
    speeds = {f"wheel.{wheel}.speed_rad_s": np.full_like(t_s, wheels) for wheel in WHEEL_NAMES}
    return {"loop.t_s": t_s, **truth, **speeds}


@given(st.floats(-1, 1), st.floats(-0.05, 0.05))
def test_at_rest_neither_wheels_turn_nor_the_robot_moves(wheels: float, metres_a_second: float) -> None:
    fastest = max(abs(wheels), abs(metres_a_second) / ROBOT.wheel_radius_m)
    if abs(fastest - REST_RAD_S) > 1e-6:
        signals = resting(wheels, metres_a_second)
        assert check_expectation(expect(at_rest=True), signals, robot=ROBOT).passed is (fastest < REST_RAD_S)


@pytest.mark.parametrize("wheel", WHEEL_NAMES)
@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_the_fastest_wheel_is_that_of_rest(wheel: str, speed: float) -> None:
    signals = resting(0.0, 0.0) | {f"wheel.{wheel}.speed_rad_s": np.full(100, speed)}
    outcome = check_expectation(expect(at_rest=True), signals, robot=ROBOT)
    assert (outcome.violation_s, outcome.violation_value, outcome.violated_s) == pytest.approx((0.0, 2.0, 0.99))


def test_rest_is_judged_by_how_fast_wheels_must_turn_for_the_true_way_and_turn() -> None:
    """3 cm and 4 cm in 0.2 s, then a turn of 0.1 rad across ±π in 0.4 s, then both, the other way, in 0.1 s."""
    signals = {name: np.full(4, NAN) for name in resting(0.0, 0.0)} | {
        "loop.t_s": np.array([0.0, 0.2, 0.6, 0.7]),
        "truth.x_m": np.array([1.0, 1.03, 1.03, 1.0]),
        "truth.y_m": np.array([-2.0, -1.96, -1.96, -2.0]),
        "truth.heading_rad": np.array([3.1, 3.1, 3.2 - math.tau, 3.1]),
    }
    lever_m = ROBOT.half_length_m + ROBOT.half_width_m
    rims_m_s = (0.05 / 0.2, 0.1 * lever_m / 0.4, (0.05 + 0.1 * lever_m) / 0.1)
    for n, rim_m_s in enumerate(rims_m_s):
        some = {name: values[n : n + 2] for name, values in signals.items()}
        outcome = check_expectation(expect(at_rest=True), some, robot=ROBOT)
        assert outcome.violation_s == signals["loop.t_s"][n + 1]
        assert outcome.violation_value == pytest.approx(rim_m_s / ROBOT.wheel_radius_m)
        assert "no samples" in check_expectation(expect(at_rest=True), {k: v[:1] for k, v in some.items()}).text


def test_without_truth_the_wheels_are_judged_and_without_feedback_the_truth_and_without_both_it_fails() -> None:
    row = expect(at_rest=True, below=0.1)
    assert check_expectation(row, resting(0.0, 9.0, known=False), robot=ROBOT).passed
    assert not check_expectation(row, resting(0.2, 0.0, known=False), robot=ROBOT).passed
    assert check_expectation(row, resting(NAN, 0.0), robot=ROBOT).passed
    assert not check_expectation(row, resting(NAN, 0.1), robot=ROBOT).passed
    outcome = check_expectation(row, resting(NAN, 0.0, known=False), robot=ROBOT)
    assert (outcome.passed, "no value at t = 0.01 s" in outcome.text) == (False, True)


def test_a_robot_must_be_at_rest_so_long_after_a_fault_and_may_drive_again_after_it() -> None:
    rest = {"at_rest": True, "after_fault": "disconnect"}
    more = {"fault": [CUT], "loop__rearm": True, "loop__duration_s": 2.0}
    result = run({**rest, "within_s": 0.5}, {**rest, "within_s": 0.02}, {**rest, "within_s": 1.5}, **more)
    assert [row["passed"] for row in result.metrics["expect"]] == [True, False, False]
    assert "from 0.8 s (0.5 s after the fault disconnect) to 0.9 s: held" in result.metrics["expect"][0]["text"]
    assert len(result.metrics["recoveries"]) == 1
    assert result.metrics["expect"][2]["violation_s"] == pytest.approx(1.8), "and there it drives"


def test_a_fault_is_named_by_its_name_its_kind_or_its_row() -> None:
    rows = [FaultTable("drop", "command", start_s=1.0), FaultTable("drop", "feedback", start_s=2.0, name="late"),
            FaultTable("push", "force_x_n", start_s=4.0, end_s=4.2, value=9.0)]  # fmt: skip
    for which, begins in ((1, 1.0), ("late", 2.0), ("push", 4.0), (3, 4.0)):
        row = expect(signal="error.x_m", below=1, after_fault=which, within_s=0.5)
        assert span_s(row, rows) == (begins + 0.5, math.inf), "a signal recovers after the fault too"
    assert span_s(expect(at_rest=True, after_fault="push", within_s=0.1), rows) == (4.1, 4.2)
    assert span_s(expect(at_rest=True, after_fault="push", within_s=0.3, to_s=6.0), rows) == (4.3, 6.0)


def test_the_viewer_draws_what_is_claimed_of_differences_and_of_rest() -> None:
    scenario = {
        "fault.1.kind": "disconnect", "fault.1.target": "link", "fault.1.start_s": 1.0, "fault.1.end_s": 3.0,
        "expect.1.signal": "wheel.fl.speed_rad_s", "expect.1.of": "wheel.fl.speed_command_rad_s", "expect.1.below": 0.5,
        "expect.2.at_rest": True, "expect.2.after_fault": "disconnect", "expect.2.within_s": 0.5,
        "expect.2.below": 0.2,
        "expect.3.figure": "t10_s", "expect.3.below": 1.0,
    }  # fmt: skip
    (lines,) = limits(scenario, claims(scenario), layout(SIGNAL_NAMES)).values()
    column = {name: i for i, name in enumerate(SIGNAL_NAMES)}
    rows = np.zeros((3, len(SIGNAL_NAMES)))
    rows[:, column["wheel.fl.speed_command_rad_s"]] = [1.0, 2.0, 3.0]
    difference, *rest = lines
    assert difference.values(column, rows).tolist() == [1.5, 2.5, 3.5]
    assert {line.value for line in rest} == {0.2, -0.2}
    assert all(line.inside(np.array([0.0, 2.0, 4.0])).tolist() == [False, True, False] for line in rest)


# Missing truth


def test_without_truth_only_expectations_on_truth_fail(tmp_path: Path) -> None:
    rows = [BELOW_1_MM, {"figure": "overshoot_m", "below": 9}, {"figure": "effort_n_m_s", "below": 99},
            {"signal": "guard.held", "equals": 0}, {"at_rest": True, "below": 30}]  # fmt: skip
    assert run(*rows[1:], record=tmp_path / "run.mcap").passed
    recorded = read_for_figures(tmp_path / "run.mcap", SIGNAL_NAMES)
    unknown = {name: values * NAN for name, values in recorded.signals.items() if name.startswith(("truth", "error"))}
    blind = to_json(judged_run(replace(recorded, signals={**recorded.signals, **unknown}, summary=None)))["expect"]
    assert {row["figure"] or row["signal"]: row["passed"] for row in blind} == {
        "overshoot_m": False, "effort_n_m_s": True, "guard.held": True, None: True,
    }  # fmt: skip
    assert "the run has no ground truth" in blind[0]["text"]


# Strict by default


LOSES_COMMANDS = "[frame for frame in frames if frame.id != WheelCommand.ID]"
DOUBLES = "[frame for frame in frames for _ in range(2)]"


def garbled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effect: str, explains: bool, **allow: object
) -> hil.RunResult:
    """A run with another package's kind of fault in 0.5 s <= t < 0.53 s, which may or may not explain its effects."""
    source = f"""
        from hil.faults.kinds import Kind
        from firmware_protocol.generated.messages import WheelCommand

        def effect(direction, frames):
            return {effect}

        garble = Kind("garble", "link", ("command",), "`command`", "Frames are changed.", "frames", {{}},
                      explains={explains}, on_frames=lambda row, chance: effect)
    """
    outside_package(tmp_path, monkeypatch, source, {"hil.faults": {"garble": "outside_package:garble"}})
    sets = {f"allow__{name}": limit for name, limit in allow.items()}
    return run(fault=[{"kind": "garble", "target": "command", "start_s": 0.5, "end_s": 0.53}], **sets)


@pytest.mark.parametrize(
    ("effect", "key", "words"),
    [
        (LOSES_COMMANDS, "unmatched", "torque feedforwards that the robot dropped"),
        (DOUBLES, "rejected", "frames that the host or the robot did not accept"),
    ],
    ids=["unmatched", "rejected"],
)
def test_what_the_robot_dropped_fails_a_run_unless_a_fault_explains_it_or_it_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effect: str, key: str, words: str
) -> None:
    result = garbled(tmp_path / "no", monkeypatch, effect, False)
    assert result.metrics[key] > 3
    assert not result.passed
    told = [text for kind, text in why_not_passed(result.run) if kind == "allow"]
    assert any(text.startswith(f"{key}: {result.metrics[key]} {words}") for text in told)
    assert garbled(tmp_path / "allowed", monkeypatch, effect, False, unmatched="50%", rejected="50%").passed
    explained = garbled(tmp_path / "yes", monkeypatch, effect, True)
    assert explained.metrics[key] > 3
    assert explained.passed, explained


class Counting:
    """A device that has rejected so many frames."""

    def __init__(self) -> None:
        self.crc = 0

    def rejected(self) -> dict[str, int]:
        return {"crc": self.crc}


@pytest.mark.parametrize(
    ("at_ms", "held_ms", "unexplained"),
    [
        (500, range(0), 1),  # long before
        (1000, range(0), 0),  # in the first tick of the fault
        (1150, range(0), 0),  # while it lasts
        (1380, range(0), 0),  # reported late
        (1600, range(0), 1),  # long after
        (1600, range(1200, 1590, 5), 0),  # the robot was away until just before
        (1990, range(1200, 1590, 5), 1),
    ],
)
def test_a_fault_explains_what_is_counted_from_its_beginning_until_the_robot_is_driven_and_has_reported(
    at_ms: int, held_ms: range, unexplained: int
) -> None:
    ms, device = 1_000_000, Counting()
    rows = [FaultRow("drop", "link", "feedback", start * ms, (start + 200) * ms, 1.0) for start in (1000, 1100)]
    names = ("loop.t_s", "guard.held", "robot.state")
    rejections = Rejections(device, rows, Timing(5 * ms, 3 * ms, 2 * ms, 25 * ms), names)  # type: ignore[arg-type]
    device.crc = 7  # before t = 0
    rejections.begin()
    for t_ms in range(0, 2500, 5):
        device.crc += t_ms == at_ms
        rejections.put(pack_row([t_ms / 1000, float(t_ms in held_ms)]))
    assert rejections.counts()["rejected"] == Count(1, unexplained)


def test_a_lenient_run_is_judged_by_its_expectations_alone_and_says_so(tmp_path: Path) -> None:
    never = [{"kind": "drop", "target": "command", "value": 1e-9}]
    assert not run({"figure": "ticks", "equals": 200}, fault=never).passed
    result = run({"figure": "ticks", "equals": 200}, fault=never, lenient=True, record=tmp_path / "run.mcap")
    assert result.passed
    assert ("lenient", LENIENT) in list(outcome_rows(result.run))
    assert ("lenient", LENIENT) in list(outcome_rows(judged_run(read_for_figures(tmp_path / "run.mcap"))))
    assert not run({"figure": "ticks", "equals": 201}, lenient=True).passed
    ended = run(lenient=True, fault=[CUT])
    assert ended.exit_code == 3, "a lost link is no expectation"


@given(st.integers(0, 500), st.integers(0, 500), st.integers(0, 500))
def test_a_limit_is_on_what_no_fault_explains(explained: int, unexplained: int, limit: int) -> None:
    count = Count(explained + unexplained, unexplained)
    (row,) = limit_results(AllowTable(rejected=limit), {"rejected": count}, ticks=1000)
    assert row.passed is (unexplained <= limit)
    assert row.margin == pytest.approx(1 - unexplained / (limit + 0.5))
    assert row[:5] == ("rejected", row.passed, explained + unexplained, unexplained, limit)
    assert row.text == (
        f"rejected: {unexplained} frames that the host or the robot did not accept; no fault of the scenario explains "
        f"them, and allow.rejected permits {limit}: {'as allowed' if row.passed else 'find the cause, or raise it'}"
    )


def test_a_share_of_the_ticks_is_permitted_and_shown_as_a_count() -> None:
    (row,) = limit_results(AllowTable(stale_ticks="5%"), {"stale_ticks": Count(9, 8)}, ticks=140)
    assert row == ("stale_ticks", False, 9, 8, "5%", 1 - 8 / 7.5, row.text)
    assert "stale_ticks: 8 of 140 ticks not driven because the feedback" in row.text
    assert "allow.stale_ticks permits 7, 5%: find the cause" in row.text


def test_a_figure_is_judged_by_what_the_baseline_has_of_it() -> None:
    baseline = Baseline("x", "", "lockstep", "", (1,), "", {"t10_s": Band(8.0, 0.0, 0.1)})
    row, run = expect(figure="t10_s", baseline="25%"), JudgedRun(figures={"t10_s": 9.0})
    outcome = figure_result(row, run, None, baseline)
    assert (outcome.passed, outcome.margin) == (True, 0.5)
    assert outcome.text == "t10_s equals 8 ± 2: held, 9"
    outcome = figure_result(expect(figure="t10_s", baseline=0.5), run, None, baseline)
    assert (outcome.passed, outcome.margin, outcome.worst_value) == (False, -1.0, 9.0)
    assert outcome.text == "t10_s equals 8 ± 0.5: failed, 9"
    outcome = figure_result(expect(figure="overshoot_m", baseline="25%"), run, None, baseline)
    assert (outcome.passed, outcome.margin) == (False, -1.0)
    assert outcome.text == "overshoot_m within 25% of the baseline: failed, the baseline has no such figure"


def test_rows_that_a_recording_lacks_fail_the_run_and_its_review(tmp_path: Path) -> None:
    result = run({"figure": "ticks", "equals": 200}, record=tmp_path / "run.mcap")
    assert (result.passed, result.metrics["lost_rows"]) == (True, 0)
    recorded = read_for_figures(tmp_path / "run.mcap")
    assert to_json(judged_run(recorded))["passed"]
    gap = to_json(judged_run(replace(recorded, rows_dropped=2, rows_missing=1)))
    assert (gap["passed"], gap["lost_rows"]) == (False, 3)
    assert next(row["text"] for row in gap["allow"] if not row["passed"]).startswith("lost_rows: 3 of 203 ticks that")


def test_a_recording_of_an_older_version_is_read_and_says_by_what_it_was_not_judged() -> None:
    old = to_json(judged_run(read_for_figures(Path("tests/recordings/circle_speed_ca92b7a.rrd"))))
    assert any(note.startswith("it was not judged by allow.") for note in old["notes"])
