"""What is learnt of the noise of fixes, pair by pair, against ESTIMATORS.md's formula in matrices."""

import math
from itertools import pairwise

import numpy as np
import pytest

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.kalman import Acceptance, Belief, Step, corrected, moved, start

TICK_NS = 20_000_000
FIRST = PoseCovariance(4e-4, 1e-4, 2e-5, 3e-4, -1e-5, 1e-4)
SECOND = PoseCovariance(2e-4, -5e-5, 1e-5, 6e-4, 3e-5, 2e-4)
NEVER = Acceptance(1e-12, 10**6, 0.0, 16.0)  # no fix is accepted, so that each is compared with the last alone


def matrix(covariance: PoseCovariance) -> np.ndarray:
    full = np.zeros((3, 3))
    full[np.triu_indices(3)] = covariance
    return full + np.triu(full, 1).T


def seen(*poses: tuple[float, float, float], acceptance: Acceptance = NEVER) -> list[Belief]:
    """Return the beliefs of a robot at rest after each fix."""
    belief, found = start(0, Pose(0.0, 0.0, 0.3), 1e-3, 1e-3, 0.0, 0.0), []
    for number, pose in enumerate(poses, 1):
        belief = corrected(belief._replace(time_ns=number), MeasuredPose(number, Pose(*pose), FIRST), acceptance)
        found.append(belief)
    return found


def test_each_pair_changes_the_noise_by_its_distance_less_the_more_there_were() -> None:
    """d = vᵀ S⁻¹ v with S = λ (R₁ + R₂), 3 on average; λ ← λ exp((d / 3 - 1) / (20 + n))."""
    poses = [(5.0, 1.0, 0.3), (5.05, 0.98, 0.31), (5.0, 1.03, 0.28), (5.01, 1.02, 0.32)]
    noise = 1.0
    for number, (before, now) in enumerate(pairwise(poses)):
        apart = np.subtract(now, before)
        distance = apart @ np.linalg.solve(2.0 * noise * matrix(FIRST), apart)
        noise *= math.exp((distance / 3.0 - 1.0) / (20.0 + number))
        belief = seen(*poses[: number + 2])[-1]
        assert (belief.noise, belief.pairs) == (pytest.approx(noise), number + 1)
        assert belief.rejected == number + 2
    assert noise > 1.0


def test_two_fixes_are_compared_over_the_robots_motion_as_it_is_seen_from_the_first() -> None:
    """The first fix stands turned by 0.8 rad: so is the way since, and its heading's error swings the way."""
    belief = start(0, Pose(0.5, -0.3, 0.3), 0.1, 0.1, 0.0, 0.0)
    first = MeasuredPose(0, Pose(5.0, 1.0, 1.1), FIRST)
    belief = corrected(belief, first, NEVER)
    step = Step(0.5, 0.2, 0.4, 0.0, 3e-4, 2e-4, 0.0)
    after = moved(belief, step, TICK_NS)
    grown = np.array([after.covariance.xx, after.covariance.yy, after.covariance.hh]) - [0.01, 0.01, 0.01]

    def led_to(pose: np.ndarray) -> np.ndarray:
        x, y, heading = pose
        c, s = math.cos(heading + 0.2), math.sin(heading + 0.2)
        return np.array([x + c * 0.5 - s * 0.2, y + s * 0.5 + c * 0.2, heading + 0.4])

    there, width = np.array(first.pose), 1e-6
    slope = np.array([(led_to(there + e) - led_to(there - e)) / (2.0 * width) for e in width * np.eye(3)]).T
    apart = np.array([0.03, -0.05, 0.02])
    pose = led_to(there) + apart + [0.0, 0.0, math.tau]  # a whole turn does not matter
    spread = matrix(SECOND) + slope @ matrix(FIRST) @ slope.T + np.diag(np.maximum(grown, 0.0))
    expected = math.exp((apart @ np.linalg.solve(spread, apart) / 3.0 - 1.0) / 20.0)
    found = corrected(after, MeasuredPose(TICK_NS, Pose(*pose.tolist()), SECOND), NEVER)
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
    assert seen(*to_and_fro, acceptance=NEVER._replace(noise=1.7))[-1].noise == 1.7


def test_less_noise_than_a_fix_tells_is_learnt_and_not_used_and_more_is() -> None:
    """Two beliefs that differ in the noise alone take the same fix."""
    fix, taken = MeasuredPose(TICK_NS, Pose(0.02, 0.0, 0.0), FIRST), Acceptance(math.inf, 5, 0.0, 16.0)
    belief = start(0, Pose(0.0, 0.0, 0.0), 0.02, 0.02, 0.0, 0.0)._replace(time_ns=TICK_NS)
    by = {noise: corrected(belief._replace(noise=noise), fix, taken).x_m for noise in (0.5, 1.0, 2.0)}
    assert by[0.5] == by[1.0]
    gain = 4e-4 * np.linalg.inv(4e-4 * np.eye(3) + 2.0 * matrix(FIRST))
    assert by[2.0] == pytest.approx(0.02 * gain[0, 0])
