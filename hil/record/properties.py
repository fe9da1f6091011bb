"""Metadata of a recording: property names that writer and reader share, the scenario's values, and the run's page."""

import json
import re
from collections.abc import Mapping
from typing import Any

APPLICATION = "mecanum-hil"
RUN_PROPERTY = "run"
SIGNALS_PROPERTY = "signals"
SUMMARY_PROPERTY = "summary"
RECORDER_PROPERTY = "recorder"
OVERLAY_PROPERTY = "overlay"
"""The two recordings that an overlay file compares; such a file is only for the viewer, not a recording of a run."""
SIGNALS_PATH = "/signals"
"""The entity of an .rrd file that holds every signal of every row."""
EVENTS_PATH, JOURNAL_PATH = "/events", "/journal"
"""The entity, or the topic, of the event log, and that of the journal."""
JOURNAL = "journal"
"""The level of an event that is a piece of the journal (``hil.record.journal``)."""
PART_PROPERTY = "part"
"""Which part of a recording the file is: ``recording_id``, ``number`` from 1, ``first_row`` and ``first_event``.

The last two count the run's rows and events from 0. A row is in two files if a recorder was killed before it could
count the row as written; a reader then takes it from the later file.
"""
OF_A_RUN = (RUN_PROPERTY, SIGNALS_PROPERTY, SUMMARY_PROPERTY, PART_PROPERTY, RECORDER_PROPERTY)
"""The properties that a recorder writes with a check value."""


def scenario_values(properties: Mapping[str, str]) -> dict[str, Any]:
    """Return the scenario's values by dotted key; empty when the properties have no scenario, or none that is JSON."""
    try:
        values = json.loads(properties.get("scenario", "{}"))
    except ValueError:
        values = None
    return values if isinstance(values, dict) else {}


def table_rows(values: Mapping[str, Any], table: str) -> list[dict[str, Any]]:
    """Return the rows of an array of tables, such as ``expect``, in their order."""
    rows: dict[int, dict[str, Any]] = {}
    pattern = re.compile(rf"{table}\.(\d+)\.(\w+)")
    for key, value in values.items():
        if (named := pattern.fullmatch(key)) is not None:
            rows.setdefault(int(named[1]), {})[named[2]] = value
    return [rows[number] for number in sorted(rows)]
