"""What a test with a run tells of it: its problems, the next commands, and its entries in a report."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.addons.testing.checked_run import CheckedRun
from hil.addons.testing.overrides import Overrides
from hil.core.errors import DeviceError, HilError, LinkError
from hil.judge.judged_run import Recorded
from hil.judge.result import RunResult
from hil.judge.run_text import applied_text
from hil.scenario import load
from tests.support.made_runs import made_runs


def metrics(**link: Any) -> dict[str, Any]:
    statistics: dict[str, Any] = {
        "sent": {"frames": 11, "bytes": 12},
        "received": {"frames": 21, "bytes": 22},
        "lost": {"snapshots": 3},
        "rejected": {"crc": 4, "length": 5},
        "load": {"a": {"worst_100_ms_percent": 6.5}, "b": {"worst_100_ms_percent": 7.5}},
        "round_trip_ms": {"p50": 1.5, "p99": 2.5},
        "feedback_age_ms": {"p50": 3.5, "p99": 4.5},
    }
    own = {"law": "dsc", "mode": "lockstep", "link": "memory:", "seed": 7, "wire_sha256": "ab", "t10_s": None}
    return {**own, "tracked_s": 0.5, "ticks": 90, "recoveries": [1, 2], "link_statistics": statistics | link}


def checked(result: Any = None, error: HilError | None = None, recording: Path | None = None) -> CheckedRun:
    return CheckedRun(load("circle_speed", seed=9), cast("RunResult | None", result), error, recording, "hil run it")


def test_entries_of_a_report_are_the_figures_of_run_and_link_that_there_are() -> None:
    found = checked(SimpleNamespace(metrics=metrics()), LinkError("it broke"), Path("a.rrd")).properties()
    assert found == [
        *[("scenario", "circle_speed"), ("law", "dsc"), ("mode", "lockstep"), ("link", "memory:"), ("seed", "7")],
        *[("wire_sha256", "ab"), ("tracked_s", "0.5"), ("ticks", "90")],
        *[("link.sent_frames", "11"), ("link.sent_bytes", "12")],
        *[("link.received_frames", "21"), ("link.received_bytes", "22")],
        *[("link.lost_snapshots", "3"), ("link.rejected", "9"), ("link.worst_load_percent", "7.5")],
        *[("link.round_trip_p50_ms", "1.5"), ("link.round_trip_p99_ms", "2.5")],
        *[("link.feedback_age_p50_ms", "3.5"), ("link.feedback_age_p99_ms", "4.5"), ("link.recoveries", "2")],
        *[("failure", "it broke"), ("recording", "a.rrd")],
    ]
    bare = metrics(load=None, round_trip_ms=None, feedback_age_ms=None)
    names = [name for name, _ in checked(SimpleNamespace(metrics=bare)).properties()]
    assert [name for name in names if "load" in name or "_ms" in name] == []
    assert checked(error=LinkError("no")).properties() == [
        ("scenario", "circle_speed"),
        ("seed", "9"),
        ("failure", "no"),
    ]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (LinkError("cut"), "the link failed, not an expectation: cut"),
        (DeviceError("hot"), "the robot failed, not an expectation: hot"),
        (HilError("odd"), "odd"),
    ],
)
def test_a_run_that_could_not_begin_says_whose_fault_it_was(error: HilError, words: str) -> None:
    assert checked(error=error).text().splitlines() == [
        *(words, ""),
        "  scenario     circle_speed, lockstep, memory:, seed 9",
        "  recording    none was kept",
        "  repeat it    hil run it",
    ]


def test_a_recording_is_told_with_what_to_do_and_with_what_it_lacks() -> None:
    lines = checked(error=HilError("odd"), recording=Path("a b.rrd")).text().splitlines()
    assert lines[3:] == [
        "  recording    a b.rrd",
        "  look at it   hil view 'a b.rrd'",
        "               hil review 'a b.rrd'",
        "  repeat it    hil run it",
    ]


def test_overrides_are_put_on_top_and_another_link_drops_the_truth() -> None:
    base = Overrides(("loop.duration_s=1.0",), "realtime", "serial:/dev/a", 4, "udp://1:2")
    more = base.changed({"robot.mass_kg": 21.0}, seed=5, mode=None)
    assert more == Overrides(("loop.duration_s=1.0", "robot.mass_kg=21.0"), "realtime", "serial:/dev/a", 5, "udp://1:2")
    assert base.changed(link="memory:").truth is None
    assert base.changed(link="memory:", truth="udp://3:4").truth == "udp://3:4"
    words = "--mode realtime --link serial:/dev/a --seed 9 --set loop.duration_s=1.0 --truth udp://1:2"
    assert base.command(load("circle_speed", seed=9)) == f"hil run circle_speed {words}"
    assert Overrides().command(load("circle_speed", seed=9)) == "hil run circle_speed --seed 9"


def test_a_run_that_failed_tells_its_causes_then_its_claims_its_faults_and_what_its_recording_lacks() -> None:
    run = made_runs()[0].judged
    whole, gap = Recorded(200, 0, 0, 0, None), Recorded(200, 0, 0, 0, "a gap")
    for recorded, more in ((whole, ""), (None, ""), (gap, ", incomplete: a gap")):
        result = SimpleNamespace(passed=False, run=replace(run, recorded=recorded))
        lines = checked(result, DeviceError("the link is gone"), Path("a.rrd")).text().splitlines()
        empty = lines.index("")
        assert lines[:2] == [
            "the robot failed, not an expectation: the link is gone",
            f"expectation: {run.expect[0].text}",
        ]
        assert not any(line.startswith("failure") for line in lines), "it is told once"
        assert lines[2:empty] == [
            "allow: stale ticks: 2, allowed 0",
            "fault: estop command from 2.2 s: never applied, so the run shows nothing about it",
        ]
        rows = [(line[2:14].rstrip(), line[15:]) for line in lines[empty + 1 :]]
        assert [text for label, text in rows if label == "expectation"] == [row.text for row in run.expect]
        assert [text for label, text in rows if label == "fault"] == [applied_text(row) for row in run.faults]
        assert ("recording", f"a.rrd{more}") in rows
        assert rows[0] == ("scenario", "circle_speed, lockstep, memory:, seed 9")
