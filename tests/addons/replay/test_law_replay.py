"""Replay: a run's law gives the same output again; another law gives its own, and is labelled so."""

import json
from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.addons.replay import law_replay as replayer
from hil.addons.replay.law_replay import replay
from hil.core.errors import BadInputError, OverdueError
from hil.core.types import WHEEL_NAMES
from hil.record.reader import read
from tests.runtime.test_tick_watch import LOOP, law
from tests.support import processes

SHORT = {"loop.duration_s": 0.5, "loop.rate_hz": 200, "expect": []}
DELAYED = {"link.command_latency_s": 0.003, "link.feedback_latency_s": 0.007}


def changed(run, key, value):
    """The run's properties with another value in its scenario."""
    scenario = json.loads(run.properties["scenario"]) | {key: value}
    return {"properties": run.properties | {"scenario": json.dumps(scenario)}}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run by torque, under latency and with old feedback for a while."""
    path = tmp_path_factory.mktemp("replay") / "run.rrd"
    fault = [{"kind": "drop", "target": "feedback", "start_s": 0.2, "end_s": 0.35, "value": 1.0}]
    keys = {"fault": fault, "firmware.watchdog_s": 0.05}
    result = hil.run("paper_circle", set=SHORT | DELAYED | keys, record=path)
    assert result.metrics["failure"] is None
    assert result.metrics["stale_ticks"] > 0
    return read(path)


@pytest.fixture(scope="module")
def by_speed(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "speed.rrd"
    hil.run("circle_speed", set=SHORT, record=path)
    return read(path)


def test_the_law_that_made_the_run_says_the_same_again(recorded, monkeypatch):
    monkeypatch.setattr(replayer, "_ROWS_AT_ONCE", 7)  # as of a long recording
    replayed = replay(recorded, "afdsc")
    assert replayed.asked < len(recorded.signals["loop.t_s"]) == 100
    for one in replayed.differences.values():
        assert one.max < 1e-12  # a recording holds doubles; only the latency went through a unit
        assert one.recorded_rms > 0.1


def test_a_law_that_never_returns_ends_the_replay_with_its_time_and_line(by_speed, tmp_path):
    limited = replace(by_speed, **changed(by_speed, "loop.tick_limit_s", 0.1))
    with pytest.raises(OverdueError, match=r"the tick at t = 0\.095 s did not end within 0\.1 s .*stuck_law\.py"):
        replay(limited, law(tmp_path, LOOP))


def test_so_does_the_law_of_a_run_by_speed_with_its_feedforward(by_speed):
    replayed = replay(by_speed, by_speed.properties["law"])
    assert len(replayed.differences) == 8
    assert max(one.max for one in replayed.differences.values()) < 1e-12


def test_a_run_that_lost_its_link_is_replayed_from_where_the_law_began_anew(tmp_path):
    record = tmp_path / "lost.rrd"
    fault = [{"kind": "disconnect", "target": "link", "start_s": 0.2, "end_s": 0.25}]
    keys = SHORT | {"loop.duration_s": 1.0, "loop.rearm": True, "fault": fault, "controller.law": "dsc_eso"}
    result = hil.run("paper_circle", set=keys, record=record)
    assert result.metrics["recoveries"]
    run = read(record)
    replayed = replay(run, "dsc_eso")
    assert replayed.asked < len(run.signals["loop.t_s"])
    assert max(one.max for one in replayed.differences.values()) < 1e-12


def test_given_gains_go_over_the_recorded_ones_and_the_figures_are_what_they_say(recorded):
    replayed = replay(recorded, "afdsc,filter_s=0.02")
    assert replayed.gains["filter_s"] == 0.02
    name = "wheel.fr.torque_command_n_m"
    apart = replayed.commands[name] - recorded.signals[name]
    asked = np.isfinite(replayed.commands[name])
    one = replayed.differences[name]
    assert one.rms == pytest.approx(np.sqrt(np.mean(apart[asked] ** 2)))
    assert one.max == np.nanmax(np.abs(apart))
    assert recorded.signals["loop.t_s"][np.nanargmax(np.abs(apart))] == one.max_s


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("dcs", "--law = 'dcs': unknown"),
        ("dsc,k1=3", "unknown key --law dsc.k1; did you mean 'k1_1_s'?"),
        ("dsc,k1_1_s", "--law dsc,k1_1_s: 'k1_1_s' is not a gain; expected key=value, as in dsc,k1_1_s=8"),
        ("./no.py:Law", "no file"),
    ],
)
def test_a_bad_law_is_refused_in_one_sentence(recorded, law, message):
    with pytest.raises(BadInputError) as refusal:
        replay(recorded, law)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_law_that_refuses_the_mode_of_the_recording_is_refused(by_speed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "only.py").write_text(
        "from hil.core.errors import BadInputError\nfrom hil.core.types import CommandMode\n"
        "class Torque:\n    def __init__(self, model, mode):\n"
        "        if mode is not CommandMode.TORQUE: raise BadInputError('it has no speed mode')\n"
        "    def reset(self, state, reference): pass\n"
        "    def update(self, reference, state, applied, dt_s): pass\n",
        encoding="utf-8",
    )
    with pytest.raises(BadInputError, match="no speed mode"):
        replay(by_speed, "./only.py:Torque")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda run: {"signals": {k: v for k, v in run.signals.items() if k != "reference.ax_m_s2"}},
            "run.rrd: it has no signal 'reference.ax_m_s2', which a law needs; record the run again",
        ),
        (lambda run: {"properties": {}}, "it does not hold the scenario of its run"),
        (lambda run: {"properties": {"scenario": "[]"}}, "it does not hold the scenario of its run"),
        (lambda run: changed(run, "controller.command", "banana"), "it does not hold the scenario of its run"),
        (lambda run: changed(run, "loop.rate_hz", 0), "loop.rate_hz and firmware.watchdog_s are more than 0"),
        (lambda run: changed(run, "firmware.watchdog_s", 0.0), "loop.rate_hz and firmware.watchdog_s are more than 0"),
        (lambda run: changed(run, "robot.wings_m", 1.0), "or that of another version"),
        (lambda run: changed(run, "robot.mass_kg", "heavy"), "or that of another version"),
        (lambda run: {"signals": {k: v[:0] for k, v in run.signals.items()}}, "the law was called in no tick"),
    ],
)
def test_a_recording_that_cannot_be_replayed_is_refused_in_one_sentence(recorded, change, message):
    with pytest.raises(BadInputError) as refusal:
        replay(replace(recorded, **change(recorded)), "dsc")
    assert message in str(refusal.value)


def test_the_command_prints_a_table_and_json_and_says_open_loop(recorded):
    command = ("replay", recorded.path, "--law", "dsc,k1_1_s=9")
    assert processes.hil(*command).stdout.count("open loop") == 2
    figures = json.loads(processes.hil(*command, "--json").stdout)
    assert figures["open_loop"] is True
    assert figures["label"] == "open loop: computed afterwards from the recorded states; it never drove the robot"
    assert figures["gains"] == {"k1_1_s": 9}
    assert set(figures["difference"]) == {f"wheel.{wheel}.torque_command_n_m" for wheel in WHEEL_NAMES}
    bad = processes.hil("replay", recorded.path.parent, "--law", "dsc")
    assert bad.returncode == 2
    assert bad.stderr.count("\n") == 1
