"""Files of batches (TOML): read and checked, so that every error names file and line."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from hil.core.errors import BadInputError, near
from hil.core.options import OptionsError, Problem, build, items
from hil.laws.law_registry import law_file
from hil.scenario import Scenario, Sources
from hil.scenario.toml_text import key_lines, parse
from hil.scenario.values import is_path

T = TypeVar("T")
_BY_KEY = ("axes", "range")
"""Tables that give values for keys of the scenario."""
_SET = "--set"
_VALUES = ("grid", "list", "uniform", "log_uniform", "one_of")
"""A table with one of these keys gives the values of a key of the scenario."""


class PlanFile(NamedTuple):
    """A file that was read.

    Attributes:
        what: the word for it in messages, such as "campaign".
        file: its path.
        lines: the line of each key there, by its path.
        document: its tables, with dotted keys in those that name keys of the scenario.
    """

    what: str
    file: Path
    lines: Mapping[tuple[str, ...], int]
    document: Mapping[str, Any]

    @property
    def folder(self) -> Path:
        """The folder from which its relative paths start."""
        return self.file.absolute().parent

    def place(self, *path: str) -> str:
        """Return ``file:line`` of a key, or of the nearest one above it; it may be written with dots or as tables."""
        dotted = {".".join(known) + ".": line for known, line in self.lines.items()}
        for end in range(len(path), 0, -1):
            prefix = ".".join(path[:end]) + "."
            if found := [line for known, line in dotted.items() if known.startswith(prefix)]:
                return f"{self.file}:{min(found)}"
        return str(self.file)

    def tables(self, kind: type[T]) -> T:
        """Return the file's tables, checked. Raises BadInputError, with one line for each problem."""
        try:
            return build(kind, self.document)
        except OptionsError as error:
            raise BadInputError("\n".join(self._sentences(error.problems))) from None

    def scenario(
        self, sources: Sources, sets: Mapping[str, object], tables: Mapping[str, str], **options: Any
    ) -> Scenario:
        """Return a scenario with these values; ``tables`` says for a key in which table of the file it stands.

        ``options`` are further arguments of ``Sources.scenario``. Raises BadInputError, which names file and line.
        """
        try:
            return sources.scenario(set=sets, folder=self.folder, **options)
        except BadInputError as error:
            placed = (self._placed(line, sets, tables) for line in str(error).splitlines())
            raise BadInputError("\n".join(placed)) from None

    def _placed(self, sentence: str, sets: Mapping[str, object], tables: Mapping[str, str]) -> str:
        """Name this file and its line in a sentence about a value that it gives, in place of ``--set``."""
        if not sentence.startswith(_SET):
            return f"{self.what} {self.file}: {sentence}"
        words = sentence.removeprefix(_SET).lstrip(": ")
        key = max(sets, key=lambda key: _named(key, words), default="")
        if not _named(key, words):
            return f"{self.what} {self.file}: {words}"
        table = (tables[key],) if key in tables else ()
        return f"{self.what} {self.place(*table, key)}: {words}"

    def _sentences(self, problems: Sequence[Problem]) -> Iterator[str]:
        for problem in problems:
            path, words = problem.path, problem.words
            about = path or next(
                (one[:-1] for one in self.lines if one[0] in _BY_KEY and ".".join(one[1:-1]) in words), ()
            )
            where = f"{self.what} {self.place(*about) if problem.kind != 'missing' else self.file}"
            yield f"{where}: {problem.sentence if path else words}"


def read_plan_file(file: Path, what: str) -> PlanFile:
    """Read a file; ``what`` is the word for it in messages. Raises BadInputError when it cannot be read."""
    try:
        text = file.read_text("utf-8-sig")
    except FileNotFoundError:
        raise BadInputError(f"{what} {file}: there is no such file; give the path of a .toml file") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise BadInputError(f"{what} {file}: it cannot be read ({why})") from error
    document = parse(text, f"{what} {file}")
    for name in _IS_VALUE:
        if isinstance(document.get(name), Mapping):
            document[name] = _dotted(document[name], _IS_VALUE[name])
    return PlanFile(what, file, key_lines(text), _frozen(document))


def found_from_anywhere(key: str, value: object, folder: Path) -> object:
    """Return a value of the scenario that is a path as an absolute one; relative ones start from ``folder``."""
    if not isinstance(value, str):
        return value
    is_file = key in ("reference.file", "device.motors.file")
    if key in ("plant.fmu", "controller.law"):
        is_file = is_path(value) if key == "plant.fmu" else law_file(value) is not None
    return str(folder / value) if is_file else value


def row_of_table(row: Any) -> dict[str, Any]:
    """Return a row of [[fault]] or [[expect]] without the keys that were not given, so that it can be given again."""
    return {key: value for key, value in items(row) if value is not None and value != math.inf}


def _is_axis(table: Mapping[str, Any]) -> bool:
    return any(kind in table for kind in _VALUES) or not any(isinstance(one, Mapping) for one in table.values())


_IS_VALUE: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "axes": _is_axis,
    "range": lambda table: any(near(key, _VALUES) for key in table),
    "set": lambda _: False,
}
"""Tables whose keys are keys of the scenario, and whether a table in them is a value or a further part of a key."""


def _dotted(table: Mapping[str, Any], is_value: Callable[[Mapping[str, Any]], bool], path: str = "") -> dict[str, Any]:
    """Turn nested tables into dotted keys: TOML reads unquoted dots as tables."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        is_table = isinstance(value, Mapping) and not is_value(value)
        found |= _dotted(value, is_value, f"{path}{key}.") if is_table else {path + key: value}
    return found


def _named(key: str, words: str) -> int:
    """Return how many leading parts of a dotted key a sentence names."""
    parts = key.split(".")
    begins = {end: re.escape(".".join(parts[:end])) for end in range(len(parts), 0, -1)}
    return next((end for end, begin in begins.items() if re.search(rf"(?<![\w.]){begin}(?!\w)", words)), 0)


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value
