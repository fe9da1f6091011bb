"""The text of a run, every figure of which is another: its labels, units and order, written down by hand."""

import math
import textwrap
from dataclasses import replace

import pytest

from hil.core.ports import Event
from hil.core.signals import Signals
from hil.judge.figure_text import link_rows
from hil.judge.judged_run import (
    BaselineResult,
    Counts,
    ExpectationResult,
    Failure,
    FaultResult,
    FramesResult,
    Identity,
    JudgedRun,
    LimitResult,
    MovedFigure,
    Recorded,
    Recovered,
    Verdict,
    decide,
)
from hil.judge.result import RunResult
from hil.judge.run_text import head_rows, outcome_rows, run_lines, timeline, why_not_passed

FIGURES = {
    "tracked_s": 1.25, "t10_s": None, "steady_rms_m": 0.00321, "steady_max_m": 0.00654, "overshoot_m": 0.0123,
    "effort_n_m_s": 7.5, "torque_variation_n_m_per_s": 31.25, "saturation_s": 0.045, "ticks": 400,
    "deadline_misses": 3, "realtime_factor": 17.5, "tick_us": {"p50": 41.27, "p99": 97.53},
    "lateness_us": {"p50": 1.0, "p99": 22.0, "p99.9": 333.0, "max": 4444.0},
    "frames": {"sent": 801, "received": 1602, "rejected": {"crc": 5, "length": 7}},
    "estimation_error": {"rms_m": 0.00412, "max_m": 0.0131, "heading_rms_rad": 0.0021},
    "pose_fixes": {"used": 31, "too_old": 2, "late": 0, "rejected": {"gate": 4, "age": 6}},
    "link_statistics": {
        "sent": {"frames": 811, "bytes": 12345}, "received": {"frames": 1622, "bytes": 67890},
        "foreign": {"frames": 0, "bytes": 0},
        "load": {"to_robot": {"mean_percent": 12.34, "worst_100_ms_percent": 23.47},
                 "to_host": {"mean_percent": None, "worst_100_ms_percent": None}},
        "lost": {"snapshots": 8, "late_frames": 0, "own_frames": 9},
        "feedback_age_ms": {"p50": 2.136, "p99": 3.5}, "round_trip_ms": {"p50": 5.25, "p99": 9.75},
        "clock": {"offset_us": -1234.6, "drift_ppm": 6.78, "round_trip_us": {"p50": 311.0, "p99": 722.0}},
    },
}  # fmt: skip
HELD = ExpectationResult("error.x_m", passed=True, margin=0.125, text="error.x_m below 8 to the end: held")
LOOSE = ExpectationResult("error.y_m", passed=True, margin=0.75, text="error.y_m below 9 to the end: held")
OPEN = ExpectationResult("error.y_m", text="error.y_m below 7 from 5 s: not judged, the run ended at t = 2 s")
BROKEN = ExpectationResult(
    "loop.t_s", None, None, False, 1.5, 1.5, 1.75, 1.75, 0.25, None, -0.5,
    "loop.t_s below 1.25 from 1.5 s to the end: failed, 1.5 at t = 1.5 s; worst 1.75 at t = 1.75 s; 0.25 s in all",
)  # fmt: skip
EARLIER = ExpectationResult("loop.tick", None, None, False, 0.5, 100.0, 0.5, 100.0, 0.0, None, -0.25,
                            "loop.tick below 99 from 0 s to the end: failed, 100 at t = 0.5 s")  # fmt: skip
