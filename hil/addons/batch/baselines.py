"""``hil baseline``: baselines of scenarios, made of runs with several seeds."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer import Argument, Option

from hil.addons.batch.job import ENDED, FAILED, PASSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import OnProgress, run_jobs
from hil.addons.batch.run import attempt
from hil.cli import options as o
from hil.cli.output import batch, print_result, rows
from hil.core.options import plain
from hil.core.outputs import write_whole
from hil.judge.baselines import baseline_of, moved, why_not_judged
from hil.judge.judged_run import MovedFigure
from hil.judge.result import RunResult
from hil.judge.run_json import from_json, to_json
from hil.judge.run_text import why_not_passed
from hil.runtime.assembly import RunOptions
from hil.scenario import Scenario, load
from hil.scenario.baseline import Baseline, place, text_of, without_baselines

KIND = "hil.addons.batch.baselines:run"
SCHEMA = "hil.baseline/1"
"""Name and version of the command's JSON; ``baselines.schema.json`` beside this file describes it."""


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
    moved: Sequence[MovedFigure] = ()
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
    workers: int | None,
    limit_s: float,
    allow_motion: bool,
    on_progress: OnProgress | None,
) -> list[Made]:
    """Run each scenario with so many seeds, from its own on, and return what came of it; nothing is written.

    Runs in real time are done one after the other. Raises BadInputError when a file of a scenario cannot be read.
    """
    runs = [_seeded(scenario, seeds) for scenario in scenarios]
    jobs = [make_job(one, KIND, limit_s=limit_s, allow_motion=allow_motion) for each in runs for one in each.values()]
    workers = 1 if any(scenario.loop.mode == "realtime" for scenario in scenarios) else workers
    outcomes = iter(run_jobs(jobs, workers, on_progress))
    return [
        _made(scenario, {seed: next(outcomes) for seed in each}) for scenario, each in zip(scenarios, runs, strict=True)
    ]


def _seeded(scenario: Scenario, count: int) -> dict[int, Scenario]:
    """Return the scenario by seed, from its own on, judged without a baseline."""
    expect = tuple(row for row in scenario.expect if row.baseline is None)
    judged = replace(scenario, expect=expect, baseline=None)
    seeds = [(scenario.loop.seed + i) % 2**32 for i in range(count)]
    return {seed: replace(judged, loop=replace(scenario.loop, seed=seed)) for seed in seeds}


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a scenario and return its whole JSON as figures; a kind of job."""

    def judge(result: RunResult) -> Outcome:
        reason = next((words for _, words in why_not_passed(result.run)), None)
        status = ENDED if result.failure is not None else PASSED if result.passed else FAILED
        return Outcome(job.key, status, reason, to_json(result.run))

    return attempt(job, scenario, judge, RunOptions(allow_motion=job.allow_motion, keep_signals=False))


def _made(scenario: Scenario, outcomes: Mapping[int, Outcome]) -> Made:
    file = place(scenario)
    old = scenario.baseline if scenario.baseline is not None and Path(scenario.baseline.file) == file else None
    failed = [f"seed {seed}: {one.status}, {one.reason}" for seed, one in outcomes.items() if one.status != PASSED]
    if failed:
        return Made(scenario, file, failed, old, None)
    runs = {seed: from_json(outcome.figures) for seed, outcome in outcomes.items()}
    new = baseline_of(scenario, runs)
    if old is None:
        return Made(scenario, file, (), None, new)
    if not old.wire_sha256:  # it was taken out: the figures alone are judged
        new = replace(new, wire_sha256="")
    return Made(scenario, file, (), old, new, moved(old, next(iter(runs.values()))), list(_other(scenario, old, new)))


def _other(scenario: Scenario, old: Baseline, new: Baseline) -> list[str]:
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


def baseline(
    scenarios: Annotated[list[str], Argument(metavar="SCENARIO", help="shipped names or paths to .toml files")],
    accept: Annotated[bool, Option("--accept", help="write also where something has moved")] = False,
    seeds: Annotated[int, Option(metavar="N", help="runs of each, with seeds from the scenario's own on", min=2)] = 10,
    mode: o.Mode = None,
    link: o.LinkUrl = None,
    robot: o.RobotFile = None,
    jobs: o.Jobs = None,
    limit_s: o.Limit = 120.0,
    allow_motion: o.AllowMotion = False,
    as_json: o.Json = False,
) -> None:
    """Write the figures of a scenario's runs beside it, for later runs to be compared with.

    Where there is a baseline already, print what has moved and by how much; exit 1 if something has, and write it with
    --accept alone.
    """
    loaded = [load(name, mode=mode, link=link, robot=robot) for name in without_baselines(scenarios)]
    with batch(as_json=as_json) as progress:
        found = make_baselines(
            loaded, seeds, workers=jobs, limit_s=limit_s, allow_motion=allow_motion, on_progress=progress
        )
    written = [one.new is not None and (one.old is None or accept) for one in found]
    for one, is_written in zip(found, written, strict=True):
        if is_written:
            one.write()
    results = list(zip(found, written, strict=True))
    made = {"schema": SCHEMA, "baselines": [{**one.plain(), "written": is_written} for one, is_written in results]}
    print_result(as_json, made, (line for one, is_written in results for line in _lines(one, is_written=is_written)))
    is_bad = any(one.failed or (one.has_moved and not is_written) for one, is_written in results)
    raise typer.Exit(1 if is_bad else 0)


def _lines(made: Made, *, is_written: bool) -> Iterator[str]:
    yield made.scenario.name
    yield from rows(("failed", sentence) for sentence in made.failed)
    yield from rows(("moved", one.text) for one in made.moved)
    yield from rows(("moved", sentence) for sentence in made.other)
    if made.failed:
        yield from rows([("baseline", "not made: it is made of runs that passed")])
    elif is_written:
        assert made.new is not None
        yield from rows([("baseline", f"{len(made.new.figure)} figures of {len(made.new.seeds)} seeds in {made.file}")])
    elif made.has_moved:
        yield from rows([("baseline", f"{made.file} stays as it is; if the change is meant, add --accept")])
    else:
        yield from rows([("baseline", f"nothing has moved from {made.file}")])
