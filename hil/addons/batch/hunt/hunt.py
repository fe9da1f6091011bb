"""``hil hunt``: its runs on the batch engine, how each is judged, and what it found."""

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import typer
from typer import Option

from hil.addons.batch.hunt.hunt_file import Cases, Request, scenario_text
from hil.addons.batch.hunt.search import Shares, search, shrink
from hil.addons.batch.hunt.space import Change, Params
from hil.addons.batch.job import ENDED, LOST, REFUSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import run_jobs
from hil.addons.batch.store import run_resumable
from hil.cli import options as o
from hil.cli.output import batch, next_command, print_result, rows
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import existing_files, write_whole
from hil.scenario import read

SCHEMA = "hil.hunt/1"
_ENDS = {ENDED: "the run ends early", LOST: "the run crashes or hangs"}


class Margins(NamedTuple):
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
    """A case that breaks something: what, the smallest case, and how the run went."""

    what: int | str
    case: Change
    outcome: Outcome
    found_after: int


class Hunt:
    """A hunt that was loaded and checked, and a plan of the batch engine.

    Attributes:
        runs: how many runs the search has done; those of a stopped hunt that is continued count again.
        shrinking_runs: how many shrinking has done.
        least: the case of the least score so far, if none is broken.
        found_case: the case that the search found, or None. found: the same case, made smaller, once that is done.

    Raises BadInputError for a wrong file, key, range or fault.
    """

    def __init__(self, request: Request) -> None:
        need("hunt", "hil hunt")
        self._request = request
        self.cases = Cases(request)
        self.base, self.tables = self.cases.base, self.cases.tables
        self.runs = self.shrinking_runs = 0
        self.is_shrinking = False
        self.found_case: Change | None = None
        self.least: tuple[float, Change, int | str] | None = None
        self.found: Found | None = None
        self._nominal: tuple[float, ...] = ()
        self._known: dict[str, Outcome] = {}
        self._batch: list[tuple[Change, Job | None]] = []
        self._to_do: list[Job] = []
        self._steps = self._hunt()
        self._batch_of(next(self._steps))

    def next_jobs(self, outcomes: Sequence[Outcome], room: int) -> Sequence[Job]:
        """Return the next jobs; those of one step of the search or of shrinking are chosen together."""
        self._known |= {outcome.key: outcome for outcome in outcomes}
        while not self._to_do and all(job is None or job.key in self._known for _, job in self._batch):
            verdicts = [self.verdict(job and self._known[job.key]) for _, job in self._batch]
            try:
                self._batch_of(self._steps.send(verdicts))
            except StopIteration:
                return []
        jobs, self._to_do = self._to_do[:room], self._to_do[room:]
        return jobs

    def _batch_of(self, cases: Sequence[Change]) -> None:
        self._batch = [(case, self.cases.job(case)) for case in cases]
        jobs = {job.key: job for _, job in self._batch if job is not None and job.key not in self._known}
        self._to_do = list(jobs.values())

    def verdict(self, outcome: Outcome | None) -> Margins:
        """Return the meaning of a case's outcome; None stands for an invalid case."""
        if outcome is None or outcome.status == REFUSED:
            return Margins(None, outcome=outcome)
        if outcome.status in _ENDS:
            phrase = _ENDS[outcome.status]
            return Margins(-1.0, frozenset([phrase]), phrase, outcome)
        margins = [claim["margin"] for claim in outcome.details["claims"]]
        own = [abs(margin) for margin in self._nominal] or [1.0] * len(margins)
        shares = {place: margin / scale for place, (margin, scale) in enumerate(zip(margins, own, strict=True))}
        worst = min(shares, key=lambda place: shares[place])
        broken = frozenset(place for place, margin in enumerate(margins) if margin < 0.0)
        return Margins(shares[worst], broken, worst, outcome, shares)

    def _hunt(self) -> Generator[list[Change], list[Margins], None]:
        verdicts = yield [Change()]
        self.runs += 1
        own = verdicts[0]
        if own.score is None or own.outcome is None:
            raise BadInputError(f"scenario {self.base.name}: {own.outcome.reason if own.outcome else 'not valid'}")
        found = (Change(), own) if own.broken else None
        if found is None:
            self._nominal = tuple(claim["margin"] for claim in own.outcome.details["claims"])
            found = yield from self._searched()
        if found is None:
            return
        after, self.is_shrinking = self.runs, True
        case, verdict = found
        self.found_case = case
        case = yield from self._shrunk(case, verdict.worst)
        job = self.cases.job(case)
        assert job is not None
        self.found = Found(verdict.worst, case, self._known[job.key], after)

    def _searched(self) -> Generator[list[Change], list[Margins], tuple[Change, Margins] | None]:
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

    def _shrunk(self, case: Change, what: int | str) -> Generator[list[Change], list[Margins], Change]:
        steps = shrink(self.cases.space, case)
        try:
            cases = next(steps)
            while True:
                verdicts = yield cases
                self.shrinking_runs += len(cases)
                cases = steps.send([what in found.broken for found in verdicts])
        except StopIteration as end:
            smallest: Change = end.value
            return smallest

    def perform(self, folder: Path, on_runs: Callable[[], None] = lambda: None) -> None:
        """Do the runs that are not in the folder; it keeps their outcomes, so a stopped hunt can continue.

        Raises BadInputError when the folder cannot be written to or is in use, LinkError as ``run_plan``.
        """
        run_resumable(self, folder, self._request.workers, on_runs)

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
            comments.append(f"wire_sha256 in lockstep: {sha256}")
        text = scenario_text(self.cases.scenario(found.case), folder, comments)
        write_whole(path, text.encode(), "scenario", existing_files(force=force))
        again = make_job(read(str(path.absolute())).scenario())
        (outcome,) = run_jobs([again], 1)
        if again.key != job.key or outcome.figures.get("wire_sha256") != sha256:
            raise BadInputError(f"scenario {path}: its run is not the one that was found; please report this")
        return path

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
        """Return one line: the broken claim, and the differences between the run and the scenario."""
        assert self.found is not None
        what, case, outcome = self.found.what, self.found.case, self.found.outcome
        broken = outcome.details["claims"][what]["text"] if isinstance(what, int) else f"{what}: {outcome.reason}"
        return f"{self.cases.differs(case)}: {broken}"


