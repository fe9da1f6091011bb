"""TOML as text, read with the line of every key."""

import tomllib
from collections.abc import Iterator
from typing import Any

from hil.core.errors import BadInputError
from hil.scenario.layers import Path

_DEEPEST = 50


def parse(text: str, name: str) -> dict[str, Any]:
    """Return the parsed document. Raises BadInputError with its name, the line and what is wrong."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        last_line = text.rstrip().count("\n") + 1
        what = str(error).replace("at end of document", f"at line {last_line}, the end of the document")
        raise BadInputError(f"{name}: not valid TOML: {what}") from error
    except RecursionError:
        document = None
    # A key of many parts, a.b.c, nests without recursion of the parser.
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        inner = (one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list))
        level = [one for children in inner for one in children]
    if level or document is None:
        raise BadInputError(f"{name}: not readable: arrays or tables are nested more than {_DEEPEST} deep")
    return document


def parse_value(text: str) -> object:
    """Return ``text`` read as a TOML value (``24``, ``[1, 2]``), or the text itself (``memory:``)."""
    try:
        document = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    # A line break in the text would let it set further keys.
    return document["value"] if len(document) == 1 else text


def key_lines(text: str) -> dict[Path, int]:
    """Return the line on which each key of a valid document is given.

    The standard library's parser keeps no positions. So lines are collected until they parse: a statement ends at a
    line's end, and one over several lines is invalid until complete.
    """
    lines: dict[Path, int] = {}
    header: Path = ()
    last_row: dict[Path, int] = {}
    statement, first_line = "", 1
    for number, line in enumerate(text.replace("\r\n", "\n").split("\n"), start=1):
        if not statement:
            first_line = number
        statement += line + "\n"
        try:
            parsed = tomllib.loads(statement)
        except tomllib.TOMLDecodeError:
            continue
        if statement.lstrip().startswith("["):
            header = _header(parsed, last_row)
        else:
            lines.update({(*header, *path): first_line for path in _leaf_paths(parsed)})
        statement = ""
    return lines


def _header(parsed: dict[str, Any], last_row: dict[Path, int]) -> Path:
    """Return the path that ``[a.b]`` or ``[[a]]`` opens, counting the rows of arrays of tables."""
    path: Path = ()
    node: Any = parsed
    while node:
        key, node = next(iter(node.items()))
        path = (*path, key)
        if isinstance(node, list):
            last_row[path] = last_row.get(path, 0) + 1
            node = None
        if path in last_row:
            path = (*path, str(last_row[path]))
    return path


def _leaf_paths(node: Any, path: Path = ()) -> Iterator[Path]:
    if isinstance(node, dict) and node:
        children: Any = node.items()
    elif isinstance(node, list) and node and all(isinstance(row, dict) for row in node):
        children = ((str(i), row) for i, row in enumerate(node, start=1))
    else:
        if path:
            yield path
        return
    for key, child in children:
        yield from _leaf_paths(child, (*path, key))
