"""A campaign: its runs, what is left of them in a folder, and doing that.

campaign = Campaign(Path("mass.toml"))
for rows in campaign.perform(Path("runs/mass"), Place(None, 2, 120.0)):
    ...
"""

import contextlib
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa

from hil.batch.campaign.dataset import KEY, RECORDINGS, ROWS, Dataset, check_folder, read_rows
from hil.batch.campaign.jobs import ALWAYS, IF_FAILED, NEVER, Job
from hil.batch.campaign.keys import key_of
from hil.batch.campaign.load import Plan, load_plan
from hil.batch.campaign.points import Point, points
from hil.batch.campaign.rows import COLUMNS, ENDED, FAILED, FOREIGN, MACHINE, PASSED, as_judged, check_figure
from hil.batch.campaign.tables import KeepTable
from hil.core.errors import BadInputError, LinkError
from hil.runtime.parts import PartsOf
from hil.runtime.provenance import versions
from hil.runtime.robots import check_plant_start, needed_truth
from hil.scenario import Scenario, format_value, set_texts, to_plain
from hil.scenario.fields import is_path
from hil.wire.opening import is_within_process
from hil.wire.url import parse_link

if TYPE_CHECKING:
    from hil.batch.campaign.cluster import Place
    from hil.batch.campaign.schedule import Done, Told

Row = Mapping[str, Any]
_RECORDING_SUFFIX = ".rrd"
_ARROW = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}


class _Run(NamedTuple):
    key: str
    point: Point


class _How(NamedTuple):
    """How runs are done; see ``hil.batch.campaign.schedule.perform_jobs``."""

    place: "Place"
    tell: "Callable[[Told], None]"
    is_stopping: Callable[[], bool]


