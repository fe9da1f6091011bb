"""Where signals lie in a recording, and how series are thinned."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import hil
from hil.core.signals import SIGNAL_NAMES, unit_of
from hil.judge.words import with_page
from hil.laws.fuzzy import FIRING
from hil.record.drawings import Decimator
from hil.record.layout import layout
from hil.record.properties import page
from hil.runtime.provenance import properties

PICTURES = Path(__file__).parents[1] / "tools" / "pictures"
AXES = ("x", "y", "heading")


def test_every_signal_of_the_vocabulary_has_a_place_of_its_own() -> None:
    placed = [series.signal for entity in layout(SIGNAL_NAMES) for series in entity.series]
    assert sorted(placed) == sorted(SIGNAL_NAMES)
    assert not [entity.path for entity in layout(SIGNAL_NAMES) if entity.path.startswith("/more/")]


@given(st.lists(st.sampled_from([*SIGNAL_NAMES, "arm.angle_rad", "arm.speed_rad_s", "plain"]), unique=True))
def test_any_vocabulary_is_placed_completely(signals: list[str]) -> None:
    entities = layout(signals)
    assert sorted(series.signal for entity in entities for series in entity.series) == sorted(signals)
    assert len({entity.path for entity in entities}) == len(entities)


def test_the_paths_that_one_panel_draws_have_one_unit() -> None:
    for entity in layout(SIGNAL_NAMES):
        if entity.path.startswith(("/ctrl/error", "/ctrl/gain", "/ctrl/wheel", "/loop/timing", "/link/age")):
            assert len({unit_of(series.signal) for series in entity.series}) == 1


def test_what_each_axis_of_a_law_has_is_drawn_apart_in_the_colours_of_the_axes() -> None:
    signals = [f"{law}fuzzy.{axis}.{name}" for law in ("", "shadow.afdsc.") for axis in AXES for name in FIRING]
    entities = {entity.path: entity.series for entity in layout(signals)}
    own = {f"/more/fuzzy/{name}/number" for name in FIRING}
    assert entities.keys() == own | {f"/more/shadow/afdsc/fuzzy/{name}/number" for name in FIRING}
    (pose,) = layout([f"pose.{name}" for name in ("x_m", "y_m", "heading_rad")])
    colours = [(series.label, series.colour) for series in pose.series]
    assert all([(series.label, series.colour) for series in found] == colours for found in entities.values())


@given(
    periods=st.lists(st.integers(0, 30), min_size=1, max_size=80).map(sorted),
    cuts=st.lists(st.integers(0, 80), max_size=4).map(sorted),
)
def test_thinning_keeps_the_first_row_of_each_period_however_it_is_cut(periods: list[int], cuts: list[int]) -> None:
    t_s = np.array(periods) * 0.004
    decimator = Decimator(0.01)
    kept: list[float] = []
    for piece in np.split(t_s, [cut for cut in cuts if cut <= len(t_s)]):
        kept += list(piece[decimator.keep(piece)])
    first: dict[int, float] = {}
    for time in t_s:
        first.setdefault(int(time * 1e9 + 0.5) // 10_000_000, time)
    assert kept == list(first.values())


@pytest.mark.parametrize(
    "picture", [*PICTURES.glob("viewer_*.png"), *PICTURES.glob("paper_*.png")], ids=lambda path: path.stem
)
def test_a_picture_of_the_viewer_has_the_tabs_of_the_layout(picture: Path) -> None:
    from hil.record.blueprint import blueprint
    from hil.record.course import Course, windows
    from tools.screenshot import TABS

    course = Course(0.0, 15.0, ("/ctrl/error/position",), None, windows(0.0, 15.0, None, []), 0, 1)
    laid_out: Any = blueprint(layout(SIGNAL_NAMES), limits={}, shape=None, live=False, course=course).root_container
    with Image.open(picture) as image:
        shown = image.info.get(TABS, "").split(", ")
    # Their numbers, and whether there are shadows, hang on the run.
    names = [re.sub(r"^(Transients) \d+$", r"\1", name) for name in shown if not name.startswith("Shadow ")]
    assert [*dict.fromkeys(names)] == [tab.name for tab in laid_out.contents], "take it again: make picture"


def test_the_run_s_side_imports_nothing_heavy() -> None:
    heavy = "{'rerun', 'pyarrow', 'pandas', 'fmpy'} & set(sys.modules)"
    code = f"import hil.record, hil.record.viewer, hil.review, hil.judge.figures, sys; sys.exit(str({heavy} or 0))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "0"


def test_the_page_of_a_run_has_words_and_units() -> None:
    result = hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []})
    told = page(properties(result.scenario), json.loads(json.dumps(with_page(result.metrics))))
    raw = {*result.metrics, *properties(result.scenario)} - {"law", "link", "seed", "mode", "started", "python"}
    raw -= {"passed", "ticks", "effort", "overshoot", "frames", "machine", "commit", "failure", "scenario", "baseline"}
    labels = {line.split("|")[1].strip() for line in told.splitlines() if line.startswith("|")}
    assert not labels & raw, "names of the JSON are no words"
    assert "| passed | yes |" in told
    assert "| ticks | 20 |" in told
    assert " N·m·s |" in told
    assert "[]" not in told
    assert "| options of the law | k1_1_s = " in told
    assert all(line.count("|") == 3 for line in told.splitlines() if line.startswith("|"))
    assert "a\\|b c" in page({"replay": "a|b\nc"}, {})
