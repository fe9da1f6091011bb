"""``hil verify`` on outcomes that are made here: the order of the runs, their limits, verdicts, alarms and the command.

No run is done.
"""

import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from typer.testing import CliRunner

from hil.addons.batch.job import FAILED, PASSED, REFUSED, Job, Outcome
from hil.addons.verify import verify as engine
from hil.addons.verify.catalogue import Entry
from hil.addons.verify.mutation.mutant import Mutant
from hil.addons.verify.suite import RUN, TESTS, Member, read_suite
from hil.cli.main import app
from hil.core.errors import BadInputError

Answer = Callable[[Job], Outcome]


class Made:
    """A member whose jobs are named after it, the mutant and the variation."""

    def __init__(self, name: str, tests: Path | None = None, varied: str = "") -> None:
        self.name, self.tests, self._varied = name, tests, varied
        self.scenario = SimpleNamespace(loop=SimpleNamespace(duration_s=3.0))

    def job(self, mutant: Mutant | None = None, *, limit_s: float = 120.0) -> Job:
        key = f"{self.name} {mutant.id if mutant else 'healthy'}{self._varied}"
        return Job(key, "", {}, {}, limit_s)

    def varied(self, seed: int, variation: Mapping[str, Any]) -> "Made":
        return Made(self.name, self.tests, f" {seed} {dict(variation)}")


def members(*names: str) -> list[Member]:
    return [cast("Member", Made(name)) for name in names]


def entry(name: str, port: str = "law") -> Entry:
    room = name.partition(".")[0]
    return Entry(room, f"{name} is wrong", "10 %", Mutant(name, wrap={"port": port}))


def outcome(
    key: str, status: str = PASSED, a: float = 1.0, b: float = 1.0, wall_s: float = 1.0, reason: str | None = None
) -> Outcome:
    """Return an outcome with a figure ``a`` and a signal ``b``."""
    return Outcome(key, status, reason, {"a": a}, {"extremes": {"b": [0.0, b, 0.0, b]}}, wall_s)


def done(plan: engine.VerifyPlan, answer: Answer, room: int = 9) -> list[str]:
    """Do all jobs of a plan; return their keys in order."""
    order: list[str] = []
    outcomes: list[Outcome] = []
    while jobs := plan.next_jobs(outcomes, room):
        order += [job.key for job in jobs]
        outcomes = [answer(job) for job in jobs]
    return order


def verified(
    monkeypatch: pytest.MonkeyPatch, request: engine.Request, answer: Answer, told: list[tuple[Any, ...]] | None = None
) -> engine.Verification:
    def run(plan: engine.VerifyPlan, folder: Path, workers: int, show: Callable[[], None]) -> None:
        assert (folder, workers) == (Path("out"), request.workers)
        done(plan, lambda job: (show(), answer(job))[1], workers)
        show()

    monkeypatch.setattr(engine, "run_resumable", run)
    return engine.verify(request, lambda *now: None if told is None else told.append(now))


def test_as_many_jobs_are_given_out_as_there_is_room_and_there_are_workers() -> None:
    plan = engine.VerifyPlan(members("m", "n"), [entry("law.one"), entry("law.two")], [], 2, 60.0)
    assert [job.key for job in plan.next_jobs([], 1)] == ["m healthy"]
    assert [job.key for job in plan.next_jobs([], 5)] == ["n healthy"]
    assert plan.next_jobs([], 5) == [], "both workers are busy"
    assert plan.next_jobs([outcome("m healthy")], 5) == [], "no mutant before all members have passed"
    assert [job.key for job in plan.next_jobs([outcome("n healthy")], 5)] == ["m law.one", "m law.two"]
    assert plan.done == 0
    assert [job.key for job in plan.next_jobs([outcome("m law.one", FAILED)], 5)] == []
    assert plan.done == 1
    assert [job.key for job in plan.next_jobs([outcome("m law.two")], 5)] == ["n law.two"]


