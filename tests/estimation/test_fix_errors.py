"""Errors of simulated fixes: their laws over many seeds, and exact sums of their parts, in NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest, norm

from hil.core.errors import BadInputError
from hil.core.types import Pose
from hil.estimation.fix_errors import FixErrors, SimulatedOptions
from hil.scenario import load

ORIGIN = Pose(0.0, 0.0, 0.0)
SIGMA = np.array([0.02, 0.02, 0.01])
shares = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(lambda two: (two[0], two[1] * (1.0 - two[0])))
places = st.tuples(st.floats(-30, 30), st.floats(-30, 30))


def errors(drive, seed=1, **options) -> np.ndarray:
    """Return the errors at (t_s, x_m, y_m) of a drive."""
    source = FixErrors(SimulatedOptions(**options), seed)
    return np.array([np.subtract(source.next(Pose(x, y, 0.0), t).pose, (x, y, 0.0)) for t, x, y in drive])


def axis(corridor_times: float, corridor_rad: float) -> np.ndarray:
    """Return what stretches an error along a corridor."""
    along = np.array([math.cos(corridor_rad), math.sin(corridor_rad)])
    return np.block([[np.eye(2) + (corridor_times - 1.0) * np.outer(along, along), np.zeros((2, 1))], [0.0, 0.0, 1.0]])


@given(shares, st.floats(0.1, 10), st.floats(-3, 3), st.floats(0.5, 3), places, st.floats(0, 1), st.floats(0, 9))
def test_any_error_at_any_place_and_time_has_the_variance_that_a_true_covariance_tells(
    parts, times, direction, noisier, place, blend, t_s
):
    options = {"held_share": parts[0], "map_share": parts[1], "map_blend": blend, "noisier": noisier}
    options |= {"corridor_times": times, "corridor_rad": direction, "tells": "truth"}
    root = noisier * axis(times, direction) @ np.diag(SIGMA)
    xx, xy, xh, yy, yh, hh = FixErrors(SimulatedOptions(**options), 1).covariance
    told = np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]])
    assert told == pytest.approx(root @ root.T, rel=1e-9, abs=1e-15)
    drive = [(0.0, 0.0, 0.0), (t_s, *place)]
    found = np.array([errors(drive, seed, **options)[-1] for seed in range(150)])
    assert kstest(np.square(np.linalg.solve(root, found.T)).sum(axis=0), chi2(3).cdf).pvalue > 1e-7


@given(shares, st.floats(0.1, 10), st.floats(-3, 3), st.lists(places, min_size=1, max_size=8))
def test_the_parts_add_up_and_a_corridor_stretches_their_sum(parts, times, direction, path):
    held, of_map = parts
    drive = [(0.3 * n, *place) for n, place in enumerate(path)]
    white, lasting, placed = errors(drive), errors(drive, held_share=1.0), errors(drive, map_share=1.0)
    both = {"held_share": held, "map_share": of_map, "corridor_times": times, "corridor_rad": direction}
    rest = max(0.0, 1.0 - held - of_map)
    expected = math.sqrt(rest) * white + math.sqrt(held) * lasting + math.sqrt(of_map) * placed
    assert errors(drive, **both) == pytest.approx(expected @ axis(times, direction).T, abs=1e-9)


def correlation(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return the correlation over seeds and axes, and the largest deviation that chance explains (1 in 1e6)."""
    found = float(np.corrcoef(first.ravel(), second.ravel())[0, 1])
    return found, norm.isf(5e-7) / math.sqrt(first.size)


@given(st.floats(0.05, 20), st.floats(0, 20))
def test_the_lasting_error_after_dt_is_correlated_by_the_exponential_and_keeps_its_variance(held_s, dt_s):
    times_s = [*np.linspace(0.0, held_s, 6), held_s + dt_s]  # five short steps, and one
    found = np.array([errors([(t, t, 0.0) for t in times_s], n, held_share=1.0, held_s=held_s) for n in range(150)])
    found /= SIGMA
    measured, chance = correlation(found[:, -2], found[:, -1])
    assert measured == pytest.approx(math.exp(-dt_s / held_s), abs=chance)
    assert np.mean(found[:, -2] ** 2) == pytest.approx(1.0, abs=math.sqrt(2.0) * chance)


def weights(at: float, blend: float) -> dict[int, float]:
    """Return each square's part in a place: a smooth step over the last and first half of the blend."""
    edges = np.arange(math.floor(at) - 1, math.floor(at) + 3)
    width = max(blend, 1e-300)
    rises = np.clip((at - edges) / width + 0.5, 0.0, 1.0) if blend else (at >= edges).astype(float)
    rises = rises**2 * (3.0 - 2.0 * rises)
    return {int(edge): rises[n] - rises[n + 1] for n, edge in enumerate(edges[:-1])}


