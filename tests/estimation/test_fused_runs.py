"""Whole runs with fused estimation: every measurement over the wire, every fix late; and fixes of another process."""

import math
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.core.errors import BadInputError

ROOT = Path(__file__).parents[2]
CLIENT = ROOT / "tools" / "pose_fix_client.py"
NOISY = {"plant.start.gyro_noise_rad_s": 0.01, "plant.start.accelerometer_noise_m_s2": 0.2}
DEGRADED, LOST = 1.0, 2.0


def run(scenario: str = "circle_speed", **changes: Any) -> hil.RunResult:
    """Run 4 s at 200 Hz, fused, with noisy sensors unless told otherwise; ``loop__seed`` is ``loop.seed``."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    base = {"estimator.source": "fused", "loop.rate_hz": 200, "loop.duration_s": 4.0, "expect": []}
    return hil.run(scenario, set=base | NOISY | keys)


@pytest.mark.parametrize("scenario", ["circle_speed", "circle_slip"])
def test_a_biased_gyro_loses_odometry_and_not_the_fused_estimate(scenario):
    """On the rigid and on the slip plant: 0.05 rad/s turn odometry by 0.2 rad in these 4 s."""
    bias = {"plant__start__gyro_bias_z_rad_s": 0.05}
    fused, odometry = run(scenario, **bias), run(scenario, estimator__source="odometry", **bias)
    assert fused.metrics["estimation_error"]["heading_rms_rad"] < 0.03
    assert odometry.metrics["estimation_error"]["heading_rms_rad"] > 0.1
    assert fused.metrics["estimation_error"]["rms_m"] < 0.02
    assert fused.signals["estimator.gyro_bias_rad_s"][-1] == pytest.approx(0.05, abs=0.01)
    assert not fused.signals["estimator.slip"].any(), "what the plants do within their grip is no slip"
    assert fused.metrics["pose_fixes"]["rejected"] == 0


def test_one_seed_is_one_run():
    first, again, other = run(loop__duration_s=1.0), run(loop__duration_s=1.0), run(loop__duration_s=1.0, loop__seed=2)
    for name in ("pose.x_m", "estimator.sigma_position_m", "wheel.fl.speed_command_rad_s"):
        assert np.array_equal(first.signals[name], again.signals[name])
    assert first.metrics["wire_sha256"] == again.metrics["wire_sha256"]
    assert not np.array_equal(first.signals["pose.x_m"], other.signals["pose.x_m"])


def test_wheels_that_spin_are_slip_and_the_estimate_says_so():
    """3.5 N·m a wheel, where the floor carries 1.8: with the detector the fixes go on to be accepted."""
    torque = {"robot__torque_limit_n_m": 3.5, "firmware__torque_limit_n_m": 3.5, "limiter__slip_m_s": math.inf}
    result = run("circle_slip", **torque)
    slip, sigma_m = result.signals["estimator.slip"], result.signals["estimator.sigma_position_m"]
    assert 0.1 < slip.mean() < 0.5
    assert not slip[-200:].any()
    assert sigma_m[slip == 1.0].max() > 2 * sigma_m[-200:].max()
    blind = run("circle_slip", estimator__slip_threshold_m_s=100.0, **torque)
    assert not blind.signals["estimator.slip"].any()
    assert result.metrics["estimation_error"]["max_m"] < blind.metrics["estimation_error"]["max_m"]


def test_wheels_that_slip_a_little_as_the_robot_brakes_are_told():
    """By 0.05 to 0.15 m/s for 0.25 s at 1.8 N·m. Were it not told, the estimate would be 21 mm off for seconds."""
    torque = {"robot__torque_limit_n_m": 1.8, "firmware__torque_limit_n_m": 1.8}
    result = run("compare_circle", plant__start__contact="slip", **torque)
    slip = result.signals["estimator.slip"]
    assert 0.02 < slip.mean() < 0.25
    assert not slip[-200:].any()
    assert result.metrics["estimation_error"]["max_m"] < 0.016


def test_outliers_are_rejected():
    result = run(estimator__simulated_fix__outlier_probability=0.3)
    fixes = result.metrics["pose_fixes"]
    assert fixes["outliers"] > 5
    assert fixes["rejected"] >= fixes["outliers"] - 2, "those that have not arrived yet are none"
    assert fixes["restarts"] == 0
    assert result.metrics["estimation_error"]["max_m"] < 0.05
    assert result.signals["estimator.fixes_rejected"][-1] == fixes["rejected"]


def test_when_fixes_stop_the_robot_is_degraded_then_held_until_they_come_again():
    result = run(
        estimator__simulated_fix__gap_start_s=1.0,
        estimator__simulated_fix__gap_end_s=2.5,
        estimator__filter__lost_sigma_m=0.07,
        estimator__filter__wheels_sigma_m=0.1,
    )
    health, t_s = result.signals["estimator.health"], result.signals["loop.t_s"]
    assert set(health) == {0.0, DEGRADED, LOST}
    lost = health == LOST
    assert result.metrics["held_ticks"] == lost.sum() > 10
    commands = np.array([result.signals[f"wheel.{wheel}.speed_command_rad_s"] for wheel in ("fl", "fr", "rr", "rl")])
    assert not commands[:, lost].any()
    assert t_s[lost].min() > 1.0
    assert t_s[lost].max() < 2.7, "a fix of 2.5 s arrives at 2.6 s"
    assert commands[:, -100:].any(axis=0).all()
    assert not health[-100:].any()


def test_a_bias_fault_of_the_gyro_reaches_the_filter_and_is_found():
    fault = [{"kind": "bias", "target": "robot.yaw_rate_rad_s", "start_s": 1.0, "value": 0.1}]
    result = run(fault=fault, loop__duration_s=5.0)
    assert result.metrics["fault"][0]["applied"] > 700
    assert result.signals["estimator.gyro_bias_rad_s"][199] == pytest.approx(0.0, abs=0.02)
    assert result.signals["estimator.gyro_bias_rad_s"][-1] == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("allowed", [0, 1])
def test_a_restart_is_counted_told_and_fails_a_run_that_does_not_allow_it(allowed):
    """Fixes are refused as the gyro's new bias turns the estimate away; wheels and gyro tell as much of a slip."""
    suite = Path(__file__).parents[1] / "suite"
    sets = {"loop.duration_s": 2.5, "expect": [], "allow.fix_restarts": allowed}
    result = hil.run(suite / "fused_bias_jump.toml", set=sets)
    words = "the estimate began again from pose fixes that it had rejected: restart 1"
    assert words in [event.text for event in result.events]
    assert result.metrics["fix_restarts"] == result.metrics["pose_fixes"]["restarts"] == 1
    assert result.signals["estimator.fix_restarts"][[0, -1]].tolist() == [0.0, 1.0]
    assert result.passed == bool(allowed)


