"""The motion between two measurements: means of both ends, each wheel's own counts, and gaps."""

import math
from typing import NamedTuple

import pytest

from hil.core.types import Wheels
from hil.estimation.wheel_motion import MotionReader
from tests.support.closed_loop import PAPER_ROBOT

R, L = PAPER_ROBOT.wheel_radius_m, 0.6


class Measured(NamedTuple):
    robot_time_ns: int
    encoder_count: tuple[int, int, int, int] | None
    speed_rad_s: Wheels
    yaw_rate_rad_s: float
    acceleration_m_s2: tuple[float, float, float]


FIRST = Measured(5_000_000, (65_530, 3, 100, 40_000), Wheels(1.0, 2.0, 3.0, 4.0), 0.1, (1.0, 2.0, 9.8))
LATER = Measured(25_000_000, (10, 65_530, 90, 40_021), Wheels(3.0, 6.0, 9.0, 16.0), 0.3, (3.0, 6.0, 9.8))


def by_angles(fl: float, fr: float, rr: float, rl: float) -> tuple[float, ...]:
    """Return forward, left, turn, and how much further the front wheels rolled (the paper's equation 7)."""
    quarter = R / 4.0
    return (
        quarter * (fl + fr + rr + rl),
        quarter * (-fl + fr - rr + rl),
        quarter * (-fl + fr + rr - rl) / L,
        quarter * (fl + fr - rr - rl),
    )


def test_counts_give_the_way_the_shorter_way_around_and_rates_the_mean_of_both_ends() -> None:
    dt_s, forward, left, turned, gyro, apart, gained, gained_left = MotionReader(PAPER_ROBOT, 100).between(FIRST, LATER)
    rolled = by_angles(*(math.tau * counts / 100.0 for counts in (16, -9, -10, 21)))
    assert (forward, left, turned, apart) == pytest.approx(rolled)
    assert dt_s == pytest.approx(0.02)
    assert gyro == pytest.approx(0.2 * 0.02)
    assert (gained, gained_left) == pytest.approx((2.0 * 0.02, 4.0 * 0.02))


@pytest.mark.parametrize(("first", "later"), [(None, FIRST.encoder_count), (FIRST.encoder_count, None)])
def test_without_counts_at_both_ends_the_speeds_give_it(first: tuple[int, ...], later: tuple[int, ...]) -> None:
    before, after = FIRST._replace(encoder_count=first), LATER._replace(encoder_count=later)
    _, forward, left, turned, _, apart, *_ = MotionReader(PAPER_ROBOT, 1).between(before, after)
    assert (forward, left, turned, apart) == pytest.approx(by_angles(0.04, 0.08, 0.12, 0.2))


@pytest.mark.parametrize(("gap_ns", "known"), [(100_000_000, True), (100_000_001, False), (300_000_000, False)])
def test_over_more_than_a_tenth_of_a_second_rates_are_not_known_and_speeds_count_for_that_long(
    gap_ns: int, known: bool
) -> None:
    after = LATER._replace(robot_time_ns=FIRST.robot_time_ns + gap_ns, encoder_count=None)
    motion = MotionReader(PAPER_ROBOT, 100).between(FIRST, after)
    for rate, value in (("gyro_rad", 0.02), ("gained_forward_m_s", 0.2), ("gained_left_m_s", 0.4)):
        assert getattr(motion, rate) == pytest.approx(value if known else math.nan, nan_ok=True)
    assert motion.forward_m == pytest.approx(by_angles(0.2, 0.4, 0.6, 1.0)[0])
