"""Slip detection against its equations: sums over the past that fade with time, by NumPy."""

import numpy as np
import pytest

from firmware_protocol.generated.messages import State
from hil.core.model import RobotModel
from hil.core.types import Wheels
from hil.estimation.slip import SlipDetector
from hil.estimation.wheel_motion import Motion, MotionReader
from hil.robot.snapshot import Feedback

LEVER_M, THRESHOLD_M_S = 0.55, 0.1
STILL = Motion(0.005, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def faded(times_s: np.ndarray, differences: np.ndarray, window_s: float) -> float:
    """Return the sum of differences, each less the longer ago its interval began; ``times_s`` are the ends of all."""
    begins_s = np.concatenate([[0.0], times_s[:-1]])
    return float(np.exp((begins_s - times_s[-1]) / window_s) @ differences)


@pytest.mark.parametrize("seed", range(4))
def test_the_speed_of_slip_is_the_largest_contradiction_over_its_window(seed: int) -> None:
    """Wheels against each other and the gyro over 0.1 s, against the accelerometer over 0.2 s; biases are taken off."""
    chance = np.random.default_rng(seed)
    size = np.array([[0.0, 1e-3, 1e-3], [1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [1.0, 1.0, 1.0]][seed])
    detector, gyro_bias, (bias_forward, bias_left) = SlipDetector(LEVER_M, 1e-9), 0.07, (0.4, -0.9)
    dt_s = chance.uniform(0.005, 0.006, 60)
    forward, left, turned, gyro = (chance.normal(0.0, 5e-3, 60) for _ in range(4))
    apart, off_gyro, shaken = size[:, None] * chance.normal(0.0, 1.0, (3, 60))
    turned = gyro - gyro_bias * dt_s - off_gyro / LEVER_M
    speeds = np.stack([forward / dt_s, left / dt_s])
    felt = np.diff(speeds, axis=1, prepend=speeds[:, :1])
    true_gyro = gyro - gyro_bias * dt_s
    gained = felt[0] + bias_forward * dt_s - true_gyro * speeds[1] + shaken
    gained_left = felt[1] + bias_left * dt_s + true_gyro * speeds[0] - 2.0 * shaken
    for number in range(60):
        motion = Motion(*map(float, (
            dt_s[number], forward[number], left[number], turned[number], gyro[number], apart[number],
            gained[number], gained_left[number],
        )))  # fmt: skip
        found = detector.update(motion, gyro_bias, (bias_forward, bias_left))
        past = slice(number + 1)
        times_s = np.cumsum(dt_s)[past]
        compared = np.where(np.arange(number + 1) > 0, shaken[past], 0.0)  # the first has none before it
        expected = [
            abs(faded(times_s, apart[past], 0.1)) / 0.1,
            abs(faded(times_s, off_gyro[past], 0.1)) / 0.1,
            np.sqrt(5.0) * abs(faded(times_s, compared, 0.2)),
        ]
        assert found == pytest.approx(max(expected), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("times", [1.5, 4.0])
@pytest.mark.parametrize("field", ["disagreement_m", "turned_rad", "gained_forward_m_s", "gained_left_m_s"])
def test_slip_begins_above_its_threshold_and_ends_below_half_of_it(field: str, times: float) -> None:
    """That of the accelerometer is four times its usual size, learnt over 5 s; an interval counts as at most twice."""
    inertial = field.startswith("gained")
    window_s, unit = (0.2, 1.0) if inertial else (0.1, {"turned_rad": LEVER_M}.get(field, 1.0) / 0.1)
    sizes = np.where(np.arange(60) % 60 < 15, times * THRESHOLD_M_S / 10.0, 0.0)
    detector, usual, slips = SlipDetector(LEVER_M, THRESHOLD_M_S), (THRESHOLD_M_S / 4.0) ** 2, False
    detector.update(STILL)
    for number, size in enumerate(sizes.tolist()):
        detector.update(STILL._replace(**{field: size / unit}))
        found = faded(0.005 * np.arange(1, number + 2), sizes[: number + 1], window_s)
        if inertial:
            usual += 0.005 / 5.0 * (min(found**2, 4.0 * usual) - usual)
            usual = max(usual, (THRESHOLD_M_S / 4.0) ** 2)
        begin = 4.0 * np.sqrt(usual) if inertial else THRESHOLD_M_S
        slips = found > begin * (0.5 if slips else 1.0)
        assert detector.is_slipping == slips, number


def test_short_measurements_are_compared_as_one_of_5_ms() -> None:
    apart, together = (SlipDetector(LEVER_M, 1e-9) for _ in range(2))
    piece = Motion(0.001, 2e-4, -1e-4, 3e-4, 1e-4, 2e-5, 0.01, 0.02)
    for _ in range(30):
        parts = [apart.update(piece) for _ in range(5)]
        whole = together.update(Motion(*(5.0 * value for value in piece)))
        assert parts[-1] == pytest.approx(whole, rel=1e-9)
        assert len(set(parts[:-1])) == 1, "between them it is the last one"


@pytest.mark.parametrize(
    ("gap_s", "next_s", "is_compared"),
    [(0.0, 0.0074, True), (0.0, 0.0076, False), (1.0, 0.0077, True), (1.0, 0.00775, False)],
)
def test_of_an_interval_more_than_half_as_long_again_as_usual_measurements_were_lost(
    gap_s: float, next_s: float, is_compared: bool
) -> None:
    """The usual one is the mean of 100, of which a gap counts as four."""
    detector = SlipDetector(LEVER_M, THRESHOLD_M_S)
    for _ in range(300):
        detector.update(STILL)
    if gap_s:
        detector.update(STILL._replace(dt_s=gap_s))
        detector.update(STILL._replace(dt_s=0.0051505))  # the mean stays
    found = detector.update(STILL._replace(dt_s=next_s, gained_left_m_s=1.0))
    assert (found > 0.9) == is_compared
    assert found in (0.0, pytest.approx(np.exp(-next_s / 0.2)))


def test_a_restart_forgets_slip_and_what_was_before() -> None:
    used, fresh = SlipDetector(LEVER_M, THRESHOLD_M_S), SlipDetector(LEVER_M, THRESHOLD_M_S)
    for _ in range(20):
        used.update(Motion(0.005, 0.01, 0.02, 0.1, 0.0, 0.01, 1.0, 2.0))
    used.update(STILL._replace(dt_s=0.001, forward_m=1.0))
    assert used.is_slipping
    used.restart()
    assert not used.is_slipping
    for motion in (STILL, STILL._replace(forward_m=1e-5), STILL._replace(dt_s=0.02, gained_left_m_s=1.0), STILL):
        assert used.update(motion) == fresh.update(motion)


@pytest.mark.parametrize("counts", [64, 256, 1024, 8192])
@pytest.mark.parametrize(("radius_m", "dt_s"), [(0.03, 0.005), (0.075, 0.01), (0.2, 0.05)])
def test_wheels_that_roll_do_not_slip_however_coarse_their_encoders_are(
    counts: int, radius_m: float, dt_s: float
) -> None:
    """A robot that speeds up and turns, by the exact angles of its wheels cut to counts; then one wheel spins."""
    model = RobotModel(20.0, 0.56, radius_m, 0.3, 0.3, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)
    reader = MotionReader(model, counts)
    detector, zero = SlipDetector(model.lever_m, 0.05, reader.count_m), Wheels(0.0, 0.0, 0.0, 0.0)
    last = Feedback(0, State.ACTIVE, 0, 0, (0, 0, 0, 0), zero, zero, (0.0, 0.0, 9.81), 0.0)
    begin = np.random.default_rng(counts).uniform(0.0, 1.0, 4)  # of a count
    for t_s in np.arange(dt_s, 6.0, dt_s):
        # Forward, and half of it to the left; from 5 s on the front left rim goes 3 m/s faster.
        way_m, forward_m_s2 = 0.5 * (t_s - 2.0 * np.sin(0.5 * t_s)), 0.25 * np.sin(0.5 * t_s)
        rims_m = np.array([0.5 * way_m + 3.0 * max(t_s - 5.0, 0.0), 1.5 * way_m, 0.5 * way_m, 1.5 * way_m])
        fl, fr, rr, rl = (int(one) & 0xFFFF for one in np.floor(rims_m / reader.count_m + begin))
        felt = float(forward_m_s2), float(0.5 * forward_m_s2), 9.81
        measured = last._replace(robot_time_ns=round(t_s * 1e9), encoder_count=(fl, fr, rr, rl), acceleration_m_s2=felt)
        detector.update(reader.between(last, measured))
        last = measured
        assert not detector.is_slipping or t_s > 5.0
        assert detector.is_slipping or t_s < 5.5