def test_a_fault_of_the_truth_moves_the_fixes_that_are_made_of_it():
    fault = [{"kind": "bias", "target": "truth.x_m", "start_s": 1.0, "end_s": 1.4, "value": 0.5}]
    result = run(fault=fault, loop__duration_s=2.0)
    assert result.metrics["pose_fixes"]["rejected"] == 4


def test_a_robot_that_was_reset_is_less_sure_until_the_next_fixes():
    result = run(fault=[{"kind": "reset", "target": "robot", "start_s": 1.0}], loop__rearm=True)
    assert result.failure is None
    (recovery,) = result.metrics["recoveries"]
    sigma_m, t_s = result.signals["estimator.sigma_position_m"], result.signals["loop.t_s"]
    # The ticks of the way back still tell of the estimator before it.
    back = t_s > recovery["armed_s"]
    assert sigma_m[back][0] > 0.1
    assert sigma_m[-1] < 0.03
    assert result.metrics["pose_fixes"]["rejected"] == 0
    error_m = np.hypot(*(result.signals[f"pose.{axis}"] - result.signals[f"truth.{axis}"] for axis in ("x_m", "y_m")))
    assert error_m[-100:].max() < 0.03


def test_without_truth_a_simulation_of_fixes_is_refused():
    with pytest.raises(BadInputError, match=r'estimator\.fix = "simulated", but the robot is elsewhere .* add --truth'):
        hil.run("circle_speed", link="serial:/dev/null", set={"estimator.source": "fused"})


def test_fixes_from_outside_need_real_time():
    with pytest.raises(BadInputError, match=r"estimator\.fix = .*5005.*loop\.mode"):
        run(estimator__fix="udp://127.0.0.1:5005")


def test_a_wrong_address_is_found_with_the_scenario():
    with pytest.raises(BadInputError, match=r"estimator\.fix = .*my-robot.*no IPv4 address"):
        run(estimator__fix="udp://my-robot:5005")


STILL = """
from hil.core.types import NO_GAINS, ZERO_WHEELS, WheelCommand

class Law:
    gains = NO_GAINS

    def __init__(self, model, mode):
        self.rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return self.rest
"""


@pytest.mark.alone
@pytest.mark.usefixtures("state_home")
def test_another_process_says_where_the_robot_is(tmp_path):
    """The client of the documents, in real time: it says so on and on, until the run is over."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    (tmp_path / "still.py").write_text(STILL)
    (tmp_path / "still.toml").write_text('extends = "circle_speed"\n[controller]\nlaw = "./still.py:Law"\ngains = {}\n')
    over = threading.Event()
    with subprocess.Popen(
        [sys.executable, str(CLIENT), "--port", str(port)], stdin=subprocess.PIPE, text=True
    ) as client:
        assert client.stdin is not None

        def tell() -> None:
            while not over.wait(0.05):
                print("now 4.0 -3.0 0.5", file=client.stdin, flush=True)
                print("0 4.0 -3.0 0.5", file=client.stdin, flush=True)

        teller = threading.Thread(target=tell)
        teller.start()
        try:
            options = {
                "estimator.source": "fused",
                "estimator.fix": f"udp://127.0.0.1:{port}",
                "estimator.filter.begin": "fix",
                "loop.duration_s": 1.5,
                "expect": [],
            }
            result = hil.run(tmp_path / "still.toml", mode="realtime", set=options)
        finally:
            over.set()
            teller.join()
            client.stdin.close()
    assert client.returncode == 0
    assert result.failure is None
    fixes = result.metrics["pose_fixes"]
    assert fixes["accepted"] > 5
    refused = fixes["refused"]
    assert refused["stale"] > 5, "a stamp of 1970"
    assert refused.keys() <= {"stale", "waited"}, "it speaks before the first tick"
    taken = fixes["accepted"] + fixes["rejected"] + fixes["too_late"] + fixes["double"] + fixes["ahead"]
    assert sum(refused.values()) + taken == pytest.approx(fixes["received"], abs=1), "one may still be waiting"
    pose = [result.signals[f"pose.{name}"][-1] for name in ("x_m", "y_m", "heading_rad")]
    assert pose == pytest.approx([4.0, -3.0, 0.5], abs=0.01)
