"""A scenario as plain values and back: what goes to a process that need not have its files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.scenario.run import Scenario
from hil.scenario.tables import Tables


def to_plain(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as JSON can have it, infinite times among them as Python's ``json`` writes them."""
    return {
        "tables": scenario.model_dump(include=set(Tables.model_fields)),
        "name": scenario.name,
        "path": None if scenario.path is None else str(scenario.path),
        "directory": str(scenario.directory),
        "provenance": dict(scenario.provenance),
    }


def from_plain(plain: Mapping[str, Any]) -> Scenario:
    """Return the scenario of which ``to_plain`` made these values."""
    path = plain["path"]
    return Scenario(
        **frozen(plain["tables"]),
        name=plain["name"],
        path=None if path is None else Path(path),
        directory=Path(plain["directory"]),
        provenance=plain["provenance"],
    )


def frozen(value: Any) -> Any:
    """Return plain values with tuples for lists, as all tables have them."""
    if isinstance(value, Mapping):
        return {key: frozen(item) for key, item in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list | tuple) else value
