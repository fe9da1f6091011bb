"""Figures of a run: laws, cases worked by hand, and figures without a meaning."""

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.percentiles import CAPACITY, Reservoir, percentiles
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import WHEEL_NAMES
from hil.judge.effort import Effort, Overshoot, Saturation
from hil.judge.figures import signal_figures
from hil.judge.measure import CommandLimits, Measure, NoFigureError, RunSetup
from hil.judge.tracking import EstimationError, Tracking

NAN = float("nan")


def blocks(count: int) -> list[slice]:
    """Rows in pieces of unlike length, one of them empty: no figure may depend on how they came."""
    edges = [0, count // 7, count // 7, count // 2, max(0, count - 1), count]
    return [slice(*pair) for pair in itertools.pairwise(edges)]


def measured(measure: Measure, signals: dict[str, np.ndarray]) -> dict[str, Any]:
    """The figures of a measure by name; None for one without a meaning, with its reason under ``reasons``."""
    for block in blocks(len(signals["loop.t_s"])):
        measure.add({name: series[block] for name, series in signals.items()})
    found: dict[str, Any] = {"reasons": {}}
    for name in (figure.name for figure in measure.figures):
        try:
            found[name] = measure.value(name)
        except NoFigureError as no_figure:
            found[name] = None
            found["reasons"][name] = str(no_figure)
    return found


def tracking_metrics(t_s: np.ndarray, planar_m: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(**measured(Tracking(), {"loop.t_s": t_s, "error.planar_m": planar_m}))


def demand_metrics(t_s, error_m, torque_n_m, saturated) -> SimpleNamespace:
    """Overshoot, effort and saturation, of a motor that makes 0.25 N·m of 1 A."""
    signals = {"loop.t_s": t_s, "error.x_m": error_m[:, 0], "error.y_m": error_m[:, 1], "guard.saturated": saturated}
    known = torque_n_m is not None
    for wheel, torque in zip(WHEEL_NAMES, 4.0 * torque_n_m.T if known else [saturated] * 4, strict=True):
        signals[f"wheel.{wheel}.current_a"] = torque
    parts = [measured(kind(RunSetup(0.25 if known else None)), signals) for kind in (Overshoot, Effort, Saturation)]
    reasons = {name: reason for part in parts for name, reason in part["reasons"].items()}
    return SimpleNamespace(**{name: value for part in parts for name, value in part.items()} | {"reasons": reasons})


def estimation_metrics(signals: dict[str, np.ndarray]) -> dict[str, float] | None:
    return measured(EstimationError(), signals)["estimation_error.rms_m"]


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


def test_settling_is_counted_from_the_first_row_of_a_recording_that_begins_late() -> None:
    planar_m = 0.3 * np.exp(-5.0 * seconds(1000))
    at_once, later = (tracking_metrics(seconds(1000) + begin_s, planar_m) for begin_s in (0.0, 16.25))
    assert (later.tracked_s, later.t10_s) == pytest.approx((at_once.tracked_s, at_once.t10_s))


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
    assert tracking_metrics(np.array([0.0, 2.5]), np.array([0.003, 0.002])).steady_max_m == 0.003
    # Each row comes in a block of its own; the window begins after the second.
    assert tracking_metrics(np.array([0.0, 7.0, 14.0]), np.array([0.004, 0.003, 0.002])).steady_max_m == 0.002


def test_percentiles_leave_gaps_out() -> None:
    values = np.array([NAN, *range(101), NAN], dtype=np.float64)
    assert percentiles(values) == (50.0, 99.0)
    assert percentiles(np.array([NAN])) is None


def test_percentiles_are_exact_to_a_million_values_then_close_in_bounded_memory() -> None:
    values = np.random.default_rng(3).lognormal(size=4 * CAPACITY)
    values[::200] = 1e6  # taken by a stride of 2, 4 or 8 these would be more than one of a hundred
    samples = Reservoir()
    for value in values[:2000]:
        samples.append(value)
    for block in np.split(values[2000:CAPACITY], [5, 5, 70_000]):
        samples.extend(block)
    assert samples.percentiles() == percentiles(values[:CAPACITY])
    for start in range(CAPACITY, len(values), 5000):
        samples.extend(values[start : start + 5000])
    assert len(samples) == len(values)
    assert tuple(samples.percentiles()) == pytest.approx(tuple(percentiles(values)), rel=0.02)


def test_an_underdamped_step_overshoots_along_its_line_by_what_its_equation_says() -> None:
    t_s, damping = seconds(10_000, 0.001), 0.4
    rate_1_s = 6.0 * math.sqrt(1 - damping**2)
    along = np.exp(-damping * 6.0 * t_s) * (
        np.cos(rate_1_s * t_s) + damping / math.sqrt(1 - damping**2) * np.sin(rate_1_s * t_s)
    )
    sideways = 0.3 * np.sin(20.0 * t_s)  # across that line nothing is past the reference
    direction, normal = np.array([0.6, -0.8]), np.array([0.8, 0.6])
    error_m = 0.5 * along[:, None] * direction + sideways[:, None] * normal
    demand = demand_metrics(t_s, error_m, None, np.zeros(len(t_s)))
    expected_m = 0.5 * math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    assert demand.overshoot_m == pytest.approx(expected_m, rel=1e-4)


@given(st.floats(0.5, 20.0), st.floats(0.1, 4.0))
def test_effort_and_variation_of_sines_are_their_integrals(rate_rad_s: float, peak_n_m: float) -> None:
    t_s = np.arange(4001) * (2 * math.pi / rate_rad_s / 1000)  # four turns
    each = np.array([1.0, -1.0, 0.5, 0.0])
    torque_n_m = peak_n_m * np.sin(rate_rad_s * t_s)[:, None] * each
    demand = demand_metrics(t_s, np.ones((4001, 2)), torque_n_m, np.zeros(4001))
    total_s = float(t_s[-1])
    assert demand.effort_n_m_s == pytest.approx(2 / math.pi * peak_n_m * 2.5 * total_s, rel=1e-4)
    assert demand.torque_variation_n_m_per_s == pytest.approx(2 / math.pi * peak_n_m * rate_rad_s * 2.5 / 4, rel=1e-4)


@given(st.lists(st.booleans(), min_size=2, max_size=60))
def test_saturation_is_the_time_that_it_held(flags: list[bool]) -> None:
    t_s = np.cumsum(np.arange(len(flags))) * 0.01 - 0.05  # a skipped tick holds for longer; some are before the start
    saturated = np.array(flags, dtype=np.float64)
    demand = demand_metrics(t_s, np.ones((len(flags), 2)), None, saturated)
    if (t_s >= 0).sum() < 2:
        assert demand.saturation_s is None
        return
    expected_s = sum(
        later - now for now, later, flag in zip(t_s[:-1], t_s[1:], flags, strict=False) if flag and now >= 0
    )
    assert demand.saturation_s == pytest.approx(expected_s)


@pytest.mark.parametrize(
    ("speed_rad_s", "torque_n_m", "is_at_limit"),
    [
        ((NAN,) * 4, (0.0, 0.0, -4.996, 0.0), True),
        ((NAN,) * 4, (4.9, 0.0, 0.0, 0.0), False),
        ((0.0, 19.99, 0.0, 0.0), (0.0,) * 4, True),
        ((0.0, 19.9, 0.0, 0.0), (5.0,) * 4, False),  # the feedforward of a set point
        ((NAN,) * 4, (NAN,) * 4, False),  # nothing was sent
    ],
)
def test_a_law_that_keeps_the_limits_itself_is_saturated_too(speed_rad_s, torque_n_m, is_at_limit) -> None:
    t_s = seconds(11)
    signals = {f"error.{name}": np.full(11, 0.2) for name in ("x_m", "y_m", "planar_m")} | {"loop.t_s": t_s}
    signals |= {name: np.zeros(11) for name in ("loop.tick_us", "loop.deadline_misses", "guard.saturated")}
    signals |= {
        f"{group}.{name}": np.zeros(11) for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")
    }
    for wheel, speed, torque in zip(WHEEL_NAMES, speed_rad_s, torque_n_m, strict=True):
        signals[f"wheel.{wheel}.current_a"] = np.zeros(11)
        signals[f"wheel.{wheel}.speed_command_rad_s"] = np.full(11, speed)
        signals[f"wheel.{wheel}.torque_command_n_m"] = np.full(11, torque)
    figures, _ = signal_figures(signals, RunSetup(limits=CommandLimits(20.0, 5.0)))
    assert figures["saturation_s"] == pytest.approx(t_s[-1] if is_at_limit else 0.0)
    assert signal_figures(signals)[0]["saturation_s"] == 0.0


def test_demand_without_a_meaning_has_a_reason() -> None:
    def reasons(count: int = 100, error_m: float = 0.5, torque_n_m: np.ndarray | None = None) -> dict[str, str]:
        demand = demand_metrics(seconds(count), np.full((count, 2), error_m), torque_n_m, np.zeros(count))
        assert {name for name, value in vars(demand).items() if value is None} == set(demand.reasons)
        return demand.reasons

    gap = np.zeros((100, 4))
    gap[7, 2] = NAN
    assert reasons()["effort_n_m_s"] == "the torque constant of the motors is not known"
    assert reasons(torque_n_m=np.full((100, 4), NAN))["effort_n_m_s"] == "the robot measured no motor currents"
    assert reasons(torque_n_m=gap)["torque_variation_n_m_per_s"] == "the motor currents are missing at t = 0.07 s"
    assert "no ground truth" in reasons(error_m=NAN)["overshoot_m"]
    assert "began 0.141 mm from the reference" in reasons(error_m=1e-4)["overshoot_m"]
    alternating = np.zeros((100, 4))
    alternating[::2] = NAN
    assert reasons(torque_n_m=alternating) == {
        "torque_variation_n_m_per_s": "no two ticks in a row have measured motor currents"
    }
    assert set(reasons(count=1, torque_n_m=gap[:1])) == set(reasons(count=1)) - {"overshoot_m"}


def test_signal_figures_of_a_run_of_one_tick_name_what_is_missing() -> None:
    one = {"loop.t_s": 0.0, "loop.tick_us": NAN, "loop.deadline_misses": 0.0, "guard.saturated": 0.0}
    one |= {"error.x_m": 0.2, "error.y_m": 0.0, "error.planar_m": 0.2}
    one |= {f"wheel.{wheel}.current_a": 0.0 for wheel in WHEEL_NAMES}
    one |= {f"{group}.{name}": NAN for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")}
    figures, reasons = signal_figures({name: np.array([value]) for name, value in one.items()})
    assert figures["ticks"] == 1
    assert {name for name, value in figures.items() if value is None} == set(reasons)


def test_the_error_of_the_estimate_counts_ticks_of_the_run_with_both_poses() -> None:
    """3-4-5: distances 10 mm and 5 mm; a heading one turn apart is the same; one tick has no truth, one is before 0."""
    signals = {
        "loop.t_s": np.array([-0.1, 0.0, 0.1, 0.2]),
        "pose.x_m": np.array([9.0, 0.506, -0.247, 9.0]),
        "pose.y_m": np.array([9.0, -0.742, 0.254, 9.0]),
        "pose.heading_rad": np.array([0.0, 1.26, -3.01 + 2 * np.pi, 0.0]),
        "truth.x_m": np.array([0.0, 0.5, -0.25, NAN]),
        "truth.y_m": np.array([0.0, -0.75, 0.25, NAN]),
        "truth.heading_rad": np.array([0.0, 1.25, -3.0, NAN]),
    }
    found = estimation_metrics(signals)
    assert found is not None
    assert found == pytest.approx({"rms_m": math.sqrt(62.5e-6), "max_m": 0.010, "heading_rms_rad": 0.01})

    def reason(**changed: list[float]) -> str:
        some = {name.replace("__", "."): np.array(values) for name, values in changed.items()}
        return str(measured(EstimationError(), {**signals, **some})["reasons"]["estimation_error.rms_m"])

    assert reason(pose__x_m=[0.0, NAN, NAN, 0.0]) == "there is no tick with both an estimated and a true pose"
    assert reason(truth__x_m=[NAN] * 4) == "the run has no ground truth"


def test_percentiles_are_of_a_run_s_ticks_and_the_count_of_misses_is_the_newest() -> None:
    rows = {name: np.zeros(6) for name in SIGNAL_NAMES} | {
        "loop.t_s": np.array([-0.01, 0.0, 0.005, 0.01, 0.015, 0.02]),
        "loop.tick_us": np.array([NAN, 50.0, 10.0, 40.0, 20.0, 30.0]),
        "link.latency_ms": np.array([900.0, 4.0, NAN, 1.0, 3.0, NAN]),
        "loop.deadline_misses": np.array([0.0, 2.0, 2.0, 5.0, 7.0, 7.0]),
    }
    figures, _ = signal_figures(rows)
    assert (figures["ticks"], figures["deadline_misses"]) == (6, 7)
    assert figures["tick_us"] == pytest.approx({"p50": 30.0, "p99": 49.6})
    assert figures["latency_ms"] == pytest.approx({"p50": 3.0, "p99": 3.98})
    damaged = {**rows, "loop.deadline_misses": np.array([0.0, 2.0, 2.0, 5.0, 7.0, math.inf])}
    assert signal_figures(damaged)[0]["deadline_misses"] == 0
    gone = {name: np.delete(values, slice(0, 6)) for name, values in rows.items()}
    assert signal_figures(gone)[1]["tick_us"] == "the run has fewer than two ticks"
    assert signal_figures(gone)[1]["latency_ms"] == "the run has fewer than two ticks with a latency"


def test_from_a_start_one_millimetre_away_on_figures_of_that_distance_have_a_meaning() -> None:
    t_s, error_m = np.array([0.0, 0.01]), np.array([[0.0, 0.001], [0.0, -0.0012]])
    assert demand_metrics(t_s, error_m, None, np.zeros(2)).overshoot_m == 0.0012
    nearer = demand_metrics(t_s, error_m * 0.999, None, np.zeros(2))
    assert nearer.reasons["overshoot_m"] == (
        "the run began 0.999 mm from the reference: less than 1 mm has no direction in which it could go past it"
    )
    assert tracking_metrics(t_s, np.array([0.001, 0.0])).tracked_s == 0.01
    assert tracking_metrics(t_s, np.array([0.000999, 0.0])).reasons["tracked_s"] == (
        "the run began 0.999 mm from the reference: 2 % of less than 1 mm is not a usable limit"
    )


def test_rows_in_which_the_robot_was_not_heard_are_left_out_of_effort_and_variation():
    t_s = np.arange(8) * 0.5
    torque_n_m = np.repeat([[np.nan], [1.0], [2.0], [np.nan], [np.nan], [4.0], [4.0], [4.0]], 4, axis=1)
    found = demand_metrics(t_s, np.ones((8, 2)), torque_n_m, np.zeros(8))
    assert found.effort_n_m_s == 4 * 0.5 * (1.0 + 2.0 + 4.0 + 4.0)
    assert found.torque_variation_n_m_per_s == 1.0 / (3 * 0.5), "one step of 1 N·m in three pairs of ticks"
    assert not found.reasons
