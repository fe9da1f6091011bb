"""The event log is written during the run: each event is there at its tick."""

import math
import struct
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hil.core.types import Guarded, Limit
from hil.judge.result import RunResult
from hil.judge.run_text import STATE_BEGINS
from hil.record.reader import read
from hil.record.recording import Recording
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.events import EventLog, RunEvents, Takings
from hil.scenario import load
from hil.scenario.trial import ExpectTable

TICKS_A_S = 200
SHORT = ["loop.rate_hz=200", "loop.duration_s=2.0", "plant.start={ contact = 'rigid' }"]


class Noting(Recording):
    """A recording that notes how many rows it had when it was told of an event."""

    def __init__(self, *arguments, **options) -> None:
        super().__init__(*arguments, **options)
        self.told: dict[str, tuple[int, float, str]] = {}
        self.count, put = 0, self.put

        def counted(row) -> None:
            self.count += 1
            put(row)

        self.put = counted

    def event(self, t_s: float, level: str, text: str) -> None:
        self.told[text] = (self.count, t_s, level)
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
    assert len([text for text, (_, _, level) in [*in_time.items()] if level == "journal" and in_time.pop(text)]) > 10
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


def stated(row: dict[str, float], *, newest: bool = True) -> list[tuple[float, str, str]]:
    """Return the log of a run that is cut at 1.25 s, whose newest row has these values; the others are NaN."""
    names = (*RunEvents.needs, "pose.x_m")
    told: list[tuple[float, str, str]] = []
    values = struct.pack(f"{len(names)}d", *[row.get(name, math.nan) for name in names])
    base = replace(load("circle_speed"), expect=(), fault=())
    events = RunEvents(base, names, lambda *one: told.append(one), lambda: values if newest else None)
    assert not events.needs_rows
    assert events.finish(1.25, is_cut=True) == {}
    return told


def of_wheels(**quantities: tuple[float, ...]) -> dict[str, float]:
    wheels = ("fl", "fr", "rr", "rl")
    return {f"wheel.{w}.{name}": one for name, four in quantities.items() for w, one in zip(wheels, four, strict=True)}


OFF = {"error.x_m": 0.00124, "error.y_m": -0.0567, "error.heading_rad": 0.0789, "error.planar_m": 0.057}


@pytest.mark.parametrize(
    ("row", "text"),
    [
        (
            OFF | {"guard.held": 0.0}
            | of_wheels(speed_command_rad_s=(1.04, -2.0, 3.0, 4.0), torque_command_n_m=(0.1, 0.2, 0.3, 0.4),
                        speed_rad_s=(1.1, -2.16, -0.01, 4.0), current_a=(0.5, -0.625, 0.75, 0.0)),
            "off by x 1.2 mm, y -56.7 mm, heading 78.9 mrad; wheels FL, FR, RR, RL asked for 1.0, -2.0, 3.0, 4.0 rad/s;"
            " turned at 1.1, -2.2, 0.0, 4.0 rad/s; drew 0.50, -0.62, 0.75, 0.00 A",
        ),
        (
            {"guard.held": 1.0} | of_wheels(torque_command_n_m=(0.125, -0.25, 0.5, 1.0)),
            "held at rest, because its state was unknown or old; wheels FL, FR, RR, RL asked for 0.12, -0.25, 0.50, "
            "1.00 N·m",
        ),
        (
            {"guard.held": 0.0} | of_wheels(current_a=(1.0, 2.0, 3.0, math.nan)),
            "wheels FL, FR, RR, RL drew 1.00, 2.00, 3.00, nan A",
        ),
        (OFF | {"guard.held": 1.0}, "off by x 1.2 mm, y -56.7 mm, heading 78.9 mrad; held at rest, because its state "
                                    "was unknown or old"),
    ],
)  # fmt: skip
def test_how_the_robot_was_is_told_in_the_units_of_its_parts(row: dict[str, float], text: str) -> None:
    assert stated(row) == [(1.25, "info", f"{STATE_BEGINS}{text}")]


def test_without_a_row_nothing_is_told_of_the_robot() -> None:
    assert stated({}, newest=False) == []


def test_the_log_keeps_the_first_events_and_passes_on_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.runtime.events._EVENTS_KEPT", 3)
    passed_on: list[tuple[float, str, str]] = []
    log = EventLog(lambda *one: passed_on.append(one))
    for number, level in enumerate(("info", "warning", "error", "debug")):
        log.note(float(number), level, f"event {number}")
    kept = [(0.0, "INFO", "event 0"), (1.0, "WARN", "event 1"), (2.0, "ERROR", "event 2")]
    assert [tuple(event) for event in log.events] == kept
    assert passed_on[1:] == [(1.0, "warning", "event 1"), (2.0, "error", "event 2"), (3.0, "debug", "event 3")]
    EventLog(None).note(0.0, "info", "nobody follows")


def test_a_limit_that_takes_torque_is_noted_when_it_begins_and_again_after_a_second_without() -> None:
    told: list[tuple[float, str, str]] = []
    takings = Takings(lambda *one: told.append(one), lambda: f"wheel {len(told)}")
    for t_s in (0.5, 0.505, 1.4, 2.4, 3.41):
        takings.add(t_s, Guarded(False, Limit.SLIP, 1.0))
    takings.add(3.42, Guarded(False, Limit.BODY, 1.0))
    assert told == [(t_s, "warning", f"torque is taken from wheel {i}") for i, t_s in enumerate((0.5, 3.41, 3.42))]