class Campaign:
    """A campaign that was loaded, every run of it checked.

    ``on_bench`` tells whether a run needs what there is one of: a robot behind a link, or a source of pose fixes.

    Raises BadInputError, before anything is run, for a file, a key or a value that is not as it should be, for two
    runs that are the same, and for a run that would only be refused.
    """

    def __init__(self, file: Path, *, allow_motion: bool = False) -> None:
        self.plan = plan = load_plan(file)
        self._allow_motion = allow_motion
        keep = plan.tables.keep
        if isinstance(keep, KeepTable):
            check_figure(keep.by, f"campaign {plan.place('keep')}: keep.by")
        runs: dict[str, Point] = {}
        self._choices: set[tuple[str, ...]] = set()
        self.on_bench = self.in_real_time = False
        self.longest_s = 0.0
        for point in points(plan):
            scenario = plan.scenario(point.sets)
            with _of(f"campaign {file}: {point.words}: "):
                key = key_of(scenario)
                self._check(scenario, point)
            if key in runs:
                raise BadInputError(
                    f"campaign {file}: two runs are the same: {runs[key].words}; and {point.words}. Remove one of them"
                )
            runs[key] = point
            self.on_bench = self.on_bench or _needs_bench(scenario)
            self.in_real_time = self.in_real_time or scenario.loop.mode == "realtime"
            self.longest_s = max(self.longest_s, scenario.loop.duration_s)
        self.runs = [_Run(key, point) for key, point in runs.items()]
        if isinstance(keep, KeepTable) and self.in_real_time:
            raise BadInputError(
                f"campaign {plan.place('keep')}: keep.worst runs the worst once more to record them, and in real time "
                'no run comes twice; give keep = "failures" or "all"'
            )

    def _check(self, scenario: Scenario, point: Point) -> None:
        """Raise BadInputError for a run that would only be refused."""
        _check_link(scenario, allow_motion=self._allow_motion)
        check_plant_start(scenario)
        for row in scenario.expect:
            if row.from_s >= scenario.loop.duration_s:
                raise BadInputError(
                    f"the expectation of {row.signal} begins at {row.from_s:g} s, and the run ends at "
                    f"{scenario.loop.duration_s:g} s: it would always fail; give another, or expect = [] in [set] and "
                    "[[expect]] rows of the campaign's own"
                )
        controller, reference = scenario.controller, scenario.reference
        gains = (controller.gains, controller.shadow_gains)
        choice = (controller.law, *controller.shadow, reference.kind, *map(repr, (*gains, reference.options)))
        if choice not in self._choices:
            self._choices.add(choice)
            PartsOf(scenario)

    def job(self, run: _Run, recorded: str) -> Job:
        """Return what a worker is told of a run."""
        return Job(run.key, to_plain(self.plan.scenario(run.point.sets)), recorded, "", self._allow_motion)

    @cached_property
    def _schema(self) -> pa.Schema:
        """The columns of a row."""
        columns = {name: _ARROW[kind] for name, kind in COLUMNS.items()}
        return pa.schema(list((columns | self._axes).items()))

    @cached_property
    def _axes(self) -> dict[str, pa.DataType]:
        return {key: _type([run.point.axes[key] for run in self.runs]) for key in self.plan.tables.axes}

    def row(self, run: _Run) -> dict[str, Any]:
        """Return what a row says of a run before it is done."""
        point = run.point
        told = {KEY: run.key, "law": point.law, "fault": point.fault, "seed": point.seed, "sample": point.sample}
        texts = {
            key: value if isinstance(value, str) else format_value(value)
            for key, value in point.axes.items()
            if self._axes[key] == pa.string()
        }
        return told | dict(point.axes) | texts

    def perform(
        self,
        folder: Path,
        place: "Place",
        tell: "Callable[[Told], None]" = lambda _: None,
        is_stopping: Callable[[], bool] = lambda: False,
        redo: Collection[str] = (),
    ) -> Iterator[Sequence[Row]]:
        """Do what is left of it, and yield the rows as they come, each when it is on the disk.

        First comes what was there already, but for runs with one of the outcomes ``redo``, which are done again.
        ``tell`` and ``is_stopping`` are those of ``perform_jobs``. Raises BadInputError when the folder cannot be
        written to or is that of another campaign, LinkError when there is no scheduler.
        """
        how = _How(place, tell, is_stopping)
        check_folder(folder, self.about())
        with Dataset(folder, self._schema) as dataset:
            self._begin(dataset)
            there = self._there(folder)
            dataset.drop({key for key, row in there.items() if row["outcome"] in redo})
            there = self._there(folder) if redo else there
            yield list(there.values())
            yield from self._perform([run for run in self.runs if run.key not in there], dataset, how)
            yield from self._record_worst(dataset, how)

    @property
    def records_worst(self) -> bool:
        """Whether the worst are run once more at the end: with all rows there it may not be done."""
        return isinstance(self.plan.tables.keep, KeepTable)

    def left(self, folder: Path, redo: Collection[str] = ()) -> int:
        """Return how many runs ``perform`` would do in a folder, which need not be there. Raises BadInputError as it
        does."""
        check_folder(folder, self.about())
        if not (folder / ROWS).is_dir():
            return len(self.runs)
        there = self._there(folder)
        return sum(run.key not in there or there[run.key]["outcome"] in redo for run in self.runs)

    def _there(self, folder: Path) -> dict[str, Row]:
        """Return the rows of this campaign's runs that are in a folder, by their keys."""
        return {row[KEY]: row for row in read_rows(folder).to_pylist() if row[KEY] in self._by_key}

    @cached_property
    def _by_key(self) -> dict[str, _Run]:
        return {run.key: run for run in self.runs}

    def _perform(self, left: Sequence[_Run], dataset: Dataset, how: "_How") -> Iterator[Sequence[Row]]:
        recorded = {"failures": IF_FAILED, "all": ALWAYS}.get(str(self.plan.tables.keep), NEVER)
        for batch in self._done(left, recorded, how):
            new = [self._finished(done, dataset) for done in batch]
            dataset.append(new)
            yield new

    def _done(self, runs: Sequence[_Run], recorded: str, how: "_How") -> "Iterator[list[Done]]":
        if not runs:
            return
        from hil.batch.campaign.schedule import perform_jobs  # Dask takes a second to import

        jobs = (self.job(run, recorded) for run in runs)
        with contextlib.closing(
            perform_jobs(how.place, jobs, on_bench=self.on_bench, tell=how.tell, is_stopping=how.is_stopping)
        ) as batches:
            yield from batches

    def _finished(self, done: "Done", dataset: Dataset) -> dict[str, Any]:
        """Keep the recording of a run, and return its row."""
        said, answer = done.answer.said, done.answer
        if said.outcome == FOREIGN:
            raise LinkError(
                f"worker {answer.worker}: its version of this package, or its FMU, law or reference file, is not that "
                "of the campaign; make them the same, and give the same command again"
            )
        if answer.recording is not None:
            dataset.keep_recording(done.job.key + _RECORDING_SUFFIX, answer.recording)
        machine = {"wall_s": said.wall_s, "worker": answer.worker, "commit": self._commit}
        told = {"outcome": said.outcome, "reason": said.reason, **said.figures}
        told |= {MACHINE + name: value for name, value in machine.items()}
        return self.row(self._by_key[done.job.key]) | told

    @cached_property
    def _commit(self) -> str | None:
        return versions().get("commit")

    def _record_worst(self, dataset: Dataset, how: "_How") -> Iterator[Sequence[Row]]:
        """Run the worst once more, to record them; what was recorded before stays only as long as it is of them."""
        keep = self.plan.tables.keep
        if not isinstance(keep, KeepTable) or how.is_stopping():
            return
        began = [row for row in self._there(dataset.folder).values() if row["outcome"] in (PASSED, FAILED, ENDED)]
        worst = [row[KEY] for row in sorted(began, key=partial(_badness, by=keep.by), reverse=True)[: keep.worst]]
        there = {path.stem for path in (dataset.folder / RECORDINGS).glob(f"*{_RECORDING_SUFFIX}")}
        for batch in self._done([self._by_key[key] for key in worst if key not in there], ALWAYS, how):
            for done in batch:
                self._finished(done, dataset)
            yield []
        for key in there - set(worst):
            (dataset.folder / RECORDINGS / f"{key}{_RECORDING_SUFFIX}").unlink()

    def _begin(self, dataset: Dataset) -> None:
        names = [KEY, "law", "fault", "seed", "sample", *self._axes]
        of_plan = pa.schema([*(self._schema.field(name) for name in names), ("repeat", pa.string())])
        runs = [self.row(run) | {"repeat": shlex.join(self.repeat(run.point))} for run in self.runs]
        dataset.begin(pa.Table.from_pylist(runs, schema=of_plan), self.about())

    def repeat(self, point: Point) -> list[str]:
        """Return the words of the command that does a run once more, from any folder."""
        sets = {key: _found_from_anywhere(key, value, self.plan) for key, value in point.sets.items()}
        return ["hil", "run", self._scenario, *(word for text in set_texts(sets) for word in ("--set", text))]

    @cached_property
    def _scenario(self) -> str:
        """What ``hil run`` finds the base scenario by, from any folder."""
        base = self.plan.scenario({})
        return base.name if base.path is None else str(base.path)

    def about(self) -> dict[str, Any]:
        """Return what its report has to know of it."""
        tables = self.plan.tables
        keep = tables.keep.model_dump() if isinstance(tables.keep, KeepTable) else tables.keep
        return {
            "name": self.plan.name,
            "scenario": tables.scenario,
            "laws": list(dict.fromkeys(run.point.law for run in self.runs)),
            "faults": list(dict.fromkeys(run.point.fault for run in self.runs)),
            "seeds": len({run.point.seed for run in self.runs}),
            "samples": tables.samples or 1,
            "axes": {key: {"kind": axis.kind, "values": list(axis.values)} for key, axis in tables.axes.items()},
            "keep": keep,
            "by": keep["by"] if isinstance(keep, dict) else "steady_rms_m",
            "runs": len(self.runs),
        }


