"""The fused estimator and slip detection on measurements of an ideal robot, each policy in turn."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.kinematics import BodyTwist, wheel_speeds
from hil.core.model import RobotModel
from hil.core.types import NAN, MeasuredPose, Pose, PoseCovariance, State, Wheels
from hil.estimation.estimators import FilterOptions
from hil.estimation.fused import FusedEstimator
from hil.estimation.slip import SlipDetector
from hil.estimation.wheel_motion import Motion

ROBOT = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, 0.0, torque_limit_n_m=5.0, speed_limit_rad_s=60.0)
COUNTS = 4096
START = Pose(0.8, -0.2, 0.4)
TICK_NS = 5_000_000
COVARIANCE = PoseCovariance(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
GOOD, DEGRADED, LOST = 0.0, 1.0, 2.0
AT_REST = BodyTwist(0.0, 0.0, 0.0)
NO_ACCELERATION = (NAN, NAN, NAN)


class Measured(NamedTuple):
    robot_time_ns: int
    encoder_count: tuple[int, int, int, int] | None
    speed_rad_s: Wheels
    yaw_rate_rad_s: float = NAN
    acceleration_m_s2: tuple[float, float, float] = NO_ACCELERATION


class Drive:
    """A robot that moves with one body twist, and the estimator that watches it."""

    def __init__(self, body=AT_REST, *, bias=0.0, gyro=True, slip_m_s=0.1, **options) -> None:
        self.estimator = FusedEstimator(ROBOT, START, COUNTS, slip_m_s, FilterOptions(**options))
        self.speed = wheel_speeds(body, ROBOT.wheel_radius_m, ROBOT.lever_m)
        self.yaw_rate = body.yaw_rate_rad_s + bias if gyro else NAN
        self.acceleration = NO_ACCELERATION
        self.tick, self.epoch_ns = -1, 0
        self.state: State | None = None

    @property
    def now_ns(self) -> int:
        return self.epoch_ns + self.tick * TICK_NS

    @property
    def status(self):
        return self.estimator.status

    def go(self, ticks: int, fix_every: int = 0, late_ns: int = 100_000_000, at: Pose | None = None) -> None:
        """Go on; every so many ticks a fix of ``at`` arrives, else of where a robot at rest is."""
        for _ in range(ticks):
            self.tick += 1
            turns = [math.floor(w * self.tick * TICK_NS * 1e-9 * COUNTS / math.tau) & 0xFFFF for w in self.speed]
            fl, fr, rr, rl = turns
            fixes = []
            if fix_every and self.tick % fix_every == 0:
                fixes.append(MeasuredPose(self.now_ns - late_ns, at or START, COVARIANCE))
            measured = Measured(self.now_ns, (fl, fr, rr, rl), self.speed, self.yaw_rate, self.acceleration)
            self.state = self.estimator.update(measured, None, fixes)

    def fix(self, time_ns: int, pose: Pose = START) -> None:
        """A fix arrives between two ticks."""
        again = Measured(self.now_ns, None, self.speed, self.yaw_rate)
        self.state = self.estimator.update(again, None, [MeasuredPose(time_ns, pose, COVARIANCE)])


def test_what_a_fix_changes_is_told_over_time_and_with_a_release_of_zero_at_once():
    told = {}
    for release_s in (0.0, 0.2):
        drive = Drive(gyro=False, release_s=release_s)  # a fix would change the gyro's bias too
        drive.go(100)
        before = np.array(drive.state.pose)
        drive.fix(
            drive.now_ns - 20 * TICK_NS, START._replace(x_m=START.x_m + 0.02, heading_rad=START.heading_rad + 0.02)
        )
        told[release_s] = [np.array(drive.state.pose) - before]
        for _ in range(60):
            drive.go(1)
            told[release_s].append(np.array(drive.state.pose) - before)
    whole = told[0.0][0]
    assert (whole[[0, 2]] > 1e-4).all()
    assert np.array(told[0.0]) == pytest.approx(np.tile(whole, (61, 1)), abs=1e-9)
    times_s = np.arange(61)[:, None] * TICK_NS * 1e-9
    assert np.array(told[0.2]) == pytest.approx((1.0 - np.exp(-times_s / 0.2)) * whole, abs=1e-9)


def test_no_more_than_a_centimetre_of_a_correction_is_held_back():
    far = START._replace(x_m=START.x_m + 0.3, y_m=START.y_m - 0.4)
    told = []
    for release_s in (0.0, 0.2):
        drive = Drive(gyro=False, start_sigma_m=1.0, start_sigma_rad=1.0, release_s=release_s)
        drive.go(100)
        drive.fix(drive.now_ns - 20 * TICK_NS, far)
        told.append(drive.state.pose)
    at_once, released = told
    held_m = at_once.x_m - released.x_m, at_once.y_m - released.y_m
    assert math.hypot(*held_m) == pytest.approx(0.01, abs=1e-9)
    assert math.atan2(held_m[1], held_m[0]) == pytest.approx(math.atan2(-0.4, 0.3), abs=0.01)


def test_a_bias_of_the_gyro_is_found_and_leaves_pose_and_twist_alone():
    drive = Drive(bias=0.01)
    drive.go(2000, fix_every=20)
    assert drive.status.gyro_bias_rad_s == pytest.approx(0.01, abs=1e-4)
    assert drive.state.pose == pytest.approx(START, abs=1e-3)
    assert drive.state.twist.yaw_rate_rad_s == pytest.approx(0.0, abs=1e-4)
    assert drive.status.health == GOOD
    assert (drive.status.fixes_accepted, drive.status.fixes_rejected) == (98, 0), (
        "those of the start and before it come too late"
    )


def test_without_a_gyro_the_wheels_turn_the_robot_and_it_is_less_sure():
    body = BodyTwist(0.3, 0.0, 0.5)
    with_gyro, without = Drive(body), Drive(body, gyro=False)
    with_gyro.go(402)
    without.go(402)
    turned = 0.5 * 401 * TICK_NS * 1e-9
    for drive in (with_gyro, without):
        assert drive.state.pose.heading_rad == pytest.approx(START.heading_rad + turned, abs=1e-3)
    assert math.isnan(without.yaw_rate)
    assert without.status.gyro_bias_rad_s == 0.0
    way_m = (0.3 + ROBOT.lever_m * 0.5) * 400 * TICK_NS * 1e-9
    assert without.status.sigma_heading_rad == pytest.approx(math.hypot(0.01, 0.02 * math.sqrt(way_m)), rel=1e-3)


def test_over_a_gap_in_the_measurements_the_encoders_are_believed():
    """A second without feedback in a turn: the gyro is known only at its ends, the counts cover all of it."""
    drive = Drive(BodyTwist(0.0, 0.0, 1.0), bias=0.7)
    drive.go(1)
    drive.tick += 199
    drive.go(1)
    assert drive.state.pose.heading_rad == pytest.approx(START.heading_rad + 1.0, abs=1e-3)


def test_when_fixes_stop_the_robot_is_degraded_then_lost_and_comes_back():
    drive = Drive(BodyTwist(1.0, 0.0, 0.0), wheels_sigma_m=0.1, lost_sigma_m=0.2)
    drive.go(101)
    assert (drive.status.health, drive.status.fix_age_ms) == (GOOD, 500.0)
    drive.go(1)
    assert drive.status.health == DEGRADED
    drive.go(1000)
    assert drive.status.health == LOST
    assert drive.status.sigma_position_m > 0.2
    believed = drive.state.pose
    drive.fix(drive.now_ns, believed)
    assert drive.status.health == GOOD
    assert drive.status.fix_age_ms == 0.0
    assert drive.status[-4:] == (drive.now_ns / 1e9, *believed), "the fix is recorded as it came"
    drive.go(1)
    assert all(map(math.isnan, drive.status[-4:])), "and only in the tick in which it came"


def test_a_start_that_is_not_known_waits_for_a_fix():
    drive = Drive(begin="fix")
    drive.go(50)
    assert drive.state is None
    assert drive.status.health == LOST
    elsewhere = Pose(40.0, -3.0, 2.0)
    drive.fix(drive.now_ns - 100_000_000, elsewhere)
    assert drive.state.pose == pytest.approx(elsewhere)
    assert drive.status.health == GOOD
    assert drive.estimator.fix_figures()["restarts"] == 0


def test_fixes_that_go_on_to_disagree_are_believed_after_the_streak_if_the_robot_may_be_there():
    """A slip of 2 m/s would not be noticed here."""
    drive = Drive(restart_after=5, slip_m_s=2.0)
    elsewhere = Pose(1.6, 0.3, -0.2)
    drive.go(100, fix_every=20, at=elsewhere)
    assert (drive.status.fix_restarts, drive.state.pose) == (0.0, START)
    drive.go(80, fix_every=20, at=elsewhere)
    assert drive.status.fix_restarts == drive.estimator.fix_figures()["restarts"] == 1
    assert drive.state.pose == pytest.approx(elsewhere, abs=1e-6)


def test_fixes_of_a_place_that_is_too_far_are_not_believed_and_the_robot_is_lost_until_others_come():
    """After three times as many as would be believed; one that agrees with wheels and gyro ends it."""
    drive = Drive(restart_after=5)
    drive.go(200, fix_every=20)
    drive.go(14 * 20, fix_every=20, at=Pose(100.0, 1.0, -1.0))
    assert (drive.status.health, drive.status.fixes_rejected) == (DEGRADED, 14)
    drive.go(20, fix_every=20, at=Pose(100.0, 1.0, -1.0))
    assert (drive.status.health, drive.status.fixes_rejected, drive.status.fix_restarts) == (LOST, 15, 0)
    assert drive.state.pose == pytest.approx(START, abs=1e-3)
    drive.go(20, fix_every=20)
    assert drive.status.health == GOOD


@pytest.mark.parametrize("off_m_s2", [1.0, 3.0, -30.0])
def test_an_accelerometer_that_is_suddenly_wrong_is_believed_until_fixes_refute_it(off_m_s2):
    """It contradicts wheels that hold, as it does when they slip: half a second later fixes have decided."""
    drive = Drive()
    drive.acceleration = 0.0, 0.0, 9.81
    drive.go(400, fix_every=20)
    drive.acceleration = off_m_s2, 0.0, 9.81
    drive.go(100, fix_every=20)
    assert drive.status.slip == 1.0
    drive.go(800, fix_every=20)
    for _ in range(1000):
        drive.go(1, fix_every=20)
        assert drive.state.pose == pytest.approx(START, abs=0.02)
        assert drive.state.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    drive.go(2000, fix_every=20)
    assert drive.status.slip == 0.0, "it is learnt as a bias, or a floor that leans"


def test_fixes_out_of_reach_are_counted_by_cause():
    drive = Drive(history_s=0.5)
    drive.go(301)
    drive.fix(drive.now_ns - 600_000_000)
    drive.fix(drive.now_ns + 200_000_000)
    drive.fix(drive.now_ns - 50_000_000)
    drive.fix(drive.now_ns - 50_000_000)
    assert drive.estimator.fix_figures() == {
        "accepted": 1,
        "rejected": 0,
        "too_late": 1,
        "double": 1,
        "ahead": 1,
        "restarts": 0,
    }
    assert drive.status.fixes_accepted == 1


def test_a_fix_of_a_moment_to_come_waits_for_it():
    drive = Drive()
    drive.go(1)
    drive.fix(drive.now_ns + 12_000_000)
    for _ in range(2):
        drive.go(1)
        assert drive.status.fixes_accepted == 0
    drive.go(1)
    assert drive.status.fixes_accepted == 1


def test_no_more_than_32_fixes_wait():
    drive = Drive()
    drive.go(1)
    for n in range(40):
        drive.fix(drive.now_ns + 1_000_000 + n)
    assert drive.estimator.fix_figures()["ahead"] == 8


def test_after_a_reset_of_the_robot_the_pose_goes_on_with_more_doubt():
    """Clock and encoders begin anew; the age of the newest fix goes on, the bias stays, and fixes are taken again."""
    drive = Drive(bias=0.01)
    drive.go(1000, fix_every=20)
    before, pose = drive.status, drive.state.pose
    drive.estimator.restart()
    drive.tick, drive.epoch_ns = -1, 40_000_000
    drive.go(1)
    assert drive.state.pose == pose
    assert drive.status.fix_age_ms == before.fix_age_ms
    assert drive.status.gyro_bias_rad_s == before.gyro_bias_rad_s
    assert drive.status.sigma_position_m > 0.1 > before.sigma_position_m
    drive.go(100, fix_every=20)
    assert drive.status.fixes_accepted == before.fixes_accepted + 4
    assert drive.status.sigma_position_m < 0.02


def test_a_restart_before_the_first_measurement_begins_at_the_start():
    drive = Drive()
    drive.estimator.restart()
    drive.go(1)
    assert drive.state.pose == START


def test_slip_makes_the_estimate_less_sure_of_its_place():
    sure, slipping = Drive(BodyTwist(0.5, 0.0, 0.0)), Drive(BodyTwist(0.5, 0.0, 0.0))
    fl, fr, rr, rl = slipping.speed
    slipping.speed = Wheels(fl + 20.0, fr + 20.0, rr, rl)
    for drive in (sure, slipping):
        drive.go(200)
    assert (sure.status.slip, slipping.status.slip) == (0.0, 1.0)
    assert slipping.status.sigma_position_m > 3 * sure.status.sigma_position_m


def rolling(body: BodyTwist, dt_s: float, gained=(0.0, 0.0)) -> Motion:
    forward, left, rate = (rate * dt_s for rate in body)
    return Motion(dt_s, forward, left, rate, rate, 0.0, *gained)


@given(
    st.builds(BodyTwist, st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)), st.sampled_from([0.001, 0.005, 0.02])
)
def test_a_robot_that_rolls_does_not_slip(body, dt_s):
    """Driving in a turn at a constant body twist: the accelerometer feels the centripetal acceleration and no more."""
    detector = SlipDetector(ROBOT.lever_m, 0.05)
    gained = (-body.yaw_rate_rad_s * body.left_m_s * dt_s, body.yaw_rate_rad_s * body.forward_m_s * dt_s)
    for _ in range(300):
        assert detector.update(rolling(body, dt_s, gained)) == 0.0


@pytest.mark.parametrize("dt_s", [0.001, 0.005, 0.01])
@pytest.mark.parametrize(
    "fault",
    [
        {"disagreement_m": 0.3},
        {"turned_rad": 0.3 / ROBOT.lever_m},
        {"gained_forward_m_s": 3.0},
        {"gained_left_m_s": -3.0},
    ],
)
def test_each_contradiction_is_slip_within_a_window_and_over_after_it(fault, dt_s):
    """A contradiction of 0.3 m/s, or of 3 m/s² for 0.1 s; its speed is told, and half the threshold ends it."""
    detector = SlipDetector(ROBOT.lever_m, 0.1)
    plain = rolling(AT_REST, dt_s, (0.0, 0.0))
    wrong = plain._replace(**{name: value * dt_s for name, value in fault.items()})
    for _ in range(round(0.1 / dt_s)):
        found = detector.update(wrong)
    assert 0.15 < found < 0.3
    for _ in range(round(0.6 / dt_s)):
        assert detector.update(plain) <= found
    assert not detector.is_slipping


def test_an_accelerometer_that_shakes_is_no_slip_and_four_wheels_that_spin_are_still_told():
    """Its contradiction has the size of the threshold: told at first, and next to never once that is usual."""
    detector, noise = SlipDetector(ROBOT.lever_m, 0.05), np.random.default_rng(1)
    for _ in range(12_000):  # a minute at rest, after which shaking is as new as at the start
        assert detector.update(rolling(AT_REST, 0.005, (0.0, 0.0))) == 0.0
    shaken = noise.normal(0.0, 0.015, (4000, 2))  # m/s within 5 ms, a deviation of 3 m/s²
    told = [detector.update(rolling(AT_REST, 0.005, gained)) > 0.0 for gained in shaken.tolist()]
    assert any(told[:400])
    assert sum(told[1000:]) < 10
    spinning = [detector.update(rolling(BodyTwist(1.5, 0.0, 0.0), 0.005, gained)) for gained in shaken[:40].tolist()]
    assert max(spinning) > 1.0


@pytest.mark.parametrize("intervals_ms", [[5], [5, 8], [5, 10], [4, 5, 6], [1], [20]])
def test_wheels_that_spin_up_are_told_whatever_the_intervals(intervals_ms):
    """All four gain 3 m/s², of which the accelerometer feels nothing: 0.15 m/s after 50 ms."""
    detector, passed_s = SlipDetector(ROBOT.lever_m, 0.05), 0.0
    for dt_s in [0.001 * one for one in intervals_ms] * round(100 / sum(intervals_ms)):
        found = detector.update(Motion(dt_s, 3.0 * (passed_s + 0.5 * dt_s) * dt_s, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        passed_s += dt_s
    assert found == pytest.approx(3.0 * 0.2 * -math.expm1(-0.1 / 0.2), rel=0.35)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lost_measurements_are_no_slip(seed):
    """One in twenty comes 40 ms late. By what was felt in the last 5 ms of them the robot would jump by 0.02 m/s."""
    detector, rng = SlipDetector(ROBOT.lever_m, 0.05), np.random.default_rng(seed)
    durations_s, felt_m_s2 = 0.005 * (1 + 8 * (rng.random(2000) < 0.05)), rng.normal(0.0, 0.7, 2001)
    means_m_s2 = 0.5 * (felt_m_s2[1:] + felt_m_s2[:-1])
    for dt_s, mean_m_s2 in zip(durations_s.tolist(), means_m_s2.tolist(), strict=True):
        assert detector.update(rolling(AT_REST, dt_s, (mean_m_s2 * dt_s, 0.0))) == 0.0


def test_a_gap_in_the_measurements_is_no_slip():
    """Before it the robot drove, after it the robot drives again: nobody knows how its velocity changed."""
    detector = SlipDetector(ROBOT.lever_m, 0.1)
    driving = rolling(BodyTwist(1.0, 0.0, 0.5), 0.005, (0.0, 0.0025))
    gap = driving._replace(dt_s=0.3, forward_m=0.05, turned_rad=0.03, gyro_rad=NAN, gained_forward_m_s=NAN)
    for motion in (*[driving] * 100, gap, *[driving] * 100):
        assert detector.update(motion) < 0.01


def test_without_gyro_and_accelerometer_the_rollers_alone_tell():
    detector = SlipDetector(ROBOT.lever_m, 0.1)
    motion = Motion(0.005, 0.0, 0.0, 0.1, NAN, 0.0, NAN, NAN)
    for _ in range(100):
        assert detector.update(motion) == 0.0
    for _ in range(100):
        found = detector.update(motion._replace(disagreement_m=0.001))
    assert found == pytest.approx(0.2, rel=0.1)