def hunt(
    scenario: o.ScenarioName,
    ranges: Annotated[
        Path | None, Option(metavar="FILE", help="what may differ, see HUNT.md; by default NAME.hunt.toml beside it")
    ] = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="results, continued if begun; by default runs/hunt/NAME")
    ] = None,
    robot: o.RobotFile = None,
    link: o.LinkUrl = None,
    seed: o.Seed = None,
    jobs: o.Jobs = None,
    limit_s: o.Limit = 120.0,
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Search for a run that breaks an expectation, make it as small as possible and save it; exit 1 when found."""
    found = Hunt(Request(scenario, ranges, robot, link, seed, jobs, limit_s))
    folder = out if out is not None else Path("runs") / "hunt" / found.base.name
    found.check_free(folder, force=force)
    with batch(as_json=as_json) as progress:

        def show() -> None:
            if progress is not None:
                words = "found one; it is made smaller" if found.is_shrinking else None
                progress(found.runs + found.shrinking_runs, max(found.runs, found.tables.runs), words)

        found.perform(folder, show)
        saved = None if found.found is None else found.save(folder, force=force)
    result = {"schema": SCHEMA, **found.plain(), "scenario": None if saved is None else str(saved)}
    print_result(as_json, result, rows(_words(found, saved)))
    raise typer.Exit(0 if found.found is None else 1)


def _words(hunt: Hunt, saved: Path | None) -> list[tuple[str, str]]:
    runs = f"{hunt.runs} of at most {hunt.tables.runs}"
    if hunt.found is None or saved is None:
        nearest: list[tuple[str, Any]] = [] if hunt.least is None else [("nearest", hunt.nearest())]
        return [("found", "nothing"), ("runs", runs), *nearest]
    return [
        ("found", hunt.reason()),
        ("runs", f"{hunt.found.found_after} until found, {hunt.shrinking_runs} to make it smaller"),
        ("saved", str(saved)),
        ("again", next_command("hil", "run", saved)),
    ]
