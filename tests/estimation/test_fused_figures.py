"""What the fused estimator tells of its uncertainty and its motion, compared with sums by hand."""

import math

import numpy as np
import pytest

from hil.core.kinematics import BodyTwist, to_world, wheel_speeds
from hil.core.options import plain
from hil.core.types import NAN, NAN_POSE, MeasuredPose, Pose, PoseCovariance, PoseFix, Twist, Wheels
from hil.estimation.estimators import EstimatorOptions, FilterOptions, OdometryEstimator, TruthEstimator
from hil.estimation.fused import FusedEstimator
from tests.estimation.test_wheel_motion import Measured
from tests.support.closed_loop import PAPER_ROBOT

START = Pose(0.8, -0.2, 0.4)
TICK_NS, DT_S = 5_000_000, 0.005
R, L = PAPER_ROBOT.wheel_radius_m, PAPER_ROBOT.lever_m
NO_ACCELERATION = (NAN, NAN, NAN)


def fused(slip_m_s: float = 0.1, **options: float) -> FusedEstimator:
    return FusedEstimator(PAPER_ROBOT, START, 4096, slip_m_s, FilterOptions(**{"release_s": 0.0, **options}))


def at(tick: int, speed: Wheels = Wheels(0.0, 0.0, 0.0, 0.0), yaw_rate: float = NAN) -> Measured:  # noqa: B008
    return Measured(tick * TICK_NS, None, speed, yaw_rate, NO_ACCELERATION)


def test_the_defaults_are_those_that_scenarios_rely_on():
    assert plain(EstimatorOptions()) == {
        "source": "truth",
        "twist": "source",
        "slip_threshold_m_s": 0.05,
        "fix": "simulated",
        "filter": {
            "begin": "start",
            "start_sigma_m": 0.01,
            "start_sigma_rad": 0.01,
            "wheels_sigma_m": 0.0003,
            "wheels_scale_sigma": 0.01,
            "left_scale_sigma": 0.03,
            "wheels_differ_sigma": 0.006,
            "gyro_scale_sigma": 0.005,
            "wheels_sigma_rad": 0.02,
            "gyro_noise_rad_s": 0.01,
            "gyro_bias_sigma_rad_s": 0.02,
            "gyro_bias_walk_rad_s": 0.0003,
            "gate_probability": 0.999,
            "restart_after": 10,
            "fix_noise_most": 4.0,
            "fix_held_share": 0.0,
            "fix_held_s": 2.0,
            "fix_map_share": 0.0,
            "fix_map_scale_m": 5.0,
            "fix_timeout_s": 0.5,
            "lost_sigma_m": 0.25,
            "history_s": 1.0,
            "release_s": 0.2,
        },
        "simulated_fix": {
            "rate_hz": 10.0,
            "latency_s": 0.1,
            "sigma_m": 0.02,
            "sigma_rad": 0.01,
            "noisier": 1.0,
            "corridor_times": 1.0,
            "corridor_rad": 0.0,
            "held_share": 0.0,
            "held_s": 2.0,
            "map_share": 0.0,
            "map_scale_m": 5.0,
            "map_blend": 1.0,
            "tells": "sigmas",
            "outlier_probability": 0.0,
            "outlier_m": 1.0,
            "burst_s": 0.0,
            "dropout_probability": 0.0,
            "gap_start_s": 0.0,
            "gap_end_s": 0.0,
        },
    }


@pytest.mark.parametrize(
    ("noise", "bias", "walk", "expected"),
    [
        (0.5, 0.0, 0.0, 200 * (0.5 * DT_S) ** 2),
        (1e-9, 0.1, 0.0, 0.1**2),
        (1e-9, 0.0, 0.3, 0.3**2 * DT_S**3 * sum(n * n for n in range(200))),
    ],
    ids=["noise", "bias", "walk"],
)
def test_with_a_gyro_the_heading_is_doubted_by_its_noise_its_bias_and_the_walk_of_that(noise, bias, walk, expected):
    gyro = {"gyro_noise_rad_s": noise, "gyro_bias_sigma_rad_s": bias, "gyro_bias_walk_rad_s": walk}
    estimator = fused(start_sigma_rad=0.02, gyro_scale_sigma=0.0, **gyro)
    for tick in range(202):  # the deviation is told when 0.1 s is over
        estimator.update(at(tick, yaw_rate=0.1), None)
    assert estimator.status.sigma_heading_rad**2 == pytest.approx(0.02**2 + expected, rel=1e-2 if walk else 1e-6)
    told = estimator.status
    assert (told.wheel_scale, told.left_scale, told.gyro_scale, told.fix_noise) == (1.0,) * 4


