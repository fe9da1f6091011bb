"""What the catalogue plans and shows: trials with what they allow, verdicts, rows; and what makes a trial wrong."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import matplotlib.figure
import numpy as np
import pytest

from hil.addons.batch.catalogue import trials as catalogue_trials
from hil.addons.batch.catalogue.fault_cases import CASES, MOTORS_CASES, Ending
from hil.addons.batch.catalogue.trial_run import _ending, _wrong
from hil.addons.batch.catalogue.trials import JudgedTrial, Request, Trial, alone, check, in_pairs, results, scenarios
from hil.addons.batch.job import ENDED, FAILED, LOST, PASSED, REFUSED, Outcome
from hil.core.errors import BadInputError, LinkError
from hil.judge.result import RunResult
from hil.scenario import Scenario


def asked(*kinds: str, links: tuple[str, ...] = (), sets: tuple[str, ...] = ()) -> Request:
    return Request("circle_speed", list(sets), list(links), list(kinds), Path("to"))


def test_a_case_that_comes_back_is_tried_with_and_without_re_arming_over_each_link() -> None:
    trials = alone(asked("disconnect"))
    assert [(one.link, one.rearm, one.allowed, one.mode) for one in trials] == [
        (link, rearm, [Ending.REARMS if rearm else Ending.ENDS], "lockstep")
        for link in ("memory:", "serial:pty", "can:virtual/catalogue")
        for rearm in (True, False)
    ]
    assert {tuple(one.causes) for one in trials} == {tuple(one.causes_of_end) for one in trials}
    assert trials[0].causes == ["the fault disconnect"]
    assert trials[0].rows == [{"kind": "disconnect", "target": "link", "start_s": 0.25, "end_s": 0.35}]
    assert [one.recording for one in trials[:3]] == [
        str(Path("to") / f"disconnect-link-{how}.rrd")
        for how in ("memory-lockstep-rearm", "memory-lockstep-end", "serial-lockstep-rearm")
    ]
    assert [one.records_here for one in trials] == [True, True, False, False, True, True]
    (real, *_) = alone(asked("disconnect"), "realtime")
    assert (real.allowed, real.rearm, real.records_here) == ([Ending.REARMS], True, False)
    assert real.causes == ["COMMAND_TIMEOUT", "no feedback", "the fault disconnect"]
    (drop,) = alone(asked("drop", links=("can",)), "realtime")
    assert (drop.fault, drop.allowed) == ("drop command", [Ending.GOES_ON, Ending.REARMS])
    assert [(one.rearm, one.allowed) for one in alone(asked("estop", links=("can",)))] == [(True, [Ending.ENDS])]
    assert alone(asked("estop"), "realtime") == []


def test_a_pair_comes_out_like_the_worse_of_its_two_unless_it_is_known_otherwise() -> None:
    pairs = {one.fault: one for one in in_pairs(asked("disconnect", "mute"))}
    assert set(pairs) == {one.fault for one in pairs.values() if "disconnect link" in one.fault or "mute" in one.fault}
    worse = pairs["drop command + disconnect link"]
    assert (worse.allowed, worse.causes, worse.link) == ([Ending.REARMS], ["the fault disconnect"], "memory:")
    assert [row["kind"] for row in worse.rows] == ["drop", "disconnect"]
    assert (worse.records_here, worse.rearm, worse.mode) == (True, True, "lockstep")
    ends = pairs["disconnect link + estop command"]
    assert (ends.allowed, ends.causes_of_end) == ([Ending.ENDS], ["it is ESTOP"])
    assert ends.causes == ["it is ESTOP", "the fault disconnect"]
    known = pairs["mute WHEEL_COMMAND + stuck_encoder fl"]
    assert (known.allowed, known.causes_of_end) == ([Ending.REARMS], ["COMMAND_TIMEOUT"])
    assert known.causes == ["COMMAND_TIMEOUT", "ENCODER_STUCK"]
    both = [one.link for one in in_pairs(asked("disconnect", links=("can", "serial")))][:2]
    assert both == ["can:virtual/catalogue", "serial:pty"]


def test_windows_of_disturbances_begin_before_those_of_what_stops_the_robot() -> None:
    for case in CASES:
        *_, row = case.rows
        length_s = float(row.get("end_s", math.inf)) - float(row["start_s"])
        if case.outcome is Ending.GOES_ON:
            assert row["start_s"] == (0.15 if len(case.rows) == 1 else 0.2), case.name
        else:
            assert row["start_s"] in (0.2, 0.25), case.name
        if case.cause in ("COMMAND_TIMEOUT", "no feedback", "ENCODER_STUCK"):
            assert length_s == pytest.approx(0.4), "longer than the watchdog and the ramp"
        elif math.isfinite(length_s):
            assert any(length_s == pytest.approx(one) for one in (0.1, 0.2, 0.4)), case.name


def test_scenarios_of_trials_are_short_unjudged_and_of_the_mode_of_the_law() -> None:
    trials = alone(asked("override", "mute", links=("memory",)))
    for command, of in (("speed", ("WHEEL_COMMAND", "wheel.fl.speed_command_rad_s")),
                        ("torque", ("TORQUE_COMMAND", "wheel.fl.torque_command_n_m"))):  # fmt: skip
        found = list(scenarios(asked(sets=(f"controller.command={command}",)), trials))
        assert all(isinstance(one, Scenario) for one in found)
        made = [one for one in found if isinstance(one, Scenario)]
        assert [one.loop.rearm for one in made] == [trial.rearm for trial in trials]
        assert {(one.expect, one.loop.duration_s, one.plant.start["contact"]) for one in made} == {((), 1.3, "slip")}
        assert (made[0].fault[0].target, made[-1].fault[0].target) == of
    (own, *_) = scenarios(asked(sets=("controller.law=dsc", "controller.gains.k2_1_s=30.0")), trials)
    assert isinstance(own, Scenario)
    assert own.controller.gains == {"k2_1_s": 30.0}, "gains of the file belong to the file's law"
    (files, *_) = scenarios(asked(), trials)
    assert isinstance(files, Scenario)
    assert files.controller.gains


@pytest.mark.parametrize(("watchdog", "sensors"), [("fixed", set()), ("set", set()), ("set", {"gyro"})])
def test_for_motors_of_other_makers_a_fault_of_a_sensor_that_they_have_not_is_left_out(
    monkeypatch: pytest.MonkeyPatch, watchdog: str, sensors: set[str]
) -> None:
    """A fixed watchdog may be longer than a fault."""
    can = SimpleNamespace(is_twist=False, watchdog=watchdog, sensors=sensors)
    monkeypatch.setattr(catalogue_trials, "make_driver", lambda _: SimpleNamespace(capabilities=can))
    sets = ("device.driver=odrive",)
    found = {one.fault: one for one in alone(asked(sets=sets))}
    more = {Ending.GOES_ON} if watchdog == "fixed" else set()
    names = {case.name: outcomes for case, outcomes in MOTORS_CASES}
    for name in ("disconnect link", "drop command", "no feedback", "stuck_encoder fl"):
        assert set(found[name].allowed) == {*names[name], *more}
    assert (found["drop command"].link, found["drop command"].rearm) == ("can:virtual/catalogue", True)
    assert ("gyro_bias gyro" in found) is bool(sensors)
    if not sensors:
        with pytest.raises(BadInputError, match="--kind gyro_bias: this fault cannot act on 'odrive' as it is set"):
            alone(asked("gyro_bias", sets=sets))
    can.watchdog = "none"
    with pytest.raises(BadInputError, match="the catalogue cannot judge 'odrive' as it is set up"):
        alone(asked(sets=sets))
    can.watchdog, can.is_twist = "set", True
    with pytest.raises(BadInputError, match="the catalogue cannot judge 'odrive' as it is set up"):
        alone(asked(sets=sets))


def test_what_runs_in_real_time_runs_alone_after_all_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []

    def run_trials(request: Request, some: list[Trial], workers: int, limit_s: float, on_progress: Any) -> list[Trial]:
        told.append(({(one.mode, "+" in one.fault) for one in some}, workers, limit_s, on_progress))
        return some

    def progress(*_: object) -> None: ...

    monkeypatch.setattr(catalogue_trials, "run_trials", run_trials)
    request = Request("circle_speed", [], ["memory", "serial"], ["disconnect"], tmp_path / "to")
    done = catalogue_trials.catalogue(request, pairs=True, realtime=True, workers=3, limit_s=7.0, on_progress=progress)
    assert told == [
        ({("lockstep", False), ("lockstep", True)}, 3, 7.0, progress),
        ({("realtime", False)}, 1, 7.0, progress),
    ]
    assert done == [*alone(request), *in_pairs(request), *alone(request, "realtime")]
    assert not (tmp_path / "to").exists(), "nothing is to be looked at"


@pytest.mark.parametrize(
    ("request_", "more", "words"),
    [
        (asked(links=("usb",)), {}, "--link usb: the catalogue has no such link"),
        (asked("mut"), {}, "--kind mut: the catalogue has no such kind; did you mean 'mute'"),
        (asked(links=("can",), sets=("device.driver=moteus",)), {"pairs": True}, "--link, --pairs: with third-party"),
        (asked(sets=("device.driver=moteus",)), {"realtime": True}, "--realtime: with third-party motors"),
    ],
)
def test_what_the_catalogue_cannot_do_is_refused(request_: Request, more: dict[str, bool], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        check(request_, **{"pairs": False, "realtime": False} | more)


# What is shown


def trial(fault: str = "drop command", link: str = "memory:", mode: str = "lockstep", *, rearm: bool = True) -> Trial:
    return Trial(fault, link, mode, [], rearm, [Ending.REARMS], ["a cause", "another"], ["its end"], "x.rrd", True)


def outcome(status: str, reason: str | None = None, ending: str = "", **more: Any) -> Outcome:
    figures = {"applied": [3, 0], "recoveries": 2, "silent_rad_s": 0.25, "silent_ticks": 900} if ending else {}
    return Outcome("", status, reason, figures, {"ending": ending} if ending else {}, **more)


FILE = "a b.rrd"
JUDGED = [
    JudgedTrial(trial(), outcome(PASSED, None, "re-arms", wall_s=1.26)),
    JudgedTrial(
        trial(link="serial:pty", rearm=False), outcome(FAILED, "unsafe: it drove", "ends", recording="a b.rrd")
    ),
    JudgedTrial(trial(mode="realtime"), outcome(LOST, "hung: it was ended after 1.0 s", wall_s=4.0)),
    JudgedTrial(trial("push force_x_n"), outcome(REFUSED, "no such plant")),
    JudgedTrial(trial("push force_x_n"), outcome(ENDED, "line lost")),
]


def test_verdicts_are_in_the_table_on_the_page_and_in_the_json() -> None:
    page = results(asked(), JUDGED)
    assert (page.verdict, page.passed) == ("1 of 5 runs are as they should be, 5 s of runs", False)
    (table,) = page.tables
    assert list(table.rows[1:]) == [
        ("drop command", "memory:", "yes", "re-arms", "3 0", "2", "0.25 rad/s", "1.3", "ok"),
        ("drop command", "serial:pty", "no", "ends", "3 0", "2", "0.25 rad/s", "0.0", "unsafe"),
        ("drop command", "memory:, real time", "yes", "-", "-", "-", "-", "4.0", "hung"),
        ("push force_x_n", "memory:", "yes", "-", "-", "-", "-", "0.0", "refused"),
        ("push force_x_n", "memory:", "yes", "-", "-", "-", "-", "0.0", "refused"),
    ]
    assert page.about == [
        "  drop command over serial:pty: unsafe: it drove (hil view 'a b.rrd')",
        "  drop command over memory:: hung: it was ended after 1.0 s",
        "  push force_x_n over memory:: refused: no such plant",
        "  push force_x_n over memory:: refused: line lost",
    ]
    runs = page.plain["runs"]
    assert runs[1] == {
        "fault": "drop command",
        "link": "serial:pty",
        "mode": "lockstep",
        "rearm": False,
        "verdict": "unsafe: it drove",
        "outcome": "ends",
        "applied": [3, 0],
        "recoveries": 2,
        "silent_rad_s": 0.25,
        "silent_ticks": 900,
        "wall_s": 0.0,
        "recording": "a b.rrd",
    }
    assert (runs[2]["outcome"], runs[2]["silent_rad_s"]) == (None, None)
    assert results(asked(), JUDGED[:1]).passed


def test_the_picture_counts_outcomes_of_each_link() -> None:
    (plot,) = results(asked(), [*JUDGED, JUDGED[0]]).plots
    axes = list(matplotlib.figure.Figure().subplots(1, 1, squeeze=False).flat)
    plot.draw(axes)
    links = [label.get_text() for label in axes[0].get_xticklabels()]
    assert links == ["memory:", "serial:pty", "memory:, real time"]
    counts = {bars.get_label(): [bar.get_height() for bar in bars] for bars in axes[0].containers}
    assert counts == {
        "re-arms": [2, 0, 0],
        "ends": [0, 1, 0],
        "lost": [0, 0, 1],
        "refused": [1, 0, 0],
        "ended": [1, 0, 0],
    }
    for bars, tick in zip(zip(*axes[0].containers, strict=True), axes[0].get_xticks(), strict=True):
        middles = [bar.get_x() + bar.get_width() / 2.0 for bar in bars]
        assert np.mean(middles) == pytest.approx(tick), "its name is below the middle of a link's bars"
        assert np.diff(middles) == pytest.approx([0.16] * 4)


# What makes a trial wrong


def result(
    failure: str | None = None, exit_code: int = 0, recoveries: tuple[str, ...] = (), **metrics: Any
) -> RunResult:
    usual: dict[str, Any] = {"commands_refused": 0, "mode": "lockstep", "allow": [], "fault": [], "ticks": 3}
    usual |= {"recoveries": [{"why": why} for why in recoveries]} | metrics
    signals = {"loop.t_s": np.array([0.0, 0.5, 1.0])}
    error = None if failure is None else LinkError(failure)
    return cast("RunResult", SimpleNamespace(metrics=usual, failure=error, exit_code=exit_code, signals=signals))


def row(text: str, applied: int, start_s: float = 0.2) -> dict[str, Any]:
    return {"text": text, "applied": applied, "start_s": start_s, "passed": applied > 0}


OTHERWISE = "expected goes on or ends, but it"
LOST_FOR = "the robot was lost, but not for a cause"
HINT = "set loop.rearm = true"


@pytest.mark.parametrize(
    ("options", "run", "wrong"),
    [
        ({}, result(recoveries=("a cause so",), fault=[row("one", 1)], allow=[row("stale", 1)]), []),
        ({}, result(), ["expected re-arms, but it goes on"]),
        ({"allowed": ["goes on"]}, result(), []),
        (
            {"allowed": ["goes on", "ends"]},
            result(recoveries=("another",)),
            ["expected goes on or ends, but it re-arms"],
        ),
        (
            {},
            result(recoveries=("no cause", "another")),
            ["the robot was lost, but not for a cause or another: no cause"],
        ),
        ({"causes": []}, result(recoveries=("why",)), ["the robot was lost, but not for any fault: why"]),
        ({}, result(recoveries=("a cause",), commands_refused=2), ["the law gave no number 2 times"]),
        ({}, result(recoveries=("a cause",), allow=[row("stale_ticks: 9 of 3", 0)]), ["stale_ticks: 9 of 3"]),
        ({}, result(recoveries=("a cause",), allow=[row("stale", 0)], mode="realtime"), []),
        ({}, result(recoveries=("a cause",), fault=[row("mute", 0, 9.0)]), ["mute was never applied"]),
        ({"allowed": ["ends"]}, result("its end", 3, fault=[row("mute", 0, 0.9)]), ["mute was never applied"]),
        ({"allowed": ["ends"]}, result("its end", 3, fault=[row("mute", 0, 1.0)]), []),
        ({"allowed": ["ends"]}, result("its end", 3, commands_refused=1, allow=[row("stale", 0)]), []),
        ({}, result("its end", 3), ["expected re-arms, but it ends", "its end"]),
        ({"allowed": ["ends"]}, result("its end", 4), ["expected ends, but it exit code 4", "its end"]),
        (
            {"allowed": ["ends"]},
            result("a cause", 3, ("no cause",)),
            [
                "the robot was lost, but not for a cause or another: no cause",
                "the robot was lost, but not for its end: a cause",
            ],
        ),
        ({"allowed": ["ends"], "rearm": False}, result(f"its end; {HINT}", 3), []),
        (
            {"allowed": ["ends"], "rearm": False},
            result("its end", 3),
            ["it ended without the word that loop.rearm would help: its end"],
        ),
    ],
)
def test_what_is_wrong_with_a_trial_is_told(options: dict[str, Any], run: RunResult, wrong: list[str]) -> None:
    asked_for = {"allowed": ["re-arms"], "causes": ["a cause", "another"], "causes_of_end": ["its end"], "rearm": True}
    assert list(_wrong(asked_for | options, run)) == wrong


def test_a_run_goes_on_comes_back_or_ends_with_its_exit_code() -> None:
    assert _ending(result()) == "goes on"
    assert _ending(result(recoveries=("so",))) == "re-arms"
    assert _ending(result("so", 3, ("so",))) == "ends"
    assert _ending(result("so", 5)) == "exit code 5"
