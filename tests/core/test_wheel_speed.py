"""What a coarse encoder adds to a wheel's speed: the firmware's filter in C on any motion, and the limiter."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.core.model import RobotModel
from hil.core.motion_limits import MotionLimits, slip_band
from hil.core.types import Pose, State, Twist, Wheels
from hil.core.wheel_speed import FINE_COUNTS, WheelSpeed, slower
from tests.support.bare_node import core
from tests.support.wheel_rig import PARAMETERS

TICK_S = 0.001
encoders = st.builds(
    WheelSpeed, st.sampled_from([64, 100, 256, 1000, 8192]), st.sampled_from([20.0, 60.0, 150.0, 400.0])
)
periods = st.sampled_from([0.001, 0.005, 0.01, 0.02, 0.05])


def filtered(speed: WheelSpeed, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the speeds [rad/s] of the firmware's filter behind the encoder, and of one behind the angle itself."""
    ffi, lib = core()
    changes = {
        "counts_per_revolution": float(speed.counts_per_revolution),
        "tracking_bandwidth_rad_s": speed.bandwidth_rad_s,
    }
    block, tracker = ffi.new("wheel_parameters *", PARAMETERS | changes), ffi.new("wheel_tracker *")
    counts = np.floor(angle_rad * speed.counts_per_revolution / math.tau).astype(int)
    behind = np.array([lib.wheel_tracker_update(tracker, int(count) & 0xFFFF, block) for count in counts])
    w, position, rate, exact = speed.bandwidth_rad_s, angle_rad[0], 0.0, []
    for angle in angle_rad:
        position += rate * TICK_S
        error = angle - position
        position += 2.0 * w * TICK_S * error
        rate += w * w * TICK_S * error
        exact.append(rate)
    return behind, np.array(exact)


@settings(max_examples=60)
@given(encoders, periods, st.integers(0, 2**32 - 1), st.floats(0.01, 30.0))
@example(WheelSpeed(64, 150.0), 0.005, 1, 2.3)
def test_no_motion_of_a_wheel_adds_more_to_its_speed_or_to_a_change_of_it(
    speed: WheelSpeed, period_s: float, seed: int, size_rad_s: float
) -> None:
    chance = np.random.default_rng(seed)
    turns_rad_s = np.clip(chance.normal(size_rad_s, size_rad_s, 60), -100.0, 100.0)
    angle_rad = 7.0 + np.cumsum(turns_rad_s.repeat(25)) * TICK_S
    behind, exact = filtered(speed, angle_rad)
    # Both filters begin at the count; the first half count of error is one more step.
    added = (behind - exact)[-1000:]
    single = 1e-4 + 1e-4 * np.abs(exact).max()  # binary32
    assert np.abs(added).max() <= speed.noise_rad_s + single
    apart = round(period_s / TICK_S)
    assert np.abs(added[apart:] - added[:-apart]).max() <= speed.noise_of_change_rad_s(period_s) + single


@pytest.mark.parametrize("bandwidth_rad_s", [30.0, 150.0, 500.0])
def test_a_wheel_that_goes_to_and_fro_by_a_count_comes_near_to_the_bound(bandwidth_rad_s: float) -> None:
    """So it is not far too wide: a wheel that rocks about the edge of a count at the filter's own pace."""
    speed, most = WheelSpeed(256, bandwidth_rad_s), 0.0
    for rate in np.geomspace(0.3, 3.0, 12) * bandwidth_rad_s:
        edge = 100.0 * math.tau / 256
        angle_rad = edge + 1e-4 * np.sin(rate * np.arange(3000) * TICK_S + 0.1)
        behind, exact = filtered(speed, angle_rad)
        most = max(most, float(np.abs(behind - exact)[1000:].max()))
    assert 0.5 * speed.noise_rad_s < most <= speed.noise_rad_s


@settings(max_examples=40)
@given(
    st.sampled_from([64, 128, 256, 512, 1024, 4096, 8192]),
    st.sampled_from([0.005, 0.01, 0.02, 0.05]),
    st.sampled_from([0.03, 0.075, 0.2]),
    st.sampled_from([0.1, 0.3, 1.0]),
    st.integers(0, 2**32 - 1),
)
@example(256, 0.005, 0.075, 0.3, 1)
def test_wheels_that_roll_keep_their_torque_however_coarse_their_encoders_are(
    counts: int, period_s: float, radius_m: float, slip_m_s: float, seed: int
) -> None:
    """Speeds as the firmware measures them while the robot goes ahead at up to 2 m/s, evenly: what is left is noise."""
    speed = WheelSpeed(counts)
    model = RobotModel(20.0, 0.56, radius_m, 0.3, 0.3, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=60.0)
    limits = MotionLimits(model, period_s, slip_m_s, "off", speed)
    forward_m_s = float(np.random.default_rng(seed).uniform(0.05, 2.0))
    behind, _ = filtered(speed, 3.0 + forward_m_s / radius_m * TICK_S * np.arange(1500))
    state = State(Pose(0.0, 0.0, 0.0), Twist(forward_m_s, 0.0, 0.0))
    for at in range(500, 1500, round(period_s / TICK_S)):
        measured = Wheels(*[float(behind[at])] * 4)
        assert not limits.is_near(measured, at * 1_000_000, state, 0.005, 0.0)


@given(encoders, periods, st.floats(0.05, 2.0), st.floats(0.03, 0.2))
def test_the_band_of_slip_is_that_of_the_scenario_unless_the_encoder_is_too_coarse(
    speed: WheelSpeed, period_s: float, slip_m_s: float, radius_m: float
) -> None:
    begin_m_s, end_m_s, blind_m_s = slip_band(slip_m_s, radius_m, speed, period_s)
    assert begin_m_s == max(0.5 * slip_m_s, radius_m * speed.noise_rad_s)
    assert end_m_s - begin_m_s == pytest.approx(0.5 * slip_m_s)
    assert blind_m_s >= 0.0
    finer = slip_band(slip_m_s, radius_m, speed._replace(counts_per_revolution=32768), period_s)
    assert finer.begin_m_s <= begin_m_s
    assert finer.blind_m_s <= blind_m_s


@pytest.mark.parametrize(("counts", "factor"), [(64, 0.3299), (128, 0.4353), (512, 0.7579), (1024, 1.0), (4096, 1.0)])
def test_filter_and_speed_loop_are_slower_by_a_power_of_what_an_encoder_lacks(counts: int, factor: float) -> None:
    assert slower(counts) == pytest.approx(factor, abs=1e-4)
    assert FINE_COUNTS == 1024
    assert WheelSpeed(counts, 150.0 * factor).lag_s == pytest.approx(0.0133 / factor)
