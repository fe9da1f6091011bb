"""Fixes that come late or out of order, and steps that are replaced: the past is as if it had been so at first."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.history import History
from hil.estimation.kalman import Lasting, Priors, gate_of, start
from hil.estimation.motion_sums import MotionSums, Step
from tests.support.examples import share_of_examples
from tests.support.fused_world import (
    FIX_EVERY,
    LEG_NS,
    TICK_NS,
    TICK_S,
    TICKS,
    World,
    believed,
    history_of,
    in_time,
    model,
    moved_by,
    same,
)

SURE = Priors(1.0, 1e-6, 1e-6, 1e-9, 1e-9, 1e-9, 1e-9)


@share_of_examples(0.3)
@given(
    st.lists(st.integers(0, 80), min_size=TICKS // FIX_EVERY, max_size=TICKS // FIX_EVERY),
    st.integers(0, TICK_NS - 1),
    st.sampled_from([(), (Lasting(0.5, 0.3, 0.2),)]),
    st.randoms(),
)
def test_late_and_out_of_order_is_exactly_in_order(delays, apart_ns, lasting, chance):
    """Bit for bit, with gate and streak of rejections: fixes between the ticks, two of one instant, outliers."""
    world = World(3, lasting=lasting)
    wrong = world.fixes[4]
    world.fixes[4] = wrong._replace(pose=wrong.pose._replace(x_m=wrong.pose.x_m + 3.0))
    world.fixes = [fix._replace(time_ns=fix.time_ns - apart_ns) for fix in world.fixes]
    world.fixes[7] = world.fixes[7]._replace(time_ns=world.fixes[6].time_ns)
    late = [(min(at + delay, TICKS), fix) for (at, fix), delay in zip(in_time(world), delays, strict=True)]
    chance.shuffle(late)
    like = model(gate_of(0.999), 3, lasting)
    expected = believed(world, in_time(world), like)
    assert expected.rejected >= 1
    assert same(believed(world, late, like), expected)


def test_a_fix_between_two_measurements_is_taken_at_its_own_instant():
    """Driving at 1 m/s without turning, a perfect fix half way through the step says where the robot is at its end."""
    history = History(start(0, Pose(0.0, 0.0, 0.0), SURE, model()), 10**9, model())
    history.append(Step(0.02, 0.0, 0.0, TICK_S, 1e-12, 1e-12, 0.0), TICK_NS)
    fix = MeasuredPose(TICK_NS // 2, Pose(5.0, 1.0, 0.0), PoseCovariance(1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10))
    assert history.insert([fix]) == 0
    assert history.pose[:2] == pytest.approx((5.01, 1.0), abs=1e-6)
    assert history.insert([fix]) == 1, "the same fix again is no news"
    assert history.pose == pytest.approx(history.newest.pose)


@pytest.mark.parametrize("tick_ns", [TICK_NS, 7 * TICK_NS])
def test_the_past_is_as_long_as_asked_for_and_at_most_a_leg_and_a_tick_longer(tick_ns):
    history = History(start(0, Pose(0.0, 0.0, 0.0), SURE, model()), 10**9, model())
    for tick in range(1, 500):
        history.append(Step(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), tick * tick_ns)
        asked_ns = max(0, tick * tick_ns - 10**9)
        assert max(0, asked_ns - LEG_NS - 2 * tick_ns) <= history.begin_ns <= asked_ns


@given(st.integers(1, 25), st.integers(1, TICKS - 1))
@share_of_examples(0.3)
def test_steps_that_are_replaced_are_as_if_they_had_been_there_at_first(replaced, ticks):
    """With fixes among them, bit for bit; more steps than there are change those that are."""
    world = World(9)
    at_first, replacing = history_of(world), history_of(world)
    other = [
        step._replace(forward_m=2.0 * step.forward_m, is_rolled=False, disagreement_m=math.nan)
        for step in world.steps[:ticks]
    ]
    begin = max(0, ticks - replaced)
    for tick, step in enumerate(world.steps[:ticks], 1):
        at_first.append(step if tick <= begin else other[tick - 1], tick * TICK_NS)
        replacing.append(step, tick * TICK_NS)
        if tick % FIX_EVERY == 0:
            for history in (at_first, replacing):
                history.insert([world.fixes[tick // FIX_EVERY - 1]])
    surplus = [world.steps[0]] * max(0, replaced - ticks)
    replacing.replace([*surplus, *other[begin:]])
    assert same(replacing.newest, at_first.newest)


@given(st.integers(0, 10**6), st.floats(0.0, 1.0))
@share_of_examples(0.3)
def test_sums_of_motion_are_the_motions_one_by_one_and_a_step_may_be_split(seed, share):
    """With scales and bias off by as much as a leg may meet: 5 and 1 per cent, 0.05 rad/s."""
    world, sums = World(seed), MotionSums()
    state = np.add(world.first.mean, (0, 0, 0, 0.05, 0.01, -0.02, 0.05, 0.005, -0.005, 0.005))
    there = world.first._replace(mean=tuple(state.tolist()))
    for step in world.steps[:5]:
        sums.add(step, share)
        sums.add(step, 1.0 - share)
        state = moved_by(state, step)
    history = History(there, 10**9, model())
    history._legs[0].parts = [sums]
    assert history.pose == pytest.approx(state[:3], abs=2e-5)
