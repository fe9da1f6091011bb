"""Checks a stacked scenario: each table alone, then the tables against each other. Writes the messages."""

import re
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path as FilePath
from typing import Any, cast

from hil.core.errors import SEE_SIGNALS, BadInputError, near, nearest
from hil.core.model import RobotModel
from hil.core.options import ABSENT, OptionsError, Problem, Range, build, in_another_unit, options_of, plausible
from hil.core.signals import INDEX, unit_of
from hil.core.wheel_speed import slower
from hil.references import make_reference
from hil.scenario import layers
from hil.scenario.laws import make_laws
from hil.scenario.layers import Given, Node, Path, Tree, leaves
from hil.scenario.plant import SHIPPED_FMUS
from hil.scenario.scenario import values
from hil.scenario.tables import RATES_HZ, FirmwareTable, Tables
from hil.scenario.trial import REALTIME_ALLOW, span_s

WATCHDOG_PERIODS = 5
_WATCHDOG_RULE = f"default: {WATCHDOG_PERIODS} command periods, within 0.02 to 0.1 s"
_FOLLOWING = {"tracking_bandwidth_rad_s": 1, "speed_kp_n_m_s_rad": 1, "speed_ki_n_m_rad": 2}
"""Powers of ``slower`` by which keys of [firmware] follow the encoder."""
_ALLOW_RULE = "default in real time"
_SHADOWS = (("controller", "shadow"), ("controller", "shadow_gains"))
_SHADOWS_GONE = "; `hil replay RUN --law LAW` computes another law over a recorded run"


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


def following(tree: Tree, shipped: Container[str]) -> Tree:
    """Return filter and gains of [firmware] as a coarse encoder needs them, where no user gave them.

    Those of a ``shipped`` scenario, by its file, are for the encoder of that file.
    """
    firmware = tree.get("firmware")
    counts = firmware.get("counts_per_revolution") if isinstance(firmware, dict) else None
    if not (isinstance(firmware, dict) and isinstance(counts, Given) and isinstance(counts.value, int)):
        return {}
    if counts.value < 1:
        return {}
    factor, file, found = slower(counts.value), _file_of(counts), Tree()
    for key, power in _FOLLOWING.items() if factor < 1.0 else ():
        given = firmware.get(key, Given(options_of(FirmwareTable)[key].default, "default"))
        if not (isinstance(given, Given) and isinstance(given.value, float | int)):
            continue  # refused by ``check``
        if given.where == "default" or (_file_of(given) in shipped and _file_of(given) != file):
            value = float(f"{given.value * factor**power:.4g}")
            found[key] = Given(value, f"{given.where}, for {counts.value} counts a turn")
    return {"firmware": found}


def _file_of(given: Given) -> str:
    return given.where.rpartition(":")[0]


def check(tree: Tree, scenario: str, directory: FilePath) -> Tables:
    """Return the validated tables; ``scenario`` begins the messages about keys that were not given anywhere.

    ``directory`` is the folder from which relative paths start.

    Raises BadInputError with one line for each problem.
    """
    try:
        tables = build(Tables, cast("Mapping[str, object]", layers.plain(tree)))
        for found in (_contradictions(tables), _unknown_signals(tables, directory)):
            if wrong := list(found):
                given = dict(values(tables))
                raise OptionsError([Problem(tuple(k.split(".")), "value", w, given.get(k, ABSENT)) for k, w in wrong])
        make_reference(tables.reference.kind, tables.reference.options, directory)
    except OptionsError as error:
        raise BadInputError("\n".join(describe(error.problems, tree, scenario))) from None
    except BadInputError as error:  # about a reference's file: it begins with the key
        named = re.match(r"reference(\.\w+)?", str(error))
        path = tuple(named[0].split(".")) if named is not None else ("reference",)
        raise BadInputError(f"{place(tree, path, scenario)}: {error}") from error
    return tables


def describe(problems: Sequence[Problem], tree: Tree, scenario: str) -> list[str]:
    """Return one sentence for each problem, with its place: ``scenario`` for a key that was not given."""
    sentences = []
    for problem in problems:
        path = problem.path
        if problem.kind == "missing":
            # A table may be given in many files, but a row of an array is given in one place.
            where = place(tree, path[:2], scenario) if len(path) > 2 and path[1].isdigit() else scenario
            if len(path) == 1:
                table = f"the table [{path[0]}]"
                sentences.append(f'{where}: {table} is missing; write it, or start with extends = "paper_circle"')
                continue
        else:
            where = place(tree, path, scenario)
            is_ours = len(path) < 3 and path[0] != "reference"
            if problem.kind == "unknown" and path in _SHADOWS:
                problem = problem._replace(words=_SHADOWS_GONE, meant=())
            elif problem.kind == "unknown" and not problem.meant and is_ours and (found := _elsewhere(path[-1])):
                problem = problem._replace(words=f"; did you mean {' or '.join(map(repr, found))}?")
        sentences.append(f"{where}: {problem.sentence}")
    return sentences


