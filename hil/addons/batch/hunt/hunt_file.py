"""The cases of a hunt: its file and scenario, checked, scenario and job of each case, and one written as TOML."""

import contextlib
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.batch.hunt.space import Change, Chosen, HuntTables, Space
from hil.addons.batch.job import Job
from hil.addons.batch.keys import make_job
from hil.addons.batch.plan_file import PlanFile, found_from_anywhere, read_plan_file, row_of_table
from hil.core.errors import BadInputError
from hil.core.options import format_value
from hil.runtime.robots import check_plant_start
from hil.scenario import Scenario, Sources, load, read, resolved
from hil.scenario.scenario import values as values_of

SUFFIX = ".hunt.toml"


class Request(NamedTuple):
    """A user's request: a scenario with its options as in ``hil run``, the hunt's file, and where runs are done."""

    scenario: str
    ranges: Path | None = None
    robot: Path | None = None
    link: str | None = None
    seed: int | None = None
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

    def scenario(self, case: Change) -> Scenario:
        """Return the scenario of a case. Raises BadInputError when it is not valid."""
        sets: dict[str, Any] = dict(case.values)
        if case.faults:
            sets["fault"] = [*map(row_of_table, self.base.fault), *map(self._row, case.faults)]
        return self._scenario_of(sets)

    def _row(self, chosen: Chosen) -> dict[str, Any]:
        row = {"kind": self.space.kinds[chosen.offer], **chosen.given}
        if (duration_s := row.pop("duration_s", None)) is not None:
            row["end_s"] = round(row["start_s"] + duration_s, 6)
        return {name: value for name, value in row.items() if value != ""}

    def _scenario_of(self, sets: Mapping[str, object]) -> Scenario:
        tables = dict.fromkeys(self.tables.set, "set") | dict.fromkeys(self.tables.range, "range")
        how = {"link": self._request.link, "seed": self._request.seed}
        return self._file.scenario(self._sources, {**self.tables.set, **sets}, tables, **how)

    def _check(self) -> None:
        """Raise BadInputError, with file and line, for a range or a fault that the scenario does not take."""
        for key, dimension in self.space.ranges.items():
            for value in dimension.options or (dimension.low, dimension.high):
                with self._about("range", key):
                    check_plant_start(self.scenario(Change({key: value})))
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

    def job(self, case: Change) -> Job | None:
        """Return the job of a case; None where the values contradict each other, so that there is no such run."""
        try:
            return make_job(self.scenario(case), limit_s=self._request.limit_s)
        except BadInputError:
            return None

    def differs(self, case: Change) -> str:
        """Return a text on the differences between a case and the scenario."""
        scenario = self.scenario(case)
        changes = [
            f"{key} = {value:g}" if isinstance(value, float) else f"{key} = {value}"
            for key, value in case.values.items()
        ]
        changes += [row.words for row in scenario.fault[len(self.base.fault) :]]
        return ", ".join(changes) or "the scenario as it is"


def _beside(scenario: str) -> Path:
    return Path(scenario.removesuffix(".toml") + SUFFIX)


_ROWS = ("fault", "expect")


def scenario_text(scenario: Scenario, folder: Path, comments: Sequence[str]) -> str:
    """Return the TOML of a scenario for a folder: the scenario that it extends, and its changes."""
    base = scenario.name if scenario.path is None else str(scenario.path)
    extends = base if scenario.path is None else Path(os.path.relpath(base, folder.absolute())).as_posix()
    if scenario.path is not None and "/" not in extends and not extends.endswith(".toml"):
        extends = f"./{extends}"
    lines = [f"# {line}" for line in comments]
    lines += ["", f"extends = {format_value(extends)}", ""]
    before, after = (_values(one) for one in (load(base), scenario))
    lines += [
        f"{_key(key)} = {format_value(found_from_anywhere(key, value, scenario.directory))}"
        for key, value in after.items()
        if key not in before or before[key] != value
    ]
    arrays = {name: [row_of_table(row) for row in getattr(scenario, name)] for name in _ROWS}
    original = {name: [row_of_table(row) for row in getattr(load(base), name)] for name in _ROWS}
    for name in _ROWS:
        if arrays[name] != original[name]:
            lines += _tables(name, arrays[name])
    return "\n".join(lines) + "\n"


def _values(scenario: Scenario) -> dict[str, object]:
    return {key: value for key, value, _ in resolved(scenario) if key.partition(".")[0] not in _ROWS}


def _tables(name: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not rows:
        yield f"{name} = []"
    for row in rows:
        yield from ("", f"[[{name}]]", *(f"{key} = {format_value(value)}" for key, value in row.items()))


def _key(dotted: str) -> str:
    parts = dotted.split(".")
    return ".".join(part if part.replace("_", "").replace("-", "").isalnum() else format_value(part) for part in parts)
