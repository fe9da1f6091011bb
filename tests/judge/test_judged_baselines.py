"""A run against a baseline and a baseline from runs, both made up: what is judged, and what is told of it."""

from dataclasses import replace
from typing import Any

import pytest

from hil.judge.baselines import against_baseline, baseline_of, baseline_words, why_not_judged
from hil.judge.judged_run import FramesResult, JudgedRun
from hil.scenario import Scenario, load
from hil.scenario.baseline import Band, Baseline, asked_sha256, this_platform
from hil.scenario.trial import ExpectTable

SHA, OTHER_SHA = "0123456789abcdef" * 4, "fedcba9876543210" * 4
SCENARIO = replace(load("circle_speed", seed=7, set={"expect": []}), baseline=None)
SETS: dict[str, Any] = {
    "robot.mass_kg": 21.0, "robot.inertia_kg_m2": 0.75, "robot.half_width_m": 0.25, "controller.gains.k1_1_s": 9.0,
    "reference.radius_m": 1.25, "loop.duration_s": 0.5,
}  # in the order of a scenario  # fmt: skip


def baseline(**changes: Any) -> Baseline:
    """Return a baseline by which runs of ``SCENARIO`` are judged."""
    figure = {"steady_rms_m": Band(0.002, 0.0, 0.0005), "rejected": Band(0.0, 0.0, 0.0), "gone": Band(1.0, 0.0, 0.1)}
    sha256 = asked_sha256(SCENARIO)
    made = Baseline("x", sha256, "lockstep", this_platform(), (7, 8), SHA, figure, "x.baseline.toml")
    return replace(made, **changes)


def with_baseline(made: Baseline, **changes: Any) -> Scenario:
    return replace(SCENARIO, baseline=made, **changes)


def run(steady_rms_m: float | None = 0.0025, rejected: int = 0, **changes: Any) -> JudgedRun:
    whole = JudgedRun(figures={"steady_rms_m": steady_rms_m}, wire_sha256=SHA)
    return replace(whole, counts=whole.counts._replace(rejected=rejected), **changes)


@pytest.mark.parametrize(("count", "more"), [(1, ""), (4, ""), (5, " and 1 more"), (6, " and 2 more")])
def test_what_was_given_and_is_asked_is_named_up_to_four_keys(count: int, more: str) -> None:
    names = list(SETS)[:count]
    # Neither a seed nor an expectation is asked of the controller; the rows of a fault are one thing.
    given = load("circle_speed", seed=9, set={"expect": [], **{name: SETS[name] for name in names}})
    assert why_not_judged(given, baseline()) == (
        f"the run differs from those that made it, in {', '.join(names[:4])}{more}"
    )
    faults = [{"kind": "drop", "target": "command", "value": share} for share in (0.1, 0.2)]
    with_faults = load("circle_speed", set={"expect": [], "fault": faults})
    assert str(why_not_judged(with_faults, baseline())).endswith(", in fault")


def test_a_baseline_is_of_one_mode_and_of_one_scenario() -> None:
    realtime = "it was made in real time, and the run is in lockstep"
    assert why_not_judged(SCENARIO, baseline()) is None
    assert why_not_judged(SCENARIO, baseline(mode="realtime")) == realtime
    assert "its scenario was another one" in str(why_not_judged(SCENARIO, baseline(scenario_sha256="ab")))
    assert baseline_words(with_baseline(baseline())) == "x.baseline.toml, 3 figures"
    assert baseline_words(with_baseline(baseline(mode="realtime"))) == f"not judged against it: {realtime}"
    assert baseline_words(SCENARIO) == "none; `hil baseline` makes it"


@pytest.mark.parametrize(
    ("figures", "texts"),
    [
        ({}, []),
        ({"steady_rms_m": 0.0015}, []),
        ({"steady_rms_m": 0.003}, ["steady_rms_m: 0.003 in place of 0.002 ± 0.0005, +50 %"]),
        ({"steady_rms_m": 0.001}, ["steady_rms_m: 0.001 in place of 0.002 ± 0.0005, -50 %"]),
        ({"rejected": 3}, ["rejected: 3 in place of 0 ± 0"]),
        (
            {"steady_rms_m": None, "reasons": {"steady_rms_m": "it was short"}},
            ["steady_rms_m: no value (it was short) in place of 0.002 ± 0.0005"],
        ),
        ({"steady_rms_m": None, "reasons": {"steady_rms_m": "the run has no ground truth"}}, []),
    ],
)
def test_figures_outside_their_bands_are_told_with_how_far(figures: dict[str, Any], texts: list[str]) -> None:
    found = against_baseline(with_baseline(baseline()), run(**figures), is_cut=False)
    assert found is not None
    assert [row.text for row in found.figures] == texts
    assert (found.judged, found.file, found.why) == (3, "x.baseline.toml", None)


