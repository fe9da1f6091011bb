"""The status and the motion of a served robot: each value from its own source, in its own unit."""

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service.messages import Phase, Task
from hil.addons.service.status import MotionFeed, bench_status
from hil.core.signals import EstimatorSignals
from hil.core.types import NO_GAINS, Pose, PoseFix, State, Twist, Wheels
from hil.robot.snapshot import Feedback
from hil.runtime.realtime import RealTime, Setting
from hil.scenario import load

NAN = math.nan
STATE = State(Pose(1.0, -2.0, 0.5), Twist(0.1, -0.2, 0.3))
FEEDBACK = Feedback(
    7_000_000, RobotState.ACTIVE, 3, 2, (100, 65_500, 5, 40_000),
    Wheels(1.0, 2.0, 3.0, 4.0), Wheels(0.5, -0.6, 0.7, 0.8), (0.1, -0.2, 9.8), 0.25,
)  # fmt: skip
ESTIMATOR = EstimatorSignals(*([NAN] * len(EstimatorSignals._fields)))._replace(
    health=1.0, sigma_position_m=0.01, sigma_heading_rad=0.02
)


class Device:
    """What a status asks a robot's driver for."""

    sent, received = 10, 9
    feedback: Feedback | None = FEEDBACK
    info: Any = SimpleNamespace(describe=lambda: "firmware 1.2", has_power_stage=False)

    def __init__(self) -> None:
        self.report = SimpleNamespace(health=SimpleNamespace(battery_v=24.5))

    def describe_link(self) -> str:
        return "a line"

    def link_figures(self) -> tuple[float, ...]:
        return (1.0, 2.0, 3.0, 4.5)

    def rejected(self) -> Mapping[str, int]:
        return {"crc": 1}


def pilot_of(device: Device, **more: Any) -> Any:
    tasks = SimpleNamespace(
        task=Task.GO, reference=SimpleNamespace(pose=Pose(3.0, 4.0, -1.0)), twist_age_s=0.125, wheels=None, sequence=7
    )
    gains = NO_GAINS._replace(k1_x_1_s=8.0, k2_y_1_s=0.0)
    parts = SimpleNamespace(
        controller=SimpleNamespace(gains=gains), estimator=SimpleNamespace(status=ESTIMATOR), device=device
    )
    values = {
        "phase": Phase.ACTIVE, "tasks": tasks, "state": STATE, "why": "so", "parts": parts, "feedback_age_ms": 1.5,
        "recoveries": 2,
    }  # fmt: skip
    return SimpleNamespace(**values | more)


def test_each_value_of_a_status_comes_from_its_source() -> None:
    device = Device()
    granted = RealTime([Setting("memory", False, "memory: refused")])
    status = bench_status(pilot_of(device), SimpleNamespace(device=device), granted)
    assert status == {
        "phase": Phase.ACTIVE,
        "task": Task.GO,
        "why": "so",
        "link": "a line",
        "robot": "firmware 1.2",
        "power_stage": False,
        "pose": (1.0, -2.0, 0.5),
        "twist": (0.1, -0.2, 0.3),
        "reference": (3.0, 4.0, -1.0),
        "speed_rad_s": (1.0, 2.0, 3.0, 4.0),
        "battery_v": 24.5,
        "gains": {"k1_x_1_s": 8.0, "k2_y_1_s": 0.0},
        "health": "degraded",
        "feedback_age_ms": 1.5,
        "round_trip_ms": 4.5,
        "frames": {"sent": 10, "received": 9, "rejected": {"crc": 1}},
        "recoveries": 2,
        "twist_age_s": 0.125,
        "realtime": {"memory": "memory: refused"},
    }


