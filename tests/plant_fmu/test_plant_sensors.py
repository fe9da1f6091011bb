"""Encoders, gyro and accelerometer: counting and wrapping, noise from a seed, what an accelerometer feels."""

import math
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from tests.support.plant_oracle import G
from tests.support.plant_testbed import ANGLES, DEFAULTS, SLIP, VARIABLES, VOLTAGE, Robot, robot, slave, wheels

R = DEFAULTS["wheel_radius_m"]
COUNTS, INDEXES = wheels("count"), wheels("index")
GYRO = tuple(f"gyro.{axis}_rad_s" for axis in "xyz")
ACCELEROMETER = tuple(f"accelerometer.{axis}_m_s2" for axis in "xyz")
IMU = GYRO + ACCELEROMETER
NOISY = {"gyro_noise_rad_s": 0.02, "accelerometer_noise_m_s2": 0.3}


def wrapped(number: float) -> int:
    """Round down into a signed counter of 32 bits."""
    return (math.floor(number) + 2**31) % 2**32 - 2**31


def imu(start: Mapping[str, float], samples: int, step_s: float = 1e-3) -> np.ndarray:
    """Return so many readings of the six axes, one a step, of a robot that stands."""
    readings = []
    with robot(start) as plant:
        for _ in range(samples):
            readings.append(plant.read(IMU))
            plant.step(step_s)
    return np.array(readings)


@given(st.floats(-1e9, 1e9), st.integers(1, 2**24))
@example(2 * math.pi * 2**19, 4096)
@example(-2 * math.pi * (2**19 + 0.5), 4096)
@example(-1e-9, 4096)
@example(6.5e8, 2**24)
def test_counts_and_index_pulses_are_the_angle_rounded_down_and_wrapped(angle: float, counts: int) -> None:
    """One step at a constant speed brings the wheels to any angle, of either sign."""
    with robot(start_vx_m_s=angle * R * 1000, counts_per_revolution=counts) as plant:
        plant.step(1e-3)
        for name, reached in zip(wheels("count"), plant.read(ANGLES), strict=True):
            assert plant[name] == wrapped(reached / (2 * math.pi) * counts)
        for name, reached in zip(wheels("index"), plant.read(ANGLES), strict=True):
            assert plant[name] == wrapped(reached / (2 * math.pi))


def test_each_wheel_counts_its_own_way() -> None:
    """To the left: front right and rear left forward, the others backward; -0.5 counts is -1, rounded down."""
    with robot(start_vy_m_s=0.5) as plant:
        plant.step(1.0)
        turns = 0.5 / R / (2 * math.pi)
        expected = [math.floor(sign * turns * 4096) for sign in (-1, 1, -1, 1)]
        assert list(plant.read(COUNTS)) == expected
        assert list(plant.read(INDEXES)) == [math.floor(sign * turns) for sign in (-1, 1, -1, 1)]


def test_a_quiet_sensor_tells_the_truth() -> None:
    with robot(start_yaw_rate_rad_s=0.7) as plant:
        np.testing.assert_array_equal(plant.read(GYRO), [0.0, 0.0, 0.7])
        np.testing.assert_allclose(plant.read(ACCELEROMETER), [0.0, 0.0, G], atol=1e-15)


def test_noise_is_normal_white_and_independent_between_axes() -> None:
    """Twenty thousand samples: mean, deviation, distribution, correlation in time and between axes at 5 sigma."""
    n = 20_000
    noise = (imu(NOISY, n) - [0, 0, 0, 0, 0, G]) / ([0.02] * 3 + [0.3] * 3)
    assert np.abs(noise.mean(axis=0)).max() < 5 / math.sqrt(n)
    assert np.abs(noise.std(axis=0) - 1).max() < 5 / math.sqrt(2 * n)
    assert min(kstest(axis, "norm").pvalue for axis in noise.T) > 1e-5
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 5 / math.sqrt(n)
    for lag in (1, 2, 7, 100):
        assert np.abs(np.mean(noise[lag:] * noise[:-lag], axis=0)).max() < 5 / math.sqrt(n - lag)


@pytest.mark.parametrize("other", [2, 0, -1, 256, 2**31 - 1])
def test_seeds_give_independent_noise(other: int) -> None:
    """Of no lag of a hundred samples is the noise of one seed that of another, on any pair of axes."""
    n = 2000
    a, b = imu({**NOISY, "seed": 1}, n), imu({**NOISY, "seed": other}, n)
    a, b = (a - a.mean(axis=0)) / a.std(axis=0), (b - b.mean(axis=0)) / b.std(axis=0)
    for lag in range(100):
        assert np.abs(a[lag:].T @ b[: n - lag]).max() / (n - lag) < 6 / math.sqrt(n - lag)


