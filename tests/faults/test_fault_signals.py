"""Bias, override and reset: their place and order in the tick, and that the guard stays last."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.signals import INDEX, SIGNAL_NAMES, pack_row
from hil.core.types import CommandMode, WheelCommand, Wheels
from hil.faults.rows import NEVER_NS, FaultRow
from hil.runtime.signal_faults import SignalFaults
from tests.support.fault_runs import applied, run_with

COMMAND = "wheel.fl.speed_command_rad_s"
STEP = 5_000_000


def row(kind: str, start: int = 0, end: int = NEVER_NS, value: float = 0.0, target: str = COMMAND) -> FaultRow:
    return FaultRow(kind, "signal", target, start, end, value)


def passed(rows: list[FaultRow], t_ns: int, value: float = 1.0) -> tuple[float, list[int]]:
    """What becomes of a command in one tick, and the accounts."""
    faults = SignalFaults(rows)
    faults.at(t_ns)
    command = WheelCommand(CommandMode.SPEED, Wheels(value, 2.0, 3.0, 4.0), Wheels(0.0, 0.0, 0.0, 0.0))
    changed = faults.command(command)
    assert changed.speed_rad_s[1:] == command.speed_rad_s[1:]
    return changed.speed_rad_s.fl, faults.applied()


@pytest.mark.parametrize(
    ("rows", "t_ns", "expected"),
    [
        ([row("bias", 10, 20, 0.5)], 9, (1.0, [0])),
        ([row("bias", 10, 20, 0.5)], 10, (1.5, [1])),
        ([row("bias", 10, 20, 0.5)], 20, (1.0, [0])),
        ([row("bias", value=0.5), row("override", value=9.0)], 0, (9.0, [1, 1])),
        ([row("override", value=9.0), row("bias", value=0.5)], 0, (9.5, [1, 1])),
        ([row("override", value=1.0)], 0, (1.0, [0])),
        ([row("bias", value=0.5), row("reset", 10)], 9, (1.5, [1, 0])),
        ([row("bias", value=0.5), row("reset", 10)], 10, (1.0, [0, 1])),
        ([row("bias", value=0.5), row("override", 10, value=3.0), row("reset", 10)], 10, (3.0, [0, 1, 1])),
        ([row("bias", value=0.5), row("reset", 10, target="wheel.fr.speed_command_rad_s")], 10, (1.5, [1, 0])),
        ([row("bias", 0, 5, 0.5), row("reset", 10)], 10, (1.0, [0, 0])),
    ],
)
def test_rows_act_in_order_and_a_reset_ends_what_began_before(rows, t_ns, expected) -> None:
    assert passed(rows, t_ns) == expected


def test_a_bias_of_what_nothing_measures_is_not_applied_and_an_override_is() -> None:
    assert passed([row("bias", value=0.5)], 0, value=float("nan"))[1] == [0]
    assert passed([row("bias", value=0.5), row("override", value=9.0)], 0, value=float("nan")) == (9.0, [0, 1])


@given(st.sampled_from(SIGNAL_NAMES[1:]), st.floats(-1, 1))
def test_every_signal_has_a_place(signal, value) -> None:
    faults = SignalFaults([row("override", value=value, target=signal)])
    faults.at(0)
    recorded = memoryview(faults.recorded(pack_row(float("nan") for _ in SIGNAL_NAMES))).cast("d")
    changed = [name for name in SIGNAL_NAMES if recorded[INDEX[name]] == value]
    group = signal.split(".")[0]
    within_tick = group in ("truth", "pose", "twist", "reference", "robot") or (
        group == "wheel" and not signal.endswith("temperature_degc")
    )
    assert changed == ([] if within_tick else [signal])


@pytest.mark.parametrize(
    ("signal", "value", "reader"),
    [
        ("truth.x_m", 0.05, "pose.x_m"),
        ("pose.y_m", 0.05, "wheel.fl.speed_command_rad_s"),
        ("reference.x_m", 0.05, "error.x_m"),
        ("reference.x_m", 0.05, "wheel.fl.speed_command_rad_s"),
        ("wheel.rr.speed_command_rad_s", 0.5, "wheel.rr.speed_rad_s"),
        ("battery.voltage_v", -5.0, "battery.voltage_v"),
        ("link.sent", 100.0, "link.sent"),
        ("gain.k1_x_1_s", 1.0, "gain.k1_x_1_s"),
    ],
)
def test_all_that_is_downstream_sees_it_and_nothing_before_the_window_does(tmp_path, signal, value, reader) -> None:
    clean = run_with(tmp_path, duration_s=0.4)
    result = run_with(
        tmp_path, {"kind": "bias", "target": signal, "start_s": 0.2, "end_s": 0.3, "value": value}, duration_s=0.4
    )
    t_s = result.signals["loop.t_s"]
    inside = (t_s >= 0.2 - 1e-9) & (t_s < 0.3 - 1e-9)
    if np.isnan(clean.signals[signal][inside]).any():  # the first value comes with 10 Hz, or never
        assert applied(result)[0] < inside.sum()
    else:
        assert applied(result) == [inside.sum()] == [20]
        difference = result.signals[reader] - clean.signals[reader]
        assert not difference[t_s < 0.2 - 1e-9].any()
        assert difference[inside].any()
    assert np.array_equal(result.signals["loop.t_s"], clean.signals["loop.t_s"])


def test_what_nothing_reads_changes_nothing_on_the_wire(tmp_path) -> None:
    clean = run_with(tmp_path, duration_s=0.2)
    result = run_with(tmp_path, {"kind": "override", "target": "error.planar_m", "value": 7.0}, duration_s=0.2)
    assert result.metrics["wire_sha256"] == clean.metrics["wire_sha256"]
    assert (result.signals["error.planar_m"] == 7.0).all()


def test_nothing_gets_round_the_guard(tmp_path) -> None:
    result = run_with(tmp_path, {"kind": "override", "target": COMMAND, "start_s": 0.1, "value": 1e9}, duration_s=0.2)
    limit = result.scenario.robot.speed_limit_rad_s
    speeds = np.stack([result.signals[f"wheel.{w}.speed_command_rad_s"] for w in ("fl", "fr", "rr", "rl")])
    assert np.abs(speeds).max() <= limit
    inside = result.signals["loop.t_s"] >= 0.1
    assert (result.signals["guard.saturated"][inside] == 1.0).all()
    assert applied(result) == [inside.sum()]


def test_a_state_that_the_sensors_lie_about_ends_the_run_as_the_real_one_would(tmp_path) -> None:
    fault = {"kind": "override", "target": "robot.state", "start_s": 0.1, "value": 5.0}
    result = run_with(tmp_path, fault, duration_s=0.2)
    assert result.exit_code == 3
    assert "t = 0.100 s" in str(result.failure)
