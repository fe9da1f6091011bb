"""The cases of a hunt: its file and scenario, checked, and the scenario and the job of each case."""

import contextlib
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hil.batch.hunt.space import Case, Chosen, Space
from hil.batch.hunt.tables import HuntTables
from hil.batch.job import Job
from hil.batch.keys import make_job
from hil.batch.plan_file import PlanFile, read_plan_file, row_of_table
from hil.core.errors import BadInputError
from hil.runtime.robots import check_plant_start
from hil.scenario import Scenario, Sources, read
from hil.scenario.run import values as values_of
from hil.scenario.trial import span_s

SUFFIX = ".hunt.toml"


class Request(NamedTuple):
    """What the user wants: a scenario with its options as in ``hil run``, the hunt's file, and where runs are done.

    ``target`` is that of ``hil device``: where the firmware runs.
    """

    scenario: str
    ranges: Path | None = None
    robot: Path | None = None
    link: str | None = None
    seed: int | None = None
    target: str = "host"
    workers: int | None = None
    limit_s: float = 120.0


class Cases:
    """What a hunt's file allows.

    Attributes:
        tables: the file. base: the scenario as it is, with what all runs share. space: the values and faults.

    Raises BadInputError for a wrong file, key, range or fault.
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self._sources: Sources = read(request.scenario, robot=request.robot)
        self._file: PlanFile = read_plan_file(request.ranges or _beside(request.scenario), "hunt")
        self.tables = self._file.tables(HuntTables)
        self.base = self._scenario_of({})
        if self.base.loop.mode != "lockstep":
            raise BadInputError(
                f'hunt {self._file.file}: in real time no run comes twice; give loop.mode = "lockstep" in [set]'
            )
        if not self.base.expect:
            raise BadInputError(f"scenario {self.base.name}: it has no [[expect]], so that no run could break one")
        self.space = Space(self.tables, dict(values_of(self.base)))
        self._check()

    def scenario(self, case: Case) -> Scenario:
        """Return the scenario of a case. Raises BadInputError when it is not valid."""
        sets: dict[str, Any] = dict(case.values)
        if case.duration_s is not None:
            sets["loop.duration_s"] = case.duration_s
            sets["expect"] = [row_of_table(self.base.expect[place]) for place in self.judged(case)]
        if case.faults:
            sets["fault"] = [*map(row_of_table, self.base.fault), *map(self._row, case.faults)]
        return self._scenario_of(sets)

    def judged(self, case: Case) -> list[int]:
        """Return the places of the expectations that a shortened run judges."""
        until_s = case.duration_s
        if until_s is None:
            return list(range(len(self.base.expect)))
        spans = [span_s(row, self.base.fault) for row in self.base.expect]
        return [
            place
            for place, (row, (from_s, to_s)) in enumerate(zip(self.base.expect, spans, strict=True))
            if row.figure is None and from_s < until_s and (row.settles_to is None or to_s <= until_s)
        ]

    def _row(self, chosen: Chosen) -> dict[str, Any]:
        row = {"kind": self.space.kinds[chosen.offer], **chosen.given}
        if (duration_s := row.pop("duration_s", None)) is not None:
            row["end_s"] = round(row["start_s"] + duration_s, 6)
        return {name: value for name, value in row.items() if value != ""}

    def _scenario_of(self, sets: Mapping[str, object]) -> Scenario:
        request = self._request
        given = {**self.tables.set, **sets}
        tables = dict.fromkeys(self.tables.set, "set") | dict.fromkeys(self.tables.range, "range")
        if request.target != "host" and request.link is None:
            given.setdefault("link.url", "serial:pty")
        return self._file.scenario(self._sources, given, tables, link=request.link, seed=request.seed)

    def _check(self) -> None:
        """Raise BadInputError, with file and line, for a range or a fault that the scenario does not take."""
        for key, dimension in self.space.ranges.items():
            for value in dimension.options or (dimension.low, dimension.high):
                with self._about("range", key):
                    check_plant_start(self.scenario(Case({key: value})))
        for params in itertools.chain.from_iterable(self.space.singles()):
            if params.get("fault 0"):
                case = self.space.case(params)
                with self._about("fault", str(case.faults[0].offer)):
                    self.scenario(case)

    @contextlib.contextmanager
    def _about(self, *path: str) -> Iterator[None]:
        try:
            yield
        except BadInputError as error:
            words = [line.removeprefix(f"hunt {self._file.file}: ") for line in str(error).splitlines()]
            where = f"hunt {self._file.place(*path)}: "
            raise BadInputError("\n".join(one if one.startswith("hunt ") else where + one for one in words)) from None

    def job(self, case: Case) -> Job | None:
        """Return the job of a case; None where the values contradict each other, so that there is no such run."""
        options = {} if self._request.target == "host" else {"target": self._request.target}
        try:
            return make_job(self.scenario(case), options=options, limit_s=self._request.limit_s, retries_crash=True)
        except BadInputError:
            return None

    def differs(self, case: Case) -> str:
        """Return in words what a case differs in from the scenario."""
        scenario = self.scenario(case)
        changes = [
            f"{key} = {value:g}" if isinstance(value, float) else f"{key} = {value}"
            for key, value in case.values.items()
        ]
        changes += [row.words for row in scenario.fault[len(self.base.fault) :]]
        return ", ".join(changes) or "the scenario as it is"


def _beside(scenario: str) -> Path:
    """Return the file beside a scenario's; for a shipped one in the current folder."""
    return Path(scenario.removesuffix(".toml") + SUFFIX)
