"""The tables of a campaign's file: every key once, with its default and meaning."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from hil.core.options import Expected, Range, build
from hil.scenario.values import AnyOption, Text

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


@dataclass(frozen=True)
class KeepTable:
    """``keep = { worst = N, by = "..." }``: recordings of the N runs in which a figure is greatest."""

    worst: Annotated[int, Range(ge=1, le=10000), "how many"]
    by: Annotated[Text, "a figure of a run that is a number"] = "steady_rms_m"


def _seeds(seeds: object) -> object:
    """Return the seeds: 1 to N for a number N, or those of an array."""
    if type(seeds) is int and 1 <= seeds <= _MOST_RUNS:
        return tuple(range(1, seeds + 1))
    if not isinstance(seeds, tuple) or not all(type(seed) is int for seed in seeds):
        raise ValueError(f"expected how many, from 1 to {_MOST_RUNS}, or an array of seeds")
    if len(set(seeds)) < len(seeds):
        raise ValueError("a seed is named twice; name each once")
    if not all(0 <= seed < 2**32 for seed in seeds):
        raise ValueError("expected seeds from 0 to 4294967295")
    return seeds


def _keep(keep: object) -> object:
    if isinstance(keep, Mapping):
        return build(KeepTable, keep)
    if keep not in ("none", "failures", "all"):
        raise ValueError('expected "none", "failures", "all" or { worst = 20, by = "steady_rms_m" }')
    return keep


@dataclass(frozen=True)
class PlanTables:
    """A campaign's file."""

    scenario: Annotated[Text, Expected(_SCENARIO), _SCENARIO]
    seeds: Annotated[Any, _seeds, "loop.seed: how many from 1 on, or which"] = ()
    laws: Annotated[tuple[LawTable, ...], "by default the scenario's own"] = ()
    axes: Annotated[Mapping[Text, AxisTable], "by the scenario's dotted keys"] = field(default_factory=dict)
    samples: Annotated[int | None, Range(ge=1, le=_MOST_RUNS), "draws of the random axes"] = None
    latin: Annotated[bool, "draws fill a Latin hypercube"] = False
    seed: Annotated[int, Range(ge=0, le=2**32 - 1), "of the draws"] = 1
    fault: tuple[AlternativeTable, ...] = ()
    expect: Annotated[tuple[Mapping[str, Any], ...], "beside the scenario's own"] = ()
    set: Annotated[Mapping[Text, Any], "keys of the scenario that all runs share"] = field(default_factory=dict)
    keep: Annotated[Any, _keep, "recordings"] = "failures"

    def __post_init__(self) -> None:
        random = [key for key, axis in self.axes.items() if axis.is_random]
        if random and self.samples is None:
            raise ValueError(f"axes {random[0]} is random; say with samples = N how often to draw")
        if not random and (self.samples is not None or self.latin):
            raise ValueError("samples and latin belong to random axes, and there is none; remove them")
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
