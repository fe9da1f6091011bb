"""The row of a tick: each value stands under the name of its signal."""

from types import SimpleNamespace

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.core.signals import SIGNAL_NAMES, EstimatorSignals, LoopSignals
from hil.core.types import (
    WHEEL_NAMES,
    Acceleration,
    Applied,
    CommandMode,
    Gains,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.robot.snapshot import Feedback
from hil.runtime.row import RowWriter

LATENCY_NS = 3_000_000


def four(base: float) -> Wheels:
    return Wheels(*(base + place for place in range(4)))


def test_every_value_of_a_row_stands_under_its_signals_name() -> None:
    loop = LoopSignals(1.0, 100, 2.0, 3.0, 4.0)
    reference = Reference(Pose(10, 11, 0.12), Twist(13, 14, 15), Acceleration(16, 17, 18))
    state = State(Pose(20, 21, 22), Twist(23, 24, 25))
    fix = PoseFix(0, Pose(13.0, 15.0, 0.5), Twist(0, 0, 0))
    feedback = Feedback(
        robot_time_ns=40_000_000_000,
        state=RobotState.ACTIVE,
        command_sequence=0,
        command_age_ms=42,
        encoder_count=None,
        speed_rad_s=four(50),
        current_a=four(60),
        acceleration_m_s2=(70.0, 71.0, 72.0),
        yaw_rate_rad_s=73.0,
    )
    estimator = EstimatorSignals(*range(180, 194))
    gains = Gains(*range(90, 90 + len(Gains._fields)))
    applied = Applied(WheelCommand(CommandMode.SPEED, four(100), four(110)), True, 0.12)
    device = SimpleNamespace(
        report=SimpleNamespace(health=(120.0, 121.0, four(122))),
        link_figures=lambda: (130, 131, 134, 138.0),
        rejected=lambda: {"one": 132, "other": 1},
        clock_sync=SimpleNamespace(offset_us=140.0, drift_ppm=141.0),
    )
    wire = SimpleNamespace(byte_counts=lambda: (135, 136), load_percent=lambda _: 137.0, is_timed=True)
    extra = SimpleNamespace(signals=("one", "other"), telemetry=(150.0, 151.0))
    rows: list[bytes] = []
    writer = RowWriter(
        (*SIGNAL_NAMES, *extra.signals),
        device,
        wire,
        SimpleNamespace(gains=gains),
        CommandMode.SPEED,
        [extra],
        [SimpleNamespace(put=rows.append)],
        LATENCY_NS,
    )
    writer.write(loop, feedback, 2_000_000, fix, state, reference, applied, estimator, False)
    expected = {
        **{f"loop.{name}": value for name, value in loop._asdict().items()},
        **{
            f"reference.{name}": value
            for part, names in (
                (reference.pose, ("x_m", "y_m", "heading_rad")),
                (reference.twist, ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")),
                (reference.acceleration, ("ax_m_s2", "ay_m_s2", "yaw_acceleration_rad_s2")),
            )
            for name, value in zip(names, part, strict=True)
        },
        **{f"pose.{name}": value for name, value in state.pose._asdict().items()},
        **{f"twist.{name}": value for name, value in state.twist._asdict().items()},
        **{f"truth.{name}": value for name, value in fix.pose._asdict().items()},
        "error.x_m": 3.0,
        "error.y_m": 4.0,
        "error.heading_rad": 0.38,
        "error.planar_m": 5.0,
        **{f"gain.{name}": value for name, value in gains._asdict().items()},
        **{
            f"wheel.{wheel}.{name}": base + place
            for name, base in (
                ("speed_rad_s", 50),
                ("speed_command_rad_s", 100),
                ("torque_command_n_m", 110),
                ("current_a", 60),
                ("temperature_degc", 122),
            )
            for place, wheel in enumerate(WHEEL_NAMES)
        },
        "robot.time_s": 40.0,
        "robot.state": RobotState.ACTIVE,
        "robot.command_age_ms": 42,
        "robot.yaw_rate_rad_s": 73.0,
        "battery.voltage_v": 120.0,
        "battery.current_a": 121.0,
        **{f"robot.acceleration_{axis}_m_s2": 70.0 + place for place, axis in enumerate("xyz")},
        **{f"estimator.{name}": value for name, value in estimator._asdict().items()},
        "guard.saturated": 1.0,
        "guard.held": 0.0,
        "link.sent": 130,
        "link.received": 131,
        "link.rejected": 133,
        "link.feedback_age_ms": 5.0,
        "link.lost": 134,
        "link.sent_bytes": 135,
        "link.received_bytes": 136,
        "link.load_percent": 137.0,
        "link.rtt_ms": 138.0,
        "link.latency_ms": 120.0,
        "link.clock_offset_us": 140.0,
        "link.clock_drift_ppm": 141.0,
    }
    (packed,) = rows
    row = memoryview(packed).cast("d").tolist()
    assert sorted(expected) == sorted(SIGNAL_NAMES)
    assert dict(zip(SIGNAL_NAMES, row[:-2], strict=True)) == pytest.approx(expected)
    assert row[-2:] == list(extra.telemetry)
