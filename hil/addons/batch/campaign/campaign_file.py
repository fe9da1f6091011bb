"""Loads a campaign: its file, checked, its scenario, and its runs.

The runs are all combinations of samples, seeds, grids, lists, faults and laws, always in this order: laws vary fastest
and samples slowest, so that the runs of a campaign that was stopped are those of a smaller one.
"""

import itertools
import math
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from hil.addons.batch.job import ALWAYS, IF_FAILED, NEVER
from hil.addons.batch.plan_file import PlanFile, read_plan_file, row_of_table
from hil.core.errors import BadInputError
from hil.core.options import Expected, Range
from hil.laws.law_registry import short_name
from hil.scenario import Scenario, Sources, format_value, read
from hil.scenario.load import with_baseline
from hil.scenario.values import AnyOption, Text, is_path

RANDOM = ("uniform", "log_uniform")
"""Kinds of axes whose values are drawn."""
AXIS_KINDS = ("grid", "list", *RANDOM)
_MOST_RUNS = 10_000_000
_SCENARIO = "a shipped name, or a path relative to this file"


@dataclass(frozen=True)
class AxisTable:
    """A row of ``[axes]``: the values of one key of the scenario in the runs. Exactly one of these is given."""

    grid: Annotated[tuple[AnyOption, ...] | None, "values, each with each of the other axes"] = None
    list: Annotated[tuple[AnyOption, ...] | None, "values that go together with other lists, in step"] = None
    uniform: Annotated[tuple[float, float] | None, "[low, high] of a random number"] = None
    log_uniform: Annotated[tuple[float, float] | None, "[low, high] of one with uniform logarithm"] = None

    @property
    def kind(self) -> str:
        """Which of ``AXIS_KINDS`` it is."""
        return next(kind for kind in AXIS_KINDS if getattr(self, kind) is not None)

    @property
    def is_random(self) -> bool:
        """Whether its values are drawn."""
        return self.kind in RANDOM

    @property
    def values(self) -> tuple[Any, ...]:
        """The values, or low and high of a random axis."""
        return tuple(getattr(self, self.kind))

    def __post_init__(self) -> None:
        given = [kind for kind in AXIS_KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"expected one of {', '.join(AXIS_KINDS)}, as in {{ grid = [16, 20, 24] }}")
        if not self.values:
            raise ValueError(f"{given[0]} has no values; give at least one")
        if self.is_random and not self.values[0] < self.values[1]:
            raise ValueError(f"{given[0]} = {list(self.values)}; expected [low, high] with low < high")
        if self.log_uniform is not None and self.log_uniform[0] <= 0.0:
            raise ValueError(f"log_uniform = {list(self.values)}; expected numbers greater than 0")
        if self.grid is not None and len({repr(value) for value in self.grid}) < len(self.grid):
            raise ValueError("grid: a value is named twice; name each once")


@dataclass(frozen=True)
class LawTable:
    """An item of ``laws``: a law under which all runs are done, by its name alone or with what differs."""

    law: Annotated[Text, "as controller.law"]
    name: Annotated[Text | None, "what it is called; by default its law with its gains"] = None
    gains: Annotated[Mapping[Text, AnyOption], "over those that the scenario has for it"] = field(default_factory=dict)
    command: Annotated[Literal["speed", "torque"] | None, "by default the scenario's"] = None

    @property
    def keys_set(self) -> frozenset[str]:
        """The keys of the scenario that it gives beside the law."""
        command = () if self.command is None else ("controller.command",)
        return frozenset((*command, *(f"controller.gains.{name}" for name in self.gains)))


@dataclass(frozen=True)
class AlternativeTable:
    """``[[fault]]``: faults that a run has besides the scenario's own. Each alternative is run with everything else."""

    name: Annotated[Text, "what it is called"]
    rows: Annotated[tuple[Mapping[str, Any], ...], "as [[fault]] of a scenario; none for no fault"] = ()


def _seeds(seeds: object) -> object:
    if type(seeds) is int and 1 <= seeds <= _MOST_RUNS:
        return tuple(range(1, seeds + 1))
    if not isinstance(seeds, tuple) or not all(type(seed) is int for seed in seeds):
        raise ValueError(f"expected how many, from 1 to {_MOST_RUNS}, or an array of seeds")
    if len(set(seeds)) < len(seeds):
        raise ValueError("a seed is named twice; name each once")
    if not all(0 <= seed < 2**32 for seed in seeds):
        raise ValueError("expected seeds from 0 to 4294967295")
    return seeds


