"""How much of the commanded acceleration a robot has: learnt from motion, and not from wheels that may slip."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.laws.adaptation import AccelerationShare

LARGEST_M_S2, TICK_S = 8.0, 0.005
BELIEVED_M_S2 = 0.3


def driven(share: float, friction_m_s2: float, *, limited_to_s: float = 0.0, seconds: float = 0.6) -> AccelerationShare:
    """Push to and fro with half of the largest acceleration; a limiter acts until ``limited_to_s``."""
    learns, speed = AccelerationShare(LARGEST_M_S2, BELIEVED_M_S2), 0.0
    learns.update((speed,), (0.0,), (0.0,), TICK_S, is_limited=False)
    for tick in range(round(seconds / TICK_S)):
        # Longer one way than the other, so that friction shows at a speed and not at rest.
        change = TICK_S * 0.5 * LARGEST_M_S2 * (1.0 if tick % 60 < 40 else -1.0)
        against = -math.copysign(1.0, speed) if speed else 0.0
        speed += share * change + TICK_S * friction_m_s2 * against
        learns.update((speed,), (change,), (TICK_S * against,), TICK_S, is_limited=tick * TICK_S < limited_to_s)
    return learns


@given(st.floats(0.5, 2.0), st.floats(0.0, 1.0))
def test_mass_and_friction_of_a_robot_that_rolls_are_learnt(share: float, friction_m_s2: float):
    learns = driven(share, friction_m_s2)
    assert learns.is_known
    assert learns.share == pytest.approx(share, rel=0.1)
    assert learns.friction == pytest.approx(friction_m_s2, abs=0.25)


@given(st.floats(0.7, 1.4), st.floats(0.8, 1.2), st.floats(0.0, math.tau))
def test_friction_of_pairs_of_wheels_is_learnt_whatever_way_the_robot_goes(
    share: float, friction_m_s2: float, way: float
) -> None:
    """Each pair has its own friction: on the way along one pair the whole has it once, between both √2 times."""
    learns, push = AccelerationShare(LARGEST_M_S2, BELIEVED_M_S2), (math.cos(way), math.sin(way))
    speeds = [0.0, 0.0]
    for tick in range(240):
        size = TICK_S * 0.5 * LARGEST_M_S2 * (1.0 if tick % 60 < 40 else -1.0)
        changes = tuple(size * one for one in push)
        rubbed = tuple(-TICK_S * math.tanh(one / 0.02) for one in speeds)
        learns.update((speeds[0], speeds[1]), changes, rubbed, TICK_S, is_limited=False)
        for axis, change in enumerate(changes):
            speeds[axis] += share * change + friction_m_s2 * rubbed[axis]
    assert learns.share == pytest.approx(share, rel=0.1)
    assert learns.friction == pytest.approx(friction_m_s2, abs=0.3)


@given(st.floats(0.01, 20.0), st.booleans())
def test_share_and_friction_stay_within_their_bounds_whatever_the_robot_does(share: float, is_limited: bool):
    learns = driven(share, 0.0, limited_to_s=1.0 if is_limited else 0.0)
    assert 0.45 <= learns.share <= 2.2
    assert learns.friction >= 0.0


@given(st.floats(-1.0, 1.0))
def test_what_little_torque_does_teaches_nothing(gained: float):
    learns = AccelerationShare(LARGEST_M_S2, BELIEVED_M_S2)
    for tick in range(200):
        learns.update((gained * tick,), (TICK_S * LARGEST_M_S2 / 7.0,), (0.0,), TICK_S, is_limited=False)
    assert (learns.share, learns.friction, learns.is_known) == (1.0, BELIEVED_M_S2, False)


@given(st.floats(0.5, 0.9))
def test_from_wheels_that_may_slip_no_heavier_robot_is_learnt_before_or_after(share: float):
    """Wheels that slip give less force than their torque stands for, and the limiter notices only some of it."""
    assert driven(share, 0.0, limited_to_s=0.01).share == 1.0
    heavy = driven(share, 0.0)
    assert heavy.share < 0.95
    heavy.update((0.0,), (0.0,), (0.0,), TICK_S, is_limited=True)
    assert (heavy.share, heavy.is_known) == (1.0, False)


@given(st.floats(1.2, 2.0))
def test_a_lighter_robot_is_learnt_even_while_a_limiter_acts(share: float):
    assert driven(share, 0.0, limited_to_s=1.0).share > 1.1


def test_a_robot_that_was_stopped_begins_anew():
    learns = driven(0.6, 0.5, limited_to_s=0.01)
    learns.reset()
    assert (learns.share, learns.friction, learns.is_known) == (1.0, BELIEVED_M_S2, False)


@pytest.mark.parametrize(("torque_share", "windows"), [(0.16, None), (0.17, 17), (0.5, 2), (0.64, 1), (0.62, 2)])
def test_it_is_known_from_windows_with_enough_torque(torque_share: float, windows: int | None):
    """Each window of 30 ms, here 8 ticks of 4 ms, adds the square of its share to 0.98 of the sum; 0.4 is enough."""
    learns, change = AccelerationShare(LARGEST_M_S2), torque_share * LARGEST_M_S2 * 0.03 / 8
    known = []
    for tick in range(8 * 20 + 1):
        learns.update((tick * change,), (change,), (0.0,), 0.004, is_limited=False)
        known.append(learns.is_known)
    assert known.count(False) == (len(known) if windows is None else 8 * windows)
