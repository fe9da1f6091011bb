"""Verifies a suite: runs it on each mutant, and says which were noticed, and by what."""

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.batch.job import PASSED, REFUSED, Job, Outcome
from hil.addons.batch.store import run_resumable
from hil.addons.verify.catalogue import Entry
from hil.addons.verify.suggest import Suggestion, suggestion
from hil.addons.verify.suite import Member
from hil.core.errors import BadInputError

VERDICTS = NOTICED, SURVIVED, UNREACHED = "noticed", "survived", "unreached"
"""The verdicts on a mutant.

Survived: it moved figures or bytes, and all passed. Unreached: it changed nothing, so no member goes there.
"""
_FIRST_SEED = 1_000_000
"""Seeds of the healthy runs begin here, far from those with which anybody makes a baseline."""


class Request(NamedTuple):
    """The request: the suite, the mutants, the number of further healthy runs, the workers, and the folder.

    ``least``: the part of the mutants that has to be noticed.
    """

    members: Sequence[Member]
    mutants: Sequence[Entry]
    variations: Mapping[str, Mapping[str, Any]]
    healthy: int
    folder: Path
    seed: int = 0
    workers: int | None = None
    limit_s: float = 600.0
    least: float = 1.0


_FACTOR, _LEAST_S = 10.0, 20.0
"""A run with a mutant is ended after so many times the time of the healthy one, and at least so long [s]."""
_SAME_TARGET, _SAME_ROOM, _OVERHEAD_S = 8.0, 3.0, 0.2


class Trial:
    """A mutant under trial: what the ``members`` of the suite made of it so far, in order."""

    def __init__(self, entry: Entry, members: int) -> None:
        self.entry = entry
        self.outcomes: dict[str, Outcome] = {}
        self._members = members

    @property
    def is_over(self) -> bool:
        """Whether a member has noticed it, or all have been run."""
        return self.noticed_by is not None or len(self.outcomes) == self._members

    @property
    def noticed_by(self) -> str | None:
        """The member that noticed it, if one has."""
        return next((name for name, outcome in self.outcomes.items() if outcome.status != PASSED), None)


class Healthy(NamedTuple):
    """A run without a mutant: the member, and a text on its variation; empty for the unchanged member."""

    member: Member
    varied: str = ""