def test_what_is_not_judged_against_a_baseline() -> None:
    assert against_baseline(SCENARIO, run(), is_cut=False) is None
    cut = against_baseline(with_baseline(baseline()), run(0.1), is_cut=True)
    assert cut is not None
    assert (cut.why, cut.judged, cut.figures, cut.frames) == ("the run ended early", 0, (), None)
    own = with_baseline(baseline(), expect=[ExpectTable(figure="steady_rms_m", baseline="99%")])
    found = against_baseline(own, run(0.1), is_cut=False)
    assert found is not None
    assert (found.judged, found.figures) == (2, []), "an expectation judges that figure"
    absolute = with_baseline(baseline(), expect=[ExpectTable(figure="steady_rms_m", below=1.0)])
    found = against_baseline(absolute, run(0.1), is_cut=False)
    assert found is not None
    assert (found.judged, len(found.figures)) == (3, 1)


DIFFER = "wire_sha256 is fedcba987654, not 0123456789ab"


@pytest.mark.parametrize(
    ("changes", "sha256", "frames"),
    [
        ({}, SHA, FramesResult(True, "the frames on the wire are the same")),
        ({"platform": "Plan 9"}, SHA, FramesResult(True, "the frames on the wire are the same")),
        ({}, OTHER_SHA, FramesResult(False, f"the frames on the wire are others: {DIFFER}")),
        (
            {"platform": "Plan 9"},
            OTHER_SHA,
            FramesResult(None, f"{DIFFER}; not judged: made on Plan 9, and this is {this_platform()}"),
        ),
        ({"seeds": (8, 7)}, OTHER_SHA, None),
        ({"wire_sha256": ""}, OTHER_SHA, None),
        ({}, None, None),
    ],
)
def test_frames_are_judged_by_the_first_seed_on_the_platform_of_the_baseline(
    changes: dict[str, Any], sha256: str | None, frames: FramesResult | None
) -> None:
    found = against_baseline(with_baseline(baseline(**changes)), run(wire_sha256=sha256), is_cut=False)
    assert found is not None
    assert found.frames == frames


def made_of(*figures: dict[str, Any], mode: str | None = None) -> Baseline:
    runs = {seed: JudgedRun(figures=one, wire_sha256=SHA) for seed, one in enumerate(figures, start=7)}
    return baseline_of(load("circle_speed", mode=mode, set={"loop.duration_s": 4.0, "loop.rate_hz": 50}), runs)


def test_a_baseline_has_the_figures_that_all_runs_have_in_bands_around_the_first() -> None:
    made = made_of({"steady_rms_m": 0.002, "overshoot_m": 0.5}, {"steady_rms_m": 0.0025, "overshoot_m": None})
    assert made.figure == {"steady_rms_m": Band(0.002, 0.0005, 0.0015), "recoveries": Band(0.0, 0.0, 0.0)}
    assert (made.seeds, made.mode, made.platform, made.wire_sha256) == ((7, 8), "lockstep", this_platform(), SHA)
    assert made_of({"steady_rms_m": 0.002}, mode="realtime").wire_sha256 == ""


def test_a_time_of_the_end_whose_band_comes_to_the_end_tells_nothing() -> None:
    alike = made_of({"t10_s": 2.0, "steady_max_m": 0.5}, {"t10_s": 2.0, "steady_max_m": 0.5})
    assert alike.figure["t10_s"] == Band(2.0, 0.0, 0.04), "2 % of it"
    by_chance = made_of({"t10_s": 0.25, "steady_max_m": 0.5}, {"t10_s": 0.25, "steady_max_m": 0.25})
    assert by_chance.figure["t10_s"] == Band(0.25, 0.0, 0.02), "a tick at 50 Hz"
    for spread_s, is_known in ((0.5, True), (0.75, False), (1.0, False)):  # 1 s and three spreads; the run takes 4 s
        made = made_of({"t10_s": 1.75, "steady_max_m": 9.0}, {"t10_s": 1.75 - spread_s, "steady_max_m": 9.0})
        assert ("t10_s" in made.figure, "steady_max_m" in made.figure) == (is_known, True)
