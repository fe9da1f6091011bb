"""The chart of believed against true poses, of recordings of real runs."""

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.addons.report.panels import charts, read_for_page
from hil.addons.report.shown import Shown
from hil.judge.recorded import judged_run

TITLE = "Believed and true pose"
TICKS = 40


def shown(folder: Path, source: str) -> tuple[Shown, hil.RunResult]:
    path = folder / f"{source}.mcap"
    ran = hil.run("circle_speed", set={"estimator.source": source, "loop.duration_s": 0.2}, record=path, lenient=True)
    run = read_for_page(path)
    return Shown(source, run, judged_run(run), (0, 114, 178)), ran


def test_an_estimate_is_shown_against_the_truth_with_what_was_believed_of_its_error(tmp_path):
    fused, ran = shown(tmp_path, "fused")
    (chart,) = [one for one in charts([fused]) if one.title == TITLE]
    assert [panel.title.partition(",")[0] for panel in chart.panels] == ["x", "y", "heading"]
    for panel, name in zip(chart.panels, ("x_m", "y_m", "heading_rad"), strict=True):
        apart, low, high = panel.lines
        expected = 1e3 * (ran.signals[f"pose.{name}"] - ran.signals[f"truth.{name}"])
        assert len(expected) == TICKS
        assert apart.y == pytest.approx(expected)
        sigma = "heading_rad" if name == "heading_rad" else "position_m"
        assert high.y == pytest.approx(2e3 * ran.signals[f"estimator.sigma_{sigma}"])
        assert np.array_equal(low.y, -high.y)
    (path,) = [one for one in charts([fused]) if one.title == "Path"]
    assert [line.label for line in path.panels[0].lines] == ["reference", "believed", "truth"]


def test_a_run_on_the_truth_has_no_such_chart_and_another_one_beside_it_has_its_line(tmp_path):
    truth, _ = shown(tmp_path, "truth")
    assert TITLE not in [one.title for one in charts([truth])]
    odometry, _ = shown(tmp_path, "odometry")
    (chart,) = [one for one in charts([odometry, truth]) if one.title == TITLE]
    assert [line.label for line in chart.panels[0].lines] == ["odometry"], "odometry tells no deviation"
