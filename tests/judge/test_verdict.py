"""How a run went as text: the verdict first, why in order of time, in 80 columns, the same in `hil run` and review."""

import re
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.judge.judged_run import ExpectationResult, JudgedRun
from hil.judge.recorded import judged_run, read_for_figures
from hil.judge.run_json import from_json
from hil.judge.run_text import COLUMNS, failed_text, run_lines, timeline, wrapped
from tests.support.processes import hil as command
from tests.support.processes import run_json

FAULTS = (
    "fault=[{kind='drop',target='feedback',value=1.0,start_s=1.0,end_s=1.1},"
    "{kind='drop',target='command',value=0.5,start_s=0.4,end_s=0.6}]"
)
EXPECT = (
    "expect=[{figure='ticks',below=10},{signal='loop.t_s',below=1.2},{signal='error.planar_m',from_s=0.2,below=0.001},"
    "{signal='loop.tick',above=-1}]"
)
FAILED = ("circle_speed", "--set", "loop.duration_s=1.5", "--set", FAULTS, "--set", EXPECT, "--seed", "4")


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("failed")
    done = command("run", *FAILED, "--record", "run.rrd", cwd=folder)
    assert done.returncode == 1
    return done.stdout, folder / "run.rrd"


def test_run_and_review_print_the_same(failed: tuple[str, Path]) -> None:
    ran, path = failed
    told = ran.partition("\nNext:\n")[0].rstrip().splitlines()
    reviewed = command("review", path).stdout.splitlines()
    assert reviewed[: len(told)] == told
    assert reviewed[len(told)].startswith("  made ")
    assert str(hil.load(path)) == "\n".join(told)


def test_a_failed_run_says_first_that_it_failed_and_then_why_in_order_of_time(failed: tuple[str, Path]) -> None:
    lines = failed[0].splitlines()
    assert lines[0] == "FAILED  circle_speed: dsc by speed, lockstep over memory:, seed 4"
    assert "loop.duration_s = 1.5; loop.seed = 4" in lines[1], "what was given explains it"
    events = [line.split() for line in lines if re.match(r" +(\d+\.\d{3} s|at the end)  \w", line)]
    kinds = [(words[0], words[2] if words[1] == "s" else words[3]) for words in events]
    assert kinds[0] == ("0.200", "failed")
    assert kinds[-1] == ("at", "failed"), "a figure is judged at the end"
    assert {("0.200", "state"), ("0.400", "fault"), ("1.000", "fault"), ("1.200", "failed")} <= set(kinds)
    times = [float(at) for at, _ in kinds if at != "at"]
    assert times == sorted(times)
    text = " ".join(failed[0].split())
    at_once = r"first \S+ m at 0\.2 s, already when its time began, worst \S+ m at \S+ s, \S+ s in all"
    assert re.search(rf"error\.planar_m below 0\.001 from 0\.2 s to the end: {at_once}", text)
    later = "first 1.2 s at 1.2 s, worst 1.495 s at 1.495 s, 0.295 s in all"
    assert f"loop.t_s below 1.2 from 0 s to the end: {later}" in text
    assert "wheels FL, FR, RR, RL asked for" in text
    assert "expectations 1 held: loop.tick above -1 from 0 s to the end" in text


def test_nothing_is_wider_than_80_columns_but_a_word(failed: tuple[str, Path]) -> None:
    for line in failed[0].partition("\nNext:")[0].splitlines():
        assert len(line) <= COLUMNS, line
    path = "/a" * 100
    assert wrapped("  note  ", f"it is in {path} and ends") == [
        "  note  it is in",
        f"        {path}",
        "        and ends",
    ]


def test_a_green_run_is_short_and_says_how_much_room_is_left() -> None:
    found = run_json("circle_speed", "--record", "none")
    lines = list(run_lines(from_json(found)))
    assert lines[0].startswith("PASSED  circle_speed: ")
    assert len(lines) <= 16
    text = "\n".join(lines)
    assert "% to spare" in text
    for noise in ("times real time", "tick p50", "deadline", "round trip", "frames  "):
        assert noise not in text
        assert noise in "\n".join(run_lines(from_json(found), everything=True))


def test_what_ended_a_run_is_told_at_its_time_with_how_the_robot_was() -> None:
    reset = {"kind": "reset", "target": "robot", "start_s": 0.5}
    result = hil.run("circle_speed", set={"loop.duration_s": 1.5, "expect": [], "fault": [reset]})
    assert result.failure is not None
    told = [(one.kind, round(one.t_s, 1)) for one in timeline(result.run)]
    assert told == [("state", 0.5), ("fault", 0.5), ("ended", 0.5)]
    text = str(result)
    labels = re.findall(r"^  no value +(.*)$", text, re.MULTILINE)
    assert len(labels) == 1, "figures without a value are told together, by their reason"


def row(**fields: Any) -> ExpectationResult:
    failed = ExpectationResult(None, None, None, False, 1.0, 2.0, 1.0, 2.0, 0.0)
    return failed._replace(**{"text": "x below 1 from 0 s to the end: failed, 2 at t = 1 s", **fields})


def test_a_violation_of_one_sample_a_gap_and_a_claim_without_a_time_are_worded() -> None:
    assert failed_text(row()) == "x below 1 from 0 s to the end: first 2 at 1 s, once"
    gap = row(violation_value=float("nan"), worst_s=2.0, worst_value=None, violated_s=3.0)
    assert failed_text(gap) == "x below 1 from 0 s to the end: first no value at 1 s, worst no value at 2 s, 3 s in all"
    figure = row(text="ticks below 9: failed, 80", violation_s=None, worst_s=None, violated_s=None)
    assert failed_text(figure) == "ticks below 9: 80"
    assert timeline(JudgedRun(expect=[figure, row()]))[0].t_s == 1.0


def test_a_recording_without_an_end_has_no_verdict_but_what_was_violated_is_told(
    failed: tuple[str, Path], tmp_path: Path
) -> None:
    whole = failed[1].read_bytes()
    cut = tmp_path / "cut.rrd"
    for tenths in range(9, 0, -1):  # how much stands behind the rows differs with how fast they were written
        cut.write_bytes(whole[: len(whole) * tenths // 10])
        lines = list(run_lines(judged_run(read_for_figures(cut))))
        if not lines[0].startswith("FAILED"):
            break
    assert lines[0].startswith("NO VERDICT  circle_speed: ")
    text = " ".join(" ".join(lines).split())
    assert "cut.rrd has no end" in text
    assert re.search(r" s failed error\.planar_m below 0\.001 from 0\.2 s to the end: first", text)
    assert re.search(r" s ended the recording has no summary", text)
