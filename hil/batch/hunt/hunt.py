"""A hunt: its runs on the batch engine, how each is judged, and what it found."""

import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from hil.batch.hunt.cases import Cases, Request
from hil.batch.hunt.saved import scenario_text
from hil.batch.hunt.search import Shares, search
from hil.batch.hunt.shrink import shrink
from hil.batch.hunt.space import Case, Params
from hil.batch.job import ENDED, LOST, REFUSED, Job, Outcome
from hil.batch.keys import make_job
from hil.batch.plan import run_jobs
from hil.batch.resumable import run_resumable
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import existing_files, write_whole
from hil.scenario import Scenario, read
from hil.scenario.trial import span_s

_ENDS = {ENDED: "the run ends early", LOST: "the run crashes or hangs"}


class Verdict(NamedTuple):
    """How a hunt judges one run.

    A claim is an expectation or a limit of ``[allow]``; its number counts the expectations first.

    Attributes:
        score: the smallest of ``shares``, below 0 if a claim is broken; None for a run that could not be judged.
        broken: the numbers of the broken claims, or words for a run that ended early or crashed; empty if all hold.
        worst: the number of the claim with the smallest share, or these words.
        outcome: the outcome of the run; None where the values contradict each other, so that nothing ran.
        shares: for each claim its margin, divided by its margin in the scenario as it is.
    """

    score: float | None
    broken: frozenset[int | str] = frozenset()
    worst: int | str = 0
    outcome: Outcome | None = None
    shares: Shares = MappingProxyType({})


class Found(NamedTuple):
    """A case that breaks something: what, the smallest case, its scenario, and how the run went."""

    what: int | str
    case: Case
    scenario: Scenario
    outcome: Outcome
    found_after: int