FAULTS = [
    FaultResult("push", "force_x_n", "push force_x_n 9 from 1.125 s to 1.25 s", 12, "steps", 1.125, 1.25, 9.0),
    FaultResult("drop", "command", "drop command 0.1 from 0.75 s", 0, "frames lost", 0.75, None, 0.1),
    FaultResult("reset", "robot", "reset robot from 1 s", 1, "resets", 1.0),
    FaultResult("mute", "STATUS", "mute STATUS from 1.375 s", None, "frames lost", 1.375),
]
MOVED = MovedFigure("overshoot_m", 0.01, 0.0123, 0.001, "overshoot_m: 0.0123 in place of 0.01 ± 0.001, +23 %")
FARTHER = MovedFigure("effort_n_m_s", 10.0, 7.5, 0.5, "effort_n_m_s: 7.5 in place of 10 ± 0.5, -25 %")
GIVEN = {
    "loop.rate_hz": {"value": "200", "from": "--set"},
    "robot.mass_kg": {"value": "21", "from": "mine.toml:3"},
}
FAILED = JudgedRun(
    identity=Identity("circle", "lqi", "realtime", "torque", "can:can0", 7, GIVEN),
    verdict=Verdict.FAILED,
    figures=FIGURES,
    reasons={"t10_s": "it never settled"},
    counts=Counts(11, 13, 17, 12, 0, 0),
    robot_slipped_ticks=19,
    allow=[LimitResult("stale_ticks", False, 9, 4, 2, -0.6, "stale_ticks: 4 of 400 ticks not driven")],
    recoveries=[Recovered(0.25, 0.375, "the link was lost")],
    expect=[HELD, BROKEN, OPEN, LOOSE, EARLIER],
    faults=FAULTS,
    failure=Failure("the robot left", "DeviceError", 1.0),
    baseline=BaselineResult("a.toml", None, 9, [MOVED, FARTHER], FramesResult(False, "the frames are others")),
    realtime={"granted": {"priority": "priority 50", "memory": "locked"}, "refused": {"cpus": "processors: no"}},
    reference={"warnings": ["wheel fl is too fast"]},
    recording="b.mcap",
    recorded=Recorded(390, 6, 4, 2, None, parts=["a.mcap", "b.mcap"]),
    notes=["it has no end"],
    events=[
        Event(0.125, "WARN", "a warning"),
        Event(0.5, "INFO", "the robot then: x 1 m"),
        Event(0.5, "ERROR", "loop.tick below 99 from 0 s to the end: failed, 100 at t = 0.5 s"),
        Event(0.625, "ERROR", "an error"),
        Event(0.65, "INFO", "not told"),
    ],
)
TOLD = """\
FAILED  circle: lqi by torque, realtime over can:can0, seed 7
  given                  loop.rate_hz = 200; robot.mass_kg = 21
  note                   it has no end

What happened, in order of time:
     0.000 s  warning   wheel fl is too fast
     0.125 s  warning   a warning
     0.250 s  lost      the link was lost; ACTIVE again at 0.375 s
     0.500 s  failed    loop.tick below 99 from 0 s to the end: first 100 at
                        0.5 s, once
     0.500 s  state     x 1 m
     0.625 s  error     an error
     0.750 s  no fault  drop command 0.1 from 0.75 s: never applied, so the run
                        shows nothing about it
     1.000 s  fault     reset robot from 1 s: applied once (resets)
     1.125 s  fault     push force_x_n 9 from 1.125 s to 1.25 s: applied 12
                        times (steps)
     1.125 s  ended     the robot left
     1.375 s  no fault  mute STATUS from 1.375 s: not known how often it was
                        applied, because the robot has gone
     1.500 s  failed    loop.t_s below 1.25 from 1.5 s to the end: first 1.5 s
                        at 1.5 s, already when its time began, worst 1.75 s at
                        1.75 s, 0.25 s in all
  at the end  allow     stale_ticks: 4 of 400 ticks not driven
  at the end  moved     effort_n_m_s: 7.5, accepted 10 ± 0.5 (-25 %)
  at the end  moved     overshoot_m: 0.0123, accepted 0.01 ± 0.001 (+23 %)

  expectation            error.x_m below 8 to the end: held
  expectation            error.y_m below 7 from 5 s: not judged, the run ended
                         at t = 2 s
  expectation            error.y_m below 9 to the end: held
  baseline               7 of 9 figures as accepted
                         find what changed; accept it with `hil baseline
                         --accept`, or explore with --lenient
  tracked after          1.25 s
  steady error rms       3.21 mm
  steady error max       6.54 mm
  overshoot              12.3 mm
  effort                 7.5 N·m·s
  torque variation       31.25 N·m/s a wheel
  saturated for          0.045 s
  ticks                  400
  deadline misses        3
  times real time        17.5
  tick p50, p99          41.3, 97.5 µs
  late p50, 99, 99.9, max 1, 22, 333, 4444 µs
  granted                priority 50; locked
  not granted            processors: no
  frames                 801 sent, 1602 received since connecting, without
                         HELLO; rejected: crc 5, length 7
  no value               within 10 mm after: it never settled
  estimate's error       4.12 mm rms, 13.1 mm max
  pose fixes             31 used, 2 too old, rejected: gate 4, age 6
  law                    its command was not finite 11 times, and the robot was
                         held at rest
  stale                  13 ticks, in which the feedback or the truth was too
                         old: the robot was not driven
  held                   17 ticks, in which the state was unknown, the estimator
                         lost, or the robot away
  virtual robot          lost 19 ms of its time to stalls of this machine
  on the wire            sent 811 frames, 12.3 kB, received 1622 frames, 67.9
                         kB, since the first ACTIVE tick
  load, to_robot         12.3 %, in the worst 100 ms 23.5 %
  lost                   snapshots 8, own frames 9
  feedback age p50, p99  2.14, 3.5 ms
  round trip p50, p99    5.25, 9.75 ms
  robot's clock          -1.235 ms, drift +6.8 ppm
  TIME_SYNC p50, p99     311, 722 µs
  recording              incomplete: the recorder was too slow; 6 rows were
                         dropped and 4 lost, 2 events lost, 390 are safe in
                         b.mcap in 2 parts
"""
GREEN = JudgedRun(
    identity=Identity("circle", "lqi", "lockstep", None, "memory:", 7),
    verdict=Verdict.PASSED,
    figures={**FIGURES, "frames": {"sent": 1, "received": 2, "rejected": {"crc": 0}}, "link_statistics": None},
    expect=[LOOSE, HELD],
    baseline=BaselineResult("a.toml", None, 9, (), FramesResult(True, "the same")),
)


