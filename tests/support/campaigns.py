"""Small campaigns: short circles at 200 Hz in lockstep."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from hil.addons.batch.campaign.campaign import Campaign
from hil.addons.batch.columns import MACHINE
from hil.addons.batch.store import ROWS, read_rows
from hil.cli.main import app

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


def do(plan: Path, folder: Path, limit_s: float = LIMIT_S, redo: Collection[str] = ()) -> list[Mapping[str, Any]]:
    """Do a campaign to its end with one worker, and return its rows in the order of its runs."""
    for _ in Campaign(plan).perform(folder, 1, limit_s, redo):
        pass
    return rows_of(plan, folder)


def rows_of(plan: Path, folder: Path) -> list[Mapping[str, Any]]:
    """Return the existing rows in the order of the campaign's runs."""
    rows = read_rows(folder)
    return [rows[run.key] for run in Campaign(plan).runs if run.key in rows]


def rows_written(folder: Path) -> int:
    """Return how many rows are in a folder, which need not exist."""
    return (folder / ROWS).read_bytes().count(b"\n") if (folder / ROWS).exists() else 0


def of_the_runs(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows without what depends on the machine."""
    return [{name: value for name, value in row.items() if not name.startswith(MACHINE)} for row in rows]


def in_process(*arguments: str | Path) -> str:
    """Do a command in this process, which saves its imports, and return its output."""
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    return done.stdout
