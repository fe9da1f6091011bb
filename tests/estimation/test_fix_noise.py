"""What is learnt of the noise of fixes, pair by pair, against ESTIMATORS.md's formula in matrices."""

import math
from itertools import pairwise

import numpy as np
import pytest

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.kalman import Belief, Lasting, Model, Priors, corrected, gate_of, matrix, moved, start
from hil.estimation.motion_sums import MotionSums, Step
from tests.support.fused_world import FIX_EVERY, OPEN_GATE, World, believed, in_time, model

TICK_NS = 20_000_000
FIRST = PoseCovariance(4e-4, 1e-4, 2e-5, 3e-4, -1e-5, 1e-4)
SECOND = PoseCovariance(2e-4, -5e-5, 1e-5, 6e-4, 3e-5, 2e-4)
NEVER = model(1e-12, 10**6, noise=16.0)  # no fix is accepted, so that each is compared with the last alone
HELD = Lasting(0.6, 2.0, 1.5)


def at_rest(sigma: float = 1e-3, like: Model = NEVER) -> Belief:
    return start(0, Pose(0.0, 0.0, 0.3), Priors(sigma, sigma, 0.0, 0.0, 0.0, 0.0, 0.0), like)


def seen(*poses: tuple[float, float, float], like: Model = NEVER) -> list[Belief]:
    """Return the beliefs of a robot at rest after each fix, of one every second."""
    belief, found = at_rest(like=like), []
    for number, pose in enumerate(poses, 1):
        now_ns = number * 10**9
        belief = corrected(belief._replace(time_ns=now_ns), MeasuredPose(now_ns, Pose(*pose), FIRST), like)
        found.append(belief)
    return found


@pytest.mark.parametrize("lasting", [(), (HELD,)], ids=["white", "held"])
def test_each_pair_changes_the_noise_by_its_distance_less_the_more_there_were(lasting) -> None:
    """d = vᵀ S⁻¹ v with S = λ (1 - c) (R₁ + R₂), 3 on average; λ ← λ exp((d / 3 - 1) / (20 + n)).

    c is the part of an error that is the same in both: 0.6 of the variance, of which e^{-1/2} is left after 1 of 2 s.
    """
    poses = [(5.0, 1.0, 0.3), (5.05, 0.98, 0.31), (5.0, 1.03, 0.28), (5.01, 1.02, 0.32)]
    changed, noise = 1.0 - 0.6 * math.exp(-0.5) * len(lasting), 1.0
    for number, (before, now) in enumerate(pairwise(poses)):
        apart = np.subtract(now, before)
        distance = apart @ np.linalg.solve(2.0 * noise * changed * matrix(FIRST), apart)
        noise *= math.exp((distance / 3.0 - 1.0) / (20.0 + number))
        belief = seen(*poses[: number + 2], like=NEVER._replace(lasting=lasting))[-1]
        assert (belief.noise, belief.pairs) == (pytest.approx(noise), number + 1)
        assert belief.rejected == number + 2
    assert noise > 1.0


@pytest.mark.parametrize("lasting", [(), (HELD,)], ids=["white", "held"])
def test_two_fixes_are_compared_over_the_robots_motion_as_it_is_seen_from_the_first(lasting) -> None:
    """The first fix stands turned by 0.8 rad: so is the way since, and its heading's error swings the way."""
    like = NEVER._replace(lasting=lasting)
    belief = corrected(at_rest(0.1, like), MeasuredPose(0, Pose(5.0, 1.0, 1.1), FIRST), like)
    sums = MotionSums()
    sums.add(Step(0.5, 0.2, 0.4, 0.0, 3e-4, 2e-4, 0.0, is_rolled=False))
    after = moved(belief, sums, TICK_NS, like)
    grown = (after.covariance - belief.covariance).diagonal()[:3]

    def led_to(pose: np.ndarray) -> np.ndarray:
        x, y, heading = pose
        c, s = math.cos(heading + 0.2), math.sin(heading + 0.2)
        return np.array([x + c * 0.5 - s * 0.2, y + s * 0.5 + c * 0.2, heading + 0.4])

    there, width = np.array([5.0, 1.0, 1.1]), 1e-6
    slope = np.array([(led_to(there + e) - led_to(there - e)) / (2.0 * width) for e in width * np.eye(3)]).T
    apart = np.array([0.03, -0.05, 0.02])
    pose = led_to(there) + apart + [0.0, 0.0, math.tau]  # a whole turn does not matter
    changed = 1.0 - 0.6 * math.exp(-0.02 / 2.0 - math.hypot(0.5, 0.2) / 1.5) * len(lasting)
    spread = changed * (matrix(SECOND) + slope @ matrix(FIRST) @ slope.T) + np.diag(np.maximum(grown, 0.0))
    expected = math.exp((apart @ np.linalg.solve(spread, apart) / 3.0 - 1.0) / 20.0)
    found = corrected(after, MeasuredPose(TICK_NS, Pose(*pose.tolist()), SECOND), like)
    assert found.noise == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("distance", "learns"), [(64.9, True), (65.1, False)])
