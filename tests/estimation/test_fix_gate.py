"""Which fixes are believed: the gate, outliers alone and in bursts, restarts within reach, and bad covariances."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import chi2

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.kalman import LASTING, Lasting, corrected, gate_of, is_regular, matrix, moved, start
from hil.estimation.motion_sums import MotionSums, Step
from tests.support.examples import share_of_examples
from tests.support.fused_world import (
    FIX_COVARIANCE,
    FIX_EVERY,
    PRIORS,
    START,
    TICK_NS,
    World,
    believed,
    in_time,
    model,
    numbers,
)

ROUND = PoseCovariance(4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4)


@given(st.floats(0.5, 0.999999))
def test_the_gate_is_chi_squares(probability):
    assert gate_of(probability) == pytest.approx(chi2.ppf(probability, 3), rel=1e-6)


def test_the_gate_lets_through_as_many_right_fixes_as_it_says():
    """Of first fixes: a right one that is rejected leaves an error behind, and makes the next rejection likelier."""
    made, taken = 300, 0
    for seed in range(made):
        world = World(seed, ticks=FIX_EVERY)
        taken += believed(world, in_time(world), model(gate_of(0.9))).accepted
    assert abs(taken - 0.9 * made) < 4 * math.sqrt(made * 0.9 * 0.1)


def test_outliers_are_rejected_and_change_nothing():
    world = World(5)
    clean = believed(world, in_time(world), model(gate_of(0.9999)))
    wrong = [
        fix._replace(time_ns=fix.time_ns + 1, pose=fix.pose._replace(x_m=fix.pose.x_m + dx))
        for fix, dx in zip(world.fixes, itertools.cycle((1.0, -1.0, 2.0)))
    ]
    arrivals = in_time(world) + [(fix.time_ns // TICK_NS + 1, fix) for fix in wrong[:-1]]
    fouled = believed(world, arrivals, model(gate_of(0.9999), 3))
    assert (clean.rejected, fouled.rejected, fouled.restarts) == (0, len(wrong) - 1, 0)
    assert fouled.accepted == clean.accepted
    # A rejected fix splits its step in two, so the numbers differ by what the midpoint rule leaves.
    assert numbers(fouled) == pytest.approx(numbers(clean), abs=1e-5)


def elsewhere(world: World, first: int, dx: float, dy: float, turned: float) -> None:
    """From this one on the fixes are those of another place, in agreement with one another and with the motion."""
    c, s = math.cos(turned), math.sin(turned)
    x0, y0, _ = world.fixes[first].pose
    for number, fix in enumerate(world.fixes[first:], first):
        x, y, heading = fix.pose
        x, y = x - x0, y - y0
        pose = Pose(x0 + dx + c * x - s * y, y0 + dy + s * x + c * y, heading + turned)
        world.fixes[number] = fix._replace(pose=pose, covariance=ROUND)


@pytest.mark.parametrize("lasting", [(), (Lasting(0.5, 0.3, math.inf),)], ids=["white", "held"])
@given(st.floats(-math.pi, math.pi), st.floats(0.3, 0.9), st.sampled_from([-1.0, 1.0]))
@share_of_examples(0.3)
def test_a_robot_that_came_off_its_wheels_unnoticed_is_found_after_the_streak(lasting, direction, far, way):
    """Within the reach that the steps allow: 0.1 m in each tick since the last fix that was accepted, of 40 ticks."""
    world = World(6, lasting=lasting)
    dx, dy, turned = 4.0 * far * math.cos(direction), 4.0 * far * math.sin(direction), far * way * 4.0 / 0.6
    world.steps = [step._replace(erred_m=0.1) for step in world.steps]
    elsewhere(world, 4, dx, dy, turned)
    end = believed(world, in_time(world), model(gate_of(0.999), 4, lasting))
    assert (end.restarts, end.rejected, end.streak) == (1, 3, 0)
    assert np.subtract(end.pose[:2], world.fixes[-1].pose[:2]) == pytest.approx([0.0, 0.0], abs=0.06)
    assert math.remainder(end.mean[2] - world.fixes[-1].pose.heading_rad, math.tau) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(("dx", "turned"), [(106.0, 0.0), (0.3, 0.0), (0.0, 0.5)])
def test_fixes_of_a_place_that_the_robot_cannot_have_come_to_are_not_believed_however_many(dx, turned):
    """1 cm in 100 ticks is what wheels and gyro may have erred by."""
    world = World(6)
    plain = believed(world, in_time(world)[:4])
    elsewhere(world, 4, dx, 0.0, turned)
    end = believed(world, in_time(world), model(gate_of(0.999), 3))
    assert (end.restarts, end.rejected, end.streak) == (0, 6, 6)
    assert end.pose == pytest.approx(plain.pose, abs=1e-5)


def test_fixes_that_disagree_with_one_another_are_never_believed():
    world = World(7)
    world.steps = [step._replace(erred_m=10.0) for step in world.steps]
    world.fixes = [
        fix._replace(pose=fix.pose._replace(x_m=fix.pose.x_m + 3.0 + number))
        for number, fix in enumerate(world.fixes)
    ]  # fmt: skip
    end = believed(world, in_time(world), model(gate_of(0.999), 2))
    assert (end.accepted, end.restarts, end.streak) == (0, 0, 1)


def test_a_restart_believes_the_fix_alone_with_the_errors_that_it_may_have():
    """The pose errs as the fix does: by its whole noise, of which the part that lasts is known to be the same."""
    lasting = Lasting(0.5, 2.0, math.inf)
    like = model(lasting=[lasting])
    end = corrected(start(0, None, PRIORS, like), MeasuredPose(0, START, FIX_COVARIANCE), like)
    assert end.pose == START
    assert (end.is_known, end.restarts, end.accepted) == (True, 0, 1)
    root = math.sqrt(0.5) * np.linalg.cholesky(matrix(FIX_COVARIANCE))
    assert end.covariance[:3, :3] == pytest.approx(matrix(FIX_COVARIANCE))
    assert end.covariance[:3, LASTING:] == pytest.approx(-root)
    assert end.covariance[LASTING:, LASTING:] == pytest.approx(np.eye(3))


EXPONENTS = st.floats(-10.0, 6.0)
COVARIANCES = st.builds(
    lambda x, y, h, c, d, e: PoseCovariance(
        10**x, c * 10 ** ((x + y) / 2), d * 10 ** ((x + h) / 2), 10**y, e * 10 ** ((y + h) / 2), 10**h
    ),
    *[EXPONENTS] * 3,
    *[st.floats(-1.0, 1.0)] * 3,
)
ADVERSE = [
    PoseCovariance(1.147, 0, 0, 2.418e-9, 0.006976, 20124.4),
    PoseCovariance(1e-10, 0, 0, 1e-10, 0, 1e-10),
    PoseCovariance(724.25, 0, 0, 1.058e-10, -0.0037205, 130810.8),
]
_ROUND = PoseCovariance(0.1, 0.09843750000000001, 0.01976423537605237, 0.1, -0.05929270612815711, 1.0)


@given(st.lists(COVARIANCES, min_size=1, max_size=8), st.booleans(), st.sampled_from([(), (Lasting(1.0, 0.1, 1.0),)]))
@example(ADVERSE, False, ())
@example(ADVERSE, True, (Lasting(1.0, 0.1, 1.0),))
@example([_ROUND] * 2, True, ())
def test_no_sequence_of_covariances_makes_a_variance_negative_or_ends_the_run(covariances, moves, lasting):
    """Singular and impossible ones among them, which a message is refused for: the filter rejects them all the same."""
    like = model(16.0, 3, lasting, noise=16.0)
    belief = start(0, START, PRIORS, like)
    for number, covariance in enumerate(covariances, 1):
        if moves:
            sums = MotionSums()
            sums.add(Step(0.5, 0.1, 0.3, 0.01, 1e-6, 1e-6, 1e-8, True, 0.18, 1e-3))
            belief = moved(belief, sums, number * TICK_NS, like)
        x, y, heading = belief.pose
        belief = corrected(
            belief, MeasuredPose(belief.time_ns, Pose(x, y, heading + 1e-3 * (-1) ** number), covariance), like
        )
        assert np.isfinite(belief.mean).all()
        assert np.isfinite(belief.covariance).all()
        assert belief.covariance.diagonal().min() > 0.0


@given(st.floats(-math.pi, math.pi), COVARIANCES, st.floats(0.9, 1.1))
def test_whether_a_covariance_is_regular_does_not_depend_on_the_frame(angle, covariance, share):
    """0.5 m and 0.01 m, a corridor's, is good at every heading. The bound of what is left is exact."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def turned(one: PoseCovariance) -> PoseCovariance:
        return PoseCovariance(*(turn @ matrix(one) @ turn.T)[np.triu_indices(3)].tolist())

    assert is_regular(turned(PoseCovariance(0.25, 0.0, 0.0, 1e-4, 0.0, 1e-4)), 0.0025)
    of_heading = math.sqrt(1.0 - 0.0025 * share)
    leans = PoseCovariance(0.25, 0.0, of_heading * 0.5 * 0.01, 1e-4, 0.0, 1e-4)
    if abs(share - 1.0) > 1e-6:
        assert is_regular(turned(leans), 0.0025) == (share > 1.0)
    if is_regular(covariance, 0.01):
        assert is_regular(turned(covariance), 0.0099)
        assert np.linalg.eigvalsh(matrix(covariance)).min() > 0.0
