"""Laws compared: each under the same scenario and seed, through the wire, at its best and at its worst."""

import itertools
import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.batch.comparison.conditions import (
    CONTACTS,
    DRIVES,
    ESTIMATORS,
    NOMINAL,
    Condition,
    Variation,
    conditions,
    variations,
)
from hil.batch.comparison.entries import check_is_scenario, entries
from hil.batch.comparison.result import Comparison, Row, Run
from hil.batch.comparison.runs import LINK, MODE, WORK, Job, Outcome
from hil.batch.old_pool import counted, perform_all
from hil.core.errors import BadInputError, nearest
from hil.laws.registry import SHIPPED
from hil.runtime.robots import plant_start
from hil.scenario import SHIPPED_FMUS, Scenario, load, set_texts
from plant_fmu.shipped import variable_names

__all__ = ["Asked", "Comparison", "compare"]

_START = "plant.start."


class Asked(NamedTuple):
    """What a user asks to be compared; without laws, all that are shipped.

    ``estimators`` and ``contacts`` are the scenario's own when empty. ``quick`` leaves out the robots other than
    nominal, ``curves`` asks for what pictures need.
    """

    laws: Sequence[str]
    scenario: str
    sets: Sequence[str]
    seed: int | None
    torques_n_m: Sequence[float]
    drives: Sequence[str]
    estimators: Sequence[str] = ()
    contacts: Sequence[str] = ()
    quick: bool = False
    curves: bool = False


def compare(
    asked: Asked,
    *,
    jobs: int | None = None,
    limit_s: float = 120.0,
    tell: Callable[[int, int, Outcome], None] | None = None,
) -> Comparison:
    """Run what is asked for and return what came of it.

    ``jobs`` is the number of processes, by default one a processor; the figures do not depend on it. A run that takes
    more than ``limit_s`` of wall-clock time is ended, and is a failed one as is one whose process ends. ``tell`` gets
    how many runs are done, of how many, and the newest outcome.

    Raises BadInputError, before anything is run, for a law, a gain, a scenario or a condition that does not exist.
    """
    check_is_scenario(asked.scenario)
    _check_choices(asked)
    tables = conditions(asked.torques_n_m, asked.drives, asked.estimators, asked.contacts)
    _check_sets(asked.sets, tables)
    base = load(asked.scenario, set=asked.sets, mode=MODE, link=LINK, seed=asked.seed)
    robots = variations(quick=asked.quick)
    sets = {table: _sets(asked, base, table, robots) for table in tables}
    named = entries(asked.laws or list(SHIPPED), asked.scenario, asked.sets)
    rows = list(itertools.product(tables, named))
    work = [
        Job(
            asked.scenario,
            texts,
            asked.seed,
            entry.law,
            entry.gains[table.mode],
            curves=asked.curves and robot == NOMINAL,
        )
        for table, entry in rows
        for robot, texts in zip(robots, sets[table], strict=True)
    ]
    outcomes = iter(perform_all(WORK, work, jobs or os.cpu_count() or 1, limit_s, counted(tell, len(work))))
    return Comparison(
        base.name,
        base.loop.seed,
        base.loop.duration_s,
        [Row(entry, table, [Run(robot, next(outcomes)) for robot in robots]) for table, entry in rows],
    )


def _sets(asked: Asked, base: Scenario, table: Condition, robots: Sequence[Variation]) -> list[list[str]]:
    """Return what is set for each robot under a condition. Raises BadInputError for what the scenario cannot have."""
    known = _variables(base)
    mass_kg = float(plant_start(base, {"mass_kg"})["mass_kg"])
    sets = []
    for robot in robots:
        changes = {**table.sets(), **robot.sets(mass_kg)}
        for key in changes:
            name = key.removeprefix(_START)
            if name != key and name not in known:
                raise BadInputError(
                    f"scenario {asked.scenario}: plant.fmu = {base.plant.fmu!r} has no {name}, which a comparison "
                    f"under {table.words} needs; use the plant 'mecanum'"
                )
        sets.append([*asked.sets, *set_texts(changes)])
        load(asked.scenario, set=sets[-1], mode=MODE, link=LINK, seed=asked.seed)
    return sets


def _variables(base: Scenario) -> frozenset[str]:
    """Return what can be set of the scenario's plant."""
    if base.plant.fmu not in SHIPPED_FMUS:
        raise BadInputError(
            f"scenario {base.name}: plant.fmu = {base.plant.fmu!r} is no plant of which is known how to change mass, "
            "friction and drive; compare laws on the plant 'mecanum'"
        )
    return frozenset(variable_names(base.plant.fmu))


def _check_choices(asked: Asked) -> None:
    for option, given, known in (
        ("--drive", asked.drives, DRIVES),
        ("--estimator", asked.estimators, ESTIMATORS),
        ("--contact", asked.contacts, CONTACTS),
    ):
        for name in given:
            if name not in known:
                raise BadInputError(f"{option} {name}: unknown{nearest(name, known)}")
    for torque_n_m in asked.torques_n_m:
        if not torque_n_m > 0.0:
            raise BadInputError(f"--torque {torque_n_m:g}: expected the limit of a wheel in N·m, more than 0")
    for option, values in (
        ("--torque", asked.torques_n_m),
        ("--drive", asked.drives),
        ("--estimator", asked.estimators),
        ("--contact", asked.contacts),
    ):
        if len(set(values)) != len(values):
            raise BadInputError(f"{option}: one is named twice in {', '.join(map(str, values))}; name each once")


def _check_sets(sets: Sequence[str], tables: Sequence[Condition]) -> None:
    """Refuse to change what the comparison itself sets: the tables would not be what they say."""
    taken = {"loop.mode", "link.url", *(key for table in tables for key in table.sets())}
    for text in sets:
        key = text.partition("=")[0].strip()
        if key in taken:
            raise BadInputError(
                f"--set {text}: a comparison sets {key} itself; it runs in lockstep over memory:, under --torque, "
                "--drive, --estimator and --contact"
            )
        if key.startswith("controller."):
            raise BadInputError(f"--set {text}: laws and gains are named together, as in: hil compare dsc,k1_1_s=8 ...")