@dataclass(frozen=True)
class PlanTables:
    """A campaign's file."""

    scenario: Annotated[Text, Expected(_SCENARIO), _SCENARIO]
    seeds: Annotated[Any, _seeds, "loop.seed: how many from 1 on, or which"] = ()
    laws: Annotated[tuple[LawTable, ...], "by default the scenario's own"] = ()
    axes: Annotated[Mapping[Text, AxisTable], "by the scenario's dotted keys"] = field(default_factory=dict)
    samples: Annotated[int | None, Range(ge=1, le=_MOST_RUNS), "draws of the random axes"] = None
    seed: Annotated[int, Range(ge=0, le=2**32 - 1), "of the draws"] = 1
    fault: tuple[AlternativeTable, ...] = ()
    expect: Annotated[tuple[Mapping[str, Any], ...], "beside the scenario's own"] = ()
    set: Annotated[Mapping[Text, Any], "keys of the scenario that all runs share"] = field(default_factory=dict)
    keep: Annotated[Literal["none", "failures", "all"], "recordings"] = "failures"

    @property
    def record(self) -> str:
        """When a run is recorded."""
        return {"none": NEVER, "failures": IF_FAILED, "all": ALWAYS}[self.keep]

    def __post_init__(self) -> None:
        random = [key for key, axis in self.axes.items() if axis.is_random]
        if random and self.samples is None:
            raise ValueError(f"axes {random[0]} is random; say with samples = N how often to draw")
        if not random and self.samples is not None:
            raise ValueError("samples belongs to random axes, and there is none; remove it")
        lengths = {key: len(axis.values) for key, axis in self.axes.items() if axis.kind == "list"}
        if len(set(lengths.values())) > 1:
            have = ", ".join(f"{key} has {count}" for key, count in lengths.items())
            raise ValueError(f"lists go together in step and need one length, but {have}; give grid for each with each")
        for what, names in (("law", [law.name for law in self.laws]), ("fault", [row.name for row in self.fault])):
            named = [name for name in names if name is not None]
            if len(set(named)) < len(named):
                raise ValueError(f"two of {what} have one name; name each otherwise")
        instead = {"controller.law": "laws", "loop.seed": "seeds", "fault": "[[fault]]", "expect": "[[expect]]"}
        for key in self.axes:
            if key in instead:
                raise ValueError(f"axes {key}: give {instead[key]} instead")
            if key in self.set:
                raise ValueError(f"{key} is in [set] and in [axes]; give it once")
            if any(key in law.keys_set for law in self.laws):
                raise ValueError(f"{key} is in laws and in [axes], which would be what counts; give it once")
        if self.seeds and "loop.seed" in self.set:
            raise ValueError("loop.seed is in [set], and there are seeds, which would be what counts; give one of them")


_OTHER_SIDE = ("plant.", "firmware.", "device.")


class CampaignFile(NamedTuple):
    """A campaign that was loaded: its file, the tables there, and the files of its scenario."""

    file: PlanFile
    tables: PlanTables
    sources: Sources

    def scenario(self, sets: Mapping[str, object]) -> Scenario:
        """Return the scenario with these values. Raises BadInputError, which names the campaign's file and line.

        It has its baseline, unless the values are such as no baseline is made for: of the system on the other side of
        the wire.
        """
        tables = dict.fromkeys(self.tables.set, "set") | dict.fromkeys(self.tables.axes, "axes")
        scenario = self.file.scenario(self.sources, sets, tables)
        return scenario if any(key.startswith(_OTHER_SIDE) for key in sets) else with_baseline(scenario)


def load_plan(path: Path) -> CampaignFile:
    """Return the campaign of a file. Raises BadInputError, with one line for each problem."""
    file = read_plan_file(path, "campaign")
    laws = file.document.get("laws")
    if isinstance(laws, tuple):  # a law may be given by its name alone
        laws = tuple({"law": one} if isinstance(one, str) else one for one in laws)
        file = file._replace(document={**file.document, "laws": laws})
    tables = file.tables(PlanTables)
    name = tables.scenario
    try:
        sources = read(file.folder / name if is_path(name) else name)
    except BadInputError as error:
        raise BadInputError(f"campaign {file.place('scenario')}: {error}") from error
    return CampaignFile(file, tables, sources)


