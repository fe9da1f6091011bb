"""Metadata of a recording: property names that writer and reader share, the scenario's values, and the run's page."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
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
PART_PROPERTY = "part"
"""Which part of a recording the file is: ``recording_id``, ``number`` from 1, ``first_row`` and ``first_event``.

The last two count the run's rows and events from 0. A row is in two files if a recorder was killed before it could
count the row as written; a reader then takes it from the later file.
"""
OF_A_RUN = (RUN_PROPERTY, SIGNALS_PROPERTY, SUMMARY_PROPERTY, PART_PROPERTY, RECORDER_PROPERTY)
"""The properties that a recorder writes with a check value."""

PROPERTY_WORDS = {
    "scenario_name": "scenario",
    "law": "law",
    "command": "commands by",
    "mode": "time",
    "link": "link",
    "seed": "seed",
    "started": "started",
    "mecanum_hil": "version",
    "rerun_sdk": "version of rerun",
    "python": "version of Python",
    "gains": "options of the law",
    "law_sha256": "code of the law",
    "shadow_laws_sha256": "code of the shadow laws",
    "fmu_sha256": "FMU",
    "map_sha256": "map of the FMU",
    "reference_file_sha256": "file of the reference",
    "motors_file_sha256": "file of the motors",
    "wheel_host_sources_sha256": "sources of the firmware (wheel_host)",
    "cosim_sources_sha256": "sources of the FMU's shim (cosim)",
    "wheel_host_sha256": "native library wheel_host",
    "cosim_sha256": "native library cosim",
    "scenario_sha256": "scenario with all values",
}
"""Labels of a recording's properties (see ``hil.runtime.provenance``)."""
HASHES = tuple(name for name in PROPERTY_WORDS if name.endswith("_sha256") and name != "scenario_sha256")
"""Hashes of a run's inputs (law, FMU, libraries, files), in the order in which they are shown."""
_HASH_LETTERS = 12  # enough to tell one hash from another


def hash_text(text: str) -> str:
    """Return a recorded hash, or a JSON object of hashes by name, shortened for a reader.

    A null, the hash of a law whose source was not found, becomes "not known".
    """
    if not text.startswith("{"):
        return text[:_HASH_LETTERS]
    hashes = {name: (digest or "not known")[:_HASH_LETTERS] for name, digest in json.loads(text).items()}
    return ", ".join(f"{name} {digest}" for name, digest in hashes.items())


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


def page(properties: Mapping[str, str], summary: Mapping[str, Any] | None) -> str:
    """Return the run's page as Markdown: a table of figures (``page`` of the summary) and one of properties."""
    text = _table("run", _about(properties))
    return text if not summary else _table("figure", summary.get("page", ())) + "\n" + text


def _about(properties: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for name, text in properties.items():
        if name in ("scenario", "scenario_sources"):  # hundreds of values: ``hil review --html`` lists them
            continue
        label = PROPERTY_WORDS.get(name, name.replace("_", " "))
        if name == "gains":
            yield label, ", ".join(f"{key} = {value}" for key, value in json.loads(text).items()) or "none"
        else:
            yield label, hash_text(text) if name.endswith("_sha256") else text


def _table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    lines = [f"| {_cell(label)} | {_cell(text)} |" for label, text in rows]
    return "\n".join([f"| {title} | |", "|---|---|", *lines, ""])


def _cell(text: str) -> str:
    """Escape a text so that it stays within one cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