def test_a_mutant_is_in_one_run_at_a_time_and_healthy_variations_come_last() -> None:
    (varied,) = (engine.Healthy(one, "seed 7") for one in (cast("Member", Made("m", varied=" again")),))
    plan = engine.VerifyPlan(members("m", "n"), [entry("law.one")], [varied], 3, 60.0)
    plan.next_jobs([], 3)
    jobs = plan.next_jobs([outcome("m healthy"), outcome("n healthy")], 3)
    assert [job.key for job in jobs] == ["m law.one", "m healthy again"]
    assert [job.key for job in plan.next_jobs([outcome("m law.one")], 3)] == ["n law.one"]
    assert plan.next_jobs([outcome("n law.one"), outcome("m healthy again", FAILED)], 3) == []


@pytest.mark.parametrize(("wall_s", "limit_s"), [(1.0, 20.0), (2.0, 20.0), (3.0, 30.0), (7.0, 60.0)])
def test_a_mutant_has_ten_times_the_healthy_time_twenty_seconds_at_least_and_the_limit_at_most(
    wall_s: float, limit_s: float
) -> None:
    plan = engine.VerifyPlan(members("m"), [entry("law.one")], [], 1, 60.0)
    (healthy,) = plan.next_jobs([], 1)
    (mutated,) = plan.next_jobs([outcome(healthy.key, wall_s=wall_s)], 1)
    assert (healthy.limit_s, mutated.limit_s) == (60.0, limit_s)


@pytest.mark.parametrize(
    ("first", "second", "times_longer"),
    [
        (entry("law.first", "guard"), entry("law.second", "guard"), 8 + 3 + 1 + 1),
        (entry("law.first", "guard"), entry("law.second", "robot"), 3 + 1 + 1),
        (entry("law.first", "guard"), entry("wire.second", "link"), 1 + 1),
    ],
)
def test_a_member_that_noticed_a_similar_mutant_is_tried_first_though_it_takes_longer(
    first: Entry, second: Entry, times_longer: int
) -> None:
    """The more alike, the longer; with 0.2 s for the start of a run."""
    for factor, tried_first in ((0.99, "long"), (1.01, "short")):
        walls_s = {"short": 0.8, "long": factor * times_longer - 0.2}

        def answer(job: Job, walls_s: Mapping[str, float] = walls_s) -> Outcome:
            member, name = job.key.split()
            noticed = (member, name) == ("long", "law.first")
            # The first mutant changes the figure of the short member, so that it counts as one that can tell.
            return outcome(
                job.key, FAILED if noticed else PASSED, 2.0 if name != "healthy" else 1.0, 1.0, walls_s[member]
            )

        order = done(engine.VerifyPlan(members("short", "long"), [first, second], [], 1, 60.0), answer)
        assert order[2:4] == ["short law.first", "long law.first"]
        assert order[4] == f"{tried_first} {second.id}"


def test_a_member_whose_figures_a_similar_mutant_left_as_they_were_is_tried_later() -> None:
    for wall_s, tried_first in ((1.75, "long"), (1.85, "short")):

        def answer(job: Job, wall_s: float = wall_s) -> Outcome:
            member, name = job.key.split()
            moved = name == "law.first" and member == "long"
            return outcome(job.key, a=2.0 if moved else 1.0, wall_s=0.8 if member == "short" else wall_s)

        mutants = [entry("law.first"), entry("law.second")]
        order = done(engine.VerifyPlan(members("short", "long"), mutants, [], 1, 60.0), answer)
        assert order[4] == f"{tried_first} law.second"


