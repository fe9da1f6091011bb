"""Writes a case as a scenario that ``hil run`` takes and that fails again, to the byte in lockstep."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.batch.plan_file import found_from_anywhere, row_of_table
from hil.core.options import format_value
from hil.scenario import Scenario, load, resolved

_ROWS = ("fault", "expect")


def scenario_text(scenario: Scenario, folder: Path, comments: Sequence[str]) -> str:
    """Return the TOML of a scenario, to be written to a folder: what it extends, and what differs from that."""
    base = scenario.name if scenario.path is None else str(scenario.path)
    extends = base if scenario.path is None else Path(os.path.relpath(base, folder.absolute())).as_posix()
    if scenario.path is not None and "/" not in extends and not extends.endswith(".toml"):
        extends = f"./{extends}"
    lines = [f"# {line}" for line in comments]
    lines += ["", f"extends = {format_value(extends)}", ""]
    before, after = (_values(one) for one in (load(base), scenario))
    lines += [
        f"{_key(key)} = {format_value(found_from_anywhere(key, value, scenario.directory))}"
        for key, value in after.items()
        if key not in before or before[key] != value
    ]
    arrays = {name: [row_of_table(row) for row in getattr(scenario, name)] for name in _ROWS}
    original = {name: [row_of_table(row) for row in getattr(load(base), name)] for name in _ROWS}
    for name in _ROWS:
        if arrays[name] != original[name]:
            lines += _tables(name, arrays[name])
    return "\n".join(lines) + "\n"


def _values(scenario: Scenario) -> dict[str, object]:
    return {key: value for key, value, _ in resolved(scenario) if key.partition(".")[0] not in _ROWS}


def _tables(name: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not rows:
        yield f"{name} = []"
    for row in rows:
        yield from ("", f"[[{name}]]", *(f"{key} = {format_value(value)}" for key, value in row.items()))


def _key(dotted: str) -> str:
    """Return a dotted key as TOML writes it; parts that are no bare keys are quoted."""
    parts = dotted.split(".")
    return ".".join(part if part.replace("_", "").replace("-", "").isalnum() else format_value(part) for part in parts)
