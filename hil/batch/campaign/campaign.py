"""A campaign: its runs, which of them are still to do in a folder, and doing them.

campaign = Campaign(Path("mass.toml")) for rows in campaign.perform(Path("runs/mass"), Place(None, 2, 120.0)):
    ...
"""

import contextlib
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from hil.batch.campaign.load import load_plan
from hil.batch.campaign.points import PackedScenarios, Point, check_run, needs_bench, points
from hil.batch.campaign.tables import KeepTable
from hil.batch.figures import KEY, MACHINE, as_judged, check_figure, row_columns, row_of
from hil.batch.job import ALWAYS, ENDED, FAILED, IF_FAILED, NEVER, PASSED, Job, Outcome
from hil.batch.keys import SCENARIO_RUN, key_of
from hil.batch.plan import FixedPlan, run_plan
from hil.batch.plan_file import found_from_anywhere
from hil.batch.pool import LocalPool, Pool, Runner
from hil.batch.store import OTHER_ROWS, ROWS, Row, Store, check_folder, read_rows
from hil.core.errors import BadInputError
from hil.core.options import plain
from hil.core.printable import command
from hil.runtime.provenance import versions
from hil.scenario import format_value, set_texts

_ARROW = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
_TIMED = 3
_BETWEEN_S = 1.0
"""What a run in real time takes besides its own time [s]."""


class Run(NamedTuple):
    """A run of a campaign: the key of its job, its place among the axes, and its scenario as it was checked, packed."""

    key: str
    point: Point
    scenario: bytes


class Place(NamedTuple):
    """Where runs are done: on the Dask scheduler at an address or, with None, in ``workers`` processes here.

    ``limit_s`` is the wall-clock time [s], ``memory_mb`` the memory [MB] that a run may take.
    """

    scheduler: str | None
    workers: int
    limit_s: float
    memory_mb: float | None = None


Outcomes = Callable[[Sequence[Run], str], Iterator[list[Outcome]]]
"""Does runs, recorded as the second argument says, and yields their outcomes."""