class Hunt:
    """A hunt that was loaded and checked, and a plan of the batch engine.

    Attributes:
        runs: how many runs the search has done; those of a stopped hunt that is continued count again.
        shrinking_runs: how many shrinking has done.
        least: the case of the least score so far, if none is broken.
        found_case: what the search found, or None. found: the same made smaller, once that is done.

    Raises BadInputError for a wrong file, key, range or fault.
    """

    def __init__(self, request: Request) -> None:
        need("hunt", "hil hunt")
        self._request = request
        self.cases = Cases(request)
        self.base, self.tables = self.cases.base, self.cases.tables
        self.runs = self.shrinking_runs = 0
        self.is_shrinking = False
        self.found_case: Case | None = None
        self.least: tuple[float, Case, int | str] | None = None
        self.found: Found | None = None
        self._nominal: tuple[float, ...] = ()
        self._known: dict[str, Outcome] = {}
        self._batch: list[tuple[Case, Job | None]] = []
        self._to_do: list[Job] = []
        self._steps = self._hunt()
        self._batch_of(next(self._steps))

    # The plan

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs; those of one step of the search or of shrinking are chosen together."""
        self._known |= {outcome.key: outcome for outcome in outcomes}
        while not self._to_do and all(job is None or job.key in self._known for _, job in self._batch):
            verdicts = [self.verdict(case, job and self._known[job.key]) for case, job in self._batch]
            try:
                self._batch_of(self._steps.send(verdicts))
            except StopIteration:
                return []
        jobs, self._to_do = self._to_do[:room], self._to_do[room:]
        return jobs

    def _batch_of(self, cases: Sequence[Case]) -> None:
        self._batch = [(case, self.cases.job(case)) for case in cases]
        jobs = {job.key: job for _, job in self._batch if job is not None and job.key not in self._known}
        self._to_do = list(jobs.values())

    def verdict(self, case: Case, outcome: Outcome | None) -> Verdict:
        """Return what the outcome of a case means; None stands for a case that is not valid."""
        if outcome is None or outcome.status == REFUSED:
            return Verdict(None, outcome=outcome)
        if outcome.status in _ENDS and not self.tables.ends:
            return Verdict(None, outcome=outcome)
        if outcome.status in _ENDS:
            phrase = _ENDS[outcome.status]
            return Verdict(-1.0, frozenset([phrase]), phrase, outcome)
        margins = {place: claim["margin"] for place, claim in self._claims(case, outcome).items()}
        shares = {place: margin / self._own(place) for place, margin in margins.items()}
        worst = min(shares, key=lambda place: shares[place])
        broken = frozenset(place for place, margin in margins.items() if margin < 0.0)
        return Verdict(shares[worst], broken, worst, outcome, shares)

    def _claims(self, case: Case, outcome: Outcome) -> dict[int, dict[str, Any]]:
        """Return the expectations that a run judged, then the limits of ``[allow]``, by their places in the base."""
        claims = outcome.details["claims"]
        judged = self.cases.judged(case)
        limits = range(len(self.base.expect), len(self.base.expect) + len(claims) - len(judged))
        return dict(zip((*judged, *limits), claims, strict=True))

    def _own(self, place: int) -> float:
        """Return the scenario's own margin, by which others are scaled."""
        return abs(self._nominal[place]) if self._nominal else 1.0

    def _hunt(self) -> Generator[list[Case], list[Verdict], None]:
        """Run the scenario as it is, search, and shrink what is found."""
        verdicts = yield [Case()]
        self.runs += 1
        own = verdicts[0]
        if own.score is None or own.outcome is None:
            raise BadInputError(f"scenario {self.base.name}: {own.outcome.reason if own.outcome else 'not valid'}")
        found = (Case(), own) if own.broken else None
        if found is None:
            self._nominal = tuple(claim["margin"] for claim in own.outcome.details["claims"])
            found = yield from self._searched()
        if found is None:
            return
        after, self.is_shrinking = self.runs, True
        case, verdict = found
        self.found_case = case
        what = verdict.worst
        case = yield from self._shrunk(case, what, verdict)
        job = self.cases.job(case)
        assert job is not None
        self.found = Found(what, case, self.cases.scenario(case), self._known[job.key], after)

    def _searched(self) -> Generator[list[Case], list[Verdict], tuple[Case, Verdict] | None]:
        steps = search(self.cases.space, self.tables.seed)
        params: list[Params] = next(steps)
        while self.runs < self.tables.runs:
            cases = [self.cases.space.case(one) for one in params][: self.tables.runs - self.runs]
            verdicts = yield cases
            for case, verdict in zip(cases, verdicts, strict=True):
                self.runs += 1
                if verdict.broken:
                    return case, verdict
                if verdict.score is not None and (self.least is None or verdict.score < self.least[0]):
                    self.least = (verdict.score, case, verdict.worst)
            shares = [None if verdict.score is None else verdict.shares for verdict in verdicts]
            params = steps.send(shares + [None] * (len(params) - len(shares)))
        return None

    def _shrunk(self, case: Case, what: int | str, verdict: Verdict) -> Generator[list[Case], list[Verdict], Case]:
        broke_s: dict[str, float | None] = {repr(case): self._shorter(case, what, verdict)}
        steps = shrink(self.cases.space, case, lambda one: broke_s[repr(one)])
        try:
            cases = next(steps)
            while True:
                verdicts = yield cases
                self.shrinking_runs += len(cases)
                for one, found in zip(cases, verdicts, strict=True):
                    broke_s[repr(one)] = self._shorter(one, what, found)
                cases = steps.send([what in found.broken for found in verdicts])
        except StopIteration as end:
            smallest: Case = end.value
            return smallest

    def _shorter(self, case: Case, what: int | str, verdict: Verdict) -> float | None:
        """Return a duration [s] that ends soon after the violation, or None where that is not known."""
        if not isinstance(what, int) or what not in verdict.broken or what >= len(self.base.expect):
            return None
        row, outcome = self.base.expect[what], verdict.outcome
        at_s: float | None = None if outcome is None else self._claims(case, outcome)[what]["violation_s"]
        if at_s is None or row.settles_to is not None:
            return None
        begins_s = max([at_s, span_s(row, self.base.fault)[0], *(fault.start_s for fault in self.base.fault)])
        return round(begins_s + max(3.0 / self.base.loop.rate_hz, 0.01), 2)

    # Doing it

    def perform(self, folder: Path, on_runs: Callable[[], None] = lambda: None) -> None:
        """Do the runs that a folder does not have; it keeps their outcomes, so that a hunt that was stopped goes on.

        Raises BadInputError when the folder cannot be written to or is in use, LinkError as ``run_plan``.
        """
        end_s = None if self.tables.minutes is None else time.monotonic() + 60.0 * self.tables.minutes

        def is_stopping() -> bool:
            return end_s is not None and not self.is_shrinking and time.monotonic() > end_s

        run_resumable(self, folder, self._request.workers, on_outcomes=on_runs, is_stopping=is_stopping)

    def check_free(self, folder: Path, *, force: bool) -> None:
        """Raise BadInputError when a folder has a scenario of an earlier hunt, which must stay."""
        path = self._path(folder)
        if path.exists() and not force:
            raise BadInputError(
                f"scenario {path}: an earlier hunt found it; name another folder with --out, or replace it with --force"
            )

    def _path(self, folder: Path) -> Path:
        return folder / f"{self.base.name}_found.toml"

    def save(self, folder: Path, *, force: bool) -> Path:
        """Write what was found as a scenario, run it once more from there, and return its path.

        Raises BadInputError when it cannot be written, or the run is not the same again.
        """
        found = self.found
        assert found is not None
        path, job = self._path(folder), self.cases.job(found.case)
        assert job is not None
        sha256 = found.outcome.figures.get("wire_sha256")
        comments = [self.reason(), f"Found by hil hunt after {found.found_after} runs, and made smaller."]
        if sha256 is not None:
            on = "" if self._request.target == "host" else f" with --target {self._request.target}"
            comments.append(f"wire_sha256 in lockstep{on}: {sha256}")
        text = scenario_text(found.scenario, folder, comments)
        write_whole(path, text.encode(), "scenario", existing_files(force=force))
        again = make_job(read(str(path.absolute())).scenario(), options=job.options)
        (outcome,) = run_jobs([again], 1)
        if again.key != job.key or outcome.figures.get("wire_sha256") != sha256:
            raise BadInputError(f"scenario {path}: its run is not the one that was found; please report this")
        return path

    # In words

    @property
    def words(self) -> str | None:
        """A sentence on what the hunt does now, or None while it searches."""
        return "found one; it is made smaller" if self.is_shrinking else None

    def nearest(self) -> str:
        """Return in words which case came nearest to breaking something."""
        assert self.least is not None
        score, case, what = self.least
        about = self.base.expect[what].subject if isinstance(what, int) and what < len(self.base.expect) else "[allow]"
        return f"{self.cases.differs(case)}: {100.0 * score:.3g} % of the margin of {about} is left"

    def plain(self) -> dict[str, Any]:
        """Return the result for JSON."""
        found = self.found
        return {
            "found": found is not None,
            "reason": None if found is None else self.reason(),
            "wire_sha256": None if found is None else found.outcome.figures.get("wire_sha256"),
            "runs": self.runs,
            "shrinking_runs": self.shrinking_runs,
            "least_margin": None if self.least is None else self.least[0],
            "nearest": None if self.least is None else self.nearest(),
        }

    def reason(self) -> str:
        """Return one line: what is broken, and what the run differs in from the scenario."""
        assert self.found is not None
        what, case, outcome = self.found.what, self.found.case, self.found.outcome
        broken = self._claims(case, outcome)[what]["text"] if isinstance(what, int) else f"{what}: {outcome.reason}"
        return f"{self.cases.differs(case)}: {broken}"
