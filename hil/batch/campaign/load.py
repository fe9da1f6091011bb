"""Loads a campaign: reads and checks its file and finds its scenario; every error names file and line."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.batch.campaign.tables import AXIS_KINDS, PlanTables
from hil.core.errors import BadInputError
from hil.core.options import OptionsError, Problem, build
from hil.scenario import Scenario, Sources, read
from hil.scenario.toml_text import key_lines, parse
from hil.scenario.values import is_path

_SET = "--set"


class Plan(NamedTuple):
    """A campaign that was loaded.

    Attributes:
        tables: the tables of its file.
        file: its path. lines: the line of each key there, by its path.
        sources: the files of its scenario.
    """

    tables: PlanTables
    file: Path
    lines: Mapping[tuple[str, ...], int]
    sources: Sources

    @property
    def folder(self) -> Path:
        """The folder from which its relative paths start."""
        return self.file.absolute().parent

    @property
    def name(self) -> str:
        """Its name: that of its file without the suffix."""
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
        """Name the campaign's file and line in a sentence about a value that it gives, in place of ``--set``."""
        if not sentence.startswith(_SET):
            return f"campaign {self.file}: {sentence}"
        words = sentence.removeprefix(_SET).lstrip(": ")
        key = max(sets, key=lambda key: _named(key, words), default="")
        if not _named(key, words):
            return f"campaign {self.file}: {words}"
        table = ("axes",) if key in self.tables.axes else ("set",) if key in self.tables.set else ()
        return f"campaign {self.place(*table, key)}: {words}"


def _named(key: str, words: str) -> int:
    """Return how many leading parts of a dotted key a sentence names."""
    parts = key.split(".")
    begins = {end: re.escape(".".join(parts[:end])) for end in range(len(parts), 0, -1)}
    return next((end for end, begin in begins.items() if re.search(rf"(?<![\w.]){begin}(?!\w)", words)), 0)


def load_plan(file: Path) -> Plan:
    """Return the campaign of a file. Raises BadInputError, with one line for each problem."""
    try:
        text = file.read_text("utf-8-sig")
    except FileNotFoundError:
        raise BadInputError(f"campaign {file}: there is no such file; give the path of a .toml file") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise BadInputError(f"campaign {file}: it cannot be read ({why})") from error
    document = _flat(parse(text, f"campaign {file}"))
    lines = key_lines(text)
    try:
        tables = build(PlanTables, _frozen(document))
    except OptionsError as error:
        raise BadInputError("\n".join(_sentences(error.problems, file, lines))) from None
    name = tables.scenario
    try:
        sources = read(file.absolute().parent / name if is_path(name) else name)
    except BadInputError as error:
        raise BadInputError(f"campaign {_place(file, lines, ('scenario',))}: {error}") from error
    return Plan(tables, file, lines, sources)


def _flat(document: dict[str, Any]) -> dict[str, Any]:
    """Turn nested tables below ``[set]`` and ``[axes]`` into dotted keys: TOML reads unquoted dots as tables."""
    flat = dict(document)
    for name, is_value in (("axes", _is_axis), ("set", lambda _: False)):
        if isinstance(flat.get(name), Mapping):
            flat[name] = _dotted(flat[name], is_value)
    return flat


def _is_axis(table: Mapping[str, Any]) -> bool:
    return any(kind in table for kind in AXIS_KINDS) or not any(isinstance(one, Mapping) for one in table.values())


def _dotted(table: Mapping[str, Any], is_value: Callable[[Mapping[str, Any]], bool], path: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        is_table = isinstance(value, Mapping) and not is_value(value)
        found |= _dotted(value, is_value, f"{path}{key}.") if is_table else {path + key: value}
    return found


def _place(file: Path, lines: Mapping[tuple[str, ...], int], path: tuple[str, ...]) -> str:
    """Return ``file:line`` of a key, whether it is written with dots or as tables."""
    dotted = {".".join(known) + ".": line for known, line in lines.items()}
    for end in range(len(path), 0, -1):
        prefix = ".".join(path[:end]) + "."
        if found := [line for known, line in dotted.items() if known.startswith(prefix)]:
            return f"{file}:{min(found)}"
    return str(file)


def _sentences(problems: Sequence[Problem], file: Path, lines: Mapping[tuple[str, ...], int]) -> Iterator[str]:
    """Yield one sentence for each problem."""
    for problem in problems:
        path, words = problem.path, problem.words
        about = path or next((one[:-1] for one in lines if one[0] == "axes" and ".".join(one[1:-1]) in words), ())
        where = f"campaign {_place(file, lines, about) if problem.kind != 'missing' else file}"
        yield f"{where}: {problem.sentence if path else words}"


def _frozen(value: Any, key: str = "") -> Any:
    """Return plain values with tuples for lists, and a law that is given only by its name as a table."""
    if isinstance(value, Mapping):
        return {key: _frozen(item, key) for key, item in value.items()}
    if not isinstance(value, list | tuple):
        return value
    return tuple({"law": one} if key == "laws" and isinstance(one, str) else _frozen(one) for one in value)
