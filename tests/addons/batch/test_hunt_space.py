"""Cases of a hunt: values in their ranges, single changes, combinations and coincident faults; verdicts on a run."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.batch.hunt import hunt as hunt_module
from hil.addons.batch.hunt.hunt import Hunt
from hil.addons.batch.hunt.hunt_file import Request
from hil.addons.batch.hunt.search import _least, search
from hil.addons.batch.hunt.space import Change, Chosen, HuntTables, OfferTable, Space, SpanTable
from hil.addons.batch.job import ENDED, FAILED, LOST, PASSED, REFUSED, Outcome
from hil.core.errors import BadInputError

LIMITS = st.tuples(st.floats(-1e3, 1e3), st.floats(0.01, 1e3)).map(lambda pair: (pair[0], pair[0] + pair[1]))


def test_claims_that_never_vary_are_nearest_only_where_none_varies() -> None:
    tried = [({}, {0: 0.5, 1: 0.9, 2: 0.2}), ({}, {0: 0.4, 1: 0.3, 2: 0.2})]
    assert list(_least(tried).items()) == [(1, 0.3), (0, 0.4)], "the closest first"
    assert list(_least(tried[:1]).items()) == [(2, 0.2), (0, 0.5), (1, 0.9)]
    assert _least([]) == {0: 1.0}


@given(LIMITS, st.floats(0.0, 1.0))
def test_a_share_of_a_range_is_a_value_of_four_digits_within_it(limits: tuple[float, float], share: float) -> None:
    low, high = limits
    span = SpanTable(uniform=limits)
    value = span.at(share)
    step = 10.0 ** (math.floor(math.log10(high - low)) - 4)
    assert low <= value <= high
    assert value == pytest.approx(low + share * (high - low), abs=0.51 * step)
    assert value in (low, high) or value / step == pytest.approx(round(value / step), abs=1e-3)
    assert span.share(value) == pytest.approx(share, abs=1e-4)
    assert (span.low, span.high) == limits
    assert (span.at(0.0), span.at(1.0)) == pytest.approx(limits, abs=step)


@given(st.floats(1e-3, 1.0), st.floats(1.5, 1e4), st.floats(0.0, 1.0))
def test_a_share_of_a_logarithm_is_a_ratio(low: float, ratio: float, share: float) -> None:
    span = SpanTable(log_uniform=(low, low * ratio))
    value = span.at(share)
    assert value == pytest.approx(low * ratio**share, rel=1e-3)
    assert span.share(value) == pytest.approx(share, abs=2e-3)
    assert span.share(0.1 * low) == 0.0
    assert span.share(10.0 * low * ratio) == 1.0


def test_a_step_and_single_values_are_kept() -> None:
    span = SpanTable(uniform=(0.0, 1.0), step=0.25)
    assert [span.at(share) for share in (0.0, 0.12, 0.13, 0.4, 0.99)] == [0.0, 0.0, 0.25, 0.5, 1.0]
    options = SpanTable(one_of=("a", "b", "c"))
    assert [options.at(share) for share in (0.0, 0.33, 0.34, 0.67, 1.0)] == ["a", "a", "b", "c", "c"]
    times = OfferTable("drop", ("command",), start_s=SpanTable(uniform=(0.0, 2.0)), value=0.5).spans
    assert (times["start_s"].at(0.1234567), times["value"].options) == (0.247, (0.5,))


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({}, "expected one of uniform, log_uniform, one_of, or"),
        ({"uniform": (0.0, 1.0), "one_of": (1,)}, "expected one of uniform"),
        ({"uniform": (1.0, 1.0)}, r"uniform = \[1.0, 1.0\]; expected \[low, high\] with low < high"),
        ({"log_uniform": (2.0, 1.0)}, r"log_uniform = \[2.0, 1.0\]; expected \[low, high\] with low < high"),
        ({"log_uniform": (0.0, 1.0)}, r"log_uniform = \[0.0, 1.0\]; expected numbers greater than 0"),
        ({"one_of": ()}, "one_of takes at least one value, and no step"),
        ({"one_of": (1,), "step": 0.5}, "one_of takes at least one value, and no step"),
    ],
)
def test_a_range_that_is_none_is_refused(given_: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SpanTable(**given_)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({}, "neither .range. nor ..fault.., so that there is nothing to look for"),
        ({"range": {"fault.1.value": 1}}, "range fault.1.value: give ..fault.. instead"),
        ({"range": {"expect": 1}}, "range expect: give the scenario's ..expect.. instead"),
        ({"range": {"loop.mode": 1}}, "range loop.mode: give --mode instead"),
        ({"range": {"a.b": 1}, "set": {"a.b": 1}}, "a.b is in .set. and in .range.; give it once"),
    ],
)
def test_tables_that_contradict_themselves_are_refused(tables: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        HuntTables(**tables)


DROP, PUSH = 0, 1
RANGES = {
    "a": SpanTable(uniform=(0.0, 10.0)),
    "b": SpanTable(one_of=("x", "y", "z")),
    "c": SpanTable(log_uniform=(1.0, 100.0)),
}


def space(at_once: int = 2) -> Space:
    """A range, options of which the second is the scenario's, a key the scenario does not have, and two faults."""
    drop = OfferTable("drop", ("command", "feedback"), start_s=SpanTable(uniform=(0.0, 2.0)),
                      duration_s=SpanTable(uniform=(0.1, 1.1)), value=SpanTable(uniform=(0.2, 0.8)))  # fmt: skip
    push = OfferTable("push", ("force_x_n",), start_s=0.5, value=SpanTable(uniform=(-50.0, 50.0)))
    return Space(HuntTables(at_once=at_once, range=RANGES, fault=(drop, push)), {"a": 2.5, "b": "y", "other": 1})