class VerifyPlan:
    """Gives out the runs of a verification; at most as many at once as there are ``workers``.

    The order: the unchanged members; the trials, with members ordered by their notices of similar mutants; the further
    healthy runs. Raises BadInputError when a member does not pass as it is.

    Attributes:
        trials: the mutants. healthy: the outcomes of all healthy runs, by the key of the job.
    """

    def __init__(
        self,
        members: Sequence[Member],
        mutants: Sequence[Entry],
        varied: Sequence[Healthy],
        workers: int,
        limit_s: float,
    ) -> None:
        self._members = {member.name: member for member in members}
        self._workers = workers
        self._limit_s = limit_s
        self.trials = [Trial(entry, len(members)) for entry in mutants]
        self._waiting = deque(self.trials)
        self._active: list[Trial] = []
        self.runs: dict[str, Healthy] = {}
        self.healthy: dict[str, Outcome] = {}
        self._running: dict[str, tuple[Trial | None, str]] = {}
        self._first = deque(Healthy(member) for member in members)
        self._varied = deque(varied)
        self._nominal: dict[str, Outcome] = {}
        self._noticed: Counter[tuple[str, str]] = Counter()  # by what was mutated (target, room or ""), and the member
        self._untouched: Counter[tuple[str, str]] = Counter()

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs, as a ``Plan``."""
        for outcome in outcomes:
            self._take(outcome)
        jobs: list[Job] = []
        while len(jobs) < room and len(self._running) < self._workers and (job := self._next()) is not None:
            jobs.append(job)
        return jobs

    @property
    def done(self) -> int:
        """How many mutants have been tried."""
        return len(self.trials) - len(self._waiting) - len(self._active)

    def member(self, name: str) -> Member:
        """Return a member by its name."""
        return self._members[name]

    def nominal(self, member: str) -> Outcome:
        """Return the outcome of a member as it is."""
        return self._nominal[member]

    def _take(self, outcome: Outcome) -> None:
        trial, member = self._running.pop(outcome.key)
        if trial is None:
            run = self.runs[outcome.key]
            self.healthy[outcome.key] = outcome
            if not run.varied:
                self._take_nominal(run.member, outcome)
            return
        trial.outcomes[member] = outcome
        if outcome.figures == self._nominal[member].figures:
            self._untouched[trial.entry.target, member] += 1
        if outcome.status != PASSED:
            self._noticed[trial.entry.target, member] += 1
            self._noticed[trial.entry.room, member] += 1
            self._noticed["", member] += 1
        if trial.is_over:
            self._active.remove(trial)

    def _next(self) -> Job | None:
        """Return the next job; None when one that is running has to end first, or all is done."""
        if self._first:
            return self._start(None, self._first.popleft())
        if len(self._nominal) < len(self._members):
            return None
        busy = {id(trial) for trial, _ in self._running.values()}
        trial = next((one for one in self._active if id(one) not in busy), None)
        if trial is None and self._waiting:
            trial = self._waiting.popleft()
            self._active.append(trial)
        if trial is not None:
            return self._start(trial, Healthy(self._next_member(trial)))
        return self._start(None, self._varied.popleft()) if self._varied else None

    def _start(self, trial: Trial | None, run: Healthy) -> Job:
        member = run.member
        if trial is None:
            job = member.job(limit_s=self._limit_s)
            self.runs[job.key] = run
        else:
            limit_s = max(_LEAST_S, _FACTOR * self._nominal[member.name].wall_s)
            job = member.job(trial.entry.mutant, limit_s=min(limit_s, self._limit_s))
        self._running[job.key] = trial, member.name
        return job

    def _next_member(self, trial: Trial) -> Member:
        """Return the member that most probably notices the mutant, for the time that it takes."""
        entry, noticed = trial.entry, self._noticed

        def worth(member: Member) -> float:
            name = member.name
            score = _SAME_TARGET * noticed[entry.target, name] + _SAME_ROOM * noticed[entry.room, name]
            expected = (score + noticed["", name] + 1.0) / (1.0 + self._untouched[entry.target, name])
            return expected / (self._nominal[name].wall_s + _OVERHEAD_S)

        left = [member for name, member in self._members.items() if name not in trial.outcomes]
        return max(left, key=worth)

    def _take_nominal(self, member: Member, outcome: Outcome) -> None:
        if outcome.status != PASSED:
            problem = "is refused" if outcome.status == REFUSED else "does not pass"
            raise BadInputError(
                f"suite {member.name}: it {problem} without any mutant ({outcome.reason}); mend it first, since "
                "what is always red notices nothing"
            )
        self._nominal[member.name] = outcome


class Verdict(NamedTuple):
    """The verdict on a mutant.

    Attributes:
        entry: the mutant. verdict: one of the constants above. by, reason: the member that noticed it, and its words.
        moved: the members whose figures or bytes it changed without a notice. suggestion: an expectation to notice it.
        runs: how many members were run on it.
    """

    entry: Entry
    verdict: str
    by: str | None = None
    reason: str | None = None
    moved: Sequence[str] = ()
    suggestion: Suggestion | None = None
    runs: int = 0


class Verification(NamedTuple):
    """The result; ``alarms`` are the healthy runs that did not pass: member, variation, reason."""

    verdicts: Sequence[Verdict]
    healthy: int
    alarms: Sequence[tuple[str, str, str]]
    members: Mapping[str, float]
    wall_s: float
    least: float = 1.0

    @property
    def passed(self) -> bool:
        """Whether enough mutants were noticed, and no healthy run raised an alarm."""
        part = noticed_part(self.verdicts)
        return (part is None or part >= self.least) and not self.alarms


def noticed_part(verdicts: Sequence[Verdict]) -> float | None:
    """Return the share of noticed mutants among those tried; None without any."""
    return sum(one.verdict == NOTICED for one in verdicts) / len(verdicts) if verdicts else None


def verify(
    request: Request, on_progress: Callable[[int, int, str | None, int], None] = lambda *_: None
) -> Verification:
    """Verify a suite. What is in the request's folder from an earlier, interrupted one is not run again.

    ``on_progress`` is called with mutants tried, mutants in all, a sentence on the newest survivor or None, and how
    many have survived. Raises BadInputError for a member that does not pass without a mutant, and when the folder
    cannot be used.
    """
    began_s = time.monotonic()
    workers = request.workers or os.cpu_count() or 1
    plan = VerifyPlan(request.members, request.mutants, _varied(request), workers, request.limit_s)

    def show() -> None:
        survivors = [trial for trial in plan.trials if trial.is_over and trial.noticed_by is None]
        on_progress(plan.done, len(plan.trials), _last_words(survivors), len(survivors))

    run_resumable(plan, request.folder, workers, show)
    verdicts = [_verdict(trial, plan) for trial in plan.trials]
    alarms = [
        (plan.runs[key].member.name, plan.runs[key].varied, str(outcome.reason))
        for key, outcome in plan.healthy.items()
        if outcome.status != PASSED
    ]
    times = {member.name: plan.nominal(member.name).wall_s for member in request.members}
    wall_s = time.monotonic() - began_s
    return Verification(verdicts, len(plan.healthy), alarms, times, wall_s, request.least)


def _varied(request: Request) -> list[Healthy]:
    """Return the further healthy runs: the scenarios in turn, each with a fresh seed and a permitted variation."""
    members = [member for member in request.members if member.tests is None]
    variations = {"": {}, **request.variations}
    names = list(variations)
    found = []
    for number in range(request.healthy if members else 0):
        turn, place = divmod(number, len(members))
        name, seed = names[(turn + place) % len(names)], _FIRST_SEED + request.seed + number
        words = f"seed {seed}" + (f", {name}" if name else "")
        found.append(Healthy(members[place].varied(seed, variations[name]), words))
    return found


def _last_words(survivors: Sequence[Trial]) -> str | None:
    return f"{survivors[-1].entry.id}: nothing noticed that {survivors[-1].entry.wrong}" if survivors else None


def _verdict(trial: Trial, plan: VerifyPlan) -> Verdict:
    entry, by = trial.entry, trial.noticed_by
    moved = [
        name for name, outcome in trial.outcomes.items() if outcome.status == PASSED and _differs(outcome, plan, name)
    ]
    runs = len(trial.outcomes)
    if by is not None:
        return Verdict(entry, NOTICED, by, trial.outcomes[by].reason, moved, runs=runs)
    if not moved:
        return Verdict(entry, UNREACHED, runs=runs)
    found = [one for name in moved if (one := _suggestion(trial.outcomes[name], plan, name)) is not None]
    best = max(found, key=lambda one: min(one.margin, 0.5) / (plan.nominal(one.member).wall_s + 1.0), default=None)
    return Verdict(entry, SURVIVED, moved=moved, suggestion=best, runs=runs)


def _differs(outcome: Outcome, plan: VerifyPlan, member: str) -> bool:
    """Whether any figure, any byte on the wire, or the extremes of any signal differ from those without a mutant."""
    healthy = plan.nominal(member)
    return (outcome.figures, outcome.details.get("extremes")) != (healthy.figures, healthy.details.get("extremes"))


def _suggestion(outcome: Outcome, plan: VerifyPlan, member: str) -> Suggestion | None:
    if "extremes" not in outcome.details:
        return None
    runs = [
        plan.healthy[key]
        for key, run in plan.runs.items()
        if run.member.name == member and plan.healthy[key].status == PASSED
    ]
    duration_s = plan.member(member).scenario.loop.duration_s
    return suggestion(member, duration_s, runs, outcome)
