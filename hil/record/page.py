"""The page of a recording that says what the run was, and in the end what came of it, in words and units."""

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hil.record.names import PROPERTY_WORDS, hash_text

_LEFT_OUT = frozenset({"scenario", "scenario_sources"})
"""Of the properties, those that have hundreds of values; ``hil show`` and ``hil review --html`` list them."""


def page(properties: Mapping[str, str], summary: Mapping[str, Any] | None) -> str:
    """Return the page as Markdown: the rows that the summary has as ``page``, and what the run was."""
    text = _table("run", _about(properties))
    return text if not summary else _table("figure", summary.get("page", ())) + "\n" + text


def _about(properties: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for name, text in properties.items():
        if name in _LEFT_OUT:
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
    """Return a text that neither ends its cell nor its row."""
    return text.replace("|", "\\|").replace("\n", " ")