NUMBERS = ("start_s", "duration_s", "value")


def nominal(**changes: float) -> dict[str, float]:
    slots = {f"fault {slot}{of}": 0.5 if of else 0 for slot in (0, 1) for of in ("", *(f" {name}" for name in NUMBERS))}
    return {"a": 0.25, "b": 1, "c": 0.5, **slots, **{name.replace("__", " "): value for name, value in changes.items()}}


def test_the_nominal_case_is_the_scenario_and_differs_in_nothing_that_it_has() -> None:
    there = space()
    assert there.nominal_params == nominal()
    assert there.case(there.nominal_params) == Change({"c": 10.0})
    assert [there.options(name) for name in ("a", "b", "c", "fault 0", "fault 1 value")] == [0, 3, 0, 4, 0]
    assert space(0).nominal_params == {"a": 0.25, "b": 1, "c": 0.5}
    assert space(0).options("fault 0") == 0
    no_number = Space(HuntTables(range={"a": RANGES["a"], "b": RANGES["b"]}), {"a": True, "b": "none of these"})
    assert no_number.nominal_params == {"a": 0.5, "b": 0}


def test_a_case_has_the_fault_its_target_and_its_own_numbers() -> None:
    drop = {"fault 0": 2, "fault 0 start_s": 0.25, "fault 0 duration_s": 0.5, "fault 0 value": 1.0}
    chosen = Chosen(DROP, {"target": "feedback", "start_s": 0.5, "duration_s": 0.6, "value": 0.8})
    push = {"fault 1": 3, "fault 1 start_s": 0.9, "fault 1 duration_s": 0.9, "fault 1 value": 0.25}
    pushed = Chosen(PUSH, {"target": "force_x_n", "start_s": 0.5, "value": -25.0})
    there = space()
    assert there.case({**nominal(), **drop, **push, "a": 0.5, "b": 2}) == Change(
        {"a": 5.0, "b": "z", "c": 10.0}, (chosen, pushed)
    )
    twice = {name.replace("0", "1", 1): value for name, value in drop.items()}
    assert there.case({**nominal(), **drop, **twice}).faults == (chosen,)


def test_single_changes_are_the_ends_of_each_key_and_each_fault_at_its_strongest() -> None:
    a, b, c, command, feedback, push = space().singles()
    assert a == [nominal(a=0.0), nominal(a=1.0)]
    assert b == [nominal(b=0), nominal(b=2)]
    assert c == [nominal(c=0.0), nominal(c=1.0)]
    strongest = {f"fault 0 {name}": 1.0 for name in NUMBERS}
    for number, group in ((1, command), (2, feedback)):
        assert group == [nominal() | strongest | {"fault 0": number, "fault 0 start_s": at} for at in (0.2, 0.7)]
    assert push == [nominal() | {"fault 0": 3, "fault 0 value": 1.0, "fault 0 start_s": 0.0}]
    assert len(space(0).singles()) == 3


def test_a_combination_has_what_differs_in_each_and_no_more_faults_than_there_may_be() -> None:
    faults = [nominal(fault__0=number, fault__0__value=value) for number, value in ((1, 0.9), (2, 0.8), (3, 0.7))]
    found = space().combined([nominal(a=1.0), faults[0], nominal(b=2), faults[1], faults[2]])
    assert found == nominal(a=1.0, b=2, fault__0=1, fault__0__value=0.9, fault__1=2, fault__1__value=0.8)
    assert space().combined([]) == nominal()