@given(places, st.floats(-1, 1), st.floats(0, 7), st.sampled_from([0.0, 0.2, 1.0]), st.floats(0.1, 20))
def test_the_maps_error_is_that_of_the_squares_about_a_place(place, turned, way, blend, side):
    x, y = place
    other = x + way * side * math.cos(math.pi * turned), y + way * side * math.sin(math.pi * turned)
    drive = [(0.0, x, y), (4.0, *other), (9.0, x, y)]
    options = {"map_share": 1.0, "map_scale_m": side, "map_blend": blend}
    found = np.array([errors(drive, seed, **options) for seed in range(150)]) / SIGMA
    assert np.ptp(found[:, [0, 2]], axis=1).max() < 1e-9, "it depends on the place alone"
    p, q = ([weights(at / side, blend) for at in one] for one in (place, other))
    shared = [sum(a[cell] * b.get(cell, 0.0) for cell in a) for a, b in zip(p, q, strict=True)]
    sizes = [math.hypot(*one.values()) for one in (*p, *q)]
    measured, chance = correlation(found[:, 0], found[:, 1])
    assert measured == pytest.approx(shared[0] * shared[1] / math.prod(sizes), abs=chance)


def test_without_a_blend_two_rooms_have_an_offset_each():
    xs = np.linspace(-4.9, 4.9, 99)
    found = errors([(0.0, x, 1.0) for x in xs], map_share=1.0, map_blend=0.0)
    west, east = found[xs < 0.0], found[xs >= 0.0]
    assert np.ptp(west, axis=0).max() < 1e-9 > np.ptp(east, axis=0).max()
    assert np.abs(west[0] - east[0]).min() > 1e-4
    smooth = errors([(0.0, x, 1.0) for x in xs], map_share=1.0)
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.1 * np.ptp(smooth, axis=0).max()


@given(st.floats(0.02, 0.9), st.integers(1, 30), st.integers(1, 100))
def test_wrong_fixes_of_a_burst_agree_and_their_share_is_the_told_one(share, length, seed):
    options = {"sigma_m": 1e-5, "sigma_rad": 1e-5, "rate_hz": 10.0, "outlier_m": 2.0}
    options |= {"outlier_probability": share, "burst_s": length / 10.0}
    source = FixErrors(SimulatedOptions(**options), seed)
    count = 60 * length
    matches = [source.next(ORIGIN, 0.1 * n) for n in range(count)]
    wrong = np.array([match.is_outlier for match in matches])
    off = np.array([match.pose for match in matches])
    assert np.hypot(off[:, 0], off[:, 1]) == pytest.approx(2.0 * wrong, abs=1e-4)
    begins = np.flatnonzero(wrong & (np.r_[1.0, np.hypot(*np.diff(off, axis=0).T[:2])] > 2e-4))
    assert all(wrong[at : at + length].all() and np.ptp(off[at : at + length], axis=0).max() < 2e-4 for at in begins)
    assert len(begins) == math.ceil(wrong.sum() / length)
    # Of some 60 rounds of a burst and a pause, whose length is geometric with n (1 - p) / p fixes on average.
    rounds = count * share / length
    pause = length * (1.0 - share) / share
    deviation = share * (1.0 - share) * math.sqrt((pause + 1.0) / pause / max(rounds, 1.0))
    assert wrong.mean() == pytest.approx(share, abs=5.5 * deviation + 2.0 * length / count)


def test_a_part_draws_numbers_of_its_own():
    plain = {"outlier_probability": 0.3, "dropout_probability": 0.3}
    more = {"held_share": 0.4, "map_share": 0.3, "corridor_times": 5.0, "noisier": 2.0}

    def fates(**options):
        source = FixErrors(SimulatedOptions(**options), 7)
        return [source.next(ORIGIN, 0.1 * n)[1:] for n in range(100)]

    assert fates(**plain) == fates(**plain, **more)
    assert len(set(fates(**plain))) == 4


def test_one_seed_gives_one_course_and_the_nominal_covariance_is_told_unless_the_true_one_is():
    drive = [(0.1 * n, 0.3 * n, 1.0) for n in range(50)]
    options = {"held_share": 0.4, "map_share": 0.3, "noisier": 2.0, "corridor_times": 5.0, "corridor_rad": 0.5}
    assert np.array_equal(errors(drive, **options), errors(drive, **options))
    assert not np.isclose(errors(drive, **options), errors(drive, seed=2, **options)).any()
    assert FixErrors(SimulatedOptions(**options), 1).covariance == pytest.approx((4e-4, 0, 0, 4e-4, 0, 1e-4))


@pytest.mark.parametrize(("table", "prefix"), [("simulated_fix", ""), ("filter", "fix_")])
def test_shares_of_more_than_the_whole_are_refused(table, prefix):
    keys = {f"{prefix}held_share": 0.7, f"{prefix}map_share": 0.5}
    words = f"{prefix}held_share = 0.7 and {prefix}map_share = 0.5 are shares of one variance"
    with pytest.raises(BadInputError, match=words) as bad:
        load("circle_speed", set={f"estimator.{table}.{key}": value for key, value in keys.items()})
    assert "expected at most 1 in all" in str(bad.value)
    assert f"estimator.{table}" in str(bad.value)
