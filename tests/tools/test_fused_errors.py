"""The measures of the estimation page, on one short drive and against linear algebra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.fused_errors import OUTSIDE, Condition, drive, mahalanobis, other_row, reach_row

offsets = st.lists(st.floats(-1, 1), min_size=6, max_size=6)


@given(offsets)
def test_the_squared_distance_is_normalised_by_the_covariance(numbers):
    root = np.array(numbers[:4]).reshape(2, 2)
    covariance = root @ root.T + 0.01 * np.eye(2)
    off = np.array(numbers[4:])
    row = np.array([[1.0, 2.0, covariance[0, 0], covariance[0, 1], covariance[1, 1]]])
    expected = off @ np.linalg.solve(covariance, off)
    assert mahalanobis(row, np.array([[1.0, 2.0]]) - off) == pytest.approx([expected], rel=1e-6, abs=1e-12)


def test_a_drive_counts_its_ticks_and_keeps_what_was_given_and_believed():
    condition = Condition("short", {}, ("rigid",), from_s=0.2, duration_s=0.5)
    outcome, kept, truth = drive(condition, "rigid", 1)
    assert len(outcome.squared) == len(outcome.estimate_m) == 60
    believed = np.array(kept.believed[-len(truth) :])
    assert np.hypot(*(believed[:, :2] - truth).T).max() < 0.03
    sigma_m = np.sqrt(believed[0, [2, 4]])
    assert sigma_m == pytest.approx([0.01, 0.01], rel=0.05), "as the start is told to be known"
    assert sum(len(fixes) for _, fixes in kept.given) == 5
    assert reach_row(condition, lambda *_: [outcome] * 2).startswith("| short | 2 x 60 | ")
    outside = 100.0 * np.mean(outcome.squared > OUTSIDE)
    assert reach_row(condition, lambda *_: [outcome]).endswith(f" | {outside:.1f} |")
    rms_mm = 1e3 * np.sqrt(np.mean(outcome.estimate_m**2))
    assert f" | {rms_mm:.1f} ({rms_mm:.1f}) | " in other_row(condition, lambda *_: [outcome])
