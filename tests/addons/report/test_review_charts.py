"""The interactive charts of a page, in a real browser, and what of a long run they show."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from hil.addons.report.charts import Band, Mark, figure_of
from hil.addons.report.panels import charts, read_for_page
from hil.addons.report.review_page import page
from hil.addons.report.shown import Shown
from hil.judge.recorded import judged_run
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load

browsers = pytest.importorskip("tools.browser", reason="the browser is driven over pipes of POSIX")
DRAWN = "document.body.dataset.drawn === 'yes'"
FAULT = 'fault=[{kind="push",target="force_x_n",value=60.0,start_s=0.6,end_s=0.8}]'
EXPECT = 'expect=[{signal="error.planar_m",from_s=0.2,below=0.001},{signal="error.heading_rad",below=1.0}]'


def shown(path: Path) -> Shown:
    run = read_for_page(path)
    return Shown("dsc", run, judged_run(run), (0, 114, 178))


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("charts") / "failed.rrd"
    run_scenario(load("circle_speed", set=["loop.duration_s=1.0", FAULT, EXPECT]), RunOptions(record=path))
    return path


@pytest.fixture(scope="module")
def opened(failed: Path) -> Iterator["browsers.Page"]:
    if browsers.chromium() is None:
        pytest.skip("needs Chromium")
    run = read_for_page(failed)
    file = failed.with_name("page.html")
    file.write_text(page([run], [judged_run(run)]), encoding="utf-8")
    with browsers.browser() as view:
        view.open(file.as_uri())
        view.wait_until(f"{DRAWN} || document.getElementById('undrawn').textContent", 60.0)
        yield view


def at(view: "browsers.Page", share: float) -> tuple[float, float]:
    """Return a place in the first panel, at this share of its width."""
    box = "document.querySelector('#chart-0 .nsewdrag').getBoundingClientRect()"
    x, y, width, height = view.value(f"(({{x, y, width, height}}) => [x, y, width, height])({box})")
    return x + share * width, y + 0.5 * height


def point(view: "browsers.Page", share: float) -> list[str]:
    """Move the pointer there, wait until the page shows the values of that instant, and return them."""
    texts = "[...document.querySelectorAll('#chart-0 .hoverlayer text')].map((one) => one.textContent)"
    low, high = view.value("document.getElementById('chart-0')._fullLayout.xaxis.range")
    view.mouse("mouseMoved", *at(view, share))
    at_s = low + share * (high - low)
    view.wait_until(f"Math.abs(parseFloat(({texts}[0] || '').slice(4)) - {at_s}) < {0.01 * (high - low)}", 10.0)
    found: list[str] = view.value(texts)
    return found


def test_every_chart_is_what_plotly_knows(failed: Path) -> None:
    """plotly's own check raises for a name or a value that it does not know; the browser would ignore these."""
    made = charts([shown(failed)])
    assert {chart.title for chart in made} >= {"What happened", "Path", "Wheel torques"}
    for chart in made:
        xs: list[np.ndarray] = []
        figure = figure_of(chart, xs)
        data = [trace | {"x": xs[trace["x"]]} for trace in figure["data"]]
        go.Figure(data, figure["layout"])
        assert {len(xs[trace["x"]]) for trace in figure["data"]} >= {len(chart.panels[0].lines[0].y)}


def test_the_first_chart_says_what_was_judged_and_when(failed: Path) -> None:
    one = shown(failed)
    chart = charts([one])[0]
    outcome = one.found.expect[0]
    assert outcome.passed is False
    assert [lane.text for lane in chart.lanes] == [
        "FAILED: error.planar_m below 0.001",
        "held: error.heading_rad below 1",
        "fault: push force_x_n 60 from 0.6 s to 0.8 s",
    ]
    assert [band.kind for band in chart.lanes[0].bands] == ["waiting", "held", "violated"]
    assert chart.lanes[0].bands[2].begin == outcome.violation_s
    assert chart.bands == [Band(0.6, 0.8, "fault")]
    panel = chart.panels[0]
    value = one.run.signals["error.planar_m"][one.run.signals["loop.t_s"] == outcome.violation_s][0]
    assert panel.title == "planar error"
    assert panel.marks == [Mark(outcome.violation_s, 1e3 * value, f"violated at {outcome.violation_s:.4g} s")]
    bound = panel.lines[1]
    assert set(bound.y[bound.x >= 0.2]) == {1.0}
    assert np.isnan(bound.y[bound.x < 0.2]).all()