def words(run: JudgedRun) -> str:
    return " ".join(" ".join(run_lines(run)).split())


def test_all_that_is_known_of_a_failed_run_is_told_with_its_units() -> None:
    assert list(run_lines(FAILED, everything=True)) == TOLD.splitlines()
    short = list(run_lines(FAILED))
    assert set(short) - set(TOLD.splitlines()) == {
        "  expectations           2 held; the tightest: error.x_m below 8 to the end,",
        "                         with 12.5 % to spare",
        "  not judged             error.y_m below 7 from 5 s, the run ended at t = 2 s",
    }
    left_out = {line[2:24].strip() for line in set(TOLD.splitlines()) - set(short) if line[2] != " "}
    assert left_out == {"expectation", "times real time", "granted"}


@pytest.mark.parametrize("drift_ppm", [None, math.nan])
def test_a_drift_that_a_short_run_does_not_know_is_left_out(drift_ppm: float | None) -> None:
    clock = {"offset_us": -1234.6, "drift_ppm": drift_ppm, "round_trip_us": {"p50": 311.0, "p99": 722.0}}
    run = replace(FAILED, figures={"link_statistics": {"clock": clock}})
    assert dict(link_rows(run))["robot's clock"] == "-1.235 ms"


def test_a_green_run_leaves_out_the_machine_and_a_link_that_lost_nothing() -> None:
    assert (
        list(run_lines(GREEN))
        == textwrap.dedent("""\
        PASSED  circle: lqi, lockstep over memory:, seed 7

          expectations           2 held; the tightest: error.x_m below 8 to the end,
                                 with 12.5 % to spare
          baseline               9 of 9 figures as accepted, and the same frames
          tracked after          1.25 s
          steady error rms       3.21 mm
          steady error max       6.54 mm
          overshoot              12.3 mm
          effort                 7.5 N·m·s
          torque variation       31.25 N·m/s a wheel
          saturated for          0.045 s
          ticks                  400
          estimate's error       4.12 mm rms, 13.1 mm max
          pose fixes             31 used, 2 too old, rejected: gate 4, age 6""").splitlines()
    )
    lost = {"link_statistics": {"lost": {"snapshots": 2}}}
    assert "on the wire nothing, since the first ACTIVE tick lost snapshots 2" in words(
        replace(GREEN, figures={**GREEN.figures, **lost})
    )
    rejected = {"frames": {"sent": 1, "received": 2, "rejected": {"crc": 3}}}
    assert "HELLO; rejected: crc 3" in words(replace(GREEN, figures={**GREEN.figures, **rejected}))


