"""Small campaigns: short circles at 200 Hz in lockstep."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.batch.campaign.campaign import Campaign, Place
from hil.batch.figures import KEY, MACHINE
from hil.batch.store import read_rows

PLAN = """
scenario = "circle_speed"
{more}
[set]
loop.duration_s = 0.2
loop.rate_hz = 200
expect = []
{tables}
"""
LIMIT_S = 60.0


def write_plan(folder: Path, more: str = "", tables: str = "", name: str = "plan.toml") -> Path:
    """Write a campaign of short circles; ``more`` are keys of its root, ``tables`` what follows ``[set]``."""
    file = folder / name
    file.write_text(PLAN.format(more=more, tables=tables), encoding="utf-8")
    return file


def do(
    plan: Path,
    folder: Path,
    place: Place = Place(None, 1, LIMIT_S),  # noqa: B008
    redo: Collection[str] = (),
) -> list[Mapping[str, Any]]:
    """Do a campaign to its end, and return its rows in the order of its runs."""
    for _ in Campaign(plan).perform(folder, place, redo=redo):
        pass
    return rows_of(plan, folder)


def rows_of(plan: Path, folder: Path) -> list[Mapping[str, Any]]:
    """Return the rows that are there, of which no run has two, in the order of the campaign's runs."""
    rows = read_rows(folder).to_pylist()
    by_key = {row[KEY]: row for row in rows}
    assert len(by_key) == len(rows)
    return [by_key[run.key] for run in Campaign(plan).runs if run.key in by_key]


def of_the_runs(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows without what depends on the machine."""
    return [{name: value for name, value in row.items() if not name.startswith(MACHINE)} for row in rows]