def place(tree: Tree, path: Path, scenario: str) -> str:
    """Return where the value at a path, or the first below it, was given, with "and --set" if both gave some."""
    node: Node | None = tree
    for key in path:
        if isinstance(node, Given):
            break
        if isinstance(node, dict):
            node = node.get(key)
        elif isinstance(node, list) and key.isdigit() and 1 <= int(key) <= len(node):
            node = node[int(key) - 1]
        else:
            node = None
    places = [given.where for _, given in leaves(node)] if node is not None else []
    if not places:
        return scenario
    where = places[0] if places[0].startswith("--") else f"scenario {places[0]}"
    return f"{where} and --set" if "--set" in places and where != "--set" else where


def _elsewhere(name: str) -> list[str]:
    """Return the keys of all tables that may be meant by an unknown one."""
    places: dict[str, list[str]] = {}
    for table, option in options_of(Tables).items():
        kind: Any = option.type
        for key in options_of(kind) if isinstance(kind, type) and is_dataclass(kind) else ():
            places.setdefault(key, []).append(f"{table}.{key}")
    return [place for key in near(name, places) for place in places[key]]


def _unknown_signals(tables: Tables, directory: FilePath) -> Iterator[tuple[str, str]]:
    """Yield key and message for each row that names a signal which the run does not have."""
    named = {
        f"expect.{i}.{key}": name
        for i, row in enumerate(tables.expect, start=1)
        for key, name in (("signal", row.signal), ("of", row.of))
        if name is not None
    }
    named |= {
        f"fault.{i}.target": table.target
        for i, table in enumerate(tables.fault, start=1)
        if table.row.acts_on == "signal"
    }
    for i, row in enumerate(tables.expect, start=1):
        if row.signal is not None and row.of is not None and unit_of(row.signal) != unit_of(row.of):
            unit = unit_of(row.signal) or "without a unit"
            yield (f"expect.{i}.of", f"expected a signal in the unit of {row.signal} ({unit}), to compare them")
    if INDEX.keys() >= set(named.values()):
        return
    known = make_laws(tables, directory).signals  # only when needed, because it runs the code of third-party laws
    for key, name in named.items():
        if name not in known:
            yield key, f"expected the name of a signal{nearest(name, known, SEE_SIGNALS)}"


def _implausible(tables: Tables) -> Iterator[tuple[str, str]]:
    """Yield key and message of numbers whose table has no range for them, and that are of another unit."""
    robot = options_of(RobotModel)
    for name, value in tables.plant.start.items() if tables.plant.fmu in SHIPPED_FMUS else ():
        within = robot[name].range if name in robot else plausible(name, turns=2)  # a start may be a turn ahead
        if isinstance(value, float) and "." not in name and (hint := in_another_unit(name, value, within)):
            yield f"plant.start.{name}", f"expected a number{within}{hint}"
    for i, row in enumerate(tables.expect, start=1):
        is_wrapped = row.signal == "error.heading_rad" or (row.of is not None and unit_of(str(row.signal)) == "rad")
        for key in ("below", "above", "within", "equals", "settles_to", "tolerance") if is_wrapped else ():
            given = getattr(row, key)
            for value in given if isinstance(given, tuple) else (given,) if given is not None else ():
                if hint := in_another_unit("difference_rad", value, Range(ge=-3.15, le=3.15)):  # rounded up
                    yield f"expect.{i}.{key}", f"a difference of headings is at most half a turn{hint}"


def _contradictions(tables: Tables) -> Iterator[tuple[str, str]]:
    estimator, firmware, loop, robot = tables.estimator, tables.firmware, tables.loop, tables.robot
    period_s = 1.0 / loop.rate_hz
    if firmware.watchdog_s <= period_s:
        words = f"expected more than the command period of {period_s:g} s, or every command would come too late"
        yield "firmware.watchdog_s", words
    if (limit := robot.speed_limit_rad_s) >= firmware.overspeed_rad_s:
        words = f"expected more than robot.speed_limit_rad_s = {limit:g}, or the robot would trip at a permitted speed"
        yield "firmware.overspeed_rad_s", words
    for i, row in enumerate(tables.expect, start=1):
        if row.after_fault is not None:
            try:
                from_s, to_s = span_s(row, tables.fault)
            except ValueError as error:
                yield f"expect.{i}.after_fault", str(error)
            else:
                if to_s < from_s:
                    yield (f"expect.{i}.to_s", f"expected a time after {from_s:g} s, from when it is judged")
    for name in sorted(name for name, count in Counter(row.name for row in tables.fault).items() if name and count > 1):
        at = next(i for i, row in reversed(list(enumerate(tables.fault, start=1))) if row.name == name)
        yield f"fault.{at}.name", "another fault has this name; expected one of its own"
    yield from _implausible(tables)
    if tables.device.is_makers:
        from hil.scenario import motor_checks

        yield from motor_checks.contradictions(tables)
    if estimator.source == "fused" and estimator.fix != "simulated" and loop.mode == "lockstep":
        words = 'expected "simulated" in lockstep: no other program follows its time; or give loop.mode = "realtime"'
        yield "estimator.fix", words
