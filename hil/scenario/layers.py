"""Layers of a scenario: trees of values, each with the place where it was given, and how layers are stacked.

Tables merge key by key, the later layer wins. Everything else, arrays of tables too, is replaced as a whole. A layer
that names another ``controller.law``, ``reference.kind`` or ``device.driver`` drops the options of the layers below,
because they belong to the other. A change to or from an FMU that is not shipped drops ``plant.start`` and
``plant.map`` in the same way. A change between shipped FMUs keeps the start values that the new one knows. A row of
``plant.map`` that names a variable replaces the row of the layer below.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from hil.core.errors import BadInputError
from hil.core.options import options_of
from hil.robot.driver_registry import OUR_DRIVER
from hil.scenario.plant import PLANT_SIGNALS, SHIPPED_FMUS, MapRow, PlantTable
from plant_fmu.shipped import variable_names

Path = tuple[str, ...]
"""Keys from the root to a value; a row of an array of tables is its number from 1, as text."""


class Given(NamedTuple):
    """A value of a scenario, and the place where it was given."""

    value: object
    where: str


Node = dict[str, "Node"] | list["Node"] | Given
Tree = dict[str, Node]

_NO_LINES: Mapping[Path, int] = MappingProxyType({})
# table, the key that chooses, and the keys that do not belong to the choice
_CHOICES = (
    ("controller", "law", ("command",)),
    ("reference", "kind", ()),
    ("plant", "fmu", ("timeout_s", "memory_limit_mb", "wiring")),
    ("device", "driver", ("wheels", "reversed", "imu")),
)
_DEFAULTS = {"fmu": Given(PlantTable().fmu, "default"), "driver": Given(OUR_DRIVER, "default")}


def dotted(path: Path) -> str:
    """Return the path as in messages, ``--set`` and `hil show`."""
    return ".".join(path)


def make_layer(raw: Mapping[str, object], source: str, lines: Mapping[Path, int] = _NO_LINES) -> Tree:
    """Return the layer for the values of a ``source``, a file or an option; ``lines`` has the line of each key."""
    tree = {str(key): _annotate(value, source, lines, (str(key),)) for key, value in raw.items()}
    _flatten_plant(tree)
    return tree


def stack(below: Tree, above: Tree) -> Tree:
    """Return both layers as one, ``above`` winning. Neither is changed."""
    kept = dict(below)
    for table, key, common in _CHOICES:
        old, new = below.get(table), above.get(table)
        if isinstance(old, dict) and isinstance(new, dict):
            if _differs(old.get(key, _DEFAULTS.get(key)), new.get(key)):
                kept[table] = {name: node for name, node in old.items() if name in common}
            elif table == "plant":
                plant = dict(old)
                if "map" in old:
                    plant["map"] = _kept_rows(old["map"], new.get("map", {}))
                if "start" in old:
                    plant["start"] = _known_start(old["start"], new.get("fmu"))
                kept[table] = plant
    return merge(kept, above)


def merge(below: Tree, above: Tree) -> Tree:
    """Return ``below`` with the values of ``above``: tables merge, everything else is replaced."""
    merged = dict(below)
    for key, node in above.items():
        old = merged.get(key)
        merged[key] = merge(old, node) if isinstance(old, dict) and isinstance(node, dict) else node
    return merged


def assign(tree: Tree, key: str, value: object, where: str) -> Tree:
    """Return the tree with one dotted key set, such as ``robot.mass_kg`` or ``expect.1.below``.

    Raises BadInputError when the key is malformed or names a row that is not there.
    """
    path = tuple(key.replace('"', "").split("."))  # a message quotes a signal as TOML does, which nests it no other way
    if not all(path):
        raise BadInputError(f"{where} {key!r}: expected a dotted key such as robot.mass_kg")
    rows = tree.get(path[0])
    numbered = len(path) > 1 and path[1].isdecimal()
    if len(path) == 1 or not (numbered or isinstance(rows, list)):
        return stack(tree, make_layer(_nested(path, value), where))
    if not isinstance(rows, list):
        rows = []
    if not numbered or not 1 <= int(path[1]) <= len(rows):
        if not rows:
            raise BadInputError(f"{where} {key}: there is no [[{path[0]}]] to change; add one to a file")
        raise BadInputError(f"{where} {key}: expected {path[0]}.N.KEY with the row N from 1 to {len(rows)}")
    index = int(path[1]) - 1
    row = rows[index]
    above = make_layer(_nested(path[2:], value), where) if len(path) > 2 else None
    changed: Node = Given(value, where)
    if above is not None:
        changed = merge(row, above) if isinstance(row, dict) else above
    return {**tree, path[0]: [*rows[:index], changed, *rows[index + 1 :]]}


def leaves(node: Node, path: Path = ()) -> Iterator[tuple[Path, Given]]:
    """Yield every value below a node with its path, in order."""
    if isinstance(node, Given):
        yield path, node
        return
    children = node.items() if isinstance(node, dict) else ((str(i), row) for i, row in enumerate(node, start=1))
    for key, child in children:
        yield from leaves(child, (*path, key))


def plain(node: Node) -> object:
    """Return the values alone: tables as dictionaries, arrays as tuples."""
    if isinstance(node, Given):
        return _frozen(node.value)
    if isinstance(node, dict):
        return {key: plain(child) for key, child in node.items()}
    return tuple(plain(child) for child in node)


def place_in(source: str, lines: Mapping[Path, int], path: Path) -> str:
    """Return ``source:line`` of the value at a path; a value in an inline table has its table's line."""
    for end in range(len(path), 0, -1):
        if path[:end] in lines:
            return f"{source}:{lines[path[:end]]}"
    return source


