"""Whole runs from Python: every byte through codec, framing, firmware and FMU."""

import numpy as np
import pandas as pd
import pytest

import hil
from hil.core.errors import BadInputError, DeviceError
from hil.core.signals import SIGNAL_NAMES

SHORT = {"loop.duration_s": 1.0, "expect": []}
LINKS = ["memory:", "serial:pty", "can:virtual/test_run", "can:virtual/test_run_fd?fd=1"]


def run(scenario="paper_circle", link="memory:", **overrides):
    """Run for one second unless told otherwise; ``loop__seed=2`` stands for the key ``loop.seed``."""
    keys = {key.replace("__", "."): value for key, value in overrides.items()}
    return hil.run(scenario, set=SHORT | keys, link=link)


@pytest.fixture(scope="module")
def circle():
    return hil.run("paper_circle")


def test_paper_circle_is_tracked_as_the_reproduction_says(circle):
    """AFDSC with the filter that fits the paper's DSC: 1.19 mm, where the paper prints 0.38 mm."""
    assert circle.passed
    assert circle.exit_code == 0
    assert circle.metrics["tracked_s"] < 0.7
    assert circle.metrics["steady_rms_m"] == pytest.approx(0.00119, abs=0.00002)
    assert circle.metrics["steady_max_m"] < 0.003
    assert circle.metrics["ticks"] == 15_000
    assert circle.metrics["deadline_misses"] == 0
    assert circle.metrics["frames"]["rejected"] == {}
    assert circle.metrics["reasons"] == {"pose_fixes": "'truth' takes none", "recording": "no recording was asked for"}
    assert circle.metrics["stopped"]


def test_paper_circle_dsc_has_the_papers_steady_error():
    """ς ω² r / K1 = 0.0675 (2π/15)² 1 / 15 = 0.79 mm, Nguyen Minh et al. 2023, section IV.A."""
    result = hil.run("paper_circle_dsc")
    assert result.metrics["steady_rms_m"] == pytest.approx(0.0675 * (2 * np.pi / 15) ** 2 / 15, rel=0.02)


def test_circle_by_wheel_speeds_with_latency_and_friction():
    result = hil.run("circle_speed")
    assert result.passed
    assert result.metrics["steady_rms_m"] < 0.001


def test_signals_and_frame_hold_every_tick(circle):
    names = tuple(circle.signals)
    assert names[: len(SIGNAL_NAMES)] == SIGNAL_NAMES
    assert {name.partition(".")[0] for name in names[len(SIGNAL_NAMES) :]} == {"fuzzy"}
    assert all(values.shape == (15_000,) for values in circle.signals.values())
    frame = circle.frame()
    assert isinstance(frame, pd.DataFrame)
    assert frame["error.planar_m"].iloc[0] == pytest.approx(np.hypot(0.2, 0.2))
    assert np.allclose(np.diff(circle.signals["loop.t_s"]), 1e-3)


def test_robot_starts_at_rest_where_the_scenario_says(circle):
    assert circle.signals["truth.x_m"][0] == 0.8
    assert circle.signals["truth.y_m"][0] == -0.2
    assert circle.signals["wheel.fl.speed_rad_s"][0] == 0.0


def test_firmware_estimates_the_speed_that_the_wheels_have(circle):
    """The wheels' speed follows from the true motion: an oracle that neither firmware nor codec knows."""
    s = circle.signals
    heading = s["truth.heading_rad"]
    vx, vy = np.gradient(s["truth.x_m"], 1e-3), np.gradient(s["truth.y_m"], 1e-3)
    yaw_rate = np.gradient(heading, 1e-3)
    forward = np.cos(heading) * vx + np.sin(heading) * vy
    left = -np.sin(heading) * vx + np.cos(heading) * vy
    fl = (forward - left - 0.6 * yaw_rate) / 0.075
    steady = s["loop.t_s"] > 5.0
    assert np.max(np.abs(fl[steady] - s["wheel.fl.speed_rad_s"][steady])) < 0.4
    assert abs(np.mean(fl[steady] - s["wheel.fl.speed_rad_s"][steady])) < 0.01


