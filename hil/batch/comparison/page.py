"""A comparison as text: tables for the terminal, a page in Markdown, and every run as CSV."""

import csv
import os
import re
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path

from hil.batch.comparison.conditions import DRIVES, FRICTIONS, MASS_FACTORS, Condition
from hil.batch.comparison.result import OVER, Comparison, Row
from hil.batch.figures import Column, shown_columns
from hil.batch.output import markdown_table
from hil.core.outputs import Existing, write_whole
from hil.core.printable import printable
from hil.review.plots import FORMATS

OVERVIEW = "figures"
"""The name of the picture of all figures."""
_LAST_S = 1.0
_MADE = """\
Made by `{command}`; do not edit. Scenario `{scenario}`, seed {seed}, every run in
lockstep through the wire in memory. Less is better in every column. In brackets behind a law are gains of
the scenario that are not its defaults.
"""
_VARIED = """\
A cell has three figures: nominal / worst over the plant's mass / worst over its mass and friction. The
mass is {masses} times the nominal one, the friction {frictions}, each with each; what the law believes
does not change. The lowest of the last is bold. A dash says that a run has no such figure; why is below
the table.
"""
_NOMINAL = """\
Nominal runs alone. The lowest figure is bold. A dash says that a run has no such figure; the reason is
below the table.
"""


def names(condition: Condition) -> tuple[str, str]:
    """Return the names of the pictures of a condition: path and error, and torques."""
    return f"error-{condition.slug}", f"torque-{condition.slug}"


def older(folder: Path) -> list[Path]:
    """Return the files that an earlier comparison wrote into a folder, whatever its conditions."""
    drives = "|".join(DRIVES)
    pictures = rf"({OVERVIEW}|(error|torque)-[0-9.e+-]+nm-({drives})(-[a-z-]+)?)\.({'|'.join(FORMATS)})"
    own = re.compile(rf"comparison\.csv|{pictures}")
    return sorted(file for file in folder.iterdir() if own.fullmatch(file.name) and file.is_file())


def terminal(comparison: Comparison) -> Iterator[tuple[str, list[tuple[str, ...]], list[str]]]:
    """Yield for each condition its title, its table with a head (nominal and worst in a cell), and its notes."""
    columns = shown_columns()
    for condition, rows in comparison.tables().items():
        head = ("law", *(f"{column.head} {column.unit}" for column in columns))
        cells = [
            (row.entry.title(condition.mode), *(_cell(column, row, ("nominal", "worst")) for column in columns))
            for row in rows
        ]
        yield condition.words, [head, *cells], list(_notes(comparison, rows))


def _cell(column: Column, row: Row, over: Sequence[str], best: str | None = None) -> str:
    """Return the worst of a figure over each of ``over``, of a nominal run once; the last in bold if it is ``best``."""
    texts = [column.text(row.worst(column.name, one)) for one in (over if len(row.runs) > 1 else over[-1:])]
    return " / ".join([*texts[:-1], f"**{texts[-1]}**" if texts[-1] == best else texts[-1]])


def write_markdown(
    comparison: Comparison, file: Path, command: str, pictures: Sequence[Path] = (), existing: Existing = "refuse"
) -> None:
    """Write the page; ``command`` is what made it, ``existing`` says what to do if the file exists.

    Raises BadInputError when it cannot be written.
    """
    columns = shown_columns()
    lines = [*_preface(comparison, command)]
    for condition, rows in comparison.tables().items():
        least = {column: _least(column, rows) for column in columns if column not in _late(comparison, rows)}
        best = {column: column.text(value) for column, value in least.items() if value is not None}
        table = [("law", *(f"{column.head} [{column.unit}]" for column in columns))]
        for row in rows:
            cells = (_cell(column, row, OVER, best.get(column)) for column in columns)
            table.append((row.entry.title(condition.mode), *cells))
        lines += ["", f"## {condition.words}", "", markdown_table(table).rstrip()]
        if notes := list(_notes(comparison, rows)):
            lines += ["", *(f"- {note}" for note in notes)]
        lines += _shown(pictures, names(condition), file)
    lines += _shown(pictures, (OVERVIEW,), file)
    write_whole(file, printable("\n".join(lines) + "\n").encode("utf-8"), "page", existing)


def _preface(comparison: Comparison, command: str) -> Iterator[str]:
    masses, frictions = (" and ".join(f"{value:g}" for value in values) for values in (MASS_FACTORS, FRICTIONS))
    made = _MADE.format(command=command, scenario=comparison.scenario, seed=comparison.seed)
    cells = _VARIED.format(masses=masses, frictions=frictions) if len(comparison.rows[0].runs) > 1 else _NOMINAL
    limiter = [comparison.limiter] if comparison.limiter else []
    yield from ["# Laws compared", "", *made.splitlines(), *limiter, "", *cells.splitlines(), ""]
    for column in shown_columns():
        yield f"- {column.head} [{column.unit}]: {column.meaning}."


def _late(comparison: Comparison, rows: Sequence[Row]) -> list[Column]:
    """Return the settling times whose least value is in a run's last second: they depend on how the run ends."""
    last_s = comparison.duration_s - _LAST_S
    instants = [column for column in shown_columns() if column.is_instant]
    return [one for one in instants if (least := _least(one, rows)) is not None and least > last_s]


def _least(column: Column, rows: Sequence[Row]) -> float | None:
    return min((value for row in rows if (value := row.worst(column.name)) is not None), default=None)


def _notes(comparison: Comparison, rows: Sequence[Row]) -> Iterator[str]:
    if late := _late(comparison, rows):
        yield (
            f"{' and '.join(column.head for column in late)}: the least is in the last second of a run of "
            f"{comparison.duration_s:g} s, so that the error was not seen to stay where it is, and nobody is first"
        )
    for row in rows:
        for note in row.notes():
            yield f"{row.entry.label}: {note}"


def _shown(pictures: Sequence[Path], names: Sequence[str], file: Path) -> Iterator[str]:
    """Yield the lines that show those of the pictures that have these names, by their paths from the page."""
    for picture in pictures:
        if picture.stem in names:
            yield ""
            yield f"![{picture.stem}]({Path(os.path.relpath(picture, file.parent)).as_posix()})"


def write_csv(comparison: Comparison, file: Path) -> None:
    """Write a row for each run. Raises BadInputError when it cannot be written."""
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    first = comparison.rows[0]
    head = (*first.condition._fields, *first.runs[0].variation._fields)
    names = [column.name for column in shown_columns()]
    writer.writerow(["law", *head, *names, "refused", "failed"])
    for row in comparison.rows:
        for run in row.runs:
            figures = [None if run.figures is None else run.figures[name] for name in names]
            writer.writerow([row.entry.label, *row.condition, *run.variation, *figures, run.refused, run.failed])
    write_whole(file, stream.getvalue().encode("utf-8"))
