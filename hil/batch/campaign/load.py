"""Loading a campaign: its file read and checked, its scenario found, every refusal a sentence with file and line."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from hil.batch.campaign.tables import AXIS_KINDS, AlternativeTable, AxisTable, KeepTable, LawTable, PlanTables
from hil.core.errors import BadInputError, nearest
from hil.scenario import Scenario, Sources, format_value, read
from hil.scenario.fields import is_path
from hil.scenario.plain import frozen
from hil.scenario.toml_text import key_lines, parse

_TABLES = {
    (): PlanTables,
    ("axes", "*"): AxisTable,
    ("laws", "*"): LawTable,
    ("fault", "*"): AlternativeTable,
    ("keep",): KeepTable,
}
_SET = "--set"
_EXPECTED = {
    "tuple_type": "expected an array, in [ ]",
    "mapping_type": "expected a table",
    "dict_type": "expected a table",
    "model_type": "expected a table, in { }",
    "string_type": "expected text in quotation marks",
    "int_type": "expected a whole number",
    "float_type": "expected a number",
}
"""Kinds of TOML for kinds of Python, by pydantic's name of the problem."""


class Plan(NamedTuple):
    """A campaign that was loaded.

    Attributes:
        tables: what its file says.
        file: its path. lines: the line of each key there, by its path.
        sources: the files of its scenario.
    """

    tables: PlanTables
    file: Path
    lines: Mapping[tuple[str, ...], int]
    sources: Sources

    @property
    def folder(self) -> Path:
        """What relative paths in it start from."""
        return self.file.absolute().parent

    @property
    def name(self) -> str:
        """What it is called: its file's name without the suffix."""
        return self.file.stem

    def scenario(self, sets: Mapping[str, object]) -> Scenario:
        """Return the scenario with these values. Raises BadInputError, which names the campaign's file and line."""
        try:
            return self.sources.scenario(set=sets, folder=self.folder)
        except BadInputError as error:
            raise BadInputError("\n".join(self._placed(line, sets) for line in str(error).splitlines())) from None

    def place(self, *path: str) -> str:
        """Return ``file:line`` of a key, or of the nearest one above it that has a line."""
        return _place(self.file, self.lines, path)

    def _placed(self, sentence: str, sets: Mapping[str, object]) -> str:
        """Say of what the campaign gave where it stands there, not that it was ``--set``."""
        if not sentence.startswith(_SET):
            return f"campaign {self.file}: {sentence}"
        words = sentence.removeprefix(_SET).lstrip(": ")
        key = max(sets, key=lambda key: _named(key, words), default="")
        if not _named(key, words):
            return f"campaign {self.file}: {words}"
        table = ("axes",) if key in self.tables.axes else ("set",) if key in self.tables.set else ()
        return f"campaign {self.place(*table, key)}: {words}"


def _named(key: str, words: str) -> int:
    """Return how many parts of a dotted key, from the first on, a sentence names."""
    parts = key.split(".")
    for end in range(len(parts), 0, -1):
        if re.search(rf"(?<![\w.]){re.escape('.'.join(parts[:end]))}(?!\w)", words):
            return end
    return 0


def load_plan(file: Path) -> Plan:
    """Return the campaign of a file. Raises BadInputError, with one line for each problem."""
    try:
        text = file.read_text("utf-8-sig")
    except FileNotFoundError:
        raise BadInputError(f"campaign {file}: there is no such file; give the path of a .toml file") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise BadInputError(f"campaign {file}: it cannot be read ({why})") from error
    document = _flat(parse(text, f"campaign {file}"))
    lines = key_lines(text)
    try:
        tables = PlanTables.model_validate(frozen(document))
    except ValidationError as error:
        raise BadInputError("\n".join(_sentences(error, file, lines))) from None
    name = tables.scenario
    try:
        sources = read(file.absolute().parent / name if is_path(name) else name)
    except BadInputError as error:
        raise BadInputError(f"campaign {_place(file, lines, ('scenario',))}: {error}") from error
    return Plan(tables, file, lines, sources)


def _flat(document: dict[str, Any]) -> dict[str, Any]:
    """Make dotted keys of the tables below ``[set]`` and ``[axes]``, which TOML makes of dots without quotes."""

    def leaves(table: Mapping[str, Any], path: tuple[str, ...] = ()) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in table.items():
            here = (*path, key)
            is_axis = isinstance(value, Mapping) and any(kind in value for kind in AXIS_KINDS)
            if (
                isinstance(value, Mapping)
                and value
                and not is_axis
                and any(isinstance(v, Mapping) for v in value.values())
            ):
                found |= leaves(value, here)
            else:
                found[".".join(here)] = value
        return found

    def deepest(table: Mapping[str, Any], path: tuple[str, ...] = ()) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in table.items():
            found |= deepest(value, (*path, key)) if isinstance(value, Mapping) else {".".join((*path, key)): value}
        return found

    flat = dict(document)
    for name, walk in (("axes", leaves), ("set", deepest)):
        if isinstance(flat.get(name), Mapping):
            flat[name] = walk(flat[name])
    return flat


def _place(file: Path, lines: Mapping[tuple[str, ...], int], path: tuple[str, ...]) -> str:
    """Return ``file:line``; with dots or as tables, a key is one."""
    dotted = {".".join(known) + ".": line for known, line in lines.items()}
    for end in range(len(path), 0, -1):
        wanted = ".".join(path[:end]) + "."
        if found := [line for known, line in dotted.items() if known.startswith(wanted)]:
            return f"{file}:{min(found)}"
    return str(file)


def _sentences(error: ValidationError, file: Path, lines: Mapping[tuple[str, ...], int]) -> list[str]:
    """Return one sentence for each problem, an alternative of ``keep`` that does not fit only once."""
    said: dict[str, None] = {}
    for problem in error.errors(include_url=False):
        path = tuple(str(part) for part in problem["loc"])
        path = path[:1] if path[:1] == ("keep",) and problem["type"] != "extra_forbidden" else path
        path = tuple(part for part in path if part != "[key]")
        told = str(problem.get("ctx", {}).get("error", ""))
        about = path or next((one[:-1] for one in lines if one[0] == "axes" and ".".join(one[1:-1]) in told), ())
        where = f"campaign {_place(file, lines, about)}"
        key = ".".join(part for part in path if part not in ("KeepTable", "LawTable"))
        if path == ("keep",):
            said[f'{where}: keep; expected "none", "failures", "all" or {{ worst = 20, by = "steady_rms_m" }}'] = None
        elif problem["type"] == "missing":
            said[f"campaign {file}: {key} is missing; expected {_meaning(path)}"] = None
        elif problem["type"] == "extra_forbidden":
            known = _model(path[:-1]).model_fields
            said[f"{where}: unknown key {key}{nearest(path[-1], known)}"] = None
        elif problem["type"] == "value_error":
            said[f"{where}: {f'{key}: ' if key else ''}{told}"] = None
        else:
            value = problem["input"]
            given = "" if isinstance(value, Mapping) else f" = {format_value(value)}"
            expected = _EXPECTED.get(problem["type"], problem["msg"].replace("Input should be", "expected"))
            said[f"{where}: {key}{given}; {expected}"] = None
    return list(said)


def _model(path: tuple[str, ...]) -> Any:
    pattern = path[:1] if path[:1] == ("keep",) else tuple(part if n == 0 else "*" for n, part in enumerate(path[:2]))
    return _TABLES.get(pattern, PlanTables)


def _meaning(path: tuple[str, ...]) -> str:
    field = _model(path[:-1]).model_fields.get(path[-1])
    return str(field.description) if field is not None and field.description else "a value"
