"""Ticks in which the robot was not driven: counted, explained by the faults of the scenario, and judged by [allow]."""

from pathlib import Path

import pytest

import hil
from hil.addons.batch.comparison.comparison import Compared, Variation
from hil.addons.batch.keys import make_job
from hil.addons.batch.run import run
from hil.addons.report.review_command import review as command
from hil.addons.report.review_page import page
from hil.addons.testing.checked_run import run_as_test
from hil.core.errors import BadInputError
from hil.core.options import plain
from hil.faults.rows import FaultRow
from hil.judge.recorded import judged_run, read_for_figures, review
from hil.judge.run_text import why_not_passed
from hil.runtime.sampling import Timing
from hil.runtime.unexplained import NotDriven
from hil.scenario import load
from hil.scenario.trial import most

MS = 1_000_000
TIMING = Timing(5 * MS, 3 * MS, 2 * MS, 25 * MS)
BLIND = {
    "estimator.source": "fused",
    "estimator.filter.begin": "fix",
    "estimator.simulated_fix.dropout_probability": 1.0,
    "loop.duration_s": 0.5,
    "expect": [],
}
"""No fix ever says where the robot is, so that it is never driven."""


def drop(start_ms: int, end_ms: int) -> FaultRow:
    return FaultRow("drop", "link", "feedback", start_ms * MS, end_ms * MS, 1.0)


def unexplained(*faults: FaultRow, held_ms: range, ticks: int = 1000) -> int:
    not_driven = NotDriven(faults, TIMING)
    for t_ms in range(0, 5 * ticks, 5):
        if t_ms in held_ms:
            not_driven.hold(t_ms * MS, is_stale=False)
        else:
            not_driven.drive()
    counted = not_driven.counts(ticks)["held_ticks"]
    assert counted.all == len(held_ms)
    return counted.unexplained


@pytest.mark.filterwarnings("error")
def test_a_run_in_which_the_robot_was_never_driven_has_not_passed(tmp_path: Path) -> None:
    result = hil.run("circle_speed", set=BLIND, record=tmp_path / "run.rrd")
    assert not result.passed
    assert result.exit_code == 1
    assert (result.metrics["stale_ticks"], result.metrics["held_ticks"]) == (0, 100)
    told = result.metrics["allow"][1]
    assert (told["name"], told["passed"], told["all"], told["unexplained"]) == ("held_ticks", False, 100, 100)
    assert told["text"].startswith("held_ticks: 100 of 100 ticks not driven because the state was unknown")
    assert "allow.held_ticks permits 0: find the cause, or raise it" in told["text"]
    assert review(tmp_path / "run.rrd")["allow"] == result.metrics["allow"]
    recorded = read_for_figures(tmp_path / "run.rrd")
    assert "allow.held_ticks permits 0" in page([recorded], [judged_run(recorded)])


def test_what_a_scenario_allows_passes_and_the_review_of_what_it_does_not_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hil.run("circle_speed", set={**BLIND, "allow.held_ticks": "100%"}).passed
    assert not hil.run("circle_speed", set={**BLIND, "allow.held_ticks": 99}, record=tmp_path / "run.rrd").passed
    command([tmp_path / "run.rrd"])
    assert "at the end  allow     held_ticks: 100 of 100" in capsys.readouterr().out


def test_a_scenario_as_a_test_says_which_limit_was_passed(pytestconfig: pytest.Config) -> None:
    verdict = run_as_test(load("circle_speed", set=BLIND), None, None, "hil run ...", pytestconfig)
    assert not verdict.passed
    assert verdict.text().startswith("allow: held_ticks: 100 of 100")


def test_a_comparison_has_no_figures_of_a_run_beyond_it_and_a_campaign_says_why_it_failed() -> None:
    scenario = load("circle_speed", set={**BLIND, "controller.law": "lqi"})
    of_comparison = Compared(Variation(), run(make_job(scenario), scenario))
    assert of_comparison.figures is None
    assert str(of_comparison.failed).startswith("held_ticks: 100 of 100")
    assert next(why_not_passed(hil.run("circle_speed", set=BLIND).run))[1] == of_comparison.failed


def test_the_ticks_that_a_fault_explains_do_not_count() -> None:
    fault = [{"kind": "drop", "target": "feedback", "value": 1.0, "start_s": 0.2, "end_s": 0.4}]
    result = hil.run("circle_speed", set={"loop.duration_s": 0.6, "expect": [], "fault": fault})
    assert result.passed
    assert result.metrics["stale_ticks"] > 5
    assert {row["unexplained"] for row in result.metrics["allow"]} == {0}


