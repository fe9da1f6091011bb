"""The shipped examples of the driver ``dbc`` as settings, changed here and there."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[2] / "hil" / "addons" / "motors" / "dbc" / "examples"


def motors(name: str, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return [device.motors] of an example, its paths absolute; ``changes`` are by dotted keys, None takes one away."""
    table: dict[str, Any] = tomllib.loads((EXAMPLES / f"{name}.toml").read_text("utf-8"))["device"]["motors"]
    for key in ("file",):
        table[key] = str(EXAMPLES / table[key])
    for key, value in (changes or {}).items():
        *path, last = key.split(".")
        node = table
        for part in path:
            node = node.setdefault(part, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return table


def edited_dbc(folder: Path, name: str, *edits: tuple[str, str]) -> str:
    """Write an example's DBC with some text replaced, and return its path."""
    text = (EXAMPLES / f"{name}.dbc").read_text("utf-8")
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / f"{name}.dbc"
    path.write_text(text, "utf-8")
    return str(path)