def test_the_same_seed_gives_the_same_noise() -> None:
    np.testing.assert_array_equal(imu(NOISY, 50), imu(NOISY, 50))


def test_noise_does_not_depend_on_the_communication_step() -> None:
    """Readings at the same instants agree bit for bit, whether the steps between were long or short."""
    fine, coarse = imu(NOISY, 100), imu(NOISY, 10, 0.01)
    np.testing.assert_array_equal(fine[::10], coarse)


def test_noise_is_drawn_anew_at_its_own_rate() -> None:
    """At 100 Hz ten readings of a millisecond hear one sample."""
    readings = imu({**NOISY, "imu_rate_hz": 100.0}, 100)
    np.testing.assert_array_equal(readings, np.repeat(readings[::10], 10, axis=0))
    assert len(np.unique(readings[:, 0])) == 10


def test_noise_goes_on_before_time_zero() -> None:
    """A start time of -1 s is as good as any other: the noise before zero is not that after it."""
    with slave(initialised=False) as fmu:
        fmu.setupExperiment(startTime=-0.01)
        plant = Robot(fmu, -0.01)
        plant.set(NOISY)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        heard = []
        for n in range(20):
            heard.append(plant["gyro.x_rad_s"])
            plant.step(((n + 1) - 10) / 1000 - plant.time_s)
        assert len(set(heard)) == 20


def test_biases_are_added_each_to_its_axis() -> None:
    names = [f"gyro_bias_{axis}_rad_s" for axis in "xyz"] + [f"accelerometer_bias_{axis}_m_s2" for axis in "xyz"]
    values = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
    with robot(dict(zip(names, values, strict=True))) as plant:
        np.testing.assert_allclose(plant.read(IMU), [*values[:5], values[5] + G], atol=1e-14)
    assert all(VARIABLES[name].variability == "tunable" for name in names)