def test_a_second_fault_can_begin_as_the_first_one_begins_or_ends() -> None:
    there = space()
    both = nominal(fault__0=1, fault__0__start_s=0.25, fault__0__duration_s=0.2, fault__1=2, fault__1__start_s=0.9)
    for at_end, start_s in ((False, 0.5), (True, 0.5 + 0.3)):
        first, second = there.case(there.coincident(both, at_end=at_end)).faults
        starts = sorted((first.given["start_s"], second.given["start_s"]))
        assert starts == pytest.approx([0.5, start_s])
        assert {first.given["target"], second.given["target"]} == {"command", "feedback"}
    for alone in (nominal(fault__0=1), nominal(fault__1=1), both | {"fault 1": 3}):
        assert there.coincident(alone, at_end=True) == alone, "there is no second, or its begin is fixed"
    assert space(1).coincident({"fault 0": 0}, at_end=True) == {"fault 0": 0}


def screened(shares: dict[str, float], rounds: int) -> list[dict[str, float]]:
    """What a search tries first where some values leave these shares of a claim, and others all of it."""
    there = Space(HuntTables(range={"a": RANGES["a"], "d": SpanTable(uniform=(0.0, 1.0))}), {"a": 2.5, "d": 0.5})
    steps, tried = search(there, 1), []
    params = next(steps)
    for _ in range(rounds):
        tried += params
        cases = [there.case(one).values for one in params]
        left = [math.prod(shares.get(f"{key}={value:g}", 1.0) for key, value in case.items()) for case in cases]
        params = steps.send([{0: one} for one in left])
    return [dict(one) for one in tried]


def test_a_search_begins_with_one_end_of_each_key_and_their_combination() -> None:
    """Where the first end is better than the scenario, the other end is guessed to be worse, and tried together."""
    worse = screened({"a=0": 0.7, "d=0": 0.9}, 2)
    assert worse == [{"a": 0.0, "d": 0.5}, {"a": 0.25, "d": 0.0}, {"a": 0.0, "d": 0.0}]
    better = screened({"a=0": 1.2, "d=0": 0.9}, 2)
    assert better == [{"a": 0.0, "d": 0.5}, {"a": 0.25, "d": 0.0}, {"a": 1.0, "d": 0.0}]
    assert screened({"a=0": 0.7, "d=0": 0.9}, 3)[3:] == [{"a": 1.0, "d": 0.5}, {"a": 0.25, "d": 1.0}]


def test_later_cases_of_a_search_are_often_at_the_ends_of_ranges_and_faults_often_coincide() -> None:
    there, steps = space(), search(space(), 5)
    params, tried = next(steps), []
    while len(tried) < 220:
        tried += params
        params = steps.send([{0: 1.0} for _ in params])
    drawn = tried[20:]
    ends = [one["a"] for one in drawn if one["a"] in (0.0, 1.0)]
    assert 0.4 * len(drawn) < len(ends) < 0.75 * len(drawn), "three of four cases, four fifths of their numbers"
    assert 0.3 < ends.count(0.0) / len(ends) < 0.7
    assert not [one for one in drawn if one["fault 0 start_s"] in (0.0, 1.0)]
    faults = [case.faults for case in map(there.case, drawn) if len(case.faults) == 2]
    drops = [case for case in faults if case[0].offer == case[1].offer == DROP]
    apart = [abs(second.given["start_s"] - first.given["start_s"]) for first, second in drops]
    assert len([one for one in apart if one < 1e-9]) > len(apart) / 8


FILE = """
runs = 3
[set]
loop.duration_s = 0.1
expect = [{ signal = "error.planar_m", below = 5.0 }, { signal = "truth.x_m", below = 9.0 }]
allow.stale_ticks = 4
[range]
robot.mass_kg = [16, 24]
"""


def hunt(folder: Path) -> Hunt:
    (file := folder / "it.hunt.toml").write_text(FILE, encoding="utf-8")
    return Hunt(Request("circle_speed", file))


def outcome(key: str, *margins: float, status: str = PASSED, reason: str | None = None) -> Outcome:
    claims = [{"margin": margin, "text": f"claim {place}"} for place, margin in enumerate(margins)]
    return Outcome(key, status, reason, {"wire_sha256": "ab"}, {"claims": claims})


