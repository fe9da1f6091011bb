"""Changes values of a robot's file and leaves the rest as the user wrote it, comments too."""

import re
from collections.abc import Mapping
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.options import format_value
from hil.core.outputs import write_whole
from hil.scenario.toml_text import key_lines, parse

_HEADER = re.compile(r"\s*\[")
_COMMENTS = {("commission", "lateral_scale"): "  # measured; nothing uses it yet"}


def changed(text: str, values: Mapping[str, object], name: str = "file") -> str:
    """Return a TOML text with these values, by dotted keys of two parts; None removes the key.

    A key that is there is replaced in its line and keeps its comment; a new one is added at the end of its table, and a
    new table at the end of the text. Raises BadInputError for a text that is not TOML, and for a value that cannot be
    replaced.
    """
    for key, value in values.items():
        table, _, last = key.partition(".")
        text = _with(text, table, last, value)
    document = parse(text, name)
    for key, value in values.items():
        table, _, last = key.partition(".")
        there = document.get(table, {}).get(last)
        if there != (list(value) if isinstance(value, tuple) else value):
            raise BadInputError(f"{name}: {key} cannot be set to {format_value(value)}; write it there yourself")
    return text


def write(path: Path, values: Mapping[str, object]) -> None:
    """Change values of a robot's file on disk, wholly or not at all. Raises BadInputError as ``changed``."""
    text = path.read_text(encoding="utf-8")
    write_whole(path, changed(text, values, str(path)).encode(), "robot file", "replace")


def _with(text: str, table: str, key: str, value: object) -> str:
    lines, ours = text.split("\n"), _COMMENTS.get((table, key), "")
    at = key_lines(text).get((table, key))
    if at is not None:
        end = at
        while end < len(lines) and not _is_whole("\n".join(lines[at - 1 : end])):
            end += 1
        comment = re.search(r"(\s+#[^\"'\]]*)$", lines[end - 1])
        new = [] if value is None else [f"{key} = {format_value(value)}{comment.group(1) if comment else ours}"]
        return "\n".join([*lines[: at - 1], *new, *lines[end:]])
    if value is None:
        return text
    header = next((n for n, line in enumerate(lines) if re.match(rf"\s*\[\s*{re.escape(table)}\s*\]", line)), None)
    if header is None:
        return f"{text.rstrip()}\n\n[{table}]\n{key} = {format_value(value)}{ours}\n"
    end = next((n for n in range(header + 1, len(lines)) if _HEADER.match(lines[n])), len(lines))
    while (end > header + 1 and not lines[end - 1].strip()) or lines[end - 1].lstrip().startswith("#"):
        end -= 1
    return "\n".join([*lines[:end], f"{key} = {format_value(value)}{ours}", *lines[end:]])


def _is_whole(statement: str) -> bool:
    try:
        parse(statement, "")
    except BadInputError:
        return False
    return True