NO_FAULT = "none"
Sets = Mapping[str, object]


class Point(NamedTuple):
    """A run of a campaign.

    Attributes:
        axes: the value of each axis.
        law, fault: their names. seed: ``loop.seed``.
        sample: which draw of the random axes, 0 without any.
        sets: the keys of the scenario that make it, in the order of ``load``.
    """

    axes: Mapping[str, Any]
    law: str
    fault: str
    seed: int
    sample: int
    sets: Sets

    @property
    def words(self) -> str:
        """The run in a few words, for messages."""
        axes = (f"{key} = {format_value(value)}" for key, value in self.axes.items())
        fault = () if self.fault == NO_FAULT else (f"fault {self.fault}",)
        return ", ".join((self.law, *axes, *fault, f"seed {self.seed}"))


def points(plan: CampaignFile) -> Iterator[Point]:
    """Yield the runs. Raises BadInputError when the base scenario is not valid, or two laws have one name."""
    tables = plan.tables
    base = plan.scenario(tables.set)
    laws = [_law(law) for law in tables.laws] or [(short_name(base.controller.law), {})]
    called = [label for label, _ in laws]
    if twice := next((label for number, label in enumerate(called) if label in called[:number]), None):
        raise BadInputError(
            f"campaign {plan.file.place('laws')}: two laws are both called {twice!r}, and a report could not tell them "
            'apart; name one, as in { law = "./my_law.py:Law", name = "mine" }'
        )
    more = {row.name: [*map(row_of_table, base.fault), *row.rows] if row.rows else None for row in tables.fault}
    faults = [(name, {} if rows is None else {"fault": rows}) for name, rows in (more or {NO_FAULT: None}).items()]
    expect = {"expect": [*map(row_of_table, base.expect), *tables.expect]} if tables.expect else {}
    seeds = tables.seeds or (base.loop.seed,)
    grids, lists = (_combined(tables.axes, kind) for kind in ("grid", "list"))
    draws = _draws(tables.axes, tables.samples or 1, tables.seed)
    product = itertools.product(enumerate(draws), seeds, grids, lists, faults, laws)
    for (sample, drawn), seed, grid, listed, (fault, rows), (law, choice) in product:
        axes = {key: (grid | listed | drawn)[key] for key in tables.axes}
        sets = {**tables.set, **rows, **expect, **choice, **axes, "loop.seed": seed}
        yield Point(axes, law, fault, seed, sample, sets)


def _law(table: LawTable) -> tuple[str, dict[str, object]]:
    """Return a law's name, and the keys of the scenario that choose it."""
    options = [f"{name}={format_value(value)}" for name, value in table.gains.items()]
    command = {} if table.command is None else {"controller.command": table.command}
    label = table.name or ",".join((short_name(table.law), *options, *command.values()))
    gains = {f"controller.gains.{name}": value for name, value in table.gains.items()}
    return label, {"controller.law": table.law, **command, **gains}


def _combined(axes: Mapping[str, AxisTable], kind: str) -> list[dict[str, Any]]:
    """Return the values of the axes of a kind: of grids each with each, of lists in step."""
    some = {key: axis.values for key, axis in axes.items() if axis.kind == kind}
    each = itertools.product(*some.values()) if kind == "grid" else zip(*some.values(), strict=True)
    return [dict(zip(some, values, strict=True)) for values in each] or [{}]


def _draws(axes: Mapping[str, AxisTable], samples: int, seed: int) -> list[dict[str, float]]:
    """Return the samples of the random axes.

    Each axis has its own generator, seeded by its name: another axis, or more samples, do not change the numbers drawn
    before. Only ``random()`` is used, because Python promises for nothing else that a seed gives the
    same numbers in every version.
    """
    columns = {}
    for key, axis in axes.items():
        if axis.is_random:
            generator = random.Random(f"{seed} {key}")
            columns[key] = [_within(axis, generator.random()) for _ in range(samples)]
    return [{key: column[sample] for key, column in columns.items()} for sample in range(samples)]


def _within(axis: AxisTable, share: float) -> float:
    low, high = axis.values
    if axis.kind == "log_uniform":
        return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
    return float(low + share * (high - low))