def test_outcomes_are_told_by_kind_the_failed_ones_first_by_time() -> None:
    assert list(outcome_rows(FAILED)) == [
        ("fault", "push force_x_n 9 from 1.125 s to 1.25 s: applied 12 times (steps)"),
        ("fault", "drop command 0.1 from 0.75 s: never applied, so the run shows nothing about it"),
        ("fault", "reset robot from 1 s: applied once (resets)"),
        ("fault", "mute STATUS from 1.375 s: not known how often it was applied, because the robot has gone"),
        ("recovery", "lost at 0.250 s, ACTIVE again at 0.375 s: the link was lost"),
        *(("expect", row.text) for row in (EARLIER, BROKEN, OPEN, HELD, LOOSE)),
        ("allow", "stale_ticks: 4 of 400 ticks not driven"),
        ("baseline", MOVED.text),
        ("baseline", FARTHER.text),
        ("baseline", "the frames are others"),
        ("baseline", "7 of 9 figures as accepted"),
        ("baseline", "find what changed; accept it with `hil baseline --accept`, or explore with --lenient"),
        ("recording", "incomplete: the recorder was too slow; 6 rows were dropped and 4 lost, 2 events lost, 390 are "
                      "safe in b.mcap in 2 parts"),
    ]  # fmt: skip


def test_causes_come_before_their_consequences_and_a_lenient_run_has_only_the_first() -> None:
    first = [("failure", "the robot left"), ("expectation", EARLIER.text), ("expectation", BROKEN.text)]
    causes = list(why_not_passed(FAILED))
    assert causes[:3] == first
    assert [kind for kind, _ in causes[3:]] == ["allow", "fault", "fault", "baseline", "baseline", "baseline"]
    assert [text.split()[0] for _, text in causes[4:]] == ["drop", "mute", "overshoot_m:", "effort_n_m_s:", "the"]
    lenient = replace(FAILED, lenient=True)
    assert list(why_not_passed(lenient)) == first
    assert decide(replace(lenient, failure=None, expect=[HELD, OPEN])).verdict is Verdict.PASSED
    assert "find what changed; accept it with `hil baseline --accept` lenient judged by" in words(lenient)
    judged_alone = "judged by [[expect]] alone: not by [allow], the baseline, or whether every fault was applied"
    assert f"lenient {judged_alone}" in words(lenient)


def test_the_short_form_of_a_result_has_its_first_cause_and_counts_the_others() -> None:
    def short(run: JudgedRun) -> str:
        return repr(RunResult(None, run, Signals({}), None))

    assert short(FAILED) == "<RunResult FAILED circle, 400 ticks, the robot left and 8 more>"
    alone = replace(FAILED, lenient=True, expect=[HELD], failure=Failure("word " * 30))
    assert short(alone) == f"<RunResult FAILED circle, 400 ticks, {'word ' * 17}…>"
    assert short(GREEN) == "<RunResult PASSED circle, 400 ticks>"