class Campaign:
    """A campaign that was loaded, with every run of it checked.

    ``on_bench`` says whether a run needs the one hardware bench: a robot behind a link, or a source of pose fixes.

    Raises BadInputError, before anything is run, for a wrong file, key or value, for two runs that are the same, and
    for a run that would be refused.
    """

    def __init__(self, file: Path, *, allow_motion: bool = False) -> None:
        self.plan = plan = load_plan(file)
        self._allow_motion = allow_motion
        keep = plan.tables.keep
        if isinstance(keep, KeepTable):
            check_figure(keep.by, f"campaign {plan.file.place('keep')}: keep.by")
        self._scenarios = PackedScenarios()
        runs: dict[str, Run] = {}
        made: set[tuple[str, ...]] = set()
        self.on_bench = self.in_real_time = False
        self.longest_s = 0.0
        for point in points(plan):
            scenario = plan.scenario(point.sets)
            with _of(f"campaign {file}: {point.words}: "):
                key = key_of(scenario)
                check_run(scenario, made, allow_motion=allow_motion)
            if key in runs:
                raise BadInputError(
                    f"campaign {file}: two runs are the same: {runs[key].point.words}; and {point.words}. Remove one "
                    "of them"
                )
            # The key is of this scenario. To make it again for the job would take longer than all else about a run.
            runs[key] = Run(key, point, self._scenarios.pack(scenario))
            self.on_bench = self.on_bench or needs_bench(scenario)
            self.in_real_time = self.in_real_time or scenario.loop.mode == "realtime"
            self.longest_s = max(self.longest_s, scenario.loop.duration_s)
        self.runs = list(runs.values())
        if isinstance(keep, KeepTable) and self.in_real_time:
            raise BadInputError(
                f"campaign {plan.file.place('keep')}: keep.worst runs the worst once more to record them, and in real "
                'time no run comes twice; give keep = "failures" or "all"'
            )

    def job(self, run: Run, **how: Any) -> Job:
        """Return the job of a run; ``how`` are further fields of Job."""
        scenario = self._scenarios.unpack(run.scenario)
        return Job(run.key, SCENARIO_RUN, scenario, {}, allow_motion=self._allow_motion, **how)

    @cached_property
    def _schema(self) -> pa.Schema:
        """The columns of a row."""
        columns = {name: _ARROW[kind] for name, kind in row_columns().items()}
        return pa.schema(list((columns | self._axes).items()))

    @cached_property
    def _axes(self) -> dict[str, pa.DataType]:
        return {key: _type([run.point.axes[key] for run in self.runs]) for key in self.plan.tables.axes}

    def row(self, run: Run) -> dict[str, Any]:
        """Return the columns of a run that are known before it is done."""
        point = run.point
        own = {KEY: run.key, "law": point.law, "fault": point.fault, "seed": point.seed, "sample": point.sample}
        texts = {
            key: value if isinstance(value, str) else format_value(value)
            for key, value in point.axes.items()
            if self._axes[key] == pa.string()
        }
        return own | dict(point.axes) | texts

    def perform(
        self,
        folder: Path,
        place: Place,
        on_trouble: Callable[[str | None], None] = lambda _: None,
        is_stopping: Callable[[], bool] = lambda: False,
        redo: Collection[str] = (),
    ) -> Iterator[Sequence[Row]]:
        """Do the runs that are still to do, and yield their rows as they come, each when it is on the disk.

        The rows that the folder already has are yielded first. Those with an outcome in ``redo`` are removed instead,
        and their runs are done again. ``on_trouble`` and ``is_stopping`` are as in ``run_plan``. Raises BadInputError
        when the folder cannot be written to or belongs to another campaign, LinkError when there is no scheduler.
        """
        check_folder(folder, self.about())
        with contextlib.ExitStack() as resources:
            store = resources.enter_context(Store(folder, self._schema))
            do = partial(self._outcomes, place, store.scratch, on_trouble, is_stopping)
            store.sort(self._by_key)
            self._begin(store)
            there = self._there(folder)
            store.drop({key for key, row in there.items() if row["outcome"] in redo})
            there = self._there(folder) if redo else there
            yield list(there.values())
            record = {"failures": IF_FAILED, "all": ALWAYS}.get(str(self.plan.tables.keep), NEVER)
            new: list[Row] = []
            try:
                for outcomes in do([run for run in self.runs if run.key not in there], record):
                    new += [self._kept(outcome, store) for outcome in outcomes]
                    if new and (store.is_rested or not outcomes):
                        rows, new = new, []
                        store.append(rows)
                        yield rows
            finally:
                store.append(new)
            yield new
            if isinstance(self.plan.tables.keep, KeepTable) and not is_stopping():
                yield from self._record_worst(store, self.plan.tables.keep, do)

    @property
    def records_worst(self) -> bool:
        """Whether the worst runs are repeated at the end; then a campaign with all its rows may not be done yet."""
        return isinstance(self.plan.tables.keep, KeepTable)

    def left(self, folder: Path, redo: Collection[str] = ()) -> int:
        """Return how many runs ``perform`` would do in a folder, which need not exist. Raises BadInputError too."""
        check_folder(folder, self.about())
        there = self._there(folder) if (folder / ROWS).is_dir() else {}
        return sum(run.key not in there or there[run.key]["outcome"] in redo for run in self.runs)

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

    def _there(self, folder: Path) -> dict[str, Row]:
        """Return the rows of this campaign's runs that are in a folder, by their keys."""
        rows = [row for place in (OTHER_ROWS, ROWS) for row in read_rows(folder, place).to_pylist()]
        return {row[KEY]: row for row in rows if row[KEY] in self._by_key}

    @cached_property
    def _by_key(self) -> dict[str, Run]:
        return {run.key: run for run in self.runs}

    def _outcomes(
        self,
        place: Place,
        scratch: Path,
        on_trouble: Callable[[str | None], None],
        is_stopping: Callable[[], bool],
        runs: Sequence[Run],
        record: str,
    ) -> Iterator[list[Outcome]]:
        if not runs:
            return
        how: dict[str, Any] = {"limit_s": place.limit_s, "memory_mb": place.memory_mb, "record": record}
        files = (str(scratch / f"{run.key}.rrd") for run in runs)
        jobs = (self.job(run, retries_crash=True, recording=file, **how) for run, file in zip(runs, files, strict=True))
        if place.scheduler is None:
            pool: Pool = LocalPool(place.workers)
        else:
            from hil.batch.dask_pool import DaskPool  # which takes a second, and need not be installed

            pool = DaskPool(place.scheduler, on_bench=self.on_bench)
        yield from run_plan(FixedPlan(jobs), pool, on_trouble=on_trouble, is_stopping=is_stopping)

    def _kept(self, outcome: Outcome, store: Store) -> dict[str, Any]:
        """Keep the recording of a run, and return its row."""
        if outcome.recording is not None:
            store.keep_recording(outcome.key, Path(outcome.recording))
        return row_of(outcome) | self.row(self._by_key[outcome.key]) | {f"{MACHINE}commit": self._commit}

    @cached_property
    def _commit(self) -> str | None:
        return versions().get("commit")

    def _record_worst(self, store: Store, keep: KeepTable, do: Outcomes) -> Iterator[Sequence[Row]]:
        """Run the worst once more to record them, and remove recordings of runs that are no longer among them."""

        def badness(row: Row) -> tuple[bool, float]:
            """Return how bad a run was; one without the figure, as after an early end, is worse than all others."""
            value = as_judged(row)[keep.by]
            return value is None, value or 0.0

        began = [row for row in self._there(store.folder).values() if row["outcome"] in (PASSED, FAILED, ENDED)]
        worst = [row[KEY] for row in sorted(began, key=badness, reverse=True)[: keep.worst]]
        there = store.recorded()
        for outcomes in do([self._by_key[key] for key in worst if key not in there], ALWAYS):
            for outcome in outcomes:
                self._kept(outcome, store)
            yield []
        for key in there - set(worst):
            store.remove_recording(key)

    def _begin(self, store: Store) -> None:
        names = [KEY, "law", "fault", "seed", "sample", *self._axes]
        of_plan = pa.schema([*(self._schema.field(name) for name in names), ("repeat", pa.string())])
        runs = [self.row(run) | {"repeat": command(*self.repeat(run.point))} for run in self.runs]
        store.begin(pa.Table.from_pylist(runs, schema=of_plan), self.about())

    def repeat(self, point: Point) -> list[str]:
        """Return the command that repeats a run from any folder, as words."""
        sets = {key: found_from_anywhere(key, value, self.plan.file.folder) for key, value in point.sets.items()}
        return ["hil", "run", self._scenario, *(word for text in set_texts(sets) for word in ("--set", text))]

    @cached_property
    def _scenario(self) -> str:
        """The name or path by which ``hil run`` finds the base scenario from any folder."""
        base = self.plan.scenario({})
        return base.name if base.path is None else str(base.path)

    def about(self) -> dict[str, Any]:
        """Return the description of the campaign that its report needs."""
        tables = self.plan.tables
        keep = plain(tables.keep) if isinstance(tables.keep, KeepTable) else tables.keep
        return {
            "name": self.plan.file.name,
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


@contextlib.contextmanager
def _of(run: str) -> Iterator[None]:
    """Begin the lines of a BadInputError with the run that it is about."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError("\n".join(run + line for line in str(error).splitlines())) from error


def _type(values: Sequence[Any]) -> pa.DataType:
    """Return the type of a column: numbers where all are, truth values where all are, else text."""
    if all(isinstance(value, bool) for value in values):
        return pa.bool_()
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return pa.float64()
    return pa.string()
