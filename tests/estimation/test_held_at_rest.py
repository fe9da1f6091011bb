"""When the loop holds the robot instead of driving it: what it drives by is old, is no number, or is not known."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hil
from firmware_protocol.extension import library
from hil.core.signals import LoopSignals
from hil.core.types import WHEEL_NAMES, Pose, PoseFix, State
from hil.estimation.estimators import TruthEstimator
from hil.robot.link_times import CommandLatency
from hil.runtime.sampling import Sampling

PERIOD_S = 0.005
PATIENCE_S = 0.1  # of the firmware: [firmware] watchdog_s


def run(scenario: str = "circle_speed", *, fault: dict[str, Any] | None = None, **changes: Any) -> hil.RunResult:
    """Run 0.6 s at 200 Hz unless told otherwise; ``loop__seed`` is ``loop.seed``."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    base = {"loop.rate_hz": 200, "loop.duration_s": 0.6, "expect": [], "firmware.watchdog_s": PATIENCE_S}
    faults = {} if fault is None else {"fault": [fault]}
    return hil.run(scenario, set=base | faults | keys)


def commands(result: hil.RunResult, quantity: str = "speed_command_rad_s") -> np.ndarray:
    """Return what was commanded, one row a tick."""
    return np.array([result.signals[f"wheel.{wheel}.{quantity}"] for wheel in WHEEL_NAMES]).T


def truth_with(monkeypatch: pytest.MonkeyPatch, changed: Callable[[float, PoseFix], PoseFix]) -> None:
    """Let the truth fail as a plant may and no fault of a scenario does: ``changed`` is told t and the fix."""
    right = Sampling.fix_of

    def fix_of(sampling: Sampling, number: int) -> PoseFix | None:
        fix = right(sampling, number)
        return None if fix is None else changed(number * PERIOD_S, fix)

    monkeypatch.setattr(Sampling, "fix_of", fix_of)


