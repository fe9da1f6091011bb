"""Shadows: computed beside the law in command, from the same inputs, never sent, and never the end of a run."""

import json

import numpy as np
import pytest

import hil
from hil.cli.review import review as review_command
from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.judge.shadows import shadow_differences
from hil.laws.registry import SHIPPED
from hil.review import read, review
from hil.runtime.assembly import run_scenario
from hil.runtime.options import RunOptions
from hil.scenario import load

SHORT = {"loop.duration_s": 0.5, "loop.rate_hz": 200, "expect": []}
BROKEN = """
from hil.core.types import WheelCommand, ZERO_WHEELS

class Broken:
    def __init__(self, model, mode):
        self.mode = mode
        self.left = 20

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        self.left -= 1
        1 / self.left
        return WheelCommand(self.mode, ZERO_WHEELS, ZERO_WHEELS)
"""


def run(scenario="paper_circle", **keys):
    return hil.run(scenario, set=SHORT | {key.replace("__", "."): value for key, value in keys.items()})


def commands(result, prefix="", quantity="torque_command_n_m"):
    return np.array([result.signals[f"{prefix}wheel.{wheel}.{quantity}"] for wheel in WHEEL_NAMES])


@pytest.mark.parametrize(
    ("scenario", "quantity"), [("paper_circle", "torque_command_n_m"), ("circle_speed", "speed_command_rad_s")]
)
def test_the_law_in_command_as_its_own_shadow_says_the_same(scenario, quantity):
    """Bit for bit: it hears the same reference, state and applied command, and passes a guard of the same limits."""
    shown = load(scenario).controller
    result = run(scenario, controller__shadow=[shown.law], controller__shadow_gains={shown.law: dict(shown.gains)})
    shadow = commands(result, f"shadow.{shown.law}.", quantity)
    assert np.abs(shadow).max() > 0.1
    assert np.array_equal(shadow, commands(result, quantity=quantity))
    for difference in shadow_differences(result.signals)[shown.law].values():
        assert (difference.rms, difference.max) == (0.0, 0.0)


def test_the_difference_of_a_shadow_is_over_the_ticks_that_have_both_commands():
    signals = dict(run(controller__shadow=["profile", "dsc"]).signals)
    command, shadow = "wheel.fl.torque_command_n_m", "shadow.profile.wheel.fl.torque_command_n_m"
    signals[shadow] = np.where(np.arange(len(signals[shadow])) < 10, np.nan, signals[shadow])
    found = shadow_differences(signals)
    assert list(found) == ["profile", "dsc"]
    apart = signals[shadow][10:] - signals[command][10:]
    assert found["profile"][command].rms == pytest.approx(np.sqrt(np.mean(apart**2)))
    assert found["profile"][command].max == np.abs(apart).max() > 0.0
    assert found["profile"][command].max_s == signals["loop.t_s"][10:][np.abs(apart).argmax()]


def test_shadows_do_not_move_the_robot():
    alone = run()
    shadowed = run(controller__shadow=[law for law in SHIPPED if law != "afdsc"])
    assert alone.metrics["wire_sha256"] == shadowed.metrics["wire_sha256"]
    assert [row["asked"] for row in shadowed.metrics["shadows"]] == [100] * (len(SHIPPED) - 1)
    assert np.isfinite(commands(shadowed, "shadow.profile.")).all()


def test_a_shadow_has_gains_of_its_own():
    result = run(controller__shadow=["dsc"], controller__shadow_gains={"dsc": {"k1_1_s": 1.0}})
    other = run(controller__shadow=["dsc"])
    assert not np.allclose(commands(result, "shadow.dsc."), commands(other, "shadow.dsc."))


def test_a_shadow_that_raises_is_dropped_with_a_sentence_and_the_run_goes_on(tmp_path):
    path = tmp_path / "broken.py"
    path.write_text(BROKEN, encoding="utf-8")
    record = tmp_path / "run.mcap"
    shadows = {"controller.shadow": ["dsc", f"{path}:Broken"]}
    result = hil.run("paper_circle", set=SHORT | shadows, record=record)
    assert result.passed
    dsc, broken = result.metrics["shadows"]
    assert dsc["dropped"] is None
    assert broken["asked"] == 19
    assert broken["dropped"].startswith("shadow Broken dropped at t = 0.095 s: controller.shadow.2 = ")
    assert broken["dropped"].endswith(
        f"update failed at {path}:14 (1 / self.left): ZeroDivisionError: division by zero"
    )
    assert np.isnan(commands(result, "shadow.Broken.")[0]).tolist() == [False] * 19 + [True] * 81
    assert np.isfinite(commands(result, "shadow.dsc.")).all()
    told = [event for event in read(record).events if event.text == broken["dropped"]]
    assert [(event.level, event.t_s) for event in told] == [("WARN", 0.095)]