def _badness(row: Row, by: str) -> tuple[bool, float]:
    """Return how bad a run was: one that ended early, or never came so far as to have the figure, is worse than all."""
    value = as_judged(row)[by]
    return value is None, value or 0.0


@contextlib.contextmanager
def _of(run: str) -> Iterator[None]:
    """Say of which run it is that something is refused."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError("\n".join(run + line for line in str(error).splitlines())) from error


def _check_link(scenario: Scenario, *, allow_motion: bool) -> None:
    """Raise BadInputError for a run behind a link that could not begin, whatever stands there."""
    if is_within_process(parse_link(scenario.link.url)):
        return
    where, is_makers = f"link.url = {scenario.link.url!r}", scenario.device.is_makers
    if (setting := needed_truth(scenario)) is not None:
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


def _type(values: Sequence[Any]) -> pa.DataType:
    """Return the type of a column: numbers where all are, truth values where all are, else text."""
    if all(isinstance(value, bool) for value in values):
        return pa.bool_()
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return pa.float64()
    return pa.string()


def _found_from_anywhere(key: str, value: object, plan: Plan) -> object:
    """Return a value of the campaign's file that is a path as an absolute one."""
    if key in ("plant.fmu", "controller.law") and isinstance(value, str):
        is_file = is_path(value if key == "plant.fmu" else value.rpartition(":")[0])
        return str(plan.folder / value) if is_file else value
    if key in ("reference.file", "device.motors.file") and isinstance(value, str):
        return str(plan.folder / value)
    return value


def _needs_bench(scenario: Scenario) -> bool:
    is_fixed_from_outside = scenario.estimator.source == "fused" and scenario.estimator.fix != "simulated"
    return is_fixed_from_outside or not is_within_process(parse_link(scenario.link.url))