def test_a_browser_draws_the_page_without_an_error(opened: "browsers.Page") -> None:
    assert opened.value("document.getElementById('undrawn').textContent") == ""
    assert opened.errors == []
    assert opened.value("document.querySelectorAll('.chart .main-svg').length") >= 7
    buttons = opened.value("[...document.querySelectorAll('#chart-0 .modebar-btn')].map((b) => b.dataset.title)")
    assert not [title for title in buttons if "share" in title.lower() or "cloud" in title.lower()], buttons


def test_the_pointer_shows_all_values_of_its_instant(opened: "browsers.Page") -> None:
    texts = point(opened, 0.5)
    assert texts[0].endswith(" s")
    for name in ("planar error", "error in x", "error in y", "heading error", "planar error, bound : 1 mm"):
        assert any(text.startswith(name) for text in texts), texts


def test_two_clicks_measure_time_and_every_signal(opened: "browsers.Page", failed: Path) -> None:
    for share in (0.3, 0.8):
        point(opened, share)
        # A second click within 0.3 s makes a double click.
        opened.wait_until("performance.now() - (window.clicked || -1000) > 350", 10.0)
        opened.mouse("mousePressed", *at(opened, share))
        opened.mouse("mouseReleased", *at(opened, share))
        opened.value("window.clicked = performance.now()")
        opened.wait_until(f"document.querySelectorAll('#measured-0 th').length === {2 if share == 0.3 else 4}", 10.0)
    rows = "[...document.querySelectorAll('#measured-0 tr')].slice(0, 2)"
    head, planar = opened.value(f"{rows}.map((row) => [...row.cells].map((cell) => cell.textContent))")
    times = [float(text.split(": ")[1].removesuffix(" s")) for text in head[1:3]]
    assert head[3] == f"Δt {times[1] - times[0]:.6g} s"
    run = read_for_page(failed)
    values = np.interp(times, run.signals["loop.t_s"], 1e3 * run.signals["error.planar_m"])
    assert planar[0] == "planar error [mm]"
    np.testing.assert_allclose([float(text) for text in planar[1:3]], values, rtol=1e-3)
    assert float(planar[3].removeprefix("Δ ")) == pytest.approx(values[1] - values[0], rel=1e-3)
    assert opened.value("document.querySelectorAll('#measured-3 tr').length") > 4, "the wheels are measured too"


def test_a_zoom_is_one_of_all_charts_over_time(opened: "browsers.Page") -> None:
    ranges = "[0, 2, 3].map((n) => document.getElementById(`chart-${n}`)._fullLayout.xaxis.range)"
    before = opened.value(ranges)
    opened.mouse("mouseMoved", *at(opened, 0.25))
    opened.mouse("mousePressed", *at(opened, 0.25))
    for share in (0.3, 0.4, 0.5):
        opened.mouse("mouseMoved", *at(opened, share))
    opened.mouse("mouseReleased", *at(opened, 0.5))
    opened.wait_until(f"JSON.stringify({ranges}[1]) !== '{str(before[1]).replace(' ', '')}'", 10.0)
    opened.wait_until(f"new Set({ranges}.map(String)).size === 1", 10.0)
    low, high = opened.value(ranges)[0]
    assert low == pytest.approx(0.25, abs=0.02)
    assert high == pytest.approx(0.5, abs=0.02)


def test_a_time_of_what_happened_shows_that_instant_in_every_chart(opened: "browsers.Page") -> None:
    opened.value("document.querySelector('button.at').click()")
    ranges = "[0, 2, 3].map((n) => String(document.getElementById(`chart-${n}`)._fullLayout.xaxis.range))"
    at_s = float(opened.value("document.querySelector('button.at').dataset.t"))
    opened.wait_until(f"new Set({ranges}.concat('{at_s - 0.5:g},{at_s + 0.5:g}')).size === 1", 10.0)


def test_a_phone_needs_no_scrolling_sideways_and_paper_takes_it(opened: "browsers.Page") -> None:
    pdf = pytest.importorskip("pypdfium2")
    opened.open(opened.value("location.href"))  # without the cursors of the tests before
    opened.wait_until(DRAWN, 60.0)
    first = pdf.PdfDocument(opened.printed())[0].get_textpage().get_text_range()
    assert "FAILED at t = 0.2 s" in first
    assert "heading error [mrad]" in first, "the whole first chart is on the first page"
    opened.resize(390, 844, is_phone=True)
    wide = "[...document.querySelectorAll('body *')].filter((one) => one.getBoundingClientRect().right > 390)"
    opened.wait_until(f"{wide}.length === 0", 20.0)  # nothing is cut off, or scrolls
    assert opened.value("document.documentElement.scrollWidth") == 390
    assert opened.errors == []
