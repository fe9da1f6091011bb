"""Verifies a suite: builds the mutants, runs the suite on each, and says which were noticed, and by what."""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from platformdirs import user_cache_path

from firmware_protocol.built import is_checkout, run_script
from hil.batch.job import PASSED, Outcome
from hil.batch.resumable import run_resumable
from hil.batch.verify.catalogue import Entry, check_sources
from hil.batch.verify.plan import Built, Healthy, Trial, VerifyPlan
from hil.batch.verify.suggest import Suggestion, suggestion
from hil.batch.verify.suite import Member
from hil.core.errors import BadInputError
from hil.core.scratch import scratch_folder
from hil.plant import archive

NOTICED, SURVIVED, UNREACHED, EQUIVALENT, NOT_EQUIVALENT, NOT_BUILT = (
    "noticed", "survived", "unreached", "equivalent", "not equivalent", "not built",
)  # fmt: skip
"""The verdicts on a mutant.

Survived: it moved figures or bytes, and all passed. Unreached: it changed nothing, so no member goes there. Equivalent:
it is listed so, and changed nothing. Not equivalent: it is listed so, and changed something. Not built: its C sources
are not here.
"""
GOOD = (NOTICED, EQUIVALENT, NOT_BUILT)
_BUILDER = "tools.build.mutant"
_FIRST_SEED = 1_000_000
"""Seeds of the healthy runs begin here, far from those with which anybody makes a baseline."""


class Request(NamedTuple):
    """What to verify: the suite, the mutants, how many further healthy runs, with what workers, into which folder.

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


class Verdict(NamedTuple):
    """The verdict on a mutant.

    Attributes:
        entry: the mutant. verdict: one of the constants above. by, reason: the member that noticed it, and its words.
        by_bytes: whether that member found nothing but other bytes on the wire, which its baseline judges on its own
            platform alone.
        moved: the members whose figures or bytes it changed without a notice. suggestion: what would have noticed it.
        runs: how many members were run on it.
    """

    entry: Entry
    verdict: str
    by: str | None = None
    reason: str | None = None
    by_bytes: bool = False
    moved: Sequence[str] = ()
    suggestion: Suggestion | None = None
    runs: int = 0


class Verification(NamedTuple):
    """What came of it; ``alarms`` are the healthy runs that did not pass: member, what was varied, reason."""

    verdicts: Sequence[Verdict]
    healthy: int
    alarms: Sequence[tuple[str, str, str]]
    members: Mapping[str, float]
    wall_s: float
    least: float = 1.0

    @property
    def passed(self) -> bool:
        """Whether enough mutants were noticed, no equivalent changed anything, and no healthy run raised an alarm."""
        part = noticed_part(self.verdicts)
        is_enough = part is None or part >= self.least
        return is_enough and not self.alarms and all(one.verdict != NOT_EQUIVALENT for one in self.verdicts)


def noticed_part(verdicts: Sequence[Verdict]) -> float | None:
    """Return which part of the mutants that were tried and are no equivalents was noticed; None if there are none."""
    tried = [one for one in verdicts if one.verdict not in (EQUIVALENT, NOT_BUILT)]
    return sum(one.verdict == NOTICED for one in tried) / len(tried) if tried else None


def verify(
    request: Request, on_progress: Callable[[int, int, str | None, int], None] = lambda *_: None
) -> Verification:
    """Verify a suite. What is in the request's folder from an earlier, interrupted one is not run again.

    ``on_progress`` is called with mutants tried, mutants in all, a sentence on the newest survivor or None, and how
    many have survived. Raises BadInputError for patches that do not match the sources, for a mutant that does not
    compile, for a member that does not pass without a mutant, and when the folder cannot be used.
    """
    began_s = time.monotonic()
    check_sources(request.mutants)
    built = build(request.mutants)
    workers = request.workers or os.cpu_count() or 1
    plan = VerifyPlan(request.members, list(built.values()), _varied(request), workers, request.limit_s)

    def show() -> None:
        survivors = [trial for trial in plan.trials if trial.is_over and trial.noticed_by is None]
        on_progress(plan.done, len(plan.trials), _last_words(survivors), len(survivors))

    run_resumable(plan, request.folder, workers, on_outcomes=show)
    judged = {trial.entry.id: _verdict(trial, plan) for trial in plan.trials}
    verdicts = [judged.get(entry.id) or Verdict(entry, NOT_BUILT) for entry in request.mutants]
    alarms = [
        (plan.runs[key].member.name, plan.runs[key].varied, str(outcome.reason))
        for key, outcome in plan.healthy.items()
        if outcome.status != PASSED
    ]
    times = {member.name: plan.nominal(member.name).wall_s for member in request.members}
    wall_s = time.monotonic() - began_s
    return Verification(verdicts, len(plan.healthy), alarms, times, wall_s, request.least)


def build(mutants: Sequence[Entry], folder: Path | None = None) -> dict[str, Built]:
    """Build those mutants that need it, into a cache folder of the user's, and return all that can be run, by id.

    Where C sources or build scripts are not there, their mutants are left out. Raises BadInputError for one that does
    not compile.
    """
    folder = folder or user_cache_path("mecanum-hil") / "mutants"
    plain = {entry.id: Built(entry, entry.mutant) for entry in mutants if not entry.is_built}
    wanted = {entry.id: entry for entry in mutants if entry.is_built}
    if not wanted or not is_checkout():
        return plain
    with scratch_folder("verify") as scratch:
        file = scratch / "requests.json"
        file.write_text(json.dumps({name: entry.mutant.patches for name, entry in wanted.items()}), encoding="utf-8")
        done = run_script(_BUILDER, str(folder), str(file))
    if done.returncode != 0:
        raise BadInputError(f"the mutants cannot be built: {done.stderr.strip()}")
    made = json.loads(done.stdout)
    if errors := [f"mutant {name}: {one['error']}" for name, one in made.items() if "error" in one]:
        raise BadInputError("\n".join(errors))
    for name, one in made.items():
        entry, path = wanted[name], Path(one["path"])
        is_fmu = path.suffix == ".fmu"
        mutant = entry.mutant._replace(patches=(), fmu=str(path) if is_fmu else "", built_sha256=archive.sha256(path))
        plain[name] = Built(entry, mutant, None if is_fmu else str(path))
    return {entry.id: plain[entry.id] for entry in mutants if entry.id in plain}


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
        try:
            found.append(Healthy(members[place].varied(seed, variations[name]), words))
        except ValueError as error:
            raise BadInputError(f"variation {name}: {error}") from error
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
        verdict = NOTICED if entry.equivalent is None else NOT_EQUIVALENT
        outcome = trial.outcomes[by]
        by_bytes = bool(outcome.details.get("by_bytes"))
        return Verdict(entry, verdict, by, outcome.reason, by_bytes, moved, runs=runs)
    if not moved:
        return Verdict(entry, UNREACHED if entry.equivalent is None else EQUIVALENT, runs=runs)
    if entry.equivalent is not None:
        return Verdict(entry, NOT_EQUIVALENT, moved=moved, runs=runs)
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
