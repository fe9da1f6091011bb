"""A campaign: checks all its runs, and does those that a folder has no outcomes of yet."""

import contextlib
import math
from collections.abc import Collection, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.batch.campaign.campaign_file import Point, load_plan, points
from hil.addons.batch.columns import KEY
from hil.addons.batch.job import Job
from hil.addons.batch.kept_runs import KeptRuns
from hil.addons.batch.keys import key_of, make_job
from hil.addons.batch.plan_file import found_from_anywhere
from hil.addons.batch.pool import Runner
from hil.addons.batch.store import Row
from hil.core.errors import BadInputError
from hil.core.printable import command
from hil.judge.expectations import check_figures
from hil.runtime.robots import check_plant_start, needed_truth
from hil.runtime.run_parts import RunParts
from hil.scenario import Scenario, format_value, set_texts
from hil.scenario.trial import span_s
from hil.wire.url import parse_link

_TIMED = 3  # runs that an estimate of the time does: the first, the middle, the last
_BETWEEN_S = 1.0  # the time that a run in real time takes besides its own duration


class Run(NamedTuple):
    """A run of a campaign: the key of its job, and its values of the axes."""

    key: str
    point: Point


class Campaign:
    """A campaign that was loaded, with every run of it checked.

    ``on_bench`` says whether any run needs the one hardware bench (``needs_bench``), ``in_real_time`` whether any is in
    real time. ``longest_s`` is the longest duration of a run.

    Raises BadInputError, before anything is run, for a wrong file, key or value, for two runs that are the same, and
    for a run that would be refused.
    """

    def __init__(self, file: Path, *, allow_motion: bool = False) -> None:
        self.plan = plan = load_plan(file)
        self._allow_motion = allow_motion
        runs: dict[str, Run] = {}
        made: set[tuple[str, ...]] = set()
        self.on_bench = self.in_real_time = False
        self.longest_s = 0.0
        for point in points(plan):
            scenario = plan.scenario(point.sets)
            with _naming(f"campaign {file}: {point.words}: "):
                key = key_of(scenario)
                check_run(scenario, made, allow_motion=allow_motion)
            if key in runs:
                raise BadInputError(
                    f"campaign {file}: two runs are the same: {runs[key].point.words}; and {point.words}. Remove one "
                    "of them"
                )
            runs[key] = Run(key, point)
            self.on_bench = self.on_bench or needs_bench(scenario)
            self.in_real_time = self.in_real_time or scenario.loop.mode == "realtime"
            self.longest_s = max(self.longest_s, scenario.loop.duration_s)
        self.runs, self._by_key = list(runs.values()), runs

    def job(self, run: Run, **how: Any) -> Job:
        """Return the job of a run; ``how`` are further fields of Job."""
        job = make_job(self.plan.scenario(run.point.sets), allow_motion=self._allow_motion, **how)
        return job._replace(key=run.key)  # a worker refuses it if a file was changed since the run was checked

    def row(self, run: Run) -> dict[str, Any]:
        """Return the columns of a run that are known before it is done."""
        point = run.point
        axes = {
            key: one if isinstance(one, str | int | float) else format_value(one) for key, one in point.axes.items()
        }
        own = {KEY: run.key, "law": point.law, "fault": point.fault, "seed": point.seed, "sample": point.sample}
        return own | axes

    def perform(
        self, folder: Path, workers: int | None = None, limit_s: float = 120.0, redo: Collection[str] = ()
    ) -> Iterator[Sequence[Row]]:
        """Do the runs that are still to do, as ``KeptRuns.perform``. Raises as that does."""

        def job(key: str, recording: str) -> Job:
            how = {"limit_s": limit_s, "record": self.plan.tables.record, "recording": recording}
            return self.job(self._by_key[key], **how)

        return self.kept.perform(folder, job, workers, redo)

    def left(self, folder: Path, redo: Collection[str] = ()) -> int:
        """Return how many runs ``perform`` would do in a folder, which need not exist. Raises BadInputError as it."""
        return self.kept.left(folder, redo)

    def estimate_s(self, left: int, workers: int) -> tuple[float, float]:
        """Return the time of one run on one worker [s], and of all runs that are ``left`` [s].

        A few runs are timed in a separate process. Runs in real time are not, because nothing may move for an estimate.
        """
        if self.in_real_time or self.on_bench:
            run_s = self.longest_s + _BETWEEN_S
        else:
            timed = [self.runs[place * (len(self.runs) - 1) // (_TIMED - 1)] for place in range(_TIMED)]
            with contextlib.closing(Runner()) as runner:
                runner.run(self.job(timed[0]))  # which also imports and opens the FMU
                run_s = sum(runner.run(self.job(run)).wall_s for run in timed) / _TIMED
        return run_s, run_s * math.ceil(left / workers)

    def repeat(self, point: Point) -> list[str]:
        """Return the command that repeats a run from any folder, as words."""
        sets = {key: found_from_anywhere(key, value, self.plan.file.folder) for key, value in point.sets.items()}
        return ["hil", "run", self._scenario, *(word for text in set_texts(sets) for word in ("--set", text))]

    @cached_property
    def _scenario(self) -> str:
        """The name or path by which ``hil run`` finds the base scenario from any folder."""
        base = self.plan.scenario({})
        return base.name if base.path is None else str(base.path)

    @cached_property
    def kept(self) -> KeptRuns:
        """The runs with the description of the campaign, for the folder that keeps their rows."""
        tables = self.plan.tables
        about = {
            "name": self.plan.file.file.stem,
            "scenario": tables.scenario,
            "laws": list(dict.fromkeys(run.point.law for run in self.runs)),
            "faults": list(dict.fromkeys(run.point.fault for run in self.runs)),
            "seeds": len({run.point.seed for run in self.runs}),
            "samples": tables.samples or 1,
            "axes": {key: {"kind": axis.kind, "values": list(axis.values)} for key, axis in tables.axes.items()},
            "keep": tables.keep,
        }
        return KeptRuns(about, [self.row(run) | {"repeat": command(*self.repeat(run.point))} for run in self.runs])


@contextlib.contextmanager
def _naming(run: str) -> Iterator[None]:
    """Put the name of a run before each line of a BadInputError that is raised inside."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError("\n".join(run + line for line in str(error).splitlines())) from error


def check_run(scenario: Scenario, made: set[tuple[str, ...]], *, allow_motion: bool) -> None:
    """Raise BadInputError for a run that would be refused.

    ``made`` collects the laws and references, with their options, that were made before; each choice is made once.
    """
    check_figures(scenario)
    _check_link(scenario, allow_motion=allow_motion)
    check_plant_start(scenario)
    for row in scenario.expect:
        if (from_s := span_s(row, scenario.fault)[0]) >= scenario.loop.duration_s:
            raise BadInputError(
                f"the expectation of {row.subject} begins at {from_s:g} s, and the run ends at "
                f"{scenario.loop.duration_s:g} s: it would always fail; give another, or expect = [] in [set] and "
                "[[expect]] rows of the campaign's own"
            )
    controller, reference = scenario.controller, scenario.reference
    choice = (controller.law, reference.kind, repr(controller.gains), repr(reference.options))
    if choice not in made:
        made.add(choice)
        RunParts(scenario)


def _check_link(scenario: Scenario, *, allow_motion: bool) -> None:
    """Raise BadInputError for a run over an external link that could not begin with any robot."""
    if parse_link(scenario.link.url).is_within_process:
        return
    where, is_makers = f"link.url = {scenario.link.url!r}", scenario.device.is_makers
    if (setting := needed_truth(scenario.estimator)) is not None:
        raise BadInputError(
            f'{where}: {setting}, and of a robot behind a link no truth is known; give estimator.source = "odometry"'
        )
    if is_makers and scenario.loop.mode == "lockstep":
        raise BadInputError(
            f"{where}: the protocol of {scenario.device.driver!r} has no STEP, so that nobody can let its time pass "
            'from outside; give loop.mode = "realtime", or link.url = "memory:"'
        )
    if is_makers and not allow_motion:
        raise BadInputError(
            f"{where}: the robot has motor controllers: real motors would move; add --allow-motion when it may move"
        )


def needs_bench(scenario: Scenario) -> bool:
    """Return whether a run needs the one hardware bench: a robot behind a link, or a source of pose fixes."""
    is_fixed_from_outside = scenario.estimator.source == "fused" and scenario.estimator.fix != "simulated"
    return is_fixed_from_outside or not parse_link(scenario.link.url).is_within_process