def test_every_link_carries_the_same_frames():
    shorter = {"loop.duration_s": 1.5, "expect.1.from_s": 1.0, "expect.1.to_s": 1.5}
    results = {link: hil.run("paper_circle", set=shorter, link=link) for link in LINKS}
    hashes = {link: result.metrics["wire_sha256"] for link, result in results.items()}
    assert len(set(hashes.values())) == 1, hashes
    first = results["memory:"]
    for result in results.values():
        assert result.passed  # below 3 mm throughout
        assert np.array_equal(result.signals["truth.x_m"], first.signals["truth.x_m"])


def test_with_latency_both_ways_every_link_carries_the_same_frames():
    late = {"loop.duration_s": 0.3, "expect": [], "link.command_latency_s": 0.003, "link.feedback_latency_s": 0.007}
    hashes = {link: hil.run("paper_circle", set=late, link=link).metrics["wire_sha256"] for link in LINKS}
    assert len(set(hashes.values())) == 1, hashes


def test_seed_changes_the_wire_and_nothing_else():
    one, again, other = run(), run(), run(loop__seed=2)
    assert one.metrics["wire_sha256"] == again.metrics["wire_sha256"]
    assert one.metrics["wire_sha256"] != other.metrics["wire_sha256"]
    assert np.array_equal(one.signals["truth.x_m"], other.signals["truth.x_m"])


@pytest.mark.alone
@pytest.mark.parametrize("link", ["memory:", "serial:pty", "can:virtual/test_run_rt"])
def test_real_time_in_one_process(link):
    result = hil.run("paper_circle", set={"loop.duration_s": 3.0, "expect": []}, mode="realtime", link=link)
    assert result.failure is None
    on_the_circle_m = result.signals["error.planar_m"][result.signals["loop.t_s"] >= 1.0]
    assert np.sqrt(np.mean(on_the_circle_m**2)) < 0.003
    assert result.metrics["realtime_factor"] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("command_ms", "feedback_ms"), [(0, 0), (3, 0), (0, 2), (3, 2), (7, 0), (0, 10), (4, 23), (12, 9)]
)
def test_latency_is_from_the_sampling_instant_to_the_tick_that_uses_the_command(command_ms, feedback_ms):
    """At 100 Hz: the wheels answer to the first moving command after exactly the two latencies together."""
    result = run(
        "circle_speed",
        link__command_latency_s=command_ms * 1e-3,
        link__feedback_latency_s=feedback_ms * 1e-3,
        loop__rate_hz=100,
        firmware__watchdog_s=0.1,
    )
    assert result.failure is None
    s = result.signals
    # What the tick acts on, feedback and truth alike, was sampled at its t.
    origin = s["robot.time_s"][0] - s["loop.t_s"][0]
    assert np.allclose(s["robot.time_s"] - s["loop.t_s"], origin)
    assert np.array_equal(s["pose.x_m"], s["truth.x_m"])
    assert np.allclose(s["link.feedback_age_ms"], feedback_ms)
    # The age of the command in force at the sampling instants says when it arrived: latency after the sample that
    # it answers, in steps of a period.
    expected = 10 - (command_ms + feedback_ms) % 10
    assert set(s["robot.command_age_ms"][20:]) == {expected}


def test_feedback_latency_shows_in_the_motion():
    positions = {
        ms: run("circle_speed", link__feedback_latency_s=ms * 1e-3, link__command_latency_s=0.0).signals["truth.x_m"]
        for ms in (0, 4)
    }
    assert not np.array_equal(positions[0][100:], positions[4][100:])


def test_odometry_drifts_little_on_a_plant_without_slip():
    result = run(estimator__source="odometry", loop__duration_s=15.0)
    assert result.metrics["steady_rms_m"] < 0.01
    assert not np.array_equal(result.signals["pose.x_m"], result.signals["truth.x_m"])


