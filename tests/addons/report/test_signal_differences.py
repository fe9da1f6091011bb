"""Two runs over one time, with the difference of any signal."""

import itertools
import json
import math
import statistics
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.difference import signal_differences, signal_rows
from hil.core.errors import BadInputError
from hil.core.ports import Event
from hil.record.reader import RecordedRun
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.examples import share_of_examples
from tests.support.processes import hil

RATE_HZ = 100.0


def made(start_s: float, *, rate_hz: float = RATE_HZ, offset: float = 0.0) -> RecordedRun:
    """Return a run whose wheel begins to turn at ``start_s``; its planar error is a ramp from then on."""
    t_s = np.arange(int(4.0 * rate_hz)) / rate_hz
    moved_s = np.maximum(t_s - start_s, 0.0)
    heading_rad = np.remainder(3.0 + moved_s + np.pi, 2.0 * np.pi) - np.pi
    signals = {"loop.t_s": t_s, "error.planar_m": moved_s + offset, "truth.heading_rad": heading_rad}
    signals["wheel.fl.speed_rad_s"] = np.where(t_s > start_s, 5.0, 0.0)
    events = (Event(0.0, "INFO", "ready"), Event(start_s, "INFO", "fault begins: push"))
    return RecordedRun(Path("made.rrd"), signals, events, {}, None, 0)


def test_headings_differ_by_the_shorter_way_and_rates_may_differ() -> None:
    first, second = made(1.0), made(1.5, rate_hz=250.0)
    heading, planar = signal_differences(first, second, ["truth.heading_rad", "error.planar_m"])
    assert planar.figures()["max"] == pytest.approx(0.5)
    assert heading.figures()["max"] == pytest.approx(0.5)


def test_a_difference_is_second_minus_first() -> None:
    (one,) = signal_differences(made(1.0), made(1.0, offset=0.25), ["error.planar_m"])
    assert (one.figures()["rms"], one.figures()["max"]) == (pytest.approx(0.25), pytest.approx(0.25))
    np.testing.assert_allclose(one.values, 0.25)


@pytest.mark.filterwarnings("error")
def test_a_run_of_a_single_row_is_compared_in_that_row_and_one_without_rows_in_none() -> None:
    first = made(1.0, offset=0.25)
    for count, expected in ((1, [-0.25]), (0, [])):
        cut = {name: series[:count] for name, series in made(1.0).signals.items()}
        second = RecordedRun(Path("cut.rrd"), cut, (), {}, None, 0)
        (one,) = signal_differences(first, second, ["error.planar_m"])
        assert one.values[np.isfinite(one.values)].tolist() == expected


def by_hand(t_s: float, samples: list[tuple[float, float]], gap_s: float, *, is_angle: bool) -> float | None:
    """Return the value between two samples; None where there is none, or rows are missing."""
    for (before_s, before), (after_s, after) in itertools.pairwise(samples):
        if before_s == t_s and not math.isnan(before):
            return before
        if before_s < t_s < after_s and after_s - before_s <= gap_s:
            step = math.remainder(after - before, math.tau) if is_angle else after - before
            return before + step * (t_s - before_s) / (after_s - before_s)
    return samples[-1][1] if samples and samples[-1][0] == t_s else None


TICKS = st.lists(st.integers(0, 24), max_size=10, unique=True).map(sorted)