def test_a_motion_has_every_value_of_its_sample_and_none_that_is_unknown() -> None:
    scenario = load("circle_speed")
    pilot = pilot_of(Device())
    feed = MotionFeed(scenario, pilot)
    truth = PoseFix(0, Pose(1.1, -2.1, 0.6), Twist(0.4, 0.5, 0.6))
    motion = feed.at(12.5, truth)
    assert (motion.time_unix_s, motion.pose, motion.twist) == (12.5, (1.0, -2.0, 0.5), (0.1, -0.2, 0.3))
    assert (motion.truth, motion.true_twist, motion.sigma) == ((1.1, -2.1, 0.6), (0.4, 0.5, 0.6), (0.01, 0.02))
    assert motion.angle_rad == (0.0, 0.0, 0.0, 0.0)
    assert (motion.speed_rad_s, motion.current_a) == ((1.0, 2.0, 3.0, 4.0), (0.5, -0.6, 0.7, 0.8))
    a_torque = scenario.firmware.torque_constant_n_m_a
    assert motion.torque_n_m == pytest.approx([0.5 * a_torque, -0.6 * a_torque, 0.7 * a_torque, 0.8 * a_torque])
    assert (motion.yaw_rate_rad_s, motion.acceleration_m_s2) == (0.25, (0.1, -0.2, 9.8))
    assert motion.sequence is None, "no law elsewhere commands"
    pilot.tasks.wheels = (1.0, 1.0, 1.0, 1.0)
    assert feed.at(12.5, None).sequence == 7
    unknown = FEEDBACK._replace(current_a=Wheels(NAN, 0.0, 0.0, 0.0), yaw_rate_rad_s=NAN, acceleration_m_s2=(NAN,) * 3)
    pilot.parts.device.feedback, pilot.state = unknown, STATE._replace(pose=Pose(0.0, 0.0, NAN))
    motion = feed.at(12.6, None)
    assert [motion.pose, motion.current_a, motion.torque_n_m, motion.yaw_rate_rad_s, motion.acceleration_m_s2] == 5 * [
        None
    ]
    assert (motion.twist, motion.truth, motion.true_twist) == (STATE.twist, None, None)
    pilot.parts.device.feedback = pilot.state = None
    motion = feed.at(12.7, None)
    assert (motion.pose, motion.angle_rad, motion.speed_rad_s) == (None, None, None)


def test_angles_go_on_where_the_encoders_counts_wrap() -> None:
    scenario = load("circle_speed")
    device = Device()
    feed = MotionFeed(scenario, pilot_of(device))
    feed.at(0.0, None)
    counts = (65_530, 32_767 - 36, 6, 40_000 - 32_768)  # by -106, by 32,767, by 1, by -32,768
    device.feedback = FEEDBACK._replace(encoder_count=counts)
    a_turn = scenario.firmware.counts_per_revolution
    turned = [math.tau * count / a_turn for count in (-106, 32_767, 1, -32_768)]
    assert feed.at(0.1, None).angle_rad == pytest.approx(turned)
    device.feedback = FEEDBACK._replace(encoder_count=(100, 65_500, 5, 39_999))
    assert feed.at(0.2, None).angle_rad == pytest.approx([0.0, 0.0, 0.0, -math.tau / a_turn])


def test_a_motion_is_sent_as_often_as_it_is_asked_for_with_the_time_of_its_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hil.addons.service.status.time", SimpleNamespace(time=lambda: 100.0))
    pilot = pilot_of(Device(), feedback_age_ms=250.0)
    feed = MotionFeed(load("circle_speed", set={"loop.rate_hz": 200}), pilot)

    def ticks(rate_hz: float) -> list[int]:
        return [tick for tick in range(12) if feed.motion(rate_hz, tick, None) is not None]

    assert ticks(0.0) == []
    assert ticks(50.0) == [0, 4, 8]
    assert ticks(199.0) == ticks(1000.0) == list(range(12))
    motion = feed.motion(50.0, 4, None)
    assert motion is not None
    assert motion.time_unix_s == 99.75
    pilot.feedback_age_ms = None
    motion = feed.motion(50.0, 4, None)
    assert motion is not None
    assert motion.time_unix_s == 100.0


@pytest.mark.parametrize(("health", "word"), [(0.0, "good"), (2.0, "lost"), (NAN, None)])
def test_what_a_robot_has_not_said_is_none(health: float, word: str | None) -> None:
    device = Device()
    device.feedback = device.info = None
    device.report.health.battery_v = NAN
    pilot = pilot_of(device, state=None)
    pilot.tasks.reference = None
    pilot.parts.estimator.status = ESTIMATOR._replace(health=health)
    status = bench_status(pilot, SimpleNamespace(device=device), RealTime(()))
    unknown = ("robot", "power_stage", "pose", "twist", "reference", "speed_rad_s", "battery_v")
    assert [status[name] for name in unknown] == [None] * len(unknown)
    assert status["health"] == word
