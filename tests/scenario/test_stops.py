"""A run that must end with a robot that has stopped on its own: the claim, and the watch without commands after it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from firmware_protocol.generated.messages import State
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.judge.expectations import Stop, stop_result
from hil.judge.recorded import review
from hil.scenario import load
from hil.scenario.trial import ExpectTable, FaultTable, span_s

PRESSED = {"kind": "estop", "start_s": 0.5}
STUCK = {"kind": "stuck_encoder", "target": "fl", "start_s": 0.5}
SILENT = {"kind": "mute", "target": "WHEEL_COMMAND", "start_s": 0.5, "end_s": 0.8}
TIME = st.floats(0.0, 10.0)


def run(fault: dict[str, Any], *rows: dict[str, Any], scenario: str = "circle_speed", **more: Any) -> hil.RunResult:
    record = more.pop("record", None)
    sets = {"loop.duration_s": 1.5, "fault": [fault], "expect": list(rows), **more}
    return hil.run(scenario, set=sets, record=record)


def stops(reason: str, fault: dict[str, Any], within_s: float = 0.3) -> dict[str, Any]:
    return {"stops": reason, "after_fault": fault["kind"], "within_s": within_s}


@given(st.lists(TIME, max_size=3), TIME, TIME)
def test_a_claim_of_a_stop_holds_if_one_in_its_time_has_the_reason(
    times: list[float], begin: float, end: float
) -> None:
    from_s, to_s = sorted((begin, end))
    if to_s == 0.0:
        return
    row = ExpectTable(stops="OVERSPEED", from_s=from_s, to_s=to_s)
    happened = [Stop(t_s, f"the robot left ACTIVE at t = {t_s:.3f} s: OVERSPEED") for t_s in times]
    outcome = stop_result(row, happened)
    assert outcome.passed is any(from_s <= t_s <= to_s for t_s in times)
    assert outcome.margin is not None
    assert (outcome.margin > 0.0) is outcome.passed
    assert not stop_result(row, [Stop(one.t_s, "OVERCURRENT") for one in happened]).passed


def test_the_claim_is_of_the_time_from_the_fault_on_and_is_open_in_a_run_that_was_cut() -> None:
    row = build(ExpectTable, stops_row := stops("ESTOP", PRESSED))
    faults = [FaultTable(**PRESSED)]
    assert span_s(row, faults) == (0.5, 0.8), stops_row
    assert stop_result(row, [], cut_s=0.6, faults=faults).passed is None
    assert stop_result(row, [], cut_s=0.9, faults=faults).passed is False


def test_the_margin_of_a_stop_is_the_share_of_the_time_that_was_left() -> None:
    late, other = Stop(3.5, "OVERSPEED at 3.5"), Stop(1.0, "ESTOP at 1")
    row = ExpectTable(stops="OVERSPEED", from_s=2.0, to_s=4.0)
    outcome = stop_result(row, [other, late, Stop(3.75, "OVERSPEED again")])
    assert (outcome.passed, outcome.margin, outcome.stops) == (True, 0.25, "OVERSPEED")
    assert outcome.text == "the robot stops because of OVERSPEED from 2 s to 4 s: held, OVERSPEED at 3.5"
    failed = stop_result(row, [other, Stop(4.5, "OVERSPEED at 4.5")])
    assert (failed.passed, failed.margin, failed.violation_s, failed.violation_value) == (False, -1.0, 1.0, None)
    assert failed.text.endswith("from 2 s to 4 s: failed, ESTOP at 1; OVERSPEED at 4.5")
    assert stop_result(ExpectTable(stops="OVERSPEED"), [late]).margin == 1.0, "a time without an end"
    assert stop_result(row, [], cut_s=3.9).text.endswith(": not judged, the run ended at t = 3.9 s")


@pytest.mark.parametrize("command", ["speed", "torque"])
def test_after_an_emergency_stop_the_robot_is_watched_and_not_driven(command: str, tmp_path: Path) -> None:
    rest = {"at_rest": True, "after_fault": "estop", "within_s": 0.6}
    record = tmp_path / "run.mcap"
    result = run(PRESSED, stops("ESTOP", PRESSED, 0.02), rest, record=record, **{"controller.command": command})
    assert result.passed, result
    assert (result.exit_code, result.metrics["ticks"], result.metrics["held_ticks"]) == (0, 300, 0)
    after = result.signals["loop.t_s"] > 0.55
    assert (result.signals["robot.state"][after] == State.ESTOP).all()
    assert np.isnan(result.signals["wheel.fl.torque_command_n_m"][after]).all()
    events = [event["text"] for event in review(record)["events"]]
    assert any("watched to the end, without commands" in text for text in events)
    assert any("the robot stops because of ESTOP from 0.5 s to 0.52 s: held" in text for text in events)


def test_a_fault_of_the_robot_is_claimed_with_its_wheel() -> None:
    assert run(STUCK, stops("ENCODER_STUCK of wheel fl", STUCK, 0.9)).passed
    result = run(STUCK, stops("ENCODER_STUCK of wheel fr", STUCK, 0.9))
    assert (result.passed, result.exit_code) == (False, 1)
    assert "failed, the robot left ACTIVE at t = 1.1" in result.metrics["expect"][0]["text"]


def test_a_robot_that_does_not_stop_or_not_in_time_fails_the_claim() -> None:
    late = run(STUCK, stops("ENCODER_STUCK", STUCK, 0.1)).metrics["expect"][0]
    assert (late["passed"], late["margin"]) == (False, -1.0)
    never = run({"kind": "push", "target": "force_x_n", "start_s": 0.5, "value": 1.0}, {"stops": "FAULT"})
    assert not never.passed
    assert "failed, it did not stop" in never.metrics["expect"][0]["text"]


def test_without_the_claim_a_stop_ends_the_run_as_before() -> None:
    result = run(PRESSED)
    assert (result.exit_code, result.metrics["ticks"]) == (3, 101)
    assert "it is ESTOP because of ESTOP" in str(result.failure)


def test_a_robot_that_may_be_armed_anew_is_brought_back_and_its_stop_counts() -> None:
    claims = (stops("COMMAND_TIMEOUT", SILENT), {"signal": "robot.state", "from_s": 1.3, "equals": int(State.ACTIVE)})
    result = run(SILENT, *claims, **{"loop.rearm": True})
    assert result.passed, result
    assert len(result.metrics["recoveries"]) == 1
    watched = run(SILENT, claims[0], {"at_rest": True, "after_fault": "mute", "within_s": 0.7})
    assert watched.passed, watched
    assert watched.metrics["recoveries"] == []


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"stops": "ESTOP", "below": 1.0}, "a claim of its own"),
        ({"stops": " "}, "stops is empty"),
        ({"stops": "ESTOP", "at_rest": True}, "needs one of"),
        ({"stops": "ESTOP", "from_s": 2.0, "to_s": 1.0}, "is before from_s"),
    ],
)
def test_a_claim_of_a_stop_takes_a_reason_and_a_time(row: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        load("circle_speed", set={"expect": [row]})