@share_of_examples(0.6)
@given(TICKS, TICKS, st.lists(st.floats(-3.0, 3.0), min_size=20, max_size=20), st.booleans())
def test_the_second_run_is_taken_between_its_rows_and_not_across_missing_ones(
    ticks: list[int], others: list[int], values: list[float], is_angle: bool
) -> None:
    name = "truth.heading_rad" if is_angle else "error.planar_m"
    first, second = (
        RecordedRun(Path("made.rrd"), {"loop.t_s": np.array(at) / 8, name: np.array(own[: len(at)])}, (), {}, None, 0)
        for at, own in ((ticks, values[:10]), (others, values[10:]))
    )
    samples = list(zip((np.array(others) / 8).tolist(), values[10:], strict=False))
    gap_s = 1.5 * statistics.median(np.diff(others) / 8) if len(others) > 1 else 0.0
    expected = []
    for tick, own in zip(ticks, values, strict=False):
        if (other := by_hand(tick / 8, samples, gap_s, is_angle=is_angle)) is not None:
            apart = math.remainder(other - own, math.tau) if is_angle else other - own
            expected.append((tick / 8, apart))
    (found,) = signal_differences(first, second, [name])
    assert found.t_s.tolist() == [at_s for at_s, _ in expected]
    turned = np.exp(1j * found.values) if is_angle else found.values
    wanted = np.array([apart for _, apart in expected])
    np.testing.assert_allclose(turned, np.exp(1j * wanted) if is_angle else wanted, atol=1e-9)
    assert (np.abs(found.values) <= math.pi + 1e-9).all() or not is_angle
    figures = found.figures()
    assert (figures["name"], figures["unit"], figures["samples"]) == (name, "rad" if is_angle else "m", len(expected))
    if expected:
        _, most = max(expected, key=lambda one: abs(one[1]))
        assert figures["rms"] == pytest.approx(math.sqrt(sum(apart**2 for _, apart in expected) / len(expected)))
        assert figures["max"] == pytest.approx(abs(most), abs=1e-9)
        assert abs(dict(expected)[figures["max_s"]]) == pytest.approx(abs(most), abs=1e-9)
    else:
        assert [figures[one] for one in ("rms", "max", "max_s")] == [None] * 3
        assert signal_rows([found])[1] == (name, "-", "-", "-")


def test_where_a_run_has_no_rows_or_no_value_there_is_no_difference() -> None:
    first, second = made(1.0), made(1.0, rate_hz=250.0)
    kept = (second.signals["loop.t_s"] < 2.0) | (second.signals["loop.t_s"] > 2.5)
    for name, values in second.signals.items():
        second.signals[name] = values[kept]
    first.signals["error.planar_m"][:10] = np.nan
    (one,) = signal_differences(first, second, ["error.planar_m"])
    assert one.t_s[0] == pytest.approx(0.1)
    assert not ((one.t_s > 2.0) & (one.t_s < 2.5)).any()
    nothing = made(1.0)
    nothing.signals["error.planar_m"][:] = np.nan
    assert signal_differences(first, nothing, ["error.planar_m"])[0].figures()["rms"] is None


def test_what_cannot_be_compared_is_a_sentence() -> None:
    with pytest.raises(BadInputError, match=r"no signal 'error.planr_m'; did you mean 'error.planar_m'"):
        signal_differences(made(1.0), made(9.0), ["error.planr_m"])


def test_the_review_of_two_runs_says_so_in_json_in_text_and_on_the_page(tmp_path: Path) -> None:
    paths = [tmp_path / "one.rrd", tmp_path / "two.rrd"]
    for path, law in zip(paths, ("dsc", "afdsc"), strict=True):
        scenario = load("circle_speed", set=["loop.duration_s=0.5", f"controller.law={law}"])
        run_scenario(scenario, RunOptions(record=path))
    options = ["--difference", "wheel.fl.speed_rad_s", "--difference", "error.x_m"]
    together = json.loads(hil("review", *paths, *options, "--json").stdout)["signals"]
    assert [one["name"] for one in together] == ["wheel.fl.speed_rad_s", "error.x_m"]
    done = hil("review", *paths, *options, "--html", tmp_path / "page.html")
    row = next(line for line in done.stdout.splitlines() if line.strip().startswith("wheel.fl.speed_rad_s"))
    assert f"{together[0]['rms']:.4g} rad/s" in row
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"{together[0]['rms']:.4g} rad/s" in page
    alone = hil("review", paths[0], "--difference", "error.x_m")
    assert (alone.returncode, alone.stderr) == (
        2,
        "hil: --difference compares two runs; name the other recording too\n",
    )