@pytest.mark.parametrize("link", ["memory:", "can:virtual/test_run_map"])
def test_wheels_may_be_wired_in_any_order_and_sense(link):
    plain = run(link=link)
    wired = run(link=link, device__wheels=["rl", "fr", "fl", "rr"], device__reversed=["fr", "rr"])
    assert plain.metrics["wire_sha256"] != wired.metrics["wire_sha256"]
    assert np.max(np.abs(plain.signals["truth.x_m"] - wired.signals["truth.x_m"])) < 2e-3


def test_plant_start_is_what_is_true_and_robot_what_is_believed():
    nominal, heavy = run(), run(**{"plant.start.mass_kg": 30.0})
    assert heavy.metrics["wire_sha256"] != nominal.metrics["wire_sha256"]
    assert heavy.scenario.robot.mass_kg == 20.0


def test_failed_expectation_is_exit_code_1_with_the_first_violation():
    result = run(expect=[{"signal": "error.planar_m", "below": 0.1, "to_s": 0.5}])
    (row,) = result.metrics["expect"]
    assert (result.passed, result.exit_code) == (False, 1)
    assert row["violation_s"] == 0.0
    assert row["violation_value"] == pytest.approx(np.hypot(0.2, 0.2))


def test_expectation_over_no_samples_fails():
    assert run(expect=[{"signal": "error.planar_m", "below": 1.0, "from_s": 5.0}]).exit_code == 1


def test_faults_report_how_often_they_were_applied():
    rows = [
        {"kind": "drop", "target": "command", "value": 0.2, "start_s": 0.2},
        {"kind": "duplicate", "target": "command", "value": 0.2},
        {"kind": "drop", "target": "feedback", "value": 0.05},
    ]
    result = run(fault=rows)
    assert result.passed
    assert all(row["applied"] > 20 for row in result.metrics["fault"])
    assert result.metrics["frames"]["rejected"]["robot_stale"] > 100, "the robot refused the repeated commands"
    assert result.metrics["wire_sha256"] == run(fault=rows).metrics["wire_sha256"]


def test_a_fault_that_never_happens_fails_the_run():
    assert run(fault=[{"kind": "drop", "target": "command", "value": 0.5, "start_s": 50.0}]).exit_code == 1


@pytest.mark.parametrize("message", ["TORQUE_COMMAND", "TICK"])
def test_a_muted_message_stops_the_robot_and_ends_the_run(message):
    result = run(fault=[{"kind": "mute", "target": message, "start_s": 0.3}])
    assert result.exit_code == 3
    assert result.failure is not None
    assert ("COMMAND_TIMEOUT" in str(result.failure)) == (message == "TORQUE_COMMAND")
    assert result.metrics["ticks"] < 700


def test_a_law_of_the_users_own(tmp_path):
    (tmp_path / "my_law.py").write_text(
        """
from dataclasses import dataclass
from hil.core.types import CommandMode, Wheels, WheelCommand, NO_GAINS

class MyLaw:
    \"\"\"Drives straight ahead.\"\"\"

    @dataclass(frozen=True)
    class Options:
        speed_rad_s: float = 1.0

    gains = NO_GAINS

    def __init__(self, model, mode, options):
        self.speed = options.speed_rad_s

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        wheels = Wheels(*[self.speed] * 4)
        return WheelCommand(CommandMode.SPEED, wheels, Wheels(0, 0, 0, 0))
"""
    )
    (tmp_path / "mine.toml").write_text(
        """
extends = "paper_circle"
[controller]
law = "./my_law.py:MyLaw"
command = "speed"
[controller.gains]
speed_rad_s = 4.0
[loop]
duration_s = 1.0
[[expect]]
signal = "wheel.fl.speed_rad_s"
from_s = 0.5
above = 3.5
below = 4.5
"""
    )
    result = hil.run(tmp_path / "mine.toml")
    assert result.passed, result.metrics["expect"]
    assert result.signals["truth.x_m"][-1] - 0.8 == pytest.approx(4.0 * 0.075, rel=0.1)


