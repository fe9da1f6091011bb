"""Figures of a run: laws, cases worked by hand, and figures without a meaning."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.metrics import estimation_metrics, percentiles, signal_figures, tracking_metrics

NAN = float("nan")


def seconds(count: int, period_s: float = 0.01) -> np.ndarray:
    return np.arange(count) * period_s


def test_an_exponential_settles_when_its_equation_says() -> None:
    t_s = seconds(10_000, 0.001)
    planar_m = 0.3 * np.exp(-5.0 * t_s)
    tracking = tracking_metrics(t_s, planar_m)
    assert tracking.tracked_s == pytest.approx(math.log(50) / 5, abs=0.001)
    assert tracking.t10_s == pytest.approx(math.log(30) / 5, abs=0.001)
    assert tracking.steady_max_m == planar_m[5000]
    assert tracking.steady_rms_m == pytest.approx(0.3 * math.exp(-25) / math.sqrt(50), rel=0.01)
    assert tracking.reasons == {}


@given(
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=50),
    st.floats(0.001, 1.0),
)
def test_settling_times_obey_their_definition(errors: list[float], initial_m: float) -> None:
    planar_m = np.array([initial_m, *errors])
    t_s = seconds(len(planar_m))
    tracking = tracking_metrics(t_s, planar_m)
    for name, limit_m in (("tracked_s", 0.02 * initial_m), ("t10_s", 0.010)):
        settled = getattr(tracking, name)
        if settled is None:
            assert planar_m[-1] >= limit_m
            assert "did not stay below" in tracking.reasons[name]
        else:
            after = t_s >= settled
            assert (planar_m[after] < limit_m).all()
            assert after.all() or planar_m[~after][-1] >= limit_m


@given(st.integers(500, 1500))
def test_rms_is_never_above_the_maximum_and_both_see_only_the_last_five_seconds(count: int) -> None:
    planar_m = np.random.default_rng(count).uniform(0.0, 1.0, count)
    tracking = tracking_metrics(seconds(count), planar_m)
    last = planar_m[-500:]
    assert tracking.steady_max_m == last.max()
    assert tracking.steady_rms_m == pytest.approx(float(np.sqrt((last**2).mean())))


def test_time_before_the_start_does_not_count() -> None:
    t_s = seconds(1200) - 2.0
    planar_m = np.where(t_s < 0, 50.0, 0.1 * np.exp(-3 * t_s))
    with_approach = tracking_metrics(t_s, planar_m)
    without = tracking_metrics(t_s[t_s >= 0], planar_m[t_s >= 0])
    assert with_approach == without


@pytest.mark.parametrize(
    ("planar_m", "names", "reason"),
    [
        (np.full(600, NAN), ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m"), "no ground truth"),
        (np.empty(0), ("tracked_s", "t10_s"), "no samples"),
        (np.empty(0), ("steady_rms_m", "steady_max_m"), "fewer than two samples"),
        (np.zeros(600), ("tracked_s",), "began 0 mm from the reference"),
        (np.full(600, 0.5), ("tracked_s", "t10_s"), "did not stay below 10 mm: it was 500 mm at the end"),
        (np.full(499, 0.001), ("steady_rms_m", "steady_max_m"), "lasted 4.99 s, less than the window of 5 s"),
    ],
)
def test_a_figure_without_a_meaning_has_a_reason(planar_m: np.ndarray, names: tuple[str, ...], reason: str) -> None:
    tracking = tracking_metrics(seconds(len(planar_m)), planar_m)
    for name in names:
        assert getattr(tracking, name) is None
    assert reason in tracking.reasons[names[-1]]


def test_a_gap_spoils_only_the_figures_that_it_touches() -> None:
    planar_m = 0.3 * np.exp(-5.0 * seconds(1000))
    planar_m[123] = NAN
    tracking = tracking_metrics(seconds(1000), planar_m)
    assert tracking.reasons["tracked_s"] == tracking.reasons["t10_s"] == "the ground truth is missing at t = 1.23 s"
    assert tracking.steady_rms_m is not None
    planar_m[900] = NAN
    assert tracking_metrics(seconds(1000), planar_m).steady_rms_m is None


def test_a_run_of_exactly_the_window_has_steady_figures() -> None:
    assert tracking_metrics(seconds(5000, 0.001), np.full(5000, 0.002)).steady_max_m == 0.002


def test_percentiles_leave_gaps_out() -> None:
    values = np.array([NAN, *range(101), NAN], dtype=np.float64)
    assert percentiles(values) == (50.0, 99.0)
    assert percentiles(np.array([NAN])) is None


def test_signal_figures_of_a_run_of_one_tick_name_what_is_missing() -> None:
    one = {"loop.t_s": 0.0, "error.planar_m": 0.2, "loop.tick_us": NAN, "loop.deadline_misses": 0.0}
    one |= {f"{group}.{name}": NAN for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")}
    figures, reasons = signal_figures({name: np.array([value]) for name, value in one.items()})
    assert figures["ticks"] == 1
    assert {name for name, value in figures.items() if value is None} == set(reasons)


def test_the_error_of_the_estimate_counts_ticks_of_the_run_with_both_poses() -> None:
    """3-4-5: distances 5 mm and 10 mm; a heading one turn apart is the same; one tick has no truth, one is before 0."""
    signals = {
        "loop.t_s": np.array([-0.1, 0.0, 0.1, 0.2]),
        "pose.x_m": np.array([9.0, 0.003, 0.006, 9.0]),
        "pose.y_m": np.array([9.0, 0.004, 0.008, 9.0]),
        "pose.heading_rad": np.array([0.0, 0.01, 0.01 + 2 * np.pi, 0.0]),
        "truth.x_m": np.array([0.0, 0.0, 0.0, NAN]),
        "truth.y_m": np.array([0.0, 0.0, 0.0, NAN]),
        "truth.heading_rad": np.array([0.0, 0.0, 0.0, NAN]),
    }
    found = estimation_metrics(signals)
    assert found is not None
    assert found == pytest.approx({"rms_m": math.sqrt(62.5e-6), "max_m": 0.010, "heading_rms_rad": 0.01})
    assert estimation_metrics({name: series[3:] for name, series in signals.items()}) is None
