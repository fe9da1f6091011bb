"""A run that ended early: the part that it did not reach is neither judged nor a figure."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest

import hil
from hil.addons.batch.columns import run_columns
from hil.addons.report.difference import differences
from hil.addons.report.review_page import page
from hil.judge.recorded import judged_run
from hil.judge.result import RunResult
from hil.judge.run_json import to_json
from hil.record.reader import RecordedRun, read

END_FIGURES = ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m")
EXPECT = [
    {"signal": "error.planar_m", "below": 0.1, "from_s": 3.0, "to_s": 5.0},
    {"signal": "error.planar_m", "below": 0.1, "from_s": 6.5},
    {"signal": "error.planar_m", "below": 0.1, "from_s": 3.0},
    {"signal": "loop.tick", "below": 1000.0},
]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunResult, RecordedRun]:
    """A run of 8 s whose link is lost after 6 s, and its recording."""
    path = tmp_path_factory.mktemp("cut") / "run.mcap"
    lost = [{"kind": "disconnect", "start_s": 6.0, "end_s": 7.0}]
    result = hil.run(
        "circle_speed", set={"loop.duration_s": 8.0, "fault": lost, "expect": EXPECT}, record=path, mode="lockstep"
    )
    assert result.exit_code == 3
    return result, read(path)


def died(run: RecordedRun) -> RecordedRun:
    """Return the recording as it is when the process was killed."""
    return replace(run, summary=None, rows_dropped=None)


def judged(found: dict[str, Any]) -> list[bool | None]:
    return [row["passed"] for row in found["expect"]]


def test_a_run_that_a_lost_link_ended_has_no_figures_of_its_end(ran: tuple[RunResult, RecordedRun]) -> None:
    result, run = ran
    for found in (result.metrics, to_json(judged_run(run)), to_json(judged_run(died(run)))):
        assert [found[name] for name in END_FIGURES] == [None] * 4
        for name in END_FIGURES:
            assert found["reasons"][name].startswith("there is nothing after t = 5.99")
        assert found["effort_n_m_s"] > 0.0


def test_what_its_expectations_did_not_come_to_is_not_judged(ran: tuple[RunResult, RecordedRun]) -> None:
    result, run = ran
    expected = [True, None, None, False]
    assert (
        judged(dict(result.metrics))
        == judged(to_json(judged_run(run)))
        == judged(to_json(judged_run(died(run))))
        == expected
    )
    texts = [row["text"] for row in result.metrics["expect"]]
    assert "not judged, the run ended at t = 5.99" in texts[1]
    assert run_columns(result.run)["failed_expectation"] == texts[3]
    assert "not judged</td>" in page([run], [judged_run(run)])


def test_expectations_that_a_killed_run_cannot_be_judged_by_are_counted(ran: tuple[RunResult, RecordedRun]) -> None:
    """The recording has no baseline, may lack a signal, and may be of a version that has other keys."""
    _, run = ran
    scenario = json.loads(run.properties["scenario"])
    rows = {"expect.1.a_key_of_old": 1, "expect.5.figure": "effort_n_m_s", "expect.5.baseline": "10%"}
    found = to_json(
        judged_run(replace(died(run), properties={**run.properties, "scenario": json.dumps(scenario | rows)}))
    )
    assert len(found["expect"]) == len(EXPECT) - 1
    assert [note.partition(" ")[0] for note in found["notes"] if "cannot be judged" in note] == ["2"]
    assert not any("cannot be judged" in note for note in to_json(judged_run(died(run)))["notes"])


def test_a_killed_run_that_had_come_to_its_last_tick_has_all_its_figures(ran: tuple[RunResult, RecordedRun]) -> None:
    _, run = ran
    scenario = run.properties["scenario"].replace('"loop.duration_s": 8.0', '"loop.duration_s": 6.0')
    assert scenario != run.properties["scenario"]
    found = to_json(judged_run(replace(died(run), properties={**run.properties, "scenario": scenario})))
    assert found["steady_max_m"] is not None
    assert judged(found) == [True, False, True, False], "what has no samples in a whole run fails"


def test_beside_another_run_neither_is_better(ran: tuple[RunResult, RecordedRun]) -> None:
    _, run = ran
    ended, killed = judged_run(run), judged_run(died(run))
    whole = replace(ended, failure=None, figures={**ended.figures, "effort_n_m_s": 1e6})
    effort = {row.name: row.verdict for first in (ended, killed) for row in differences(first, whole)}
    assert effort["effort_n_m_s"] is None
    [told] = [row for row in differences(whole, whole) if row.name == "effort_n_m_s"]
    assert told.verdict == "same"
    assert math.isclose(told.first or 0.0, 1e6)
