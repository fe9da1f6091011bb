"""Hunts: a planted defect is found, made smaller and saved so that it fails again; a killed hunt goes on."""

import contextlib
import json
import random
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil as package
from hil.addons.batch.hunt.hunt import Hunt
from hil.addons.batch.hunt.hunt_file import Request
from hil.addons.batch.hunt.search import AT_A_TIME, search, shrink
from hil.addons.batch.hunt.space import Change, Chosen, HuntTables, OfferTable, Space, SpanTable
from hil.addons.batch.job import PASSED
from hil.addons.batch.store import read_rows
from hil.core.errors import BadInputError
from tests.support.campaigns import rows_written
from tests.support.processes import HIL, ROOT, environment, hil
from tools.bench import hunt as bench
from tools.bench import planted

pytest.importorskip("optuna", reason="needs the extra 'hunt': pip install 'mecanum-hil[hunt]'")

PLAN = """
runs = {runs}
{more}
[set]
loop.duration_s = 0.6
expect = [{{ signal = "error.planar_m", from_s = 0.5, below = {below} }}]

[range]
plant.start.mass_kg = [16, 24]
plant.start.friction_coefficient = {{ log_uniform = [0.01, 0.3] }}

[[fault]]
kind = "dead_motor"
target = ["fl", "rr"]
start_s = [0.0, 0.5]
duration_s = [0.02, 0.2]
"""
"""A heavy robot with much friction lags behind by more than 0.46 m; neither alone does."""


def plan(folder: Path, *, below: float = 0.46, runs: int = 40, more: str = "") -> Path:
    file = folder / "circle_speed.hunt.toml"
    file.write_text(PLAN.format(below=below, runs=runs, more=more), encoding="utf-8")
    return file


def test_what_is_found_is_made_small_and_fails_again_to_the_byte(tmp_path: Path) -> None:
    plan(tmp_path)
    done = hil("hunt", "circle_speed", "--jobs", "1", "--json", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    result = json.loads(done.stdout)
    jsonschema.validate(
        result, json.loads((ROOT / "hil/addons/batch/hunt/hunt.schema.json").read_text(encoding="utf-8"))
    )
    saved = tmp_path / result["scenario"]
    text = saved.read_text(encoding="utf-8")
    assert text.startswith(f"# {result['reason']}\n")
    assert "error.planar_m below 0.46" in result["reason"]
    again = package.run(saved)
    assert not again.passed
    assert again.failure is None
    assert again.metrics["wire_sha256"] == result["wire_sha256"]
    refused = hil("hunt", "circle_speed", "--jobs", "1", cwd=tmp_path)
    assert (refused.returncode, refused.stderr) == (
        2,
        f"hil: scenario {result['scenario']}: an earlier hunt found it; name another folder with --out, or replace it "
        "with --force\n",
    )


def test_a_hunt_that_finds_nothing_says_what_came_nearest(tmp_path: Path) -> None:
    plan(tmp_path, below=10.0, runs=6)
    done = hil("hunt", "circle_speed", "--jobs", "1", "--json", cwd=tmp_path)
    result = json.loads(done.stdout)
    assert (done.returncode, result["found"], result["runs"]) == (0, False, 6)
    assert 0.9 < result["least_margin"] < 1.0
    assert "of the margin of error.planar_m is left" in result["nearest"]


def test_a_hunt_that_was_killed_goes_on_and_finds_the_same(tmp_path: Path) -> None:
    file = plan(tmp_path, below=0.43, runs=60)
    whole = Hunt(Request("circle_speed", file, workers=1))
    whole.perform(tmp_path / "whole")
    folder = tmp_path / "killed"
    command = [*HIL, "hunt", "circle_speed", "--ranges", str(file), "--out", str(folder), "--jobs", "1"]
    with subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL) as process:
        while process.poll() is None and not rows_written(folder):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    there = read_rows(folder)
    assert there
    continued = Hunt(Request("circle_speed", file, workers=2))
    continued.perform(folder)
    after = read_rows(folder)
    assert {key: after[key] for key in there} == there, "what was known was not run again"
    assert whole.found is not None
    assert continued.found is not None
    assert (continued.runs, continued.found.case) == (whole.runs, whole.found.case)
    assert continued.found.outcome.figures["wire_sha256"] == whole.found.outcome.figures["wire_sha256"]


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("runs =", "rums =", "unknown key rums; did you mean 'runs'?"),
        ("plant.start.mass_kg", "plant.start.mas_kg", "mass_kg"),
        ("plant.start.mass_kg", "plant.strat.mass_kg", "start"),
        ('"dead_motor"', '"dead_moter"', "dead_motor"),
        ("log_uniform", "log_unifrom", "did you mean 'range.plant.start.friction_coefficient.log_uniform'?"),
        ("[16, 24]", "[24, 16]", "expected [low, high] with low < high"),
        ("duration_s = [0.02", "durations = [0.02", "did you mean 'fault.1.duration_s'?"),
        ('"rr"]', '"rear"]', "rear"),
        ("[16, 24]", "[16]", "expected [low, high], or one of { uniform = [low, high] }, log_uniform, one_of"),
        ('["fl", "rr"]', "[]", "target = []; expected a target, or an array of targets"),
        (
            "loop.duration_s = 0.6",
            'loop.mode = "realtime"',
            'in real time no run comes twice; give loop.mode = "lockstep" in [set]',
        ),
    ],
)
def test_what_is_wrong_in_the_file_is_refused_with_its_place(
    wrong: str, right: str, words: str, tmp_path: Path
) -> None:
    file = plan(tmp_path)
    text = file.read_text(encoding="utf-8")
    assert wrong in text
    file.write_text(text.replace(wrong, right), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"hunt .*circle_speed\.hunt\.toml:") as error:
        Hunt(Request("circle_speed", file))
    assert words in str(error.value)