def test_verdicts_alarms_and_progress_are_those_of_the_outcomes(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = {
        "m law.noticed": {"a": 3.0},
        "n law.noticed": {"status": FAILED, "reason": "too far"},
        "m law.survived": {"a": 1.0, "b": 1.9, "wall_s": 9.0},
        "n law.survived": {"a": 1.7},
        "n law.small": {"b": 1.00001},
        f"n healthy {engine._FIRST_SEED + 6} {{'mass_kg': 2}}": {"status": FAILED, "reason": "no luck"},
    }

    def answer(job: Job) -> Outcome:
        wall_s = {"m": 2.0, "n": 5.0}[job.key[0]]
        return outcome(job.key, **{"wall_s": wall_s, **cast("dict[str, Any]", answers.get(job.key, {}))})

    mutants = [entry(f"law.{name}") for name in ("noticed", "survived", "small", "unreached")]
    request = engine.Request(members("m", "n"), mutants, {"heavy": {"mass_kg": 2}}, 3, Path("out"), 5, 1, 60.0, 0.25)
    told: list[tuple[Any, ...]] = []
    found = verified(monkeypatch, request, answer, told)
    noticed, survived, small, unreached = found.verdicts
    assert noticed[:5] == (mutants[0], "noticed", "n", "too far", ["m"])
    assert (noticed.suggestion, noticed.runs) == (None, 2)
    assert (survived.verdict, survived.by, survived.moved, survived.runs) == ("survived", None, ["n", "m"], 2)
    assert survived.suggestion is not None
    # The margins are 0.24 and 0.18 of the size; m takes less than half as long.
    assert (survived.suggestion.member, survived.suggestion.name) == ("m", "b")
    assert (small.verdict, small.moved, small.suggestion) == ("survived", ["n"], None)
    assert (unreached.verdict, unreached.moved, unreached.runs) == ("unreached", (), 2)
    assert found.alarms == [("n", "seed 1000006, heavy", "no luck")]
    assert (found.healthy, found.members, found.least) == (2 + 3, {"m": 2.0, "n": 5.0}, 0.25)
    assert 0.0 <= found.wall_s < 60.0
    assert not found.passed
    assert found._replace(alarms=[]).passed
    assert not found._replace(alarms=[], least=0.26).passed
    assert told[0] == (0, 4, None, 0)
    assert told[-1] == (4, 4, "law.unreached: nothing noticed that law.unreached is wrong", 3)


def test_healthy_runs_take_scenarios_and_variations_in_turn_and_a_seed_each(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[str] = []
    suite = [*members("m", "n"), cast("Member", Made("tests", Path("test_mine.py")))]
    answer: Answer = lambda job: (keys.append(job.key), outcome(job.key))[1]  # noqa: E731
    request = engine.Request(suite, [], {"heavy": {"mass_kg": 2}}, 5, Path("out"), 70, 1)
    found = verified(monkeypatch, request, answer)
    heavy = "{'mass_kg': 2}"
    assert keys[3:] == [
        "m healthy 1000070 {}", f"n healthy 1000071 {heavy}", f"m healthy 1000072 {heavy}", "n healthy 1000073 {}",
        "m healthy 1000074 {}",
    ]  # fmt: skip
    assert (found.healthy, found.alarms, found.verdicts, found.passed) == (8, [], [], True)
    keys.clear()
    verified(monkeypatch, request._replace(members=suite[2:]), answer)
    assert keys == ["tests healthy"], "a file of tests has no seed"


def test_a_suggestion_holds_in_the_healthy_runs_that_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"m healthy 1000000 {}": (PASSED, 1.1), "m healthy 1000001 {}": (FAILED, 5.0), "m law.one": (PASSED, 2.1)}

    def answer(job: Job) -> Outcome:
        status, a = values.get(job.key, (PASSED, 1.0))
        return outcome(job.key, status, a)

    found = verified(monkeypatch, engine.Request(members("m"), [entry("law.one")], {}, 2, Path("out"), 0, 1), answer)
    (one,) = found.verdicts
    assert one.suggestion is not None
    assert (one.suggestion.healthy, one.suggestion.mutated, one.suggestion.from_s) == (1.1, 2.1, 0.0)


@pytest.mark.parametrize(("status", "problem"), [(FAILED, "does not pass"), (REFUSED, "is refused")])
def test_a_member_that_is_red_without_a_mutant_is_refused(status: str, problem: str) -> None:
    plan = engine.VerifyPlan(members("m"), [], [], 1, 60.0)
    plan.next_jobs([], 1)
    with pytest.raises(BadInputError) as refused:
        plan.next_jobs([outcome("m healthy", status, reason="no law")], 1)
    assert str(refused.value) == (
        f"suite m: it {problem} without any mutant (no law); mend it first, since what is always red notices nothing"
    )


# The members


def test_a_job_is_another_with_other_tests_another_baseline_or_a_mutant(tmp_path: Path) -> None:
    (tests := tmp_path / "test_mine.py").touch()
    (member,) = read_suite([str(tests)])
    keys = {member.job().key, member.job(limit_s=7.0).key}
    assert len(keys) == 1
    tests.write_text("def test_more(): ...\n", encoding="utf-8")
    keys |= {member.job().key, member.job(entry("law.one").mutant).key, member.job(entry("law.two").mutant).key}
    assert len(keys) == 4
    assert member.job().kind == TESTS
    (judged,) = read_suite(["circle_speed"])
    (bare,) = read_suite(["circle_speed"], baselines=False)
    assert judged.job().kind == RUN
    assert judged.job().key != bare.job().key


def test_a_varied_plant_is_judged_without_its_baseline_and_what_its_fmu_lacks_is_left_out() -> None:
    (member,) = read_suite(["circle_speed"])
    baseline = member.scenario.baseline
    assert baseline is not None
    for variation, kept, start in (
        ({}, baseline, {}), ({"no_such_value": 7.0}, baseline, {}), ({"mass_kg": "*1.5"}, None, {"mass_kg": 30.0}),
    ):  # fmt: skip
        varied = member.varied(7, variation).scenario
        assert varied.baseline == kept
        assert varied.loop.seed == 7
        assert varied.plant.start == {**member.scenario.plant.start, **start}


# The command


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> deque[engine.Request]:
    """What the command asks for; the answer is one survivor, of which 50 % had to be noticed."""
    asked: deque[engine.Request] = deque()

    def answer(request: engine.Request, _on_progress: object) -> engine.Verification:
        asked.append(request)
        verdicts: Sequence[engine.Verdict] = [engine.Verdict(one, engine.UNREACHED) for one in request.mutants]
        return engine.Verification(verdicts, request.healthy, [], {}, 7.0, request.least)

    monkeypatch.setattr(engine, "verify", answer)
    return asked


def test_the_command_asks_for_what_is_typed_and_prints_what_was_found(requests: deque[engine.Request]) -> None:
    words = ["verify", "circle_speed", "--mutant=plant.mass_more", "--mutant=law.gain_half"]
    usual = CliRunner().invoke(app, words)
    assert usual.exit_code == 1, "nothing was noticed"
    assert usual.stdout.splitlines()[-1] == "  0 false alarms in 6 healthy runs; 7 s"
    assert usual.stdout.startswith("unreached: law.gain_half: ")
    asked = requests.pop()
    assert [one.id for one in asked.mutants] == ["law.gain_half", "plant.mass_more"]
    assert (asked.healthy, asked.folder, asked.seed, asked.workers) == (6, Path("runs/verify"), 0, None)
    assert (asked.limit_s, asked.least) == (600.0, 1.0)
    assert asked.variations
    assert asked.members[0].scenario.baseline is not None
    more = "--room=law --sample=3 --seed=7 --healthy=2 --least=0 --no-baseline --out=there --jobs=3 --limit=9 --json"
    done = CliRunner().invoke(app, ["verify", "circle_speed", *more.split()])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["counts"] == {"noticed": 0, "survived": 0, "unreached": 3}
    asked = requests.pop()
    assert {one.room for one in asked.mutants} == {"law"}
    assert asked.members[0].scenario.baseline is None
    assert asked[3:] == (2, Path("there"), 7, 3, 9.0, 0.0)


def test_a_suite_alone_is_run_without_mutants(requests: deque[engine.Request]) -> None:
    done = CliRunner().invoke(app, ["verify", "circle_speed", "--sample=0", "--json"])
    assert (done.exit_code, json.loads(done.stdout)["noticed_part"]) == (0, None)
    assert requests.pop().mutants == []
