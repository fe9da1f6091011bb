"""Figures: one registry."""

import math

import numpy as np
import pytest

from hil.core.signals import SIGNAL_NAMES
from hil.judge.figures import MEASURES, cut_words, figures, signal_figures, table_figures


def test_every_figure_has_a_name_of_its_own_and_says_what_it_is() -> None:
    every = figures()
    assert len({figure.name for figure in every}) == len(every)
    assert all(figure.label and figure.meaning and figure.better in ("less", "more", None) for figure in every)
    assert {figure.name for kind in MEASURES for figure in kind.figures} < {figure.name for figure in every}
    assert "steady_rms_m" in table_figures()


def test_a_figure_is_shown_in_the_unit_of_its_name_times_its_scale() -> None:
    units = {
        "m": {"mm": 1e3},
        "rad": {"mrad": 1e3},
        "s": dict.fromkeys(("s", "N·m·s", "N·m/s a wheel"), 1.0),
        "ms": {"ms": 1.0},
        "us": {"µs": 1.0},
    }
    for figure in figures():
        suffix = figure.name.partition(".p")[0].rpartition("_")[2]
        assert figure.scale == units.get(suffix, {figure.unit: 1.0})[figure.unit], figure.name
        assert (figure.unit == "") == (suffix not in units), figure.name


def test_figures_of_the_end_of_the_machine_and_without_a_better_side_are_these() -> None:
    def those(has: str, value: object = True) -> set[str]:
        return {figure.name for figure in figures() if getattr(figure, has) == value}

    assert those("of_end") == {"tracked_s", "t10_s", "steady_rms_m", "steady_max_m"}
    assert those("of_machine") == {"tick_us.p50", "tick_us.p99", "deadline_misses", "realtime_factor"}
    assert those("better", None) == {"ticks", "realtime_factor", "frames.sent", "frames.received"}
    assert those("printed") == {
        *those("of_end"), "overshoot_m", "effort_n_m_s", "torque_variation_n_m_per_s", "saturation_s", "ticks",
        "deadline_misses", "realtime_factor",
    }  # fmt: skip
    cut = "there is nothing after t = 0.5 s of 2 s, and this is a figure of the run's end"
    reasons = signal_figures({name: np.zeros(3) for name in SIGNAL_NAMES}, cut=cut_words(0.5, 2.0))[1]
    assert {name for name, reason in reasons.items() if reason == cut} == those("of_end")
    assert cut_words(0.5, None) == "there is nothing after t = 0.5 s, and this is a figure of the run's end"


def test_a_figure_tells_differences_of_its_resolution() -> None:
    found = {figure.name: (figure.resolution, figure.resolution_ticks) for figure in figures()}
    times = {"tracked_s", "t10_s", "saturation_s"}
    waits = {
        f"link_statistics.{name}_ms.{share}" for name in ("feedback_age", "round_trip") for share in ("p50", "p99")
    }
    assert {name for name, (_, ticks) in found.items() if ticks} == times | waits
    assert {name: smallest for name, (smallest, _) in found.items() if smallest} == {
        **dict.fromkeys(times, 0.005),
        **dict.fromkeys({*waits, "latency_ms.p50", "latency_ms.p99"}, 0.1),
        **dict.fromkeys(("steady_rms_m", "estimation_error.rms_m", "estimation_error.heading_rms_rad"), 2e-6),
        **dict.fromkeys(("steady_max_m", "estimation_error.max_m"), 5e-6),
        "overshoot_m": 1e-4,
        **dict.fromkeys(("effort_n_m_s", "torque_variation_n_m_per_s", "taken_n_m_s"), 0.01),
    }
    assert {ticks for _, ticks in found.values()} == {0.0, 1.0}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_damaged_values_of_a_recording_without_check_values_end_no_review(value: float) -> None:
    rows = {name: np.full(3, value) for name in SIGNAL_NAMES}
    assert signal_figures(rows)[0]["ticks"] == 3