def test_the_noise_that_is_told_is_a_factor_of_sigma():
    estimator, told = fused(), PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    for tick in range(400):
        apart_m = 0.025 if tick % 2 else -0.025
        pose = Pose(START.x_m + apart_m, START.y_m - apart_m, START.heading_rad)
        estimator.update(at(tick), None, [MeasuredPose(tick * TICK_NS, pose, told)])
    noise = estimator._history.known.noise
    assert noise > 1.5
    assert estimator.status.fix_noise == pytest.approx(math.sqrt(noise))


@pytest.mark.parametrize("yaw_rate", [0.0, NAN], ids=["gyro", "no gyro"])
def test_slip_is_doubted_by_its_speed_for_a_fifth_of_a_second(yaw_rate):
    """Front against rear wheels: the body stands, so that nothing else is doubted. The leak's sum is a series."""
    estimator, variances = fused(gyro_noise_rad_s=1e-9, gyro_bias_sigma_rad_s=0.0, gyro_bias_walk_rad_s=0.0), []
    for tick in range(500):
        estimator.update(at(tick, Wheels(8.0, 8.0, -8.0, -8.0), yaw_rate), None)
        status = estimator.status
        variances.append((status.sigma_position_m**2, status.sigma_heading_rad**2))
    kept = math.exp(-DT_S / 0.1)
    slip_m_s = R * 8.0 * DT_S / 0.1 * kept / (1.0 - kept)
    position, heading = np.subtract(variances[-1], variances[-101]) / 100.0
    assert position == pytest.approx(slip_m_s**2 * DT_S * 0.2, rel=1e-6)
    assert heading == pytest.approx(
        (slip_m_s / L) ** 2 * DT_S * 0.2 if math.isnan(yaw_rate) else 0.0, rel=1e-6, abs=1e-12
    )


def test_the_twist_is_the_bodys_in_the_world_by_wheels_that_are_larger_than_believed():
    body = BodyTwist(0.5, -0.2, 0.3)
    estimator, speed = fused(wheels_scale_sigma=0.2), Wheels(*wheel_speeds(body, R, L))
    estimator.update(at(0, speed, 0.3), None)
    assert estimator.update(at(1, speed, 0.3), None).twist == pytest.approx(to_world(body, START.heading_rad + 0.0015))
    for tick in range(2, 400):
        fixes = []
        if tick % 20 == 0:
            turned = 0.3 * tick * DT_S
            middle, size = START.heading_rad + turned / 2.0, 1.1 * math.sin(turned / 2.0) / 0.15
            c, s = math.cos(middle), math.sin(middle)
            x, y = size * (c * 0.5 + s * 0.2), size * (s * 0.5 - c * 0.2)
            pose = Pose(START.x_m + x, START.y_m + y, START.heading_rad + turned)
            fixes = [MeasuredPose(tick * TICK_NS, pose, PoseCovariance(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))]
        state = estimator.update(at(tick, speed, 0.3), None, fixes)
    assert estimator.status.wheel_scale == pytest.approx(1.1, abs=2e-3)
    larger = to_world(BodyTwist(0.55, -0.22, 0.3), state.pose.heading_rad)
    assert state.twist == pytest.approx(larger, abs=2e-3)


