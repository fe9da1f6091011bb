"""Two runs over one time: aligned by time, motion or an event, with the difference of any signal."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.review import Event, RecordedRun
from hil.review.alignment import Asked, aligned, asked_for
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.processes import hil

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


@pytest.mark.parametrize("by", ["motion", "fault begins"])
@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_two_runs_that_began_apart_are_alike_once_aligned(by: str, rate_hz: float) -> None:
    first, second = made(1.0), made(1.5, rate_hz=rate_hz)
    names = [Asked("error.planar_m", 0.025), Asked("truth.heading_rad", 0.025)]
    together = aligned([first, second], by, names)
    assert together.shift_s == pytest.approx(-0.5, abs=1.0 / RATE_HZ)
    for one in together.signals:
        assert one.figures()["within"] is True
        assert one.figures()["samples"] == pytest.approx(350, abs=2), "where both have a value"
    by_time = aligned([first, second], "t", names).signals[0].figures()
    assert by_time["within"] is False
    assert by_time["max"] == pytest.approx(0.5)
    assert by_time["first_outside_s"] == pytest.approx(1.03, abs=0.001)


def test_a_difference_is_second_minus_first_and_judged_by_its_tolerance() -> None:
    first, second = made(1.0), made(1.0, offset=0.25)
    inside, outside = (aligned([first, second], asked=[Asked("error.planar_m", size)]) for size in (0.3, 0.2))
    found = inside.figures()["signals"][0]
    assert (found["rms"], found["max"], found["within"]) == (pytest.approx(0.25), pytest.approx(0.25), True)
    assert (found["first_outside_s"], found["outside_percent"]) == (None, 0.0)
    found = outside.figures()["signals"][0]
    assert (found["first_outside_s"], found["outside_percent"], found["within"]) == (0.0, 100.0, False)
    np.testing.assert_allclose(inside.signals[0].values, 0.25)


def test_where_a_run_has_no_rows_or_no_value_there_is_no_difference() -> None:
    first, second = made(1.0), made(1.0, rate_hz=250.0)
    kept = (second.signals["loop.t_s"] < 2.0) | (second.signals["loop.t_s"] > 2.5)
    for name, values in second.signals.items():
        second.signals[name] = values[kept]
    first.signals["error.planar_m"][:10] = np.nan
    one = aligned([first, second], asked=[Asked("error.planar_m")]).signals[0]
    assert one.t_s[0] == pytest.approx(0.1)
    assert not ((one.t_s > 2.0) & (one.t_s < 2.5)).any()
    assert one.figures()["within"] is None
    nothing = made(1.0)
    nothing.signals["error.planar_m"][:] = np.nan
    assert aligned([first, nothing], asked=[Asked("error.planar_m", 1.0)]).signals[0].figures()["rms"] is None


def test_what_cannot_be_aligned_or_compared_is_a_sentence() -> None:
    still = made(9.0)
    with pytest.raises(BadInputError, match=r"no wheel turns faster than .*; align by t, or an event"):
        aligned([made(1.0), still], "motion")
    with pytest.raises(BadInputError, match=r"no event with this text; its events: ready; fault begins: push"):
        aligned([made(1.0), still], "crash")
    with pytest.raises(BadInputError, match=r"no signal 'error.planr_m'; did you mean 'error.planar_m'"):
        aligned([made(1.0), still], asked=[Asked("error.planr_m")])
    for text in ("error.planar_m=wide", "error.planar_m=-1", "=3", "error.planar_m=nan"):
        with pytest.raises(BadInputError, match=r"expected the name of a signal"):
            asked_for([text])
    assert asked_for(["loop.t_s", "a=0.5"]) == [Asked("loop.t_s"), Asked("a", 0.5)]


def test_the_review_of_two_runs_says_so_in_json_in_text_and_on_the_page(tmp_path: Path) -> None:
    paths = [tmp_path / "one.rrd", tmp_path / "two.rrd"]
    for path, law in zip(paths, ("dsc", "afdsc"), strict=True):
        scenario = load("circle_speed", set=["loop.duration_s=0.5", f"controller.law={law}"])
        run_scenario(scenario, RunOptions(record=path))
    options = ["--align", "motion", "--difference", "wheel.fl.speed_rad_s=0.001", "--difference", "error.x_m"]
    together = json.loads(hil("review", *paths, *options, "--json").stdout)["aligned"]
    assert together["by"] == "motion"
    assert [one["name"] for one in together["signals"]] == ["wheel.fl.speed_rad_s", "error.x_m"]
    assert together["signals"][0]["within"] is False
    done = hil("review", *paths, *options, "--html", tmp_path / "page.html")
    row = next(line for line in done.stdout.splitlines() if line.strip().startswith("wheel.fl.speed_rad_s"))
    assert f"no, from {together['signals'][0]['first_outside_s']:.4g} s" in row
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Aligned by the instant at which the first wheel turns" in page
    assert "no, from" in page
    alone = hil("review", paths[0], "--align", "motion")
    assert (alone.returncode, alone.stderr) == (
        2,
        "hil: --align and --difference compare two runs; name the other recording too\n",
    )