def test_a_shadow_is_not_asked_while_the_law_in_command_is_not():
    """Old feedback holds the robot at rest; then both go on."""
    fault = [{"kind": "drop", "target": "feedback", "start_s": 0.2, "end_s": 0.35, "value": 1.0}]
    result = run("circle_speed", controller__shadow=["dsc"], fault=fault, firmware__watchdog_s=0.05)
    held = result.signals["guard.held"] == 1.0
    assert 0 < held.sum() < 30
    assert held.sum() == result.metrics["stale_ticks"]
    shadow = commands(result, "shadow.dsc.", "speed_command_rad_s")
    assert np.array_equal(np.isnan(shadow).all(axis=0), held)
    assert result.metrics["shadows"][0]["asked"] == (~held).sum()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"controller.shadow": ["dcs"]}, "controller.shadow.1 = 'dcs': unknown"),
        ({"controller.shadow": ["pid", "pid"]}, "expected one law of the name 'pid'"),
        ({"controller.shadow_gains.dsc": {"k1_1_s": 1.0}}, "no shadow has this name"),
        (
            {"controller.shadow": ["dsc"], "controller.shadow_gains.dsc": {"k1": 1.0}},
            "unknown key controller.shadow_gains.dsc.k1; did you mean 'controller.shadow_gains.dsc.k1_1_s'?",
        ),
        ({"controller.shadow": ["./no.py:Law"]}, "no file"),
        ({"controller.shadow": "dsc"}, "controller.shadow = "),
    ],
)
def test_bad_shadows_are_refused_before_the_run(keys, message):
    with pytest.raises(BadInputError) as refusal:
        hil.run("paper_circle", set=SHORT | keys)
    assert message in str(refusal.value)


def test_another_law_keeps_the_shadows_and_a_path_starts_from_its_own_file(tmp_path, monkeypatch):
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "base.toml").write_text(
        'extends = "paper_circle"\n[controller]\nshadow = ["dsc", "./mine.py:Broken"]\n', encoding="utf-8"
    )
    (tmp_path / "top.toml").write_text('extends = "laws/base.toml"\n[controller]\nlaw = "pid"\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    controller = load("top.toml").controller
    assert controller.law == "pid"
    assert controller.shadow == ("dsc", f"{tmp_path / 'laws' / 'mine.py'}:Broken")


@pytest.mark.parametrize("suffix", [".rrd", ".mcap"])
def test_how_far_a_shadow_is_from_the_command_is_in_the_run_its_review_and_their_text(tmp_path, suffix, capsys):
    path = tmp_path / f"run{suffix}"
    result = hil.run("paper_circle", set=SHORT | {"controller.shadow": ["dsc"]}, record=path)
    (row,) = result.metrics["shadows"]
    t_s = result.signals["loop.t_s"]
    for wheel in WHEEL_NAMES:
        name = f"wheel.{wheel}.torque_command_n_m"
        apart = np.abs(result.signals[f"shadow.dsc.{name}"] - result.signals[name])
        found = row["difference"][name]
        assert found["rms"] == pytest.approx(np.sqrt(np.mean(apart**2)))
        assert (found["max"], found["max_s"]) == (apart.max(), t_s[apart.argmax()])
    assert review(path)["shadows"] == [row]
    (line,) = [line for line in result.lines() if line.startswith("  shadow dsc ")]
    assert f"apart from the command by FL {row['difference']['wheel.fl.torque_command_n_m']['rms']:.3g}" in line
    review_command([path], as_json=True)
    assert json.loads(capsys.readouterr().out)["shadows"] == [row]


def test_a_run_that_keeps_no_rows_says_it_too():
    kept = run(controller__shadow=["dsc"])
    bare = run_scenario(kept.scenario, RunOptions(keep_signals=False))
    assert bare.metrics["shadows"] == kept.metrics["shadows"]
