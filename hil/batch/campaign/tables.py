"""The tables of a campaign's file: every key once, with its default and meaning."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from hil.scenario.fields import Option, Table, Text

AXIS_KINDS = ("grid", "list", "uniform", "log_uniform")
_MOST_RUNS = 10_000_000


class AxisTable(Table):
    """A row of ``[axes]``: what one key of the scenario is in the runs. One of these."""

    grid: tuple[Option, ...] | None = Field(default=None, description="values, each with each of the other axes")
    list: tuple[Option, ...] | None = Field(
        default=None, description="values that go together with other lists, in step"
    )
    uniform: tuple[float, float] | None = Field(default=None, description="[low, high] of a random number")
    log_uniform: tuple[float, float] | None = Field(
        default=None, description="[low, high] of one with uniform logarithm"
    )

    @property
    def kind(self) -> str:
        """Which of ``AXIS_KINDS`` it is."""
        return next(kind for kind in AXIS_KINDS if getattr(self, kind) is not None)

    @property
    def is_random(self) -> bool:
        """Whether its values are drawn."""
        return self.kind in ("uniform", "log_uniform")

    @property
    def values(self) -> tuple[Any, ...]:
        """The values, or low and high of a random axis."""
        return tuple(getattr(self, self.kind))

    @model_validator(mode="after")
    def _one(self) -> "AxisTable":
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
        return self


class LawTable(Table):
    """An item of ``laws``: a law under which all runs are done, by its name alone or with what differs."""

    law: Text = Field(description="as controller.law")
    name: Text | None = Field(default=None, description="what it is called; by default its law with its gains")
    gains: Mapping[Text, Option] = Field(default_factory=dict, description="over those that the scenario has for it")
    command: Literal["speed", "torque"] | None = Field(default=None, description="by default the scenario's")

    @property
    def keys_set(self) -> frozenset[str]:
        """The keys of the scenario that it gives beside the law."""
        command = () if self.command is None else ("controller.command",)
        return frozenset((*command, *(f"controller.gains.{name}" for name in self.gains)))


class AlternativeTable(Table):
    """``[[fault]]``: rows of faults that a run has beside the scenario's own. Alternatives are done each with each."""

    name: Text = Field(description="what it is called")
    rows: tuple[Mapping[str, Any], ...] = Field(default=(), description="as [[fault]] of a scenario; none for no fault")


class KeepTable(Table):
    """``keep = { worst = N, by = "..." }``: recordings of the N runs in which a figure is greatest."""

    worst: int = Field(ge=1, le=10_000, description="how many")
    by: Text = Field(default="steady_rms_m", description="a figure of a run that is a number")


class PlanTables(Table):
    """A campaign's file."""

    scenario: Text = Field(description="a shipped name, or a path relative to this file")
    seeds: tuple[int, ...] = Field(default=(), description="loop.seed: how many from 1 on, or which")
    laws: tuple[LawTable, ...] = Field(default=(), description="by default the scenario's own")
    axes: Mapping[Text, AxisTable] = Field(default_factory=dict, description="by the scenario's dotted keys")
    samples: int | None = Field(default=None, ge=1, le=_MOST_RUNS, description="draws of the random axes")
    latin: bool = Field(default=False, description="draws fill a Latin hypercube")
    seed: int = Field(default=1, ge=0, le=2**32 - 1, description="of the draws")
    fault: tuple[AlternativeTable, ...] = ()
    expect: tuple[Mapping[str, Any], ...] = Field(default=(), description="beside the scenario's own")
    set: Mapping[Text, Any] = Field(default_factory=dict, description="keys of the scenario that all runs share")
    keep: Literal["none", "failures", "all"] | KeepTable = Field(default="failures", description="recordings")

    @field_validator("laws", mode="before")
    @classmethod
    def _named(cls, laws: object) -> object:
        return tuple({"law": law} if isinstance(law, str) else law for law in laws) if isinstance(laws, tuple) else laws

    @field_validator("seeds", mode="before")
    @classmethod
    def _numbered(cls, seeds: object) -> object:
        if isinstance(seeds, int) and not isinstance(seeds, bool):
            if not 1 <= seeds <= _MOST_RUNS:
                raise ValueError(f"expected how many, from 1 to {_MOST_RUNS}, or an array of seeds")
            return tuple(range(1, seeds + 1))
        return seeds

    @field_validator("seeds")
    @classmethod
    def _once(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice; name each once")
        if not all(0 <= seed < 2**32 for seed in seeds):
            raise ValueError("expected seeds from 0 to 4294967295")
        return seeds

    @model_validator(mode="after")
    def _consistent(self) -> "PlanTables":
        random = [key for key, axis in self.axes.items() if axis.is_random]
        if random and self.samples is None:
            raise ValueError(f"axes {random[0]} is random; say with samples = N how often to draw")
        if not random and (self.samples is not None or self.latin):
            raise ValueError("samples and latin belong to random axes, and there is none; remove them")
        lengths = {key: len(axis.values) for key, axis in self.axes.items() if axis.kind == "list"}
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{key} has {count}" for key, count in lengths.items())
            raise ValueError(f"lists go together in step and need one length, but {told}; give grid for each with each")
        for what, names in (("law", [law.name for law in self.laws]), ("fault", [row.name for row in self.fault])):
            named = [name for name in names if name is not None]
            if len(set(named)) < len(named):
                raise ValueError(f"two of {what} have one name; name each otherwise")
        taken = {"controller.law": "laws", "loop.seed": "seeds", "fault": "[[fault]]", "expect": "[[expect]]"}
        for key in self.axes:
            if key in taken:
                raise ValueError(f"axes {key}: give {taken[key]} instead")
            if key in self.set:
                raise ValueError(f"{key} is in [set] and in [axes]; give it once")
            if any(key in law.keys_set for law in self.laws):
                raise ValueError(f"{key} is in laws and in [axes], which would be what counts; give it once")
        if self.seeds and "loop.seed" in self.set:
            raise ValueError("loop.seed is in [set], and there are seeds, which would be what counts; give one of them")
        return self
