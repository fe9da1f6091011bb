"""The event log is written while the run goes on: what happens is told at the tick at which it happens."""

import struct
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hil.batch.catalogue.recording import RecordingHere
from hil.judge.state import STATE_BEGINS
from hil.review import read
from hil.review.result import RunResult
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.events import RunEvents
from hil.scenario import load
from hil.scenario.trial import ExpectTable

TICKS_A_S = 200
SHORT = ["loop.rate_hz=200", "loop.duration_s=2.0", "plant.start={ contact = 'rigid' }"]


class Noting(RecordingHere):
    """A recording that notes how many rows it had when it was told of an event."""

    told: dict[str, tuple[int, float, str]]

    def event(self, t_s: float, level: str, text: str) -> None:
        self.told = {**getattr(self, "told", {}), text: (len(self._rows) // self._width, t_s, level)}
        super().event(t_s, level, text)


def told(path: Path, *changes: str) -> tuple[dict[str, tuple[int, float, str]], RunResult]:
    """Run; return the events, each with the rows before it, its time and level."""
    made: list[Noting] = []

    def make(*arguments, **options) -> Noting:
        made.append(Noting(*arguments, **options))
        return made[0]

    scenario = load("paper_circle", mode="lockstep", link="memory:", set=[*SHORT, *changes])
    result = run_scenario(scenario, RunOptions(record=path, make_recording=make))
    assert [event.text for event in read(path).events if event.text not in made[0].told] == []
    return made[0].told, result


def test_faults_and_expectations_are_told_at_their_tick_and_counts_at_the_end(tmp_path: Path) -> None:
    window = "kind = 'override', target = 'error.planar_m', value = 9.0, start_s = 0.5, end_s = 0.752"
    events, result = told(
        tmp_path / "run.mcap",
        f"fault=[{{ {window} }}, {{ kind = 'drop', target = 'command', value = 0.1, start_s = 1.5 }}]",
        "expect=[{ signal = 'error.planar_m', below = 8.0 }, { signal = 'loop.tick', above = -1, to_s = 1.0 },"
        "{ signal = 'loop.tick', settles_to = 399, tolerance = 0.5 }]",
    )
    in_time = {text: (rows, t_s, level) for text, (rows, t_s, level) in events.items() if t_s > 0.0}
    [state] = [text for text in in_time if text.startswith(STATE_BEGINS)]
    assert in_time.pop(state) == (101, 0.5, "info"), "how the robot was is told once, when the run first fails"
    first, open_end = "override error.planar_m 9 from 0.5 s to 0.752 s", "drop command 0.1 from 1.5 s"
    held, settled = (result.metrics["expect"][i]["text"] for i in (1, 2))
    failed = "error.planar_m below 8 from 0 s to the end: failed, 9 at t = 0.5 s"
    last_s = 2.0 - 1 / TICKS_A_S
    assert in_time == {
        f"fault begins: {first}": (101, 0.5, "info"),
        failed: (101, 0.5, "error"),
        f"fault ends: {first}": (152, 0.752, "info"),
        held: (202, 1.0, "info"),
        f"fault begins: {open_end}": (301, 1.5, "info"),
        f"fault ends with the run: {open_end}": (400, last_s, "info"),
        settled: (400, last_s, "info"),
        f"{failed}; worst 9 at t = 0.5 s; 0.255 s in all": (400, last_s, "error"),
        f"fault: {first}: applied 51 times (ticks in which the value changed)": (400, last_s, "info"),
        **{text: event for text, event in in_time.items() if text.startswith(f"fault: {open_end}: applied ")},
    }
    assert [row["passed"] for row in result.metrics["expect"]] == [False, True, True]


def test_a_loss_and_a_recovery_are_told_when_they_happen(tmp_path: Path) -> None:
    events, result = told(
        tmp_path / "run.mcap", "loop.rearm=true", "expect=[]", "fault=[{kind='disconnect', start_s=0.5, end_s=0.6}]"
    )
    (recovery,) = result.metrics["recoveries"]
    lost = events[f"{recovery['why']}; it is being brought back"]
    back = events[f"ACTIVE again after {recovery['armed_s'] - recovery['lost_s']:.3f} s: {recovery['why']}"]
    assert lost == (100, pytest.approx(0.5), "warning")
    assert back == (round(recovery["armed_s"] * TICKS_A_S), pytest.approx(recovery["armed_s"]), "info")


def test_the_work_grows_as_the_number_of_claims_and_not_as_its_square() -> None:
    base, names = load("circle_speed"), (*RunEvents.needs, "pose.x_m")

    def calls(count: int) -> int:
        claims = tuple(ExpectTable(signal="pose.x_m", below=1.0 + i) for i in range(count))
        events = RunEvents(replace(base, expect=claims, fault=()), names, lambda *_: None, lambda: None)
        made, before = [0], sys.getprofile()

        def one_more(_frame: object, event: str, _argument: object) -> None:
            made[0] += event == "call"

        sys.setprofile(one_more)
        try:
            events.put(struct.pack(f"{len(names)}d", *[0.0] * len(names)))
            assert len(events.finish(0.0, is_cut=False)) == count
        finally:
            sys.setprofile(before)
        return made[0]

    few, many = calls(100), calls(200)
    assert many < 2.1 * few