def test_nothing_is_learnt_from_two_fixes_that_are_too_far_apart(distance: float, learns: bool) -> None:
    apart_m = math.sqrt(distance * 2.0 / np.linalg.inv(matrix(FIRST))[1, 1])
    assert (seen((5.0, 1.0, 0.3), (5.0, 1.0 + apart_m, 0.3))[-1].noise != 1.0) == learns


def test_what_is_learnt_stays_from_half_to_the_most_and_200_pairs_count() -> None:
    same = seen(*[(5.0, 1.0, 0.3)] * 230)
    assert same[-1].noise == 0.5
    assert (same[200].pairs, same[-1].pairs) == (200, 200)
    assert same[5].noise == pytest.approx(math.exp(-sum(1.0 / (20 + n) for n in range(5))))
    to_and_fro = [(5.0 + 0.2 * (number % 2), 1.0, 0.3) for number in range(60)]
    assert seen(*to_and_fro, like=NEVER._replace(noise=1.7))[-1].noise == 1.7


def test_less_noise_than_a_fix_tells_is_learnt_and_not_used_and_more_is() -> None:
    """Two beliefs that differ in the noise alone take the same fix."""
    fix, taken = MeasuredPose(TICK_NS, Pose(0.02, 0.0, 0.3), FIRST), NEVER._replace(gate=OPEN_GATE)
    belief = at_rest(0.02)._replace(time_ns=TICK_NS)
    by = {noise: corrected(belief._replace(noise=noise), fix, taken).mean[0] for noise in (0.5, 1.0, 2.0)}
    assert by[0.5] == by[1.0]
    gain = 4e-4 * np.linalg.inv(4e-4 * np.eye(3) + 2.0 * matrix(FIRST))
    assert by[2.0] == pytest.approx(0.02 * gain[0, 0])


def learning(world: World) -> Belief:
    """Return what is believed at the end when each fix comes in time, and their noise is learnt."""
    return believed(world, in_time(world), world.model._replace(gate=gate_of(0.999), noise=16.0))


@pytest.mark.parametrize("times", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("lasting", [(), (Lasting(0.5, 0.3, math.inf),)], ids=["white", "held"])
def test_how_noisy_fixes_are_is_learnt_from_them(times, lasting):
    """The noise is this factor times the reported one, in each of 300 fixes; the reported one is the least believed."""
    for seed in range(2):
        world = World(seed, ticks=300 * FIX_EVERY, lasting=lasting)
        quieter = PoseCovariance(*[entry / times**2 for entry in FIRST])
        world.fixes = [fix._replace(covariance=quieter) for fix in world.fixes]
        end = learning(world)
        assert math.sqrt(end.noise) == pytest.approx(times, rel=0.2)
        assert end.rejected < 30


def test_outliers_do_not_make_fixes_look_noisy():
    world = World(8, ticks=120 * FIX_EVERY)
    world.fixes[10::5] = [fix._replace(pose=fix.pose._replace(x_m=fix.pose.x_m + 1.0)) for fix in world.fixes[10::5]]
    end = learning(world)
    assert end.rejected == len(world.fixes[10::5])
    assert math.sqrt(end.noise) < 1.2
