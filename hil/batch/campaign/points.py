"""The runs of a campaign: all combinations of samples, seeds, grids, lists, faults and laws, always in this order.

Laws vary fastest and samples slowest, so that the runs of a campaign that was stopped are those of a smaller one. Each
run is checked before the first one begins, for everything for which it would be refused. Its scenario is kept, packed.
"""

import itertools
import json
import math
import random
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.batch.campaign.load import Plan
from hil.batch.campaign.tables import AxisTable, LawTable
from hil.batch.plan_file import row_of_table
from hil.core.errors import BadInputError
from hil.judge.expectations import check_figures
from hil.laws.shadows import short_name
from hil.runtime.parts import RunParts
from hil.runtime.robots import check_plant_start, needed_truth
from hil.scenario import Scenario, format_value, to_plain
from hil.scenario.trial import span_s
from hil.wire.url import parse_link

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
            f"campaign {plan.file.place('laws')}: two laws are both called {twice!r}, and a report could not tell them "
            'apart; name one, as in { law = "./my_law.py:Law", name = "mine" }'
        )
    more = {row.name: [*map(row_of_table, base.fault), *row.rows] if row.rows else None for row in tables.fault}
    faults = [(name, {} if rows is None else {"fault": rows}) for name, rows in (more or {NO_FAULT: None}).items()]
    expect = {"expect": [*map(row_of_table, base.expect), *tables.expect]} if tables.expect else {}
    seeds = tables.seeds or (base.loop.seed,)
    grids, lists = (_combined(tables.axes, kind) for kind in ("grid", "list"))
    draws = _draws(tables.axes, tables.samples or 1, tables.seed, latin=tables.latin)
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


def check_run(scenario: Scenario, made: set[tuple[str, ...]], *, allow_motion: bool) -> None:
    """Raise BadInputError for a run that would be refused.

    ``made`` collects the choices of laws and references that were tried before; each is tried once.
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
    gains = (controller.gains, controller.shadow_gains)
    choice = (controller.law, *controller.shadow, reference.kind, *map(repr, (*gains, reference.options)))
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


class PackedScenarios:
    """Packs scenarios as JSON, compressed by what they share with the first: 0.1 kB each in place of 8.

    Only the object that packed a scenario can unpack it.
    """

    def __init__(self) -> None:
        self._first = b""

    def pack(self, scenario: Scenario) -> bytes:
        """Return the bytes from which ``unpack`` makes the values of the scenario again."""
        text = json.dumps(to_plain(scenario)).encode("ascii")
        self._first = self._first or text
        compressor = zlib.compressobj(zdict=self._first)
        return compressor.compress(text) + compressor.flush()

    def unpack(self, packed: bytes) -> dict[str, Any]:
        """Return what ``to_plain`` returned for the scenario, with lists in place of tuples, for ``from_plain``."""
        values: dict[str, Any] = json.loads(zlib.decompressobj(zdict=self._first).decompress(packed))
        return values
