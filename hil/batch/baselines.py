"""Baselines of scenarios, made of runs with several seeds (``hil baseline``)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from hil.batch.job import ENDED, FAILED, PASSED, Job, Outcome
from hil.batch.keys import make_job
from hil.batch.plan import OnProgress, run_jobs
from hil.batch.run import attempt
from hil.core.options import plain
from hil.core.outputs import write_whole
from hil.judge.baselines import Moved, baseline_of, moved, why_not_judged
from hil.judge.words import why_not_passed
from hil.review.result import RunResult
from hil.runtime.assembly import RunOptions
from hil.scenario import Scenario
from hil.scenario.baseline import Baseline, place, text_of

KIND = "hil.batch.baselines:run"
SCHEMA = "hil.baseline/1"
"""Name and version of the command's JSON; ``baselines.schema.json`` beside this file describes it."""
_SEEDS = 2**32


class Made(NamedTuple):
    """What runs of a scenario gave.

    Attributes:
        scenario: the scenario.
        file: where its baseline belongs.
        failed: a sentence for each run that did not pass: a baseline is made of runs that did.
        old: the baseline that is there, or None.
        new: the baseline of these runs; None if one of them did not pass.
        moved: the figures that are outside the bands of the old one.
        other: sentences on what else is not as in the old one.
    """

    scenario: Scenario
    file: Path
    failed: Sequence[str]
    old: Baseline | None
    new: Baseline | None
    moved: Sequence[Moved] = ()
    other: Sequence[str] = ()

    @property
    def has_moved(self) -> bool:
        """Whether something is not as in the old one."""
        return bool(self.moved or self.other)

    def write(self) -> None:
        """Write the baseline. Raises BadInputError when that fails."""
        assert self.new is not None, "all runs passed"
        write_whole(self.file, text_of(self.new).encode("utf-8"), "baseline", "replace")

    def plain(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {
            "scenario": self.scenario.name,
            "file": str(self.file),
            "failed": list(self.failed),
            "moved": [one._asdict() for one in self.moved],
            "other": list(self.other),
            "baseline": None if self.new is None else plain(self.new),
        }


def make_baselines(
    scenarios: Sequence[Scenario],
    seeds: int,
    *,
    workers: int | None = None,
    limit_s: float = 120.0,
    allow_motion: bool = False,
    on_progress: OnProgress | None = None,
) -> list[Made]:
    """Run each scenario with so many seeds, from its own on, and return what came of it; nothing is written.

    Runs in real time are done one after the other. Raises BadInputError when a file of a scenario cannot be read.
    """
    jobs = {
        (number, seed): make_job(_with_seed(scenario, seed), KIND, limit_s=limit_s, allow_motion=allow_motion)
        for number, scenario in enumerate(scenarios)
        for seed in _seeds(scenario, seeds)
    }
    workers = 1 if any(scenario.loop.mode == "realtime" for scenario in scenarios) else workers
    outcomes = dict(zip(jobs, run_jobs(list(jobs.values()), workers, on_progress), strict=True))
    return [
        _made(scenario, {seed: outcomes[number, seed] for seed in _seeds(scenario, seeds)})
        for number, scenario in enumerate(scenarios)
    ]


def _seeds(scenario: Scenario, count: int) -> list[int]:
    return [(scenario.loop.seed + i) % _SEEDS for i in range(count)]


def _with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with a seed, judged without a baseline."""
    expect = tuple(row for row in scenario.expect if row.baseline is None)
    return replace(scenario, loop=replace(scenario.loop, seed=seed), expect=expect, baseline=None)


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a scenario and return its whole JSON as figures; a kind of job."""

    def judge(result: RunResult) -> Outcome:
        reason = next((words for _, words in why_not_passed(result.metrics)), None)
        status = ENDED if result.failure is not None else PASSED if result.passed else FAILED
        return Outcome(job.key, status, reason, result.metrics)

    return attempt(job, scenario, judge, RunOptions(allow_motion=job.allow_motion, keep_signals=False))


def _made(scenario: Scenario, outcomes: Mapping[int, Outcome]) -> Made:
    file = place(scenario)
    old = scenario.baseline if scenario.baseline is not None and Path(scenario.baseline.file) == file else None
    failed = [f"seed {seed}: {one.status}, {one.reason}" for seed, one in outcomes.items() if one.status != PASSED]
    if failed:
        return Made(scenario, file, failed, old, None)
    runs = {seed: outcome.figures for seed, outcome in outcomes.items()}
    new = baseline_of(scenario, runs)
    if old is None:
        return Made(scenario, file, (), None, new)
    return Made(scenario, file, (), old, new, moved(old, next(iter(runs.values()))), list(_other(scenario, old, new)))


def _other(scenario: Scenario, old: Baseline, new: Baseline) -> list[str]:
    """Return what is not as in the old baseline beside the figures that it has."""
    found = []
    if (why := why_not_judged(scenario, old)) is not None:
        found.append(why)
    found += [
        f"{key}: {new.figure[key].value:.6g}, which it did not have" for key in new.figure if key not in old.figure
    ]
    if old.platform != new.platform:
        found.append(f"it was made on {old.platform}, and this is {new.platform}")
    elif old.wire_sha256 != new.wire_sha256:
        found.append(f"wire_sha256 is {new.wire_sha256[:12]}, not {old.wire_sha256[:12]}")
    return found
