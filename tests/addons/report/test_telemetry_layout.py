"""Where signals lie in a recording, and how series are thinned."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import hil
from hil.addons.report.claim_watch import ClaimWatch, claims, limits
from hil.addons.report.decimate import Decimator
from hil.addons.report.entities import layout
from hil.addons.report.lanes import FaultLane, Lane
from hil.addons.report.review_windows import Course, Moment, moments, windows
from hil.addons.report.urdf import RobotShape
from hil.addons.report.verdict_text import page
from hil.core.signals import SIGNAL_NAMES, unit_of
from hil.judge.run_text import with_page
from hil.laws.afdsc import FIRING
from hil.runtime.provenance import properties
from tests.support.golden import assert_golden

PICTURES = Path(__file__).parents[3] / "tools" / "pictures"
GOLDEN = Path(__file__).parent / "golden"
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
    signals = [f"fuzzy.{axis}.{name}" for axis in AXES for name in FIRING]
    entities = {entity.path: entity.series for entity in layout(signals)}
    assert entities.keys() == {f"/more/fuzzy/{name}/number" for name in FIRING}
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
    from hil.addons.report.blueprint import blueprint
    from tools.screenshot import TABS

    course = Course(0.0, 15.0, ("/ctrl/error/position",), None, windows(0.0, 15.0, None, []), 0, 1)
    laid_out: Any = blueprint(layout(SIGNAL_NAMES), limits={}, shape=None, live=False, course=course).root_container
    with Image.open(picture) as image:
        shown = image.info.get(TABS, "").split(", ")
    # Their numbers hang on the run.
    names = [re.sub(r"^(Transients) \d+$", r"\1", name) for name in shown]
    assert [*dict.fromkeys(names)] == [tab.name for tab in laid_out.contents], "take it again: make picture"


def laid_out(part: Any, indent: str = "") -> Iterator[str]:
    """Yield a layout as lines: what is beside and below what, what each view shows, and how."""
    words = [type(part).__name__, repr(part.name)]
    for name in ("origin", "column_shares", "row_shares", "active_tab", "titlebar"):
        words += [f"{name} {value}" for value in [getattr(part, name, None)] if value is not None]
    if isinstance(contents := getattr(part, "contents", ()), str) or all(isinstance(one, str) for one in contents):
        words.append(f"shows {contents}")
        contents = ()
    yield indent + ", ".join(words)
    told = [*part.properties.items(), *part.visualizer_overrides.items()] if hasattr(part, "properties") else []
    for name, archetypes in told:
        for archetype in archetypes if isinstance(archetypes, list) else [archetypes]:
            for batch in archetype.as_component_batches():
                if values := batch.as_arrow_array().to_pylist():
                    yield f"{indent}    {name} {str(batch.component_descriptor()).rpartition(':')[2]} {values}"
    for one in contents:
        yield from laid_out(one, indent + "  ")


@pytest.mark.parametrize("kind", ["live", "ended"])
def test_the_viewer_is_laid_out_so(kind: str) -> None:
    from hil.addons.report.blueprint import blueprint, first_blueprint

    signals = [*SIGNAL_NAMES, "fuzzy.x.error", "fuzzy.y.error", "arm.angle_rad"]
    entities, values = layout(signals), {"robot.torque_limit_n_m": 5.0, "firmware.current_limit_a": 8.0}
    values |= {"expect.1.signal": "error.planar_m", "expect.1.below": 0.02, "expect.1.from_s": 1.0}
    values |= {"expect.2.signal": "error.x_m", "expect.2.within": [-0.015, 0.03], "expect.3.at_rest": True}
    values |= {"expect.3.below": 0.5, "expect.3.from_s": 2.0, "expect.4.signal": "truth.x_m"}
    values |= {"expect.4.of": "reference.x_m", "expect.4.equals": 0.25, "expect.4.tolerance": 0.125}
    bounds = limits(values, claims(values), entities)
    shape = RobotShape(mass_kg=20.0, wheel_radius_m=0.075, half_length_m=0.3, half_width_m=0.2)
    lines = [f"{path}: {limit}" for path, some in bounds.items() for limit in some]
    if kind == "live":
        told = [
            first_blueprint(entities, limits=bounds, shape=None, live=True),
            blueprint(entities, limits=bounds, shape=None, live=True),
        ]
    else:
        happened = [Moment(10.0 * n, f"drop {n}", 0.5) for n in range(1, 6)]
        found = windows(0.0, 100.0, {"tracked_s": 2.0}, happened)
        course = Course(0.0, 100.0, ("/ctrl/error/position", "/link/age"), (1.5, 2.25), found, 7, 3)
        other = course._replace(violated=("/ctrl/error/heading",), windows=found[:2], first_violation=None, lanes=30)
        told = [
            blueprint(entities, limits=bounds, shape=shape, live=False, course=course),
            blueprint(entities[:12], limits={}, shape=shape, live=False, course=other),
        ]
    for one in told:
        lines += ["", *laid_out(one.root_container)]
        panel = one.time_panel
        lines.append(f"time: {panel.timeline} {panel.play_state} {panel.state} {panel.time_selection}")
        lines.append(f"panels: {one.blueprint_panel.state} {one.selection_panel.state}; views: {one.auto_views}")
    assert_golden(GOLDEN / f"layout_{kind}.txt", "\n".join(lines) + "\n")


def test_windows_are_cut_to_the_run_and_shared_by_what_is_together() -> None:
    def spans(end_s: float, tracked_s: float | None, *moments: Moment, begin_s: float = 0.0) -> list[tuple[Any, ...]]:
        found = windows(begin_s, end_s, None if tracked_s is None else {"tracked_s": tracked_s}, moments)
        return [(round(one.from_s, 6), round(one.to_s, 6), one.words) for one in found]

    assert spans(100.0, None) == [(0.0, 1.0, "start")]
    assert spans(0.4, None) == [(0.0, 0.4, "start")]
    assert spans(100.0, 0.2) == [(0.0, 0.5, "start")]
    assert spans(100.0, 2.0, begin_s=1.0) == [(1.0, 4.0, "start")]
    assert spans(100.0, 50.0) == [(0.0, 10.0, "start")]
    assert spans(100.0, 0.0, Moment(0.0, "at once")) == [(0.0, 1.0, "start"), (0.0, 1.0, "at once at 0 s")]
    assert spans(21.0, None, Moment(20.0, "late", 10.0), Moment(5.0, "first")) == [
        (0.0, 1.0, "start"), (4.75, 6.0, "first at 5 s"), (19.0, 21.0, "late at 20 s"),
    ]  # fmt: skip
    together = [Moment(5.0, "a", 2.5), Moment(5.125, "b"), Moment(5.25, "c")]
    assert spans(50.0, None, *together)[1:] == [(4.125, 8.5, "a at 5 s; b"), (5.0, 6.25, "c at 5.25 s")]
    assert len(spans(50.0, None, *(Moment(float(n), "drop") for n in range(1, 20)))) == 8


def test_what_happened_are_faults_violations_losses_and_the_end() -> None:
    values = {"expect.1.signal": "error.x_m", "expect.1.below": 1.0, "expect.1.from_s": 1.0}
    watches = [ClaimWatch(claim, {"loop.t_s": 0, "error.x_m": 1}, values) for claim in 2 * claims(values)]
    watches[1](np.array([[0.5, 9.0], [1.0, 0.5], [1.5, 2.0], [2.0, 3.0], [2.5, 0.0], [3.0, 9.0]]))
    assert watches[1].violation_s == (1.5, 2.5)
    lane = Lane("/state/6", {})
    faults = [FaultLane(lane, "IN FORCE", "drop command", 2.0, 3.5), FaultLane(lane, "IN FORCE", "push", 4.0, 99.0)]
    summary = {"recoveries": [{"lost_s": 5.0, "armed_s": 6.25}], "failure": "gone"}
    expected = [
        Moment(2.0, "drop command", 1.5), Moment(4.0, "push", 6.0), Moment(1.5, "violated: error.x_m below 1"),
        Moment(5.0, "robot lost", 1.25), Moment(10.0, "run ended"),
    ]  # fmt: skip
    assert moments(watches, faults, summary, 10.0) == expected
    assert moments(watches, faults, None, 10.0) == expected[:3]


def test_the_run_s_side_imports_nothing_heavy() -> None:
    heavy = "{'rerun', 'pyarrow', 'pandas', 'fmpy'} & set(sys.modules)"
    code = f"import hil.record.recording, hil.addons.report.viewer, hil.judge.figures, sys; sys.exit(str({heavy} or 0))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "0"


def test_the_page_of_a_run_has_words_and_units() -> None:
    result = hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []})
    told = page(properties(result.scenario), json.loads(json.dumps(with_page(result.run))))
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