def test_a_verdict_is_the_least_share_of_the_margins_of_the_scenario(tmp_path: Path) -> None:
    found = hunt(tmp_path)
    (job,) = found.next_jobs([], 5)
    jobs = list(found.next_jobs([outcome(job.key, 4.0, 8.0, 2.0)], 5))
    assert len(jobs) == 1, "the first round has one end of the one key"
    held = found.verdict(outcome("", 3.0, 4.0, 1.8))
    assert (held.score, held.worst, held.broken) == (0.5, 1, frozenset())
    assert held.shares == pytest.approx({0: 0.75, 1: 0.5, 2: 0.9})
    broken = found.verdict(outcome("", -1.0, 0.0, -0.1, status=FAILED))
    assert (broken.score, broken.worst, broken.broken) == (-0.25, 0, {0, 2})
    for status, words in ((ENDED, "the run ends early"), (LOST, "the run crashes or hangs")):
        assert found.verdict(outcome("", status=status))[:3] == (-1.0, {words}, words)
    assert found.verdict(outcome("", status=REFUSED)).score is None
    assert found.verdict(None).score is None
    assert (found.runs, found.least) == (1, None)
    found.next_jobs([outcome(jobs[0].key, 3.0, 2.0, 1.8)], 5)
    assert found.runs == 2
    assert found.nearest() == "robot.mass_kg = 16: 25 % of the margin of truth.x_m is left"
    assert found.plain() == {
        "found": False,
        "reason": None,
        "wire_sha256": None,
        "runs": 2,
        "shrinking_runs": 0,
        "least_margin": 0.25,
        "nearest": "robot.mass_kg = 16: 25 % of the margin of truth.x_m is left",
    }


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        (outcome("", 1.0, -1.0, 1.0, status=FAILED), "the scenario as it is: claim 1"),
        (
            outcome("", status=ENDED, reason="law: it raised"),
            "the scenario as it is: the run ends early: law: it raised",
        ),
    ],
)
def test_a_scenario_that_breaks_something_as_it_is_is_found_at_once(tmp_path: Path, seen: Outcome, reason: str) -> None:
    found = hunt(tmp_path)
    (job,) = found.next_jobs([], 5)
    assert found.next_jobs([seen._replace(key=job.key)], 5) == []
    assert found.reason() == reason
    assert (found.runs, found.shrinking_runs, found.is_shrinking) == (1, 0, True)
    assert found.plain()["wire_sha256"] == "ab"


def test_a_scenario_that_cannot_be_run_is_refused_with_why(tmp_path: Path) -> None:
    found = hunt(tmp_path)
    (job,) = found.next_jobs([], 5)
    with pytest.raises(BadInputError, match="scenario circle_speed: no such thing"):
        found.next_jobs([outcome(job.key, status=REFUSED, reason="no such thing")], 5)


def test_a_scenario_that_expects_nothing_is_refused(tmp_path: Path) -> None:
    (file := tmp_path / "it.hunt.toml").write_text("set.expect = []\nrange.robot.mass_kg = [16, 24]\n")
    with pytest.raises(BadInputError) as refused:
        Hunt(Request("circle_speed", file))
    assert str(refused.value) == "scenario circle_speed: it has no [[expect]], so that no run could break one"


@pytest.mark.parametrize("wire_sha256", ["ab", "cd"])
def test_what_was_found_is_run_again_from_its_file(
    wire_sha256: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = hunt(tmp_path)
    (job,) = found.next_jobs([], 5)
    found.next_jobs([outcome(job.key, -1.0, 1.0, 1.0, status=FAILED)], 5)
    again = {"wire_sha256": wire_sha256}
    monkeypatch.setattr(
        hunt_module, "run_jobs", lambda jobs, _: [outcome(job.key)._replace(figures=again) for job in jobs]
    )
    path = tmp_path / "circle_speed_found.toml"
    if wire_sha256 == "ab":
        assert found.save(tmp_path, force=False) == path
        return
    with pytest.raises(BadInputError) as refused:
        found.save(tmp_path, force=False)
    assert str(refused.value) == f"scenario {path}: its run is not the one that was found; please report this"


def test_a_found_case_is_made_smaller_and_told_with_its_runs(tmp_path: Path) -> None:
    """The claim breaks from 17 kg on downwards; the scenario's own mass is 20 kg."""
    found = hunt(tmp_path)
    jobs = list(found.next_jobs([], 9))
    while jobs:
        done = []
        for job in jobs:
            mass_kg = job.scenario["tables"]["robot"]["mass_kg"]
            done.append(outcome(job.key, 2.0, 3.0, mass_kg - 17.5, status=PASSED if mass_kg > 17.5 else FAILED))
        jobs = list(found.next_jobs(done, 9))
    assert found.found is not None
    assert found.found.found_after == found.runs == 2
    assert found.shrinking_runs > 2
    mass_kg = found.found.case.values["robot.mass_kg"]
    assert 17.0 <= mass_kg < 17.5
    assert found.reason() == f"robot.mass_kg = {mass_kg:g}: claim 2"
    assert found.plain()["runs"] == 2