def test_a_run_that_passed_with_gaps_in_its_recording_is_incomplete() -> None:
    whole = Recorded(400, 0, 0, 0, None)
    assert not any(line.startswith("  recording") for line in run_lines(replace(GREEN, recorded=whole)))
    told = replace(GREEN, recorded=whole._replace(troubles=["no index", "a retry"], parts=["a.rrd", "b.rrd"]))
    assert words(told).startswith("PASSED circle")
    assert words(told).endswith("recording complete in 2 parts, though no index; a retry")
    for gap, why in (
        ({"dropped": 5}, "the recorder was too slow; 5 rows were dropped and 0 lost"),
        ({"lost": 6}, "the recorder was too slow; 0 rows were dropped and 6 lost"),
        ({"error": "the disk is full"}, "the disk is full; 0 rows were dropped and 0 lost"),
        ({"events_lost": 7}, "the recorder was too slow; 0 rows were dropped and 0 lost, 7 events lost"),
    ):
        gone = replace(GREEN, recorded=whole._replace(**gap, parts=["a.rrd"]), recording="x.rrd")
        assert words(gone).startswith("PASSED, INCOMPLETE circle")
        assert words(gone).endswith(f"recording incomplete: {why}, 400 are safe in a.rrd")
    for run in (replace(GREEN, counts=Counts(lost_rows=1)), replace(GREEN, damaged=True)):
        assert words(run).startswith("PASSED, INCOMPLETE circle")
    assert words(replace(FAILED, damaged=True)).startswith("FAILED circle")


def test_of_many_alike_six_are_told_and_the_others_counted() -> None:
    given = {f"loop.k{i}": {"value": str(i), "from": "--set"} for i in range(1, 9)}
    head = dict(head_rows(replace(GREEN, identity=Identity(given=given))))
    assert head["given"] == "; ".join([*(f"loop.k{i} = {i}" for i in range(1, 7)), "2 more"])
    six = {key: given[key] for key in [*given][:6]}
    assert not dict(head_rows(replace(GREEN, identity=Identity(given=six))))["given"].endswith("more")
    own = {"robot.mass_kg": GIVEN["robot.mass_kg"]}
    assert "given" not in dict(head_rows(replace(GREEN, identity=Identity(given=own)))), "a green run explains nothing"

    events = [Event(0.25 * i, "WARN", f"warning {i}") for i in range(9)]
    assert timeline(replace(GREEN, events=events))[-2:] == [
        (1.25, "warning", "warning 5"),
        (2.0, "warning", "3 more until then; hil review --json has them all"),
    ]
    assert len(timeline(replace(GREEN, events=events[:6]))) == 6

    moved = [MovedFigure(f"f{i}", 1.0, 1.0 + i / 8, 0.5, "") for i in range(1, 9)]
    run = replace(GREEN, baseline=BaselineResult("a.toml", None, 9, moved))
    told = [one.text for one in timeline(run)]
    assert told[0] == "f8: 2, accepted 1 ± 0.5 (+100 %)"
    assert told[1] == "f7: 1.875, accepted 1 ± 0.5 (+87.5 %)"
    assert (len(told), told[6]) == (7, "also f2, f1")
    six = [one.text for one in timeline(replace(run, baseline=BaselineResult("a.toml", None, 9, moved[:6])))]
    assert (len(six), six[5]) == (6, "f1: 1.125, accepted 1 ± 0.5 (+12.5 %)")
    exact = MovedFigure("refused", 0.0, 12.3456789, 0.0, "")
    few = [one.text for one in timeline(replace(run, baseline=BaselineResult("a.toml", None, 9, [moved[7], exact])))]
    assert few == ["refused: 12.35, accepted 0 ± 0", "f8: 2, accepted 1 ± 0.5 (+100 %)"]
    beside = [one.text for one in timeline(replace(run, expect=[BROKEN])) if one.kind == "moved"]
    assert (len(beside), beside[3]) == (4, "also f5, f4, f3, f2, f1")
    gone = MovedFigure("t10_s", 1.0, None, 0.5, "")
    lone = replace(run, baseline=BaselineResult("a.toml", None, 9, [moved[7], gone]))
    assert timeline(lone)[0].text == "t10_s: no value, accepted 1 ± 0.5"
    frames = replace(run, baseline=BaselineResult("a.toml", None, 9, [], FramesResult(False, "other frames")))
    assert [one.text for one in timeline(frames)] == ["other frames"]
    assert "baseline 9 of 9 figures as accepted find what changed" in words(frames)
