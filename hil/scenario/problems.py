"""Sentences for what is wrong with a scenario: where it was given, the key, the value, what was expected."""

from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from hil.core.errors import near, nearest
from hil.faults.kinds import find, names
from hil.scenario.fields import Table
from hil.scenario.layers import Given, Node, Path, Tree, dotted, leaves
from hil.scenario.tables import Tables
from hil.scenario.toml_text import format_value

_MAP = ("plant", "map")
_KEY = "[key]"  # how pydantic points at the key itself of a free-form table


def describe(error: ValidationError, tree: Tree, scenario: str) -> list[str]:
    """Return one sentence for each problem; ``scenario`` stands for the place of what was not given at all.

    While a key is unknown nothing is said of missing ones: they are most likely the same mistake.
    """
    found = error.errors(include_url=False)
    misspelt = any(problem["type"] == "extra_forbidden" for problem in found)
    sentences = []
    for problem in found:
        path = tuple(str(part) for part in problem["loc"])
        if problem["type"] == "missing":
            if not misspelt:
                is_of_row = len(path) > 2 and path[1].isdigit()  # which is somewhere, and a table is in many files
                where = place(tree, path[:2], scenario) if is_of_row else scenario
                sentences.append(f"{where}: {_missing(path, tree)}")
        elif path[-1] == _KEY:
            sentences.append(f"{place(tree, path[:-1], scenario)}: {dotted(path[:-1])}: {problem['ctx']['error']}")
        elif problem["type"] == "extra_forbidden":
            sentences.append(f"{place(tree, path, scenario)}: unknown key {dotted(path)}{did_you_mean(path)}")
        else:
            expected = _expected(problem, path)
            sentences.append(complaint(tree, path, problem["input"], expected, scenario))
    return sentences


def complaint(tree: Tree, path: Path, value: object, expected: str, scenario: str) -> str:
    """Return ``place: key = value; expected ...``, the value only if it is a single one."""
    where = place(tree, path, scenario)
    if isinstance(value, BaseModel | Mapping):
        return f"{where}: {dotted(path)}: {expected}"
    return f"{where}: {dotted(path)} = {format_value(value)}; {expected}"


def place(tree: Tree, path: Path, scenario: str) -> str:
    """Return where the value at a path, or the first one below it, was given, and whether another was on the line."""
    node: Node | None = tree
    for key in path:
        if isinstance(node, Given):
            break
        if isinstance(node, dict):
            node = node.get(key)
        elif isinstance(node, list) and key.isdigit() and int(key) < len(node):
            node = node[int(key)]
        else:
            node = None
    places = [given.where for _, given in leaves(node)] if node is not None else []
    if not places:
        return scenario
    where = places[0] if places[0].startswith("--") else f"scenario {places[0]}"
    return f"{where} and --set" if "--set" in places and where != "--set" else where


def did_you_mean(path: Path) -> str:
    """Return the hint for an unknown key: its name in another table, or the nearest one here or anywhere."""
    table, name = tuple(part for part in _without_signal(path)[:-1] if not part.isdigit()), path[-1]
    keys = _keys()
    tables = {other: names for other, names in keys.items() if other not in ((), _MAP)}
    elsewhere = {key: dotted((*other, key)) for other, names in tables.items() for key in names}
    here = keys.get(table, ())
    if name in elsewhere:
        return f"; did you mean {elsewhere[name]!r}?"
    if not near(name, here) and (found := near(name, elsewhere)):
        return f"; did you mean {' or '.join(repr(elsewhere[one]) for one in found)}?"
    return nearest(name, here)


