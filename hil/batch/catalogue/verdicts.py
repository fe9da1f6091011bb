"""Runs the trials of the catalogue and gives a verdict on each."""

import contextlib
from collections.abc import Sequence
from typing import NamedTuple

from hil.batch.catalogue import plan
from hil.batch.catalogue.plan import Request, Trial
from hil.batch.job import ENDED, PASSED, REFUSED, Job, Outcome
from hil.batch.keys import make_job
from hil.batch.plan import OnProgress, run_jobs
from hil.scenario import Scenario

KIND = "hil.batch.catalogue.runs:run"
OK = "ok"
_FIGURES = ("applied", "recoveries", "silent_rad_s", "silent_ticks")
_OF_OPTIONS = ("rearm", "allowed", "causes", "causes_of_end", "records_here")


class Verdict(NamedTuple):
    """The result of a trial.

    ``verdict`` is "ok" or what is wrong. ``silent_rad_s`` is the greatest set point in the ``silent_ticks`` ticks in
    which it has to be zero. The figures of a lost run are None.
    """

    fault: str
    link: str
    mode: str
    rearm: bool
    verdict: str
    outcome: str | None
    applied: Sequence[int] | None
    recoveries: int | None
    silent_rad_s: float | None
    silent_ticks: int | None
    wall_s: float
    recording: str | None

    @property
    def is_ok(self) -> bool:
        """Whether the run was as it should be."""
        return self.verdict == OK


def catalogue(
    request: Request,
    *,
    pairs: bool = False,
    realtime: bool = False,
    workers: int | None = None,
    limit_s: float = 60.0,
    on_progress: OnProgress | None = None,
) -> list[Verdict]:
    """Run the catalogue and return a verdict on each run.

    ``workers`` is the number of processes; what runs in real time runs alone, after all else. A run that takes more
    than ``limit_s`` of wall-clock time is ended. ``on_progress`` is called as ``hil.batch.plan.run_jobs`` does.

    Raises BadInputError for a link or kind that does not exist, and for a base scenario that cannot be used.
    """
    plan.check(request, pairs=pairs, realtime=realtime)
    lockstep = plan.alone(request) + (plan.pairs(request) if pairs else [])
    in_real_time = plan.alone(request, "realtime") if realtime else []
    request.recordings.mkdir(parents=True, exist_ok=True)
    verdicts: list[Verdict] = []

    def on_outcome(done: int, _: int, trouble: str | None) -> None:
        if on_progress is not None:
            on_progress(len(verdicts) + done, len(lockstep) + len(in_real_time), trouble)

    verdicts += run_trials(request, lockstep, workers, limit_s, on_outcome)
    verdicts += run_trials(request, in_real_time, 1, limit_s, on_outcome)
    with contextlib.suppress(OSError):  # what is not empty has recordings to look at
        request.recordings.rmdir()
    return verdicts


def run_trials(
    request: Request,
    trials: Sequence[Trial],
    workers: int | None,
    limit_s: float,
    on_progress: OnProgress | None = None,
) -> list[Verdict]:
    """Do trials and return a verdict on each. A trial whose scenario is not valid is refused.

    Raises BadInputError when the first one is not valid, because then the base scenario is wrong.
    """
    jobs: dict[int, Job] = {}
    outcomes: dict[int, Outcome] = {}
    for number, scenario in enumerate(plan.scenarios(request, trials)):
        if isinstance(scenario, Scenario):
            jobs[number] = job_of(trials[number], scenario, limit_s)
        elif number == 0:
            raise scenario
        else:
            outcomes[number] = Outcome("", REFUSED, str(scenario))
    by_key = {job.key: trials[number] for number, job in jobs.items()}

    def trouble(outcome: Outcome) -> str | None:
        verdict = verdict_of(by_key[outcome.key], outcome)
        return None if verdict.is_ok else f"{verdict.fault} over {verdict.link}: {verdict.verdict}"

    done = run_jobs(list(jobs.values()), workers, on_progress, trouble)
    outcomes |= dict(zip(jobs, done, strict=True))
    return [verdict_of(trial, outcomes[number]) for number, trial in enumerate(trials)]


def job_of(trial: Trial, scenario: Scenario, limit_s: float = 60.0) -> Job:
    """Return the job of a trial in its scenario."""
    options = {name: getattr(trial, name) for name in _OF_OPTIONS}
    return make_job(scenario, KIND, options, limit_s=limit_s, recording=trial.recording)


def verdict_of(trial: Trial, outcome: Outcome) -> Verdict:
    """Return the verdict on a trial."""
    reason = f"refused: {outcome.reason}" if outcome.status in (REFUSED, ENDED) else str(outcome.reason)
    verdict = OK if outcome.status == PASSED else reason
    run = (trial.fault, trial.link, trial.mode, trial.rearm, verdict, outcome.details.get("ending"))
    applied, recoveries, silent_rad_s, silent_ticks = map(outcome.figures.get, _FIGURES)
    return Verdict(*run, applied, recoveries, silent_rad_s, silent_ticks, outcome.wall_s, outcome.recording)