@pytest.mark.parametrize("rate", [0.7, -0.7])
def test_a_gyro_whose_scale_is_wrong_reads_so_much_more_of_the_rate_alone(rate: float) -> None:
    """Bias and noise are as large as those of a right one."""
    wrong = {"start_yaw_rate_rad_s": rate, "gyro_bias_z_rad_s": 0.1, **NOISY}
    with robot(wrong, gyro_scale=1.01) as plant, robot(wrong) as right:
        difference = plant.read(IMU) - right.read(IMU)
    np.testing.assert_allclose(difference, [0.0, 0.0, 0.01 * rate, 0.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("angles", [(0.1, 0.0, 0.0), (0.0, -0.2, 0.0), (0.05, -0.03, 0.2), (3.0, -1.0, 2.0)])
def test_sensors_that_are_mounted_askew_see_the_body_turned(angles: tuple[float, float, float]) -> None:
    """SciPy's rotation by roll, pitch and yaw about the body's axes takes what they read back to the body's."""
    moving = {"start_yaw_rate_rad_s": 0.7, "start_vx_m_s": 0.5, "gyro_bias_x_rad_s": 0.02, "slope_rad": 0.1}
    mounted = dict(zip(("imu_roll_rad", "imu_pitch_rad", "imu_yaw_rad"), angles, strict=True))
    with robot(moving) as plain, robot(moving | mounted) as plant:
        for each in (plain, plant):
            each.torque((0.5, 0.1, -0.2, 0.3))
        bias = np.array([0.02, 0.0, 0.0])
        turn = Rotation.from_euler("xyz", angles)
        assert turn.apply(plant.read(GYRO) - bias) == pytest.approx(plain.read(GYRO) - bias, abs=1e-14)
        assert turn.apply(plant.read(ACCELEROMETER)) == pytest.approx(plain.read(ACCELEROMETER), abs=1e-13)


def test_a_gyro_that_warms_up_drifts_evenly() -> None:
    with robot(gyro_drift_rad_s2=1e-3, gyro_bias_y_rad_s=0.2, start_yaw_rate_rad_s=0.5) as plant:
        plant.step(0.25, 10)
        assert plant.read(GYRO) == pytest.approx((2.5e-3, 0.2025, 0.5025), abs=1e-14)


def test_the_bias_of_a_gyro_wanders_as_a_random_walk() -> None:
    """At knots of 1/16 s, over 256 s: steps are normal, independent in time and between axes; so are sums of 64."""
    sigma, n = 0.01, 4096
    quick = {"longest_step_s": 0.01, "gyro_walk_rad_s": sigma}
    walk = imu(quick, n + 1, 1 / 16)[:, :3]
    assert not walk[0].any()
    for together in (1, 64):
        steps = np.diff(walk[::together], axis=0) / (sigma * math.sqrt(together / 16))
        count = len(steps)
        assert min(kstest(axis, "norm").pvalue for axis in steps.T) > 1e-5
        assert np.abs(steps.std(axis=0) - 1).max() < 5 / math.sqrt(2 * count)
        assert np.abs(np.corrcoef(steps.T) - np.eye(3)).max() < 5 / math.sqrt(count)
        for lag in (1, 2, 3, 7):
            assert np.abs(np.mean(steps[lag:] * steps[:-lag], axis=0)).max() < 5 / math.sqrt(count - lag)
    coarse = imu(quick, 5, 8.0)[:, :3]  # another way through the same time
    np.testing.assert_allclose(coarse, walk[: 4 * 128 + 1 : 128], rtol=1e-12)
    assert not np.array_equal(imu({**quick, "seed": 2}, 2, 1.0), imu(quick, 2, 1.0))


def test_an_encoder_counts_what_its_disc_shows() -> None:
    """One whose disc is off its centre by 0.02 rad, one that misses 3 % of its counts; index pulses stay."""
    start = {"wheel.fr.encoder_error_rad": 0.02, "wheel.rr.counts_factor": 0.97}
    with robot(start, start_vx_m_s=0.5) as plant:
        seen = []
        for _ in range(60):
            plant.step(0.03)
            angles = plant.read(ANGLES)
            shown = angles + np.array([0.0, 0.02, 0.0, 0.0]) * np.sin(angles)
            expected = np.floor(shown * np.array([1.0, 1.0, 0.97, 1.0]) * (4096 / (2 * math.pi)))
            np.testing.assert_array_equal(plant.read(COUNTS), expected)
            np.testing.assert_array_equal(plant.read(INDEXES), np.floor(angles / (2 * math.pi)))
            seen.append(plant.read(COUNTS))
    off = np.array(seen)[:, 1] - np.array(seen)[:, 0]
    assert (off.min(), off.max()) == pytest.approx((-13, 13), abs=1)  # 0.02 rad of 4096 counts


@pytest.mark.parametrize("start", [{}, {"com_x_m": 0.1, "drive": VOLTAGE}, {"contact": SLIP}], ids=str)
def test_the_accelerometer_feels_the_second_derivative_of_the_pose(start: dict[str, float]) -> None:
    """In the turning body frame, less gravity along the slope: centred differences of the true pose, 1e-5 m/s^2."""
    slope, direction, h = 0.1, 0.7, 5e-4
    level = {"slope_rad": slope, "slope_direction_rad": direction, "start_yaw_rate_rad_s": 1.0, "start_vx_m_s": 0.3}
    with robot(level | start, start_heading_rad=0.4) as plant:
        plant.torque([1.0, 0.4, -0.2, 0.7])
        plant.duty([0.1, 0.05, -0.02, 0.08])
        plant.step(0.02, 5)
        places, felt, heading = [], None, 0.0
        for n in range(5):
            places.append(complex(*plant.read(("pose.x_m", "pose.y_m"))))
            if n == 2:
                felt, heading = plant.read(ACCELEROMETER), plant["pose.heading_rad"]
            plant.step(h)
        p = np.array(places)
        second = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h**2)
        specific = (second + G * np.sin(slope) * np.exp(1j * direction)) * np.exp(-1j * heading)
        np.testing.assert_allclose(felt, [specific.real, specific.imag, G * np.cos(slope)], atol=1e-4)


def test_a_robot_at_rest_on_a_slope_feels_gravity_alone() -> None:
    """Held by its brakes, whichever way it looks: uphill is forward, so forward it feels g sin(slope)."""
    for heading in (0.0, 1.0, np.pi):
        start = {
            "slope_rad": 0.2,
            "slope_direction_rad": 1.0,
            "friction_coefficient": 2.0,
            "start_heading_rad": heading,
        }
        with robot(start) as plant:
            expected = [G * np.sin(0.2) * np.cos(1 - heading), G * np.sin(0.2) * np.sin(1 - heading), G * np.cos(0.2)]
            np.testing.assert_allclose(plant.read(ACCELEROMETER), expected, rtol=1e-12, atol=1e-12)


def test_a_robot_that_rolls_freely_down_feels_only_what_its_wheels_hold() -> None:
    """Of g sin(slope) the wheels' inertia holds k / (m + k)."""
    k = 4 * DEFAULTS["wheel_inertia_kg_m2"] / R**2
    with robot(slope_rad=0.2) as plant:
        held = k / (DEFAULTS["mass_kg"] + k) * G * np.sin(0.2)
        assert plant["accelerometer.x_m_s2"] == pytest.approx(held, rel=1e-12)