def _keys() -> dict[Path, tuple[str, ...]]:
    """Return the known keys of every table by its path; the root's keys are the tables."""

    def below(model: type[BaseModel], path: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
        yield path, tuple(model.model_fields)
        for name, field in model.model_fields.items():
            inner = _table(field)
            if inner is not None:
                yield from below(inner, (*path, name))

    return dict(below(Tables, ()))


def _table(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a table or of the rows of an array of tables."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if isinstance(kind, type) and issubclass(kind, Table):
            return kind
    return None


def _field(path: Path) -> FieldInfo | None:
    model: type[BaseModel] | None = Tables
    field: FieldInfo | None = None
    for part in _without_signal(path):
        if part.isdigit():
            continue
        if model is None:
            return None
        field = model.model_fields.get(part)
        model = _table(field) if field is not None else None
    return field


def _without_signal(path: Path) -> Path:
    """Return the path without the key of a row of ``[plant.map]``: every row has the same keys."""
    return (*_MAP, *path[3:]) if path[:2] == _MAP else path


def _missing(path: Path, tree: Tree) -> str:
    field = _field(path)
    if path[0] == "fault" and path[-1] in ("kind", "target"):
        return f"{dotted(path)} is missing; expected {_fault_choice(path, tree)}"
    if path[0] == "expect" and path[-1] == "signal":
        return f"{dotted(path)} is missing; expected the name of a signal; `hil list signals` prints them all"
    if field is not None and _table(field) is not None:
        return f'the table [{dotted(path)}] is missing; write it, or start with extends = "paper_circle"'
    return f"{dotted(path)} is missing; {_expected_of(field)}"


def _fault_choice(path: Path, tree: Tree) -> str:
    """Return what the kind of a fault can be, or the target of its kind."""
    rows = tree.get("fault")
    row = rows[int(path[1])] if isinstance(rows, list) else None
    kind = row.get("kind") if isinstance(row, dict) else None
    if path[-1] == "kind" or not isinstance(kind, Given):
        return f"a kind of fault, one of {', '.join(names())}"
    return f"what {kind.value} acts on: {find(str(kind.value), None).target_words.replace('`', '')}"


def _expected(problem: Any, path: Path) -> str:
    if problem["type"] == "value_error":
        return str(problem["ctx"]["error"])
    field, in_array = _field(path), path[-1].isdigit()
    if in_array and field is not None:
        item = get_args(field.annotation)[0]
        is_table = isinstance(item, type) and issubclass(item, Table)
        return "expected a table" if is_table else f"expected {_item(item)}"
    if problem["type"] == "finite_number":
        return _expected_of(field).replace("a number", "a finite number")
    return _expected_of(field)


def _expected_of(field: FieldInfo | None) -> str:
    """Return what a field takes, from its type and its bounds."""
    if field is None:  # an entry of a free-form table
        return "expected a finite number"
    kind, inner = field.annotation, _table(field)
    if inner is not None:
        many = get_origin(kind) is tuple
        return "expected an array of tables: write [[...]], with two brackets" if many else "expected a table"
    if get_origin(kind) is Literal:
        return f"expected {_either(get_args(kind))}"
    if get_origin(kind) is tuple:
        item = get_args(kind)[0]
        example = ', as in ["first", "second"]' if get_origin(item) is not Literal else ""
        return f"expected an array, each item {_item(item)}{example}"
    if kind is str:
        return "expected text in quotation marks"
    if kind is bool:
        return "expected true or false"
    if any(get_origin(one) is tuple for one in get_args(kind)):
        return "expected two numbers: [low, high]"
    if kind not in (int, float) and float not in get_args(kind):
        return "expected a table"
    return f"expected a {'whole number' if kind is int else 'number'}{_range(field)}"


def _item(kind: Any) -> str:
    """Return what an item of an array is."""
    if get_origin(kind) is Literal:
        return _either(get_args(kind))
    return "a whole number" if kind is int else "text in quotation marks"


def _either(choice: tuple[object, ...]) -> str:
    *first, last = map(format_value, choice)
    return f"{', '.join(first)} or {last}" if first else last


def _range(field: FieldInfo) -> str:
    bounds = {
        name: f"{value:.12g}"
        for name in ("gt", "ge", "le")
        for value in (getattr(item, name, None) for item in field.metadata)
        if value is not None
    }
    match bounds:
        case {"gt": low, "le": high}:
            return f" greater than {low} and at most {high}"
        case {"gt": low}:
            return f" greater than {low}"
        case {"ge": low, "le": high}:
            return f" from {low} to {high}"
        case {"ge": low}:
            return f" of at least {low}"
    return ""
