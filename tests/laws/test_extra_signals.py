"""Signals that a law brings: recorded behind the vocabulary, judged, changed by faults, refused when they are bad."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import CommandMode, State, Twist
from hil.laws.afdsc import Afdsc, FuzzyBlock, FuzzyGains, FuzzyLaw
from hil.laws.law_registry import make_controller, shipped_laws
from hil.record.reader import read
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.laws.test_afdsc_tables import memberships
from tests.support.closed_loop import AT_REST, PAPER_CIRCLE, PAPER_ROBOT, PAPER_START
from tests.support.processes import hil as hil_command

SHIPPED = shipped_laws()

SHORT = {"loop.duration_s": 0.5, "loop.rate_hz": 200, "expect": []}
LAW = """
from hil.core.types import CommandMode, WheelCommand, Wheels, ZERO_WHEELS

class Counting:
    signals = {signals}

    def __init__(self, model, mode):
        self.mode = mode
        self.count = 0

    @property
    def telemetry(self):
        return {telemetry}

    def reset(self, state, reference):
        self.count = 0

    def update(self, reference, state, applied, dt_s):
        self.count += 1
        return WheelCommand(self.mode, ZERO_WHEELS, ZERO_WHEELS)
"""


def counting(folder, signals='("mine.count",)', telemetry="(self.count,)") -> str:
    path = folder / "counting.py"
    path.write_text(LAW.format(signals=signals, telemetry=telemetry), encoding="utf-8")
    return f"{path}:Counting"


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_the_strongest_rule_is_the_product_of_the_largest_memberships(error, rate):
    """The place alone gives all memberships, so that nothing of the inference is lost."""
    gains = FuzzyGains(FuzzyBlock.from_tables("printed", 1.0, 1.0))
    assert all(map(math.isnan, gains.firing()))
    gains.at((error, rate))
    at_error, at_rate, rule, degree = gains.firing()
    of_error, of_rate = memberships(error), memberships(rate)
    row, column = divmod(int(rule), 5)
    assert degree == pytest.approx(max(of_error) * max(of_rate))
    assert of_rate[row] == pytest.approx(max(of_rate))
    assert of_error[column] == pytest.approx(max(of_error))
    assert memberships(at_error / 2) == pytest.approx(of_error)
    assert memberships(at_rate / 2) == pytest.approx(of_rate)


def test_firing_is_finite_for_every_input():
    gains = FuzzyGains(FuzzyBlock.from_tables("printed", 1.0, 1.0))
    gains.at((math.nan, math.inf))
    assert gains.firing() == (-2.0, 2.0, 20.0, 1.0)


def test_afdsc_tells_what_fires_and_nothing_before_it_was_asked():
    law = Afdsc(PAPER_ROBOT, CommandMode.TORQUE, Afdsc.Options())
    assert len(law.signals) == len(law.telemetry) == 12
    assert all(map(math.isnan, law.telemetry))
    state, reference = State(PAPER_START, Twist(0.0, 0.0, 0.0)), PAPER_CIRCLE.at(0.0)
    law.reset(state, reference)
    law.update(reference, state, AT_REST, 0.005)
    told = dict(zip(law.signals, law.telemetry, strict=True))
    assert told["fuzzy.x.error"] == pytest.approx(-2.0)  # 0.2 m behind, the whole range
    assert all(map(math.isfinite, told.values()))


@pytest.mark.parametrize("name", SHIPPED)
def test_own_signals_of_a_shipped_law_are_as_a_law_of_somebody_else_must_have_them(name):
    law = make_controller(name, Path(), PAPER_ROBOT, CommandMode.TORQUE, {})
    names = getattr(law, "signals", ())
    assert len(set(names)) == len(names)
    assert not {one.partition(".")[0] for one in names} & {one.partition(".")[0] for one in SIGNAL_NAMES}


def test_own_signals_are_in_the_run_and_its_recording_and_are_judged(tmp_path):
    record = tmp_path / "run.mcap"
    expect = [{"signal": "mine.count", "settles_to": 100, "tolerance": 0.5}]
    given_keys = SHORT | {"controller.law": counting(tmp_path), "expect": expect}
    result = hil.run("paper_circle", set=given_keys, record=record)
    assert result.passed
    assert tuple(result.signals) == (*SIGNAL_NAMES, "mine.count")
    assert list(result.signals["mine.count"]) == list(range(1, 101))
    assert np.array_equal(read(record).signals["mine.count"], result.signals["mine.count"])


def test_a_fault_changes_what_is_recorded_of_an_own_signal(tmp_path):
    fault = [{"kind": "bias", "target": "mine.count", "value": 1000.0, "start_s": 0.25}]
    result = hil.run("paper_circle", set=SHORT | {"controller.law": counting(tmp_path), "fault": fault})
    assert result.metrics["fault"][0]["applied"] == 50
    assert result.signals["mine.count"][-1] == 1100


def test_own_signals_are_asked_for_only_where_somebody_reads_them(tmp_path, monkeypatch):
    """They are read if recorded, kept, judged or spoilt by a fault; not in a run that keeps only figures."""
    asked = []
    monkeypatch.setattr(FuzzyLaw, "telemetry", property(lambda law: asked.append(law) or law._firing()))

    def ticks_asked(record=None, *, keep_signals=False, **more):
        asked.clear()
        scenario = load("paper_circle", mode="lockstep", link="memory:", set=SHORT | more)
        result = run_scenario(scenario, RunOptions(record=record, keep_signals=keep_signals))
        assert result.failure is None
        return len(asked), result.metrics

    degree = {"signal": "fuzzy.x.degree", "above": -1.0}
    fault = {"kind": "bias", "target": "fuzzy.x.degree", "value": 1.0, "start_s": 0.1, "end_s": 0.2}
    (nobody, alone), (all_read, kept) = ticks_asked(), ticks_asked(keep_signals=True)
    assert (nobody, all_read) == (0, 100)
    depends_on_the_wall_clock = {"realtime_factor", "tick_us"}
    assert {name: value for name, value in alone.items() if name not in depends_on_the_wall_clock} == {
        name: value for name, value in kept.items() if name not in depends_on_the_wall_clock
    }
    assert ticks_asked(tmp_path / "run.mcap")[0] == 100
    asked.clear()
    words = [f"--set={key}={value}" for key, value in SHORT.items()]
    assert hil_command("run", "paper_circle", "--record", "none", *words).returncode == 0
    assert asked == [], "the command keeps none, so that its memory does not grow"
    (judged, figures), (faulty, _) = ticks_asked(expect=[degree]), ticks_asked(fault=[fault])
    assert (judged, faulty) == (100, 100)
    assert figures["expect"][0]["passed"]


def test_signals_of_somebody_elses_law_are_asked_for_in_every_run_as_they_may_fail(tmp_path):
    law = counting(tmp_path, telemetry="(1.0 / (5 - self.count),)")
    scenario = load("paper_circle", mode="lockstep", link="memory:", set=SHORT | {"controller.law": law})
    result = run_scenario(scenario, RunOptions(keep_signals=False))
    assert result.exit_code == 2
    assert "telemetry" in str(result.failure)


def test_no_law_with_own_signals_leaves_the_vocabulary_alone():
    result = hil.run("paper_circle", set=SHORT | {"controller.law": "dsc"})
    assert tuple(result.signals) == SIGNAL_NAMES


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ({"expect": [{"signal": "fuzzy.x.rul", "below": 1}]}, "did you mean 'fuzzy.x.rule'?"),
        ({"expect": [{"signal": "fuzy.x.rule", "below": 1}]}, "did you mean 'fuzzy.x.rule'?"),
        ({"fault": [{"kind": "bias", "target": "fuzzy.x.rul", "value": 1}]}, "did you mean 'fuzzy.x.rule'?"),
        ({"fault": [{"kind": "bias", "target": "truth.x", "value": 1}]}, "did you mean 'truth.x_m'?"),
        ({"fault": [{"kind": "bias", "target": "loop.t_s", "value": 1}]}, "it is the time of the run"),
        ({"controller.law": "dsc", "expect": [{"signal": "fuzzy.x.rule", "below": 1}]}, "hil list signals"),
    ],
)
def test_a_signal_that_the_run_does_not_have_is_told_with_the_nearest_one(rows, message):
    with pytest.raises(BadInputError) as refusal:
        load("paper_circle", set=SHORT | rows)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("signals", "telemetry", "message"),
    [
        ('("count",)', "(1,)", "signals has 'count'; expected dotted names in lower case"),
        ('("wheel.count",)', "(1,)", "'wheel' is reserved, begin the name with another word"),
        ('("my.x", "my.x")', "(1, 2)", "'my.x' twice"),
        ('("my.x", "my.x.y")', "(1, 2)", "neither may be a group of the other"),
        ('("my.x.y", "my.x")', "(1, 2)", "neither may be a group of the other"),
        ('"my.x"', "(1,)", "expected a tuple of names"),
        ("None", "(1,)", "it has telemetry alone; signals of its own take signals and telemetry"),
    ],
)
def test_bad_names_are_refused_before_the_run(tmp_path, signals, telemetry, message):
    with pytest.raises(BadInputError) as refusal:
        hil.run("paper_circle", set=SHORT | {"controller.law": counting(tmp_path, signals, telemetry)})
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("telemetry", "message"),
    [
        ("(1, 2)", "telemetry has 2 values for 1 signals"),
        ("('a',)", "telemetry failed"),
        ("(1 / 0,)", "ZeroDivisionError"),
    ],
)
def test_bad_values_end_the_run_as_a_law_that_fails_does(tmp_path, telemetry, message):
    result = hil.run("paper_circle", set=SHORT | {"controller.law": counting(tmp_path, telemetry=telemetry)})
    assert result.exit_code == 2
    assert message in str(result.failure)
