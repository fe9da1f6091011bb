"""The oracle of the estimation page, on a robot at rest: there the best filter is a weighted mean."""

import math

import numpy as np
import pytest

from hil.core.types import MeasuredPose, Pose, PoseCovariance, Wheels
from tests.estimation.test_wheel_motion import Measured
from tests.support.closed_loop import PAPER_ROBOT
from tools.fused_oracle import Noises, best

TICK_NS = 50_000_000
SIGMA_M, START_M = 0.02, 0.01


def test_at_rest_it_is_the_weighted_mean_of_the_fixes_that_came_and_smoothed_that_of_all() -> None:
    poses = [Pose(1.0 + 0.01 * n, -0.02 * n, 2 * math.pi * n + 0.001) for n in range(5)]  # the heading wraps
    told = PoseCovariance(SIGMA_M**2, 0.0, 0.0, SIGMA_M**2, 0.0, 1e-4)
    fixes = [MeasuredPose((2 * n + 1) * TICK_NS // 2, pose, told) for n, pose in enumerate(poses)]
    at_rest = [Measured(n * TICK_NS, None, Wheels(0, 0, 0, 0), 0.0, (0.0, 0.0, 9.81)) for n in range(8)]
    given = [(one, fixes[n - 2 : n - 1] if n >= 2 else []) for n, one in enumerate(at_rest)]  # 75 ms late
    found = best(
        PAPER_ROBOT, Pose(1.0, 0.0, 0.0), 4096, given, Noises((START_M, START_M, 0.1, 1e-6, 0.005), 1e-4, 0.01)
    )
    came = np.array([0, 0, 1, 2, 3, 4, 5, 5])
    assert found.causal_m2 == pytest.approx(2.0 / (START_M**-2 + came * SIGMA_M**-2))
    weight = SIGMA_M**-2 / (START_M**-2 + len(fixes) * SIGMA_M**-2)
    offsets = [np.array([pose.x_m - 1.0, pose.y_m]) for pose in poses]
    mean = np.array([1.0, 0.0]) + weight * np.sum(offsets, axis=0)
    assert found.smoothed[:, :2] == pytest.approx(np.tile(mean, (8, 1)))
    assert np.abs(found.smoothed[:, 2]).max() < 0.01
