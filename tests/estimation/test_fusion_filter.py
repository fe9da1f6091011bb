"""The filter against oracles of its own: a textbook's in NumPy, SciPy over the whole past, chi-square."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2

from hil.core.types import MeasuredPose, Pose
from hil.estimation.kalman import Lasting, corrected, matrix, moved, position_sigma_m, start
from hil.estimation.motion_sums import MotionSums, Step
from tests.support.examples import share_of_examples
from tests.support.fused_world import (
    FIX_COVARIANCE,
    FIX_EVERY,
    LEG_NS,
    PRIORS,
    ROLLED_M,
    STATES,
    TICK_NS,
    TICKS,
    Array,
    World,
    believed,
    by_textbook,
    history_of,
    in_time,
    model,
    moved_by,
    numbers,
)

HELD = Lasting(0.5, 0.3, math.inf)
MAP = Lasting(0.3, math.inf, 0.2)


@share_of_examples(0.3)
@given(
    st.integers(0, 10**6),
    st.booleans(),
    st.sampled_from([(), (HELD,), (MAP,), (HELD, MAP)]),
    st.lists(st.integers(0, 60), min_size=TICKS // FIX_EVERY, max_size=TICKS // FIX_EVERY),
)
def test_the_filter_is_the_textbooks(seed, gyro, lasting, late):
    """Its sums of motion are linear in scales and bias: what differs is of second order in what they are off."""
    world = World(seed, gyro=gyro, lasting=lasting)
    arrivals = [(min(at + delay, TICKS), fix) for (at, fix), delay in zip(in_time(world), late, strict=True)]
    end, book = believed(world, arrivals), by_textbook(world)
    sigma = np.sqrt(book.p.diagonal())
    assert (numbers(end) - book.state) / sigma == pytest.approx(np.zeros(len(sigma)), abs=0.05)
    assert end.covariance / np.outer(sigma, sigma) == pytest.approx(book.p / np.outer(sigma, sigma), abs=0.02)


def test_the_filter_is_near_the_most_likely_past_of_all():
    """SciPy finds all states at once from all measurements; the filter, which linearises as it goes, ends beside it.

    The unknowns are the six calibrations, which do not change, and then four numbers of each tick.
    """
    world = World(2)
    roots = [np.sqrt([s.position_m2, s.position_m2, s.heading_rad2, s.bias_rad2_s2]) for s in world.steps]
    whitener = np.linalg.inv(np.linalg.cholesky(matrix(FIX_COVARIANCE)))
    prior = np.sqrt(world.first.covariance.diagonal())
    per_leg = LEG_NS // TICK_NS
    legs = [world.steps[begin : begin + per_leg] for begin in range(0, TICKS, per_leg)]
    rolled = [leg for leg in legs if all(step.is_rolled for step in leg)]

    def residuals(flat: Array) -> Array:
        states = np.column_stack([flat[6:].reshape(TICKS + 1, 4), np.tile(flat[:6], (TICKS + 1, 1))])
        parts = [(states[0] - numbers(world.first)) / prior]
        for before, after, step, root in zip(states, states[1:], world.steps, roots, strict=False):
            parts.append((after - moved_by(before, step))[:4] / root)
        for fix in world.fixes:
            miss = states[fix.time_ns // TICK_NS][:3] - np.array(fix.pose)
            miss[2] = math.remainder(miss[2], math.tau)
            parts.append(whitener @ miss)
        for leg in rolled:
            ways = np.sum([(step.yaw_m, step.left_m, step.forward_m) for step in leg], axis=0)
            off = sum(step.disagreement_m for step in leg) + ways @ flat[3:6]
            parts.append(np.array([off / math.sqrt(1e-8 + (ROLLED_M * np.abs(ways).sum()) ** 2)]))
        return np.concatenate(parts)

    guess = [numbers(world.first)]
    for step in world.steps:
        guess.append(moved_by(guess[-1], step))
    band = np.zeros((STATES + 4 * TICKS + 3 * len(world.fixes) + len(rolled), 6 + 4 * (TICKS + 1)))
    band[:, :6] = 1
    band[:STATES, 6:10] = 1
    for tick in range(TICKS):
        band[STATES + 4 * tick : STATES + 4 + 4 * tick, 6 + 4 * tick : 14 + 4 * tick] = 1
    for row, fix in enumerate(world.fixes):
        at = 6 + 4 * (fix.time_ns // TICK_NS)
        band[STATES + 4 * TICKS + 3 * row :, at : at + 4][:3] = 1
    first = np.concatenate([numbers(world.first)[4:], np.array(guess)[:, :4].ravel()])
    found = least_squares(residuals, first, jac_sparsity=band, x_scale="jac").x
    best = np.array([*found[-4:], *found[:6]])
    end = believed(world, in_time(world))
    sigma = np.sqrt(end.covariance.diagonal())
    assert abs(numbers(end) - best) / sigma == pytest.approx(np.zeros(STATES), abs=0.1)


@pytest.mark.parametrize("lasting", [(), (HELD,), (MAP,)], ids=["white", "held", "map"])
def test_the_errors_are_as_large_as_the_covariance_says(lasting):
    """Normalised squared errors of the pose over 60 seeds: their sum is chi-square distributed, 3 degrees each.

    And of all states of one seed, so that none is believed too little.
    """
    pose, whole, seeds = 0.0, 0.0, 60
    for seed in range(seeds):
        world = World(seed, lasting=lasting)
        end = believed(world, in_time(world))
        error = numbers(end) - world.truth
        pose += error[:3] @ np.linalg.solve(end.covariance[:3, :3], error[:3])
        whole += error @ np.linalg.solve(end.covariance, error)
    for total, degrees in ((pose, 3 * seeds), (whole, (STATES + 3 * len(lasting)) * seeds)):
        assert chi2.ppf(0.001, degrees) < total < chi2.ppf(0.999, degrees)


def test_wheels_that_differ_are_found_by_the_wheels_alone():
    """Where a robot drives, turns and goes aside, front against rear wheels tells three differences; slip does not."""
    world = World(11, ticks=600, slips=False)
    end = believed(world, [])
    sigma = np.sqrt(end.covariance.diagonal())[7:10]
    assert (sigma < 0.2 * PRIORS.differ / 2).all()
    assert (abs(numbers(end) - world.truth)[7:10] < 4 * sigma).all()
    slipped = history_of(world)
    for tick, step in enumerate(world.steps, 1):
        slipped.append(step._replace(disagreement_m=0.01), tick * TICK_NS)
    assert numbers(slipped.newest)[7:10] == pytest.approx(np.zeros(3), abs=0)


@given(st.lists(st.floats(-1, 1), min_size=100, max_size=100), st.floats(-4, 4), st.floats(-0.1, 0.1))
@share_of_examples(0.3)
def test_a_covariance_stays_one(entries, heading, turned):
    root = np.array(entries).reshape(STATES, STATES)
    plain = model()
    belief = start(0, Pose(0.0, 0.0, heading), PRIORS, plain)._replace(covariance=root @ root.T + 1e-6 * np.eye(STATES))
    sums = MotionSums()
    sums.add(Step(0.05, -0.02, turned, 0.01, 1e-6, 1e-6, 1e-8, True, 0.6 * turned, 1e-4))
    after = moved(belief, sums, TICK_NS, plain)
    fix = MeasuredPose(TICK_NS, after.pose, FIX_COVARIANCE)
    for one in (after, corrected(after, fix, plain)):
        assert np.linalg.eigvalsh(one.covariance).min() > 0.0
        worst = np.linalg.eigvalsh(one.covariance[:2, :2]).max()
        assert position_sigma_m(one.covariance) == pytest.approx(math.sqrt(worst))
