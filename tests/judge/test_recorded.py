"""The judgement of a recording that lacks something: what is said of it, and what is judged all the same."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.core.options import options_of
from hil.core.signals import SIGNAL_NAMES
from hil.judge.judged_run import FaultResult, JudgedRun
from hil.judge.recorded import fault_span_s, judged_run, load, read_for_figures
from hil.record.reader import RecordedRun
from hil.scenario.trial import AllowTable

SCENARIO = {
    "loop.rate_hz": 10.0, "loop.duration_s": 2.0, "firmware.torque_constant_n_m_a": 0.5,
    "robot.speed_limit_rad_s": 20.0, "robot.torque_limit_n_m": 4.0,
    "expect.1.signal": "error.x_m", "expect.1.below": 9.0, "expect.1.to_s": 0.9,
    "expect.2.figure": "ticks", "expect.2.above": 1.0,
    "expect.3.signal": "error.y_m", "expect.3.below": -1.0,
}  # fmt: skip
SUMMARY = {
    "passed": True, "failure": None, "scenario": "circle", "seed": 7, "frames": {"sent": 1, "rejected": {"crc": 2}},
    "lost_rows": 0, "allow": [{"name": name} for name in options_of(AllowTable)], "reasons": {"pose_fixes": "none"},
}  # fmt: skip


def recorded(rows: int = 20, without: tuple[str, ...] = (), **more: Any) -> RecordedRun:
    """A recording at 10 Hz, of a torque command of 2 N·m of 4 A and a limit, and with a scenario of 2 s."""
    signals = {name: np.zeros(rows) for name in SIGNAL_NAMES if name not in without}
    signals["loop.t_s"] = 0.1 * np.arange(rows)
    signals["wheel.rr.current_a"] = np.full(rows, -4.0)
    for wheel in ("fl", "fr", "rr", "rl"):
        signals[f"wheel.{wheel}.speed_command_rad_s"] = np.full(rows, np.nan)
    signals["wheel.rl.torque_command_n_m"] = np.array([-4.0] * 5 + [3.9] * (rows - 5))
    given: dict[str, Any] = {"summary": SUMMARY, "rows_dropped": 0, "properties": {"scenario": json.dumps(SCENARIO)}}
    return RecordedRun(Path("run.mcap"), signals, (), **{"held": tuple(signals), **given, **more})


def told(run: JudgedRun) -> list[tuple[bool | None, str]]:
    return [(row.passed, row.text) for row in run.expect]


def test_figures_of_a_recording_are_those_of_its_scenario_s_motor_and_limits() -> None:
    run = judged_run(recorded())
    assert run.figures["effort_n_m_s"] == pytest.approx(4.0 * 0.5 * 1.9)
    assert run.figures["saturation_s"] == pytest.approx(0.5)
    assert (run.figures["frames"], run.counts.rejected, run.notes) == ({"sent": 1, "rejected": {"crc": 2}}, 2, [])
    assert (run.identity.scenario, run.identity.seed, run.failure) == ("circle", 7, None)
    assert run.reasons["pose_fixes"] == "none"
    assert run.reasons["link_statistics"] == "the run's summary does not have it"
    unknown = judged_run(recorded(properties={}))
    assert unknown.figures["saturation_s"] == 0.0
    assert unknown.reasons["effort_n_m_s"] == "the torque constant of the motors is not known"


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({}, "the recording has no summary: the run did not come to its end"),
        ({"rows_dropped": None}, "the recording has no summary and no end: how the run ended is not known"),
        ({"is_continued": True}, "the recording has no summary: it is in a later part, which was not read"),
    ],
)
def test_a_recording_without_a_summary_has_failed_at_its_last_row_for_a_reason(more: dict[str, Any], text: str) -> None:
    run = judged_run(recorded(12, summary=None, **more))
    assert run.failure == (text, "RunInterruptedError", pytest.approx(1.1))
    assert run.reasons["frames"] == run.reasons["passed"] == run.reasons["wire_sha256"] == text
    assert run.reasons["steady_rms_m"].startswith("there is nothing after t = 1.1 s of 2 s")
    assert told(run) == [
        (True, "error.x_m below 9 from 0 s to 0.9 s: held over 10 samples"),
        (None, "ticks above 1: not judged, the run ended at t = 1.1 s"),
        (False, "error.y_m below -1 from 0 s to the end: failed, 0 at t = 0 s; worst 0 at t = 0 s; 1.1 s in all"),
    ]
    assert run.notes == []


@pytest.mark.parametrize(("rows", "is_whole"), [(20, True), (19, True), (18, False)])
def test_a_recording_without_a_summary_is_whole_if_its_rows_come_to_within_two_ticks_of_the_end(
    rows: int, is_whole: bool
) -> None:
    run = judged_run(recorded(rows, summary=None))
    assert run.expect[1].passed is (True if is_whole else None)
    assert judged_run(recorded(rows, summary=None, is_continued=True)).expect[1].passed is None
    ended = judged_run(recorded(rows, summary={**SUMMARY, "failure": "it left", "failure_s": 1.5}))
    assert ended.reasons["tracked_s"].startswith("there is nothing after") is not is_whole
    late = recorded(rows, summary=None)
    late.signals["loop.t_s"][-1] += 0.0625
    assert judged_run(late).expect[1].passed is (True if is_whole else None)


def test_the_signals_of_expectations_are_read_only_where_there_is_no_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = {**SCENARIO, "expect.3.signal": "robot.yaw_rate_rad_s"}
    for values, summary, read_them in (
        (scenario, None, [False, True]),
        (SCENARIO, None, [False]),
        (scenario, SUMMARY, [False]),
    ):
        run = recorded(summary=summary, properties={"scenario": json.dumps(values)})
        asked: list[set[str]] = []
        monkeypatch.setattr(
            "hil.judge.recorded.read", lambda _path, names, run=run, to=asked: (to.append(set(names)), run)[1]
        )
        assert read_for_figures(Path("run.mcap"), ["link.own"]) is run
        assert ["robot.yaw_rate_rad_s" in names for names in asked] == read_them
        assert all({"link.own", "error.planar_m"} <= names for names in asked)


def test_rows_that_are_in_no_file_count_as_ticks_and_as_lost() -> None:
    run = judged_run(recorded(rows_dropped=3, rows_missing=2))
    assert (run.figures["ticks"], run.counts.lost_rows, run.passed) == (25, 5, False)
    lost = {**SUMMARY, "lost_rows": 5}
    assert judged_run(recorded(rows_dropped=3, rows_missing=2, summary=lost)).passed, "the run has judged them itself"


def test_what_another_version_recorded_is_named_up_to_four_and_what_it_judged_by_too() -> None:
    gone = SIGNAL_NAMES[-6:]
    for lacks, shown in ((gone[:1], gone[0]), (gone[:4], ", ".join(gone[:4]))):
        notes = judged_run(recorded(without=lacks)).notes
        assert notes == [f"another version made it: it lacks {shown}, which this one records"]
    run = judged_run(recorded(without=gone, properties={"commit": "abc", "seed": "9", "python": "3"}))
    assert run.notes == [
        f"another version (commit abc) made it: it lacks {', '.join(gone[:4])} and 2 more, which this one records"
    ]
    assert run.made == {"commit": "abc", "python": "3"}
    lacks = judged_run(recorded(without=("guard.saturated",))).reasons["saturation_s"]
    assert lacks == "the recording has no signal guard.saturated: another version of the program made it"
    allow = [row for row in SUMMARY["allow"] if row["name"] not in ("refused", "lost_rows")]  # type: ignore[attr-defined]
    assert judged_run(recorded(summary={**SUMMARY, "allow": allow})).notes == [
        "it was not judged by allow.refused, lost_rows: an older version made it"
    ]


def test_expectations_that_cannot_be_judged_by_the_rows_are_counted() -> None:
    scenario = SCENARIO | {
        "expect.2.figure": "of another version", "expect.3.signal": "a.of_another_m",
        "expect.4.figure": "ticks", "expect.4.baseline": "5%", "expect.5.later_key": 1.0,
    }  # fmt: skip
    run = judged_run(recorded(summary=None, properties={"scenario": json.dumps(scenario)}))
    assert told(run) == [(True, "error.x_m below 9 from 0 s to 0.9 s: held over 10 samples")]
    assert run.notes == [
        "4 of its expectations cannot be judged: the recording lacks their figures, signals or baseline, or another "
        "version made it"
    ]


def test_a_scenario_of_another_version_is_not_loaded_and_two_of_its_problems_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    later = {"loop.later_s": 1.0, "robot.later_m": 2.0, "plant.later_n": 3.0}
    for properties, note in (
        ({}, "the recording does not hold the scenario of its run"),
        (
            {"scenario": json.dumps(later)},
            "its scenario is that of another version, and this one does not understand it: ",
        ),
    ):
        monkeypatch.setattr("hil.judge.recorded.read", lambda _path, given=properties: recorded(properties=given))
        loaded = load("run.mcap")
        (told_of,) = loaded.notes
        assert loaded.scenario is None
        assert told_of.startswith(note)
        assert sum(key in told_of for key in later) == (2 if properties else 0)
        assert len(loaded.signals["loop.t_s"]) == 20


def test_what_has_no_time_is_no_recording_of_a_run() -> None:
    with pytest.raises(BadInputError, match=r"run\.mcap: it has no signal 'loop\.t_s', so it is not a recording"):
        judged_run(RecordedRun(Path("run.mcap"), {"pose.x_m": np.zeros(2)}, (), {}, None, 0))


@pytest.mark.parametrize(
    ("fault", "span_s"),
    [
        (FaultResult("drop", "command", "", 1, "", 1.0, 2.0), (1.0, 2.0)),
        (FaultResult("drop", "command", "", 1, "", 1.0, 5.0), (1.0, 4.0)),
        (FaultResult("drop", "command", "", 1, "", 1.0), (1.0, 4.0)),
        (FaultResult("drop", "command", "", 1, ""), (0.0, 4.0)),
        (FaultResult("drop", "command", "", 0, "", 6.0, 7.0), (6.0, 6.0)),
        (FaultResult("reset", "robot", "", 1, "", 1.0), (1.0, 1.0)),
    ],
)
def test_a_fault_was_in_force_until_its_end_or_that_of_the_run_and_one_that_happens_at_once(
    fault: FaultResult, span_s: tuple[float, float]
) -> None:
    assert fault_span_s(fault, 4.0) == span_s
