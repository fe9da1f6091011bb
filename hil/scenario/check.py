"""Checking a stacked scenario: each table by itself, then the tables against each other."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from pydantic import ValidationError

from hil.core.errors import BadInputError, nearest
from hil.core.signals import INDEX
from hil.references import make_reference
from hil.scenario import layers, motors
from hil.scenario.allow import REALTIME_ALLOW
from hil.scenario.laws import make_laws
from hil.scenario.layers import Given, Tree
from hil.scenario.problems import complaint, describe, place
from hil.scenario.tables import RATES_HZ, Tables

WATCHDOG_PERIODS = 5
_WATCHDOG_RULE = f"default: {WATCHDOG_PERIODS} command periods, within 0.02 to 0.1 s"
_ALLOW_RULE = "default in real time"


def derived(tree: Tree) -> Tree:
    """Return the defaults that follow from other values: the watchdog from the command rate, [allow] from the mode."""
    loop, found = tree.get("loop"), Tree()
    rate, mode = (loop.get(key) if isinstance(loop, dict) else None for key in ("rate_hz", "mode"))
    if isinstance(rate, Given) and rate.value in RATES_HZ and isinstance(tree.get("firmware"), dict):
        watchdog_s = min(max(WATCHDOG_PERIODS * (1000 // int(rate.value)) / 1000.0, 0.02), 0.1)
        found["firmware"] = {"watchdog_s": Given(watchdog_s, _WATCHDOG_RULE)}
    if isinstance(mode, Given) and mode.value == "realtime" and isinstance(tree.get("allow", {}), dict):
        found["allow"] = {name: Given(limit, _ALLOW_RULE) for name, limit in REALTIME_ALLOW.items()}
    return found


def check(tree: Tree, scenario: str, directory: Path) -> Tables:
    """Return the validated tables; ``scenario`` begins the messages about what was not given anywhere.

    ``directory`` is where relative paths start from.

    Raises BadInputError with one line for each problem.
    """
    try:
        tables = Tables.model_validate(layers.plain(tree))
    except ValidationError as error:
        raise BadInputError("\n".join(describe(error, tree, scenario))) from None
    contradictions = [
        complaint(tree, tuple(key.split(".")), value, expected, scenario)
        for key, value, expected in _contradictions(tables)
    ]
    if contradictions:
        raise BadInputError("\n".join(contradictions))
    unknown = [
        complaint(tree, path, name, f"expected the name of a signal{hint}", scenario)
        for path, name, hint in _unknown_signals(tables, directory)
    ]
    if unknown:
        raise BadInputError("\n".join(unknown))
    try:
        make_reference(tables.reference.kind, tables.reference.options, directory)
    except BadInputError as error:
        raise BadInputError(f"{_place_of_reference(tree, str(error), scenario)}: {error}") from error
    return tables


def _unknown_signals(tables: Tables, directory: Path) -> list[tuple[tuple[str, ...], str, str]]:
    """Return path, name and hint of each row of a signal that the run does not have."""
    named = [(("expect", str(index), "signal"), row.signal) for index, row in enumerate(tables.expect)]
    named += [
        (("fault", str(index), "target"), table.target)
        for index, table in enumerate(tables.fault)
        if table.row.acts_on == "signal"
    ]
    if all(name in INDEX for _, name in named):
        return []
    # Only now, because it runs the code of laws that are not ours.
    known = make_laws(tables, directory).signals
    return [(path, name, _nearest_signal(name, known)) for path, name in named if name not in known]


def _nearest_signal(name: str, known: Sequence[str]) -> str:
    """Return the nearest signal; the whole vocabulary is too long for a sentence."""
    hint = nearest(name, known)
    return hint if "did you mean" in hint else "; `hil list signals` prints them all"


def _place_of_reference(tree: Tree, message: str, scenario: str) -> str:
    """Return where the key was given that a complaint about the reference names first."""
    paths = [path for path, _ in layers.leaves(tree["reference"], ("reference",))]
    named = [(m.start(), path) for path in paths for m in re.finditer(rf"\b{re.escape(path[-1])}\b", message)]
    return place(tree, min(named)[1] if named else ("reference",), scenario)


def _contradictions(tables: Tables) -> Iterator[tuple[str, object, str]]:
    """Yield key, value and expectation of what cannot work together."""
    estimator, firmware, loop, robot = tables.estimator, tables.firmware, tables.loop, tables.robot
    shadows = tables.controller.shadow_names
    for name in sorted({name for name in shadows if shadows.count(name) > 1}):
        yield (
            "controller.shadow",
            tables.controller.shadow,
            f"expected one law of the name {name!r}, which its signals go by; leave the others out",
        )
    for name, gains in tables.controller.shadow_gains.items():
        if name not in shadows:
            yield f"controller.shadow_gains.{name}", gains, f"there is no such shadow{nearest(name, shadows)}"
    period_s = 1.0 / loop.rate_hz
    if firmware.watchdog_s <= period_s:
        yield (
            "firmware.watchdog_s",
            firmware.watchdog_s,
            f"expected more than the command period of {period_s:g} s, or every command would come too late",
        )
    if firmware.overspeed_rad_s <= robot.speed_limit_rad_s:
        yield (
            "firmware.overspeed_rad_s",
            firmware.overspeed_rad_s,
            f"expected more than robot.speed_limit_rad_s = {robot.speed_limit_rad_s:g}, "
            "or the robot would trip at a speed that it may be told",
        )
    if tables.device.is_makers:
        yield from motors.contradictions(tables)
    if estimator.source == "fused" and estimator.fix != "simulated" and loop.mode == "lockstep":
        yield (
            "estimator.fix",
            estimator.fix,
            'expected "simulated" in lockstep, whose time no other program knows; or give loop.mode = "realtime"',
        )