@pytest.mark.parametrize("field", Pose._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_truth_that_is_no_number_any_more_drives_no_longer_than_one_that_stopped(field, value, monkeypatch):
    def changed(t_s: float, fix: PoseFix) -> PoseFix:
        return fix._replace(pose=fix.pose._replace(**{field: value})) if 0.2 <= t_s < 0.5 else fix

    truth_with(monkeypatch, changed)
    result = run()
    t_s = result.signals["loop.t_s"]
    held = (t_s > 0.195 + PATIENCE_S + 1e-9) & (t_s < 0.5 - 1e-9)
    assert not commands(result)[held].any()
    assert commands(result)[~held].any(axis=1).all()
    assert result.metrics["stale_ticks"] == held.sum() == 40


RESET = {"kind": "reset", "target": "robot", "start_s": 0.1}


@pytest.mark.parametrize("frozen_s", [0.8, 0.2])  # the robot is back at 0.4 s: after that, and while it is away
def test_a_truth_that_stops_is_noticed_after_a_reset_too(frozen_s, monkeypatch):
    """The robot's clock began anew and the truth's did not: one is not simply behind the other any more."""
    last: list[PoseFix] = []

    def changed(t_s: float, fix: PoseFix) -> PoseFix:
        if t_s < frozen_s or not last:
            last[:] = [fix]
        return last[0]

    truth_with(monkeypatch, changed)
    result = run(fault=RESET, loop__rearm=True, loop__duration_s=1.2)
    (recovery,) = result.metrics["recoveries"]
    t_s = result.signals["loop.t_s"]
    held_s = max(frozen_s, recovery["armed_s"]) + PATIENCE_S
    drives = (t_s > recovery["armed_s"]) & (t_s < held_s - PERIOD_S)
    assert commands(result)[drives].any(axis=1).all()
    assert not commands(result)[t_s > held_s + PERIOD_S].any()


@pytest.mark.alone
def test_after_a_reset_the_latency_is_measured_by_the_truth_as_before(monkeypatch):
    restart = CommandLatency.restart

    def forgetful(meter: CommandLatency) -> None:
        restart(meter)
        library()[0].cast("wheel_latency *", meter.address).median_s = 0.077

    monkeypatch.setattr(CommandLatency, "restart", forgetful)
    found = run(fault=RESET, loop__rearm=True, loop__duration_s=0.9, loop__mode="realtime").signals["link.latency_ms"]
    assert 77.0 in found
    assert found[-1] != 77.0


COUNTING = """
from hil.core.types import NO_GAINS, ZERO_WHEELS, WheelCommand

class Counting:
    gains = NO_GAINS
    signals = ("counting.resets",)

    def __init__(self, model, mode):
        self.rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self.resets = 0

    @property
    def telemetry(self):
        return (float(self.resets),)

    def reset(self, state, reference):
        self.resets += 1

    def update(self, reference, state, applied, dt_s):
        assert sum(state.pose) + sum(state.twist) < 1e9
        return self.rest
"""


@pytest.fixture
def counting(tmp_path):
    """A law that counts how often it begins, and raises for a state that is no number."""
    (tmp_path / "counting.py").write_text(COUNTING, encoding="utf-8")
    return {"controller.law": f"{tmp_path / 'counting.py'}:Counting", "controller.gains": {}}


def test_after_a_hold_the_law_begins_anew(counting):
    silence = {"kind": "drop", "target": "feedback", "start_s": 0.2, "end_s": 0.4, "value": 1.0}
    result = run(fault=silence, **counting)
    begun, held = result.signals["counting.resets"], result.signals["guard.held"] == 1.0
    assert 0 < held.sum() < 40
    first = int(np.flatnonzero(held)[0])
    assert set(begun[:first]) == {1.0}
    assert set(begun[first + held.sum() :]) == {2.0}


@pytest.mark.parametrize(("skipped", "resets"), [(18, 1), (20, 2)])
def test_after_a_stall_longer_than_the_firmwares_patience_the_law_begins_anew(counting, monkeypatch, skipped, resets):
    """As when the whole machine stood still, robot and all: no law integrates over it."""

    def later(t_s, tick, *rest):
        return LoopSignals(t_s, tick if tick < 60 else tick + skipped, *rest)

    monkeypatch.setattr("hil.runtime.loop.make_loop_signals", later)
    result = run(**counting)
    assert set(result.signals["counting.resets"]) == set(range(1, resets + 1))
    assert not result.signals["guard.held"].any()


def test_in_torque_mode_a_robot_that_is_held_is_braked_to_rest_within_a_second():
    """Lost at 1.2 m/s, with the latency of the speed runs; zero torque would let it roll."""
    lost = {
        "estimator__source": "fused",
        "estimator__filter__lost_sigma_m": 0.05,
        "estimator__filter__wheels_sigma_m": 0.1,
        "estimator__simulated_fix__gap_start_s": 0.3,
        "estimator__simulated_fix__gap_end_s": 9.0,
    }
    result = run("circle_speed", controller__command="torque", loop__duration_s=3.0, **lost)
    t_s, held = result.signals["loop.t_s"], result.signals["guard.held"] == 1.0
    speed_m_s = np.hypot(*(np.gradient(result.signals[f"truth.{axis}"], PERIOD_S) for axis in ("x_m", "y_m")))
    first_s = t_s[held][0]
    assert speed_m_s[held][0] > 0.5
    after = t_s > first_s + 0.9
    assert held[after].all()
    assert speed_m_s[after].max() < 0.01
    assert np.abs(commands(result, "torque_command_n_m")[after]).max() < 0.05


def test_a_state_that_is_no_number_reaches_no_law(counting, monkeypatch):
    """The law raises for one, which would end the run."""
    update = TruthEstimator.update
    calls: list[int] = []

    def flawed(estimator: TruthEstimator, *measured: Any) -> State | None:
        state = update(estimator, *measured)
        calls.append(1)
        if state is None or not 40 <= len(calls) < 50:
            return state
        return state._replace(twist=state.twist._replace(yaw_rate_rad_s=math.nan))

    monkeypatch.setattr(TruthEstimator, "update", flawed)
    result = run(**counting)
    assert result.failure is None
    assert (result.signals["guard.held"] == 1.0).sum() == 10