def test_after_a_reset_15_cm_and_a_fifth_of_a_radian_may_have_passed_on_every_axis():
    """A fix that is as sure as that moves the robot half of the way."""
    estimator = fused(start_sigma_m=0.0, start_sigma_rad=0.0, gyro_noise_rad_s=1e-9, gyro_bias_sigma_rad_s=0.0)
    estimator.update(at(0, yaw_rate=0.0), None)
    estimator.restart()
    estimator.update(at(0, yaw_rate=0.0), None)
    apart = np.array([0.1, -0.06, 0.08])
    fix = MeasuredPose(TICK_NS, Pose(*(np.array(START) + apart)), PoseCovariance(0.0225, 0.0, 0.0, 0.0225, 0.0, 0.04))
    state = estimator.update(at(1, yaw_rate=0.0), None, [fix])
    assert state.pose == pytest.approx(np.array(START) + apart / 2.0, abs=1e-5)


def test_a_fix_waits_for_up_to_a_tenth_of_a_second():
    estimator = fused()
    estimator.update(at(0), None)
    ahead = [MeasuredPose(ns, START, PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)) for ns in (10**8, 10**8 + 1)]
    estimator.update(at(0), None, ahead)
    assert estimator.fix_figures()["ahead"] == 1
    for tick in range(1, 21):
        estimator.update(at(tick), None)
    assert estimator.fix_figures()["accepted"] == 1


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_no_more_than_ten_milliradians_of_a_correction_are_held_back(way):
    turned = START._replace(heading_rad=START.heading_rad + 0.6 * way)
    fix = MeasuredPose(TICK_NS, turned, PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-6))
    told = []
    for release_s in (0.0, 0.2):
        estimator = fused(start_sigma_m=1e-3, start_sigma_rad=1.0, release_s=release_s)
        estimator.update(at(0), None)
        told.append(estimator.update(at(1), None, [fix]).pose)
    assert np.subtract(*told) == pytest.approx([0.0, 0.0, 0.01 * way], abs=1e-9)


def test_a_fix_that_waits_goes_with_the_clock_by_which_it_was_stamped():
    estimator = fused()
    estimator.update(at(0), None, [MeasuredPose(10**7, START, PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))])
    estimator.restart()
    for tick in range(21):
        estimator.update(at(tick), None)
    assert not any(estimator.fix_figures().values())


def test_odometry_goes_on_after_a_reset_from_where_it_was_without_slip():
    estimator = OdometryEstimator(PAPER_ROBOT, START, 4096, 0.1)
    for tick in range(40):
        here = estimator.update(at(tick, Wheels(9.0, 8.0, -3.0, -4.0)), None)
    assert estimator.status.slip == 1.0
    estimator.restart()
    assert estimator.status.slip == 0.0
    assert estimator.update(at(0, Wheels(9.0, 8.0, -3.0, -4.0)), None).pose == here.pose


def test_after_a_reset_the_truth_is_not_known_until_its_next_sample():
    estimator, fix = TruthEstimator(PAPER_ROBOT), PoseFix(0, START, Twist(0.1, 0.2, 0.3))
    assert estimator.update(at(0), fix) == (START, fix.twist)
    estimator.restart()
    assert estimator.update(at(1), None) is None
    assert estimator.update(at(2), fix._replace(pose=NAN_POSE)) is None
    assert estimator.update(at(3), fix) == (START, fix.twist)


@pytest.mark.parametrize(("after_ns", "is_refuted"), [(250_000_000, True), (249_999_999, False)])
def test_a_quarter_of_a_second_of_rejected_fixes_refutes_the_accelerometer(after_ns, is_refuted):
    """It feels 3 m/s² of a robot at rest: by it the robot moves, and by its wheels it does not."""
    estimator, sure = fused(), PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    right_ns = 100 * TICK_NS
    fixes = {
        100: MeasuredPose(right_ns, START, sure),
        150: MeasuredPose(right_ns + after_ns, Pose(9.0, 9.0, 0.0), sure),
    }
    for tick in range(152):
        felt = at(tick, yaw_rate=0.0)._replace(acceleration_m_s2=(3.0 if tick > 100 else 0.0, 0.0, 9.81))
        state = estimator.update(felt, None, [fixes[tick]] if tick in fixes else [])
    assert (estimator.fix_figures()["accepted"], estimator.fix_figures()["rejected"]) == (1, 1)
    assert (math.hypot(*state.twist[:2]) < 1e-9) == is_refuted
    assert is_refuted or math.hypot(*state.twist[:2]) == pytest.approx(3.0 * 51 * DT_S, rel=0.05)