def test_a_fault_explains_what_follows_it_until_the_robot_is_driven_again() -> None:
    assert unexplained(drop(1000, 1100), held_ms=range(1025, 4000, 5)) == 0
    assert unexplained(drop(1000, 1100), held_ms=range(500, 600, 5)) == 20
    assert unexplained(drop(1000, 1100), held_ms=range(500, 1200, 5)) == 100, "what was before it is not its doing"


@pytest.mark.parametrize(("begin_ms", "counts"), [(1140, 0), (1145, 1), (995, 1), (1000, 0)])
def test_a_fault_shows_for_as_long_as_frames_are_on_their_way_and_old_ones_fresh(begin_ms: int, counts: int) -> None:
    held_ms = range(begin_ms, begin_ms + 5, 5)
    assert unexplained(drop(1000, 1100), held_ms=held_ms) == counts


def test_a_delay_shows_for_its_own_time_longer_and_a_reset_from_its_instant_on() -> None:
    late = FaultRow("delay", "link", "feedback", 1000 * MS, 1100 * MS, 0.5)
    assert unexplained(late, held_ms=range(1600, 1700, 5)) == 0
    reset = FaultRow("reset", "device", "robot", 1000 * MS, 2**62)
    assert unexplained(reset, held_ms=range(1025, 2000, 5)) == 0
    assert unexplained(reset, held_ms=range(1500, 2000, 5)) == 100


def test_no_fault_explains_a_run_of_which_no_tick_was_driven() -> None:
    assert unexplained(drop(0, 5000), held_ms=range(0, 5000, 5)) == 1000
    assert unexplained(drop(0, 5000), held_ms=range(0, 4995, 5)) == 0


@pytest.mark.parametrize(
    ("kind", "acts_on", "target", "explains"),
    [
        ("babble", "link", "feedback", True),
        ("slow_clock", "device", "clock", True),
        ("dead_motor", "device", "rr", False),
        ("push", "plant", "force_y_n", False),
        ("bias", "signal", "battery.voltage_v", False),
        ("bias", "signal", "observer.x_m_s2", False),
        ("bias", "signal", "pose.x_m", False),
        ("bias", "signal", "reference.x_m", False),
        ("override", "signal", "wheel.fl.speed_command_rad_s", False),
        ("override", "signal", "wheel.fl.current_a", False),
        ("override", "signal", "wheel.fl.speed_rad_s", True),
        ("override", "signal", "robot.state", True),
        ("bias", "signal", "truth.x_m", True),
    ],
)
def test_only_what_can_take_feedback_state_or_robot_away_explains(
    kind: str, acts_on: str, target: str, explains: bool
) -> None:
    row = FaultRow(kind, acts_on, target, 0, 2**62, 1.0)
    assert unexplained(row, held_ms=range(1000, 1100, 5)) == (0 if explains else 20)


def test_a_fault_that_is_only_recorded_does_not_switch_the_limits_off() -> None:
    recorded = {"kind": "bias", "target": "battery.voltage_v", "value": 0.001}
    sparse = {"estimator.filter.begin": "fix", "estimator.simulated_fix.dropout_probability": 0.9}
    result = hil.run("circle_speed", set={**BLIND, **sparse, "loop.duration_s": 3.0, "fault": [recorded]})
    assert not result.passed
    assert 0 < result.metrics["allow"][1]["unexplained"] < result.metrics["ticks"]


def test_limits_are_ticks_or_shares_and_have_their_defaults_by_mode() -> None:
    assert [most(limit, 399) for limit in (0, 7, "5%", "12.5 %", "100%")] == [0, 7, 19, 49, 399]
    assert [most(f"{share}%", 100) for share in range(101)] == list(range(101))
    others = dict.fromkeys(("rejected", "refused", "unmatched", "fix_restarts", "lost_rows"), 0)
    assert plain(load("circle_speed").allow) == {"stale_ticks": 0, "held_ticks": 0} | others
    real = load("circle_speed", mode="realtime", set={"allow.stale_ticks": 3})
    assert plain(real.allow) == {"stale_ticks": 3, "held_ticks": "5%"} | others


@pytest.mark.parametrize("limit", [-1, 0.5, True, "5", "101%", "some"])
def test_what_is_no_limit_is_refused_with_what_is_expected(limit: object) -> None:
    expected = r'allow.held_ticks = .*; expected a whole number of at least 0, or a share of the ticks such as "5%"'
    with pytest.raises(BadInputError, match=expected):
        load("circle_speed", set={"allow.held_ticks": limit})
