"""What a recording's properties tell of the run's scenario, for those that draw it."""

import json
import re
from collections.abc import Mapping
from typing import Any

_ROW = r"{}\.(\d+)\.(\w+)"


def scenario_values(properties: Mapping[str, str]) -> dict[str, Any]:
    """Return the scenario's values by their dotted keys; none when the properties have no scenario."""
    values: dict[str, Any] = json.loads(properties.get("scenario", "{}"))
    return values


def table_rows(values: Mapping[str, Any], table: str) -> list[dict[str, Any]]:
    """Return the rows of an array of tables, such as ``expect``, in their order."""
    rows: dict[int, dict[str, Any]] = {}
    pattern = re.compile(_ROW.format(table))
    for key, value in values.items():
        if (named := pattern.fullmatch(key)) is not None:
            rows.setdefault(int(named[1]), {})[named[2]] = value
    return [rows[number] for number in sorted(rows)]
