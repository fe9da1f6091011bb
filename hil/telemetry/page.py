"""The page of a recording that says what the run was, and in the end what came of it."""

from collections.abc import Mapping

_LONGEST_CELL = 80


def page(properties: Mapping[str, str], summary: Mapping[str, object] | None) -> str:
    """Return the page as Markdown: the figures, when there are any, and the properties that fit a line."""
    text = _table("run", properties)
    return text if summary is None else _table("figure", summary) + "\n" + text


def _table(title: str, values: Mapping[str, object]) -> str:
    cells = {name: _cell(value) for name, value in values.items() if value is not None}
    rows = [f"| {name} | {cell} |" for name, cell in cells.items() if len(cell) <= _LONGEST_CELL]
    return "\n".join([f"| {title} | |", "|---|---|", *rows, ""])


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_cell(one)}" for name, one in value.items())
    return str(value)
