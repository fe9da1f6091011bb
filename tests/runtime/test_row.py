"""The row of a tick: each value stands under the name of its signal."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.generated.messages import State as RobotState
from hil.core.signals import SIGNAL_NAMES, EstimatorSignals, LoopSignals
from hil.core.types import (
    WHEEL_NAMES,
    Acceleration,
    Applied,
    CommandMode,
    Gains,
    Guarded,
    Limit,
    Pose,
    PoseFix,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.robot.snapshot import Feedback
from hil.runtime.row import DIFFERENCE_SIGNALS, RowWriter

LATENCY_NS = 3_000_000


def four(base: float) -> Wheels:
    return Wheels(*(base + place for place in range(4)))


LOOP = LoopSignals(1.0, 100, 2.0, 3.0, 4.0)
REFERENCE = Reference(Pose(10, 11, 0.12), Twist(13, 14, 15), Acceleration(16, 17, 18))
STATE = State(Pose(20, 21, 22), Twist(23, 24, 25))
FIX = PoseFix(0, Pose(13.0, 15.0, 0.5), Twist(0, 0, 0))
FEEDBACK = Feedback(
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
ESTIMATOR = EstimatorSignals(*range(180, 180 + len(EstimatorSignals._fields)))
GAINS = Gains(*range(90, 90 + len(Gains._fields)))
APPLIED = Applied(WheelCommand(CommandMode.SPEED, four(100), four(110)), True, 0.12)
EXTRA = SimpleNamespace(signals=("one", "other"), telemetry=(150.0, 151.0))


def written(names: Sequence[str], asked: Callable[[str], None] = lambda _: None, *, is_timed: bool) -> dict[str, float]:
    """Return the row of these signals; ``asked`` gets the name of each part that the writer asks for its values."""

    def told(name: str, value: object) -> object:
        asked(name)
        return value

    class Device:
        report = property(lambda _: told("report", SimpleNamespace(health=(120.0, 121.0, four(122)))))
        clock_sync = property(lambda _: told("clock", SimpleNamespace(offset_us=140.0, drift_ppm=141.0)))

        def link_figures(self) -> object:
            return told("figures", (130, 131, 134, 138.0))

        def rejected(self) -> object:
            return told("rejected", {"one": 132, "other": 1})

    class Law:
        gains = property(lambda _: told("gains", GAINS))

    wire = SimpleNamespace(
        byte_counts=lambda: told("bytes", (135, 136)), load_percent=lambda _: told("load", 137.0), is_timed=is_timed
    )
    rows: list[bytes] = []
    sink = SimpleNamespace(put=rows.append)
    writer = RowWriter(names, Device(), wire, Law(), CommandMode.SPEED, [EXTRA], [sink], LATENCY_NS)
    writer.write(
        LOOP, FEEDBACK, 2_000_000, FIX, STATE, REFERENCE, APPLIED, ESTIMATOR, Guarded(False, Limit.SLIP, 142.0)
    )
    (packed,) = rows
    return dict(zip(names, memoryview(packed).cast("d").tolist(), strict=True))


ALL = (*SIGNAL_NAMES, *EXTRA.signals)
STANDING = ("gain.", "battery.", "wheel.fl.temp", "link.sent", "link.received", "link.lost", "link.rtt", "link.load",
            "link.rejected", "link.clock", "one", "other")  # fmt: skip


@given(st.sets(st.sampled_from(ALL)), st.booleans())
def test_a_row_of_some_signals_has_the_values_of_the_whole_one_and_asks_for_no_others(
    some: set[str], is_timed: bool
) -> None:
    names = [name for name in ALL if name in some or name in DIFFERENCE_SIGNALS]
    asked: list[str] = []
    whole, part = written(ALL, is_timed=is_timed), written(names, asked.append, is_timed=is_timed)
    assert part == pytest.approx({name: whole[name] for name in names}, nan_ok=True)
    wants = any(name.startswith(STANDING) or ".temperature" in name for name in names)
    assert wants or asked == (["bytes", "load"] if is_timed else [])
    assert bool(asked) == (wants or is_timed)


def test_every_value_of_a_row_stands_under_its_signals_name() -> None:
    expected = {
        **{f"loop.{name}": value for name, value in LOOP._asdict().items()},
        **{
            f"reference.{name}": value
            for part, names in (
                (REFERENCE.pose, ("x_m", "y_m", "heading_rad")),
                (REFERENCE.twist, ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")),
                (REFERENCE.acceleration, ("ax_m_s2", "ay_m_s2", "yaw_acceleration_rad_s2")),
            )
            for name, value in zip(names, part, strict=True)
        },
        **{f"pose.{name}": value for name, value in STATE.pose._asdict().items()},
        **{f"twist.{name}": value for name, value in STATE.twist._asdict().items()},
        **{f"truth.{name}": value for name, value in FIX.pose._asdict().items()},
        "error.x_m": 3.0,
        "error.y_m": 4.0,
        "error.heading_rad": 0.38,
        "error.planar_m": 5.0,
        **{f"gain.{name}": value for name, value in GAINS._asdict().items()},
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
        **{f"estimator.{name}": value for name, value in ESTIMATOR._asdict().items()},
        "guard.saturated": 1.0,
        "guard.held": 0.0,
        "guard.limit": 2.0,
        "guard.taken_n_m": 142.0,
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
    row = written(ALL, is_timed=True)
    assert sorted(expected) == sorted(SIGNAL_NAMES)
    assert {name: row[name] for name in SIGNAL_NAMES} == pytest.approx(expected)
    assert tuple(row[name] for name in EXTRA.signals) == EXTRA.telemetry