def space() -> Space:
    numbers = {"start_s": (0.0, 2.0), "duration_s": (0.1, 1.0), "value": (0.1, 0.9)}
    offer = OfferTable("drop", ("command",), **{name: SpanTable(uniform=one) for name, one in numbers.items()})
    ranges = {"a": SpanTable(uniform=(0.0, 10.0)), "b": SpanTable(log_uniform=(0.1, 10.0))}
    return Space(HuntTables(at_once=2, range=ranges, fault=(offer, offer)), {"a": 5.0, "b": 1.0})


def explored(seed: int, runs: int) -> list[Mapping[str, Any]]:
    """The cases that a search tries when a = 10 with b = 0.1 and a fault is worst."""
    steps, there = search(space(), seed), space()
    params, found = next(steps), []
    while len(found) < runs:
        found += params
        cases = [there.case(one) for one in params]
        params = steps.send([{0: _score(case), 3: 1.0} for case in cases])
    return found


def _score(case: Change) -> float:
    values = {"a": 5.0, "b": 1.0} | dict(case.values)
    return 1.0 - values["a"] / 20.0 + values["b"] / 20.0 - 0.2 * len(case.faults)


def test_a_search_depends_on_its_seed_alone_and_nears_what_is_worst() -> None:
    once, again, other = explored(1, 60), explored(1, 60), explored(2, 60)
    assert once == again != other
    chance = random.Random(1)
    drawn = [space().suggested(lambda _, n: chance.randrange(n) if n else chance.random()) for _ in range(60)]
    best, best_drawn = (min(_score(space().case(one)) for one in some) for some in (once, drawn))
    assert best < best_drawn


CASES = st.builds(
    lambda a, b, faults: Change(
        {"a": round(a, 3), "b": round(b, 4)},
        tuple(
            Chosen(offer, {"target": "command", "start_s": 0.5, "duration_s": round(d, 3), "value": round(v, 4)})
            for offer, (d, v) in enumerate(faults)
        ),
    ),
    st.floats(0.0, 10.0),
    st.floats(0.1, 10.0),
    st.lists(st.tuples(st.floats(0.1, 1.0), st.floats(0.1, 0.9)), max_size=2),
)


@given(CASES, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_smaller_case_breaks_the_same_and_nothing_that_is_not_needed_is_left(case, needs_a, needs_value) -> None:
    def breaks(one: Change) -> bool:
        far = abs(one.values.get("a", 5.0) - 5.0) >= needs_a * abs(case.values["a"] - 5.0)
        strongest = max((fault.given["value"] for fault in case.faults), default=0.0)
        return far and max((fault.given["value"] for fault in one.faults), default=0.0) >= needs_value * strongest

    steps = shrink(space(), case)
    runs = 0
    try:
        tried: Sequence[Change] = next(steps)
        while True:
            runs += len(tried)
            tried = steps.send([breaks(one) for one in tried])
    except StopIteration as end:
        smallest: Change = end.value
    assert breaks(smallest)
    assert runs < 600
    assert "b" not in smallest.values
    assert len(smallest.faults) <= 1
    if needs_a == 0.0:
        assert not smallest.values
    elif "a" in smallest.values:
        needed = needs_a * abs(case.values["a"] - 5.0)
        assert abs(smallest.values["a"] - 5.0) <= 1.12 * needed + 0.02


def test_the_page_has_the_planted_defects_and_random_search_seldom_meets_them() -> None:
    rates = json.loads(bench.RATES.read_text(encoding="utf-8"))
    assert list(rates) == [one.name for one in planted.DEFECTS]
    rare = [name for name, rate in rates.items() if 0 < rate["broken"] <= bench.RARE * rate["runs"]]
    assert len(rare) >= 20
    rows = (ROOT / "docs/results/hunts.md").read_text(encoding="utf-8").split("\n| ")
    assert {row.partition(" |")[0] for row in rows} >= set(rare)


def test_a_planted_defect_acts_where_its_condition_is_met_and_nowhere_else(tmp_path: Path) -> None:
    hunt = planted.hunt_of(planted.HEALTHY, tmp_path, 1, seed=1)
    defect = next(one for one in planted.DEFECTS if one.name == "turned far")
    for heading_rad, is_met in ((0.585, True), (0.685, False)):
        job = hunt.cases.job(Change({"plant.start.start_heading_rad": heading_rad}))
        assert job is not None
        healthy, met = bench.watched(job, tmp_path)
        outcome = bench.done(bench.planted(job, defect))
        assert (defect.is_met(job.scenario, met), bench.breaks(hunt, outcome)) == (is_met, is_met)
        assert healthy.status == PASSED
        assert (outcome.figures["wire_sha256"] == healthy.figures["wire_sha256"]) is not is_met


def test_defects_of_the_bench_are_found_together_as_they_are_alone(tmp_path: Path) -> None:
    defects = [one for one in planted.DEFECTS if one.name in ("turned far", "needle")]
    together = bench.hunted_together(defects, tmp_path, 12, seed=1)
    alone = {one.name: bench.hunted(one, tmp_path, 12, seed=1) for one in defects}
    assert together["turned far"] is not None
    assert alone["turned far"] is not None
    assert together["needle"] == alone["needle"]
    assert 0 <= alone["turned far"] - together["turned far"] < AT_A_TIME, (
        "alone, runs that were done before count again"
    )
