"""Which run is next: the suite without a mutant, then each mutant until a member of the suite notices it."""

from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

from hil.batch.job import PASSED, REFUSED, Job, Outcome
from hil.batch.verify.catalogue import Entry
from hil.batch.verify.suite import Member
from hil.core.errors import BadInputError
from hil.core.mutant import Mutant, module_of

_FACTOR, _LEAST_S = 10.0, 20.0
"""A run with a mutant is ended after so many times the time of the healthy one, and at least so long [s]."""
_SAME_TARGET, _SAME_ROOM, _OVERHEAD_S = 8.0, 3.0, 0.2


class Built(NamedTuple):
    """A mutant that can be run: its entry, what its processes get, its firmware library or None for the usual one."""

    entry: Entry
    mutant: Mutant
    library: str | None = None


class Trial:
    """A mutant under trial: what the members of the suite made of it so far, in order.

    ``members`` are those that can come to where it is; None before the trial begins.
    """

    def __init__(self, built: Built) -> None:
        self.entry = built.entry
        self.built = built
        self.outcomes: dict[str, Outcome] = {}
        self.members: Sequence[str] | None = None

    @property
    def is_over(self) -> bool:
        """Whether a member has noticed it, or all have been run."""
        return self.noticed_by is not None or (self.members is not None and len(self.outcomes) == len(self.members))

    @property
    def noticed_by(self) -> str | None:
        """The member that noticed it, if one has."""
        return next((name for name, outcome in self.outcomes.items() if outcome.status != PASSED), None)


class Healthy(NamedTuple):
    """A run without a mutant: the member, and what is varied, in words; empty for the member as it is."""

    member: Member
    varied: str = ""


class VerifyPlan:
    """Gives out the runs of a verification; at most as many at once as there are ``workers``.

    First come the members as they are, then the trials, the members in the order in which they noticed similar mutants,
    at last the further healthy runs. Raises BadInputError when a member does not pass as it is.

    Attributes:
        trials: the mutants. healthy: the outcomes of all healthy runs, by the key of the job.
    """

    def __init__(
        self,
        members: Sequence[Member],
        mutants: Sequence[Built],
        varied: Sequence[Healthy],
        workers: int,
        limit_s: float,
    ) -> None:
        self._members = {member.name: member for member in members}
        self._workers = workers
        self._limit_s = limit_s
        self.trials = [Trial(built) for built in mutants]
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
        while trial is None and self._waiting:
            trial = self._begun(self._waiting.popleft())
        if trial is not None:
            return self._start(trial, Healthy(self._next_member(trial)))
        return self._start(None, self._varied.popleft()) if self._varied else None

    def _begun(self, trial: Trial) -> Trial | None:
        """Begin a trial and return it; None if it is over at once, because no member imports what is changed.

        A member that did not import a module of Python without the mutant does not import it with it.
        """
        changed = {module_of(patch.file) for patch in trial.built.mutant.patches}
        imported = {name: outcome.details.get("modules") for name, outcome in self._nominal.items()}
        trial.members = [
            name for name, modules in imported.items() if not changed or modules is None or changed & {*modules}
        ]
        if not trial.members:
            return None
        self._active.append(trial)
        return trial

    def _start(self, trial: Trial | None, run: Healthy) -> Job:
        member = run.member
        if trial is None:
            job = member.job(alone=not run.varied, limit_s=self._limit_s)
            self.runs[job.key] = run
        else:
            limit_s = max(_LEAST_S, _FACTOR * self._nominal[member.name].wall_s)
            job = member.job(trial.built.mutant, trial.built.library, limit_s=min(limit_s, self._limit_s))
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

        left = [self._members[name] for name in trial.members or () if name not in trial.outcomes]
        return max(left, key=worth)

    def _take_nominal(self, member: Member, outcome: Outcome) -> None:
        if outcome.status != PASSED:
            problem = "is refused" if outcome.status == REFUSED else "does not pass"
            raise BadInputError(
                f"suite {member.name}: it {problem} without any mutant ({outcome.reason}); mend it first, since "
                "what is always red notices nothing"
            )
        self._nominal[member.name] = outcome