def test_a_law_that_gives_no_number_stops_the_robot(tmp_path):
    (tmp_path / "bad.py").write_text(
        """
from hil.core.types import CommandMode, Wheels, WheelCommand

class Bad:
    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return WheelCommand(CommandMode.TORQUE, Wheels(0, 0, 0, 0), Wheels(float("nan"), 1, 1, 1))
"""
    )
    result = run(controller__law=f"{tmp_path}/bad.py:Bad", controller__command="torque")
    assert np.all(result.signals["truth.x_m"] == 0.8)
    assert result.metrics["commands_refused"] == 1000
    assert not result.passed


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ("WheelCommand(CommandMode.TORQUE, Wheels(0, 0, 0, 0), Wheels(0, 0, 0, None))", "four numbers"),
        ("WheelCommand(CommandMode.TORQUE, Wheels(0, 0, 0, 0), [1.0, 2.0, 3.0])", "four numbers"),
        ("WheelCommand(CommandMode.SPEED, Wheels(0, 0, 0, 0), Wheels(0, 0, 0, 0))", "expected TORQUE"),
        ("1 / 0", "ZeroDivisionError"),
        ("None", "expected a WheelCommand"),
    ],
)
def test_a_law_that_fails_ends_the_run_with_the_robot_stopped(tmp_path, result, words):
    (tmp_path / "bad.py").write_text(
        f"""
from hil.core.types import CommandMode, Wheels, WheelCommand

class Bad:
    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return {result}
"""
    )
    ended = run(controller__law=f"{tmp_path}/bad.py:Bad", controller__command="torque")
    assert (ended.exit_code, ended.metrics["stopped"]) == (2, True)
    assert words in str(ended.failure)


def test_a_robot_that_cannot_stop_does_not_pass():
    """The steps of the stop phase are answered, but its IDLE request and every STATUS and TICK are muted."""
    result = run(fault=[{"kind": "mute", "target": "TICK", "start_s": 0.9995, "end_s": 100.0}])
    assert not result.passed


def test_another_process_without_truth_is_refused_when_the_estimator_needs_it():
    with pytest.raises(BadInputError, match="--truth"):
        hil.run("paper_circle", link="serial:/dev/null")


@pytest.mark.parametrize("record", [True, False])
def test_a_rotation_that_cannot_be_read_is_refused_though_nothing_is_recorded(tmp_path, record):
    with pytest.raises(BadInputError, match=r"^rotate 'daily': expected a size or a time"):
        hil.run("paper_circle", record=tmp_path / "run.mcap" if record else None, rotate="daily")


def test_truth_that_nobody_publishes():
    with pytest.raises(BadInputError) as refused:
        hil.run("paper_circle", link="serial:pty", truth="tcp://127.0.0.1:1")
    assert str(refused.value) == (
        "--truth tcp://127.0.0.1:1: the link serial:pty makes its robot in this process, which knows the truth; leave "
        "--truth out, or give the link of hil device"
    )
    with pytest.raises(DeviceError, match="start hil device first"):
        hil.run("paper_circle", link="serial:/dev/null", truth="tcp://127.0.0.1:1")
    with pytest.raises(BadInputError, match="expected tcp://"):
        hil.run("paper_circle", link="serial:/dev/null", truth="udp://x")


SLOW_AT_LAST = """
import time
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand

class Law:
    def reset(self, state, reference):
        self.ticks = 0

    def update(self, reference, state, applied, dt_s):
        self.ticks += round(dt_s * 200)
        if self.ticks >= 95:
            time.sleep(0.06)
        return WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, ZERO_WHEELS)
"""


@pytest.mark.alone
def test_ticks_that_are_skipped_last_are_counted_up_to_the_end_and_no_further(tmp_path):
    (tmp_path / "slow.py").write_text(SLOW_AT_LAST, encoding="utf-8")
    overrides = {"controller.law": f"{tmp_path / 'slow.py'}:Law", "controller.gains": {}, "loop.rate_hz": 200}
    result = hil.run("paper_circle", set=SHORT | overrides | {"loop.duration_s": 0.5}, mode="realtime")
    assert result.failure is None
    assert result.metrics["deadline_misses"] >= 1
    assert result.metrics["ticks"] + result.metrics["deadline_misses"] == 100