def _annotate(value: object, source: str, lines: Mapping[Path, int], path: Path) -> Node:
    if isinstance(value, Mapping):
        return {str(key): _annotate(child, source, lines, (*path, str(key))) for key, child in value.items()}
    if isinstance(value, list | tuple) and value and all(isinstance(row, Mapping) for row in value):
        return [_annotate(row, source, lines, (*path, str(i))) for i, row in enumerate(value, start=1)]
    return Given(value, place_in(source, lines, path))


def _flatten_plant(tree: Tree) -> None:
    """Join keys under ``[plant.start]`` and ``[plant.map]`` into dotted names, as in ``wheel.fl.angle_rad = 1``."""
    plant = tree.get("plant")
    if not isinstance(plant, dict):
        return
    if isinstance(start := plant.get("start"), dict):
        plant["start"] = {dotted(path): given for path, given in leaves(start)}
    if isinstance(rows := plant.get("map"), dict):
        flat: Tree = {}
        for path, node in _entries(rows):
            signal, key = _signal_and_key(path)
            row = flat.setdefault(signal, {})
            if isinstance(row, dict) and node != {}:
                row[key] = node
        plant["map"] = flat


def _entries(table: Tree, path: Path = ()) -> Iterator[tuple[Path, Node]]:
    """Yield path and node of each value, and of each empty table, below a table."""
    for key, node in table.items():
        if isinstance(node, dict) and node:
            yield from _entries(node, (*path, key))
        else:
            yield (*path, key), node


def _signal_and_key(path: Path) -> tuple[str, str]:
    """Split a path below ``[plant.map]`` into signal and key; a row that is only a text is the variable's name."""
    ends = [end for end in range(1, len(path)) if dotted(path[:end]) in PLANT_SIGNALS]
    if not ends and path[-1] in options_of(MapRow):
        ends = [len(path) - 1]
    return (dotted(path[: ends[0]]), dotted(path[ends[0] :])) if ends else (dotted(path), "name")


def _kept_rows(below: Node, above: Node) -> Node:
    """Return the rows of ``[plant.map]`` without those whose variable the layer above names."""
    if not (isinstance(below, dict) and isinstance(above, dict)):
        return below
    named = {signal for signal, row in above.items() if isinstance(row, dict) and "name" in row}
    return {signal: row for signal, row in below.items() if signal not in named}


def _known_start(below: Node, fmu: Node | None) -> Node:
    """Return the start values that the shipped FMU of the layer above knows; all, if it names none."""
    if not (isinstance(below, dict) and isinstance(fmu, Given) and fmu.value in SHIPPED_FMUS):
        return below
    known = variable_names(str(fmu.value))
    return {name: given for name, given in below.items() if name in known}


def _differs(old: Node | None, new: Node | None) -> bool:
    if not (isinstance(old, Given) and isinstance(new, Given)):
        return False
    return old.value != new.value and not all(given.value in SHIPPED_FMUS for given in (old, new))


def _nested(path: Path, value: object) -> dict[str, object]:
    for key in reversed(path[1:]):
        value = {key: value}
    return {path[0]: value}


def _frozen(value: object) -> object:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value
