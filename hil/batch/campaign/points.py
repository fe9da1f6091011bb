"""The runs of a campaign: all combinations of samples, seeds, grids, lists, faults and laws, always in this order.

Laws vary fastest and samples slowest, so that the runs of a campaign that was stopped are those of a smaller one.
"""

import itertools
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.batch.campaign.load import Plan
from hil.batch.campaign.tables import AlternativeTable, AxisTable, LawTable
from hil.core.errors import BadInputError
from hil.laws.shadows import short_name
from hil.scenario import Scenario, format_value

NO_FAULT = "none"
Sets = Mapping[str, object]


class Point(NamedTuple):
    """A run of a campaign.

    Attributes:
        axes: the value of each axis.
        law, fault: their names. seed: ``loop.seed``.
        sample: which draw of the random axes, 0 without any.
        sets: the keys of the scenario that make it, in the order in which ``load`` takes them.
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


def points(plan: Plan) -> Iterator[Point]:
    """Yield the runs. Raises BadInputError when the base scenario is not valid, or two laws have one name."""
    tables = plan.tables
    base = plan.scenario(tables.set)
    laws = [_law(law) for law in tables.laws] or [(short_name(base.controller.law), {})]
    called = [label for label, _ in laws]
    if twice := next((label for number, label in enumerate(called) if label in called[:number]), None):
        raise BadInputError(
            f"campaign {plan.place('laws')}: two laws are both called {twice!r}, and a report could not tell them "
            'apart; name one, as in { law = "./my_law.py:Law", name = "mine" }'
        )
    faults = [(row.name, _faults(row, base)) for row in tables.fault] or [(NO_FAULT, {})]
    expect = {"expect": [*map(_row, base.expect), *tables.expect]} if tables.expect else {}
    seeds = tables.seeds or (base.loop.seed,)
    grids, lists = _grids(tables.axes), _lists(tables.axes)
    draws = _draws(tables.axes, tables.samples or 1, tables.seed, latin=tables.latin)
    product = itertools.product(enumerate(draws), seeds, grids, lists, faults, laws)
    for (sample, drawn), seed, grid, listed, (fault, rows), (law, choice) in product:
        axes = {key: (grid | listed | drawn)[key] for key in tables.axes}
        sets = {**tables.set, **rows, **expect, **choice, **axes, "loop.seed": seed}
        yield Point(axes, law, fault, seed, sample, sets)


def _law(table: LawTable) -> tuple[str, dict[str, object]]:
    """Return a law's name, and the keys of the scenario that choose it."""
    options = [f"{name}={format_value(value)}" for name, value in table.gains.items()]
    options += [table.command] if table.command is not None else []
    label = table.name or ",".join((short_name(table.law), *options))
    command = {} if table.command is None else {"controller.command": table.command}
    gains = {f"controller.gains.{name}": value for name, value in table.gains.items()}
    return label, {"controller.law": table.law, **command, **gains}


def _faults(table: AlternativeTable, base: Scenario) -> dict[str, object]:
    return {"fault": [*map(_row, base.fault), *table.rows]} if table.rows else {}


def _row(row: Any) -> dict[str, object]:
    """Return a row of the scenario without the keys that were not given, so that it can be given again."""
    return {key: value for key, value in row if value is not None and value != math.inf}


def _grids(axes: Mapping[str, AxisTable]) -> list[dict[str, Any]]:
    grids = {key: axis.values for key, axis in axes.items() if axis.kind == "grid"}
    return [dict(zip(grids, values, strict=True)) for values in itertools.product(*grids.values())]


def _lists(axes: Mapping[str, AxisTable]) -> list[dict[str, Any]]:
    lists = {key: axis.values for key, axis in axes.items() if axis.kind == "list"}
    return [dict(zip(lists, values, strict=True)) for values in zip(*lists.values(), strict=True)] or [{}]


def _draws(axes: Mapping[str, AxisTable], samples: int, seed: int, *, latin: bool) -> list[dict[str, float]]:
    """Return the samples of the random axes.

    Each axis has its own generator, seeded by its name: another axis, or more samples without ``latin``, do not change
    the numbers drawn before. Only ``random()`` is used, because Python promises for nothing else that a seed gives the
    same numbers in every version.
    """
    columns = {
        key: [_within(axis, share) for share in _shares(random.Random(f"{seed} {key}"), samples, latin=latin)]
        for key, axis in axes.items()
        if axis.is_random
    }
    return [{key: column[sample] for key, column in columns.items()} for sample in range(samples)]


def _shares(generator: random.Random, samples: int, *, latin: bool) -> Sequence[float]:
    """Return numbers in [0, 1); for a Latin hypercube (McKay, Beckman, Conover 1979) one in each equal part of it."""
    drawn = [generator.random() for _ in range(samples)]
    if not latin:
        return drawn
    ranks = [generator.random() for _ in range(samples)]
    order = sorted(range(samples), key=ranks.__getitem__)
    return [(stratum + share) / samples for stratum, share in zip(order, drawn, strict=True)]


def _within(axis: AxisTable, share: float) -> float:
    low, high = axis.values
    if axis.kind == "log_uniform":
        return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
    return float(low + share * (high - low))
