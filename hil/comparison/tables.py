"""A comparison in words: cells for the terminal, a page in Markdown, and every run as CSV."""

import csv
import os
import re
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from hil.comparison.conditions import DRIVES, FRICTIONS, MASS_FACTORS, Condition
from hil.comparison.result import Comparison, Row
from hil.comparison.runs import FIGURES
from hil.errors import BadInputError
from hil.whole_file import write_whole

OVERVIEW = "figures"
"""The name of the picture of all figures."""

_NONE = "-"


class Column(NamedTuple):
    """How a figure is shown."""

    name: str
    head: str
    unit: str
    scale: float
    digits: int
    meaning: str

    def text(self, value: float | None) -> str:
        """Return the figure in the column's unit."""
        return _NONE if value is None else f"{value * self.scale:.{self.digits}f}"


COLUMNS = (
    Column("t10_s", "t10", "s", 1.0, 3, "first time from which the planar error stays below 10 mm"),
    Column("tracked_s", "tracked", "s", 1.0, 3, "first time from which it stays below 2 % of its initial value"),
    Column("steady_rms_m", "rms", "mm", 1e3, 3, "planar error over the last 5 s, root mean square"),
    Column("steady_max_m", "max", "mm", 1e3, 3, "planar error over the last 5 s, largest"),
    Column("overshoot_m", "overshoot", "mm", 1e3, 1, "how far past the reference, along the line of the initial error"),
    Column("effort_n_m_s", "effort", "N·m·s", 1.0, 1, "∫ Σ abs(τ) dt over the four wheels, by the measured currents"),
    Column("torque_variation_n_m_per_s", "variation", "N·m/s", 1.0, 2, "mean absolute slew of a wheel's torque"),
    Column("saturation_s", "saturated", "s", 1.0, 2, "how long a wheel's command was at its limit"),
)
assert tuple(column.name for column in COLUMNS) == FIGURES


def names(condition: Condition) -> tuple[str, str]:
    """Return the names of the pictures of a condition: path and error, and torques."""
    return f"error-{condition.slug}", f"torque-{condition.slug}"


def remove_older(folder: Path) -> None:
    """Remove the files that an earlier comparison wrote into a folder, whatever its conditions; nothing else."""
    drives = "|".join(DRIVES)
    own = re.compile(rf"comparison\.csv|{OVERVIEW}\.png|(error|torque)-[0-9.e+-]+nm-({drives})(-[a-z-]+)?\.png")
    for file in folder.iterdir():
        if own.fullmatch(file.name) and file.is_file():
            try:
                file.unlink()
            except OSError as error:
                raise BadInputError(
                    f"file {file}: this older result cannot be removed ({error.strerror}); name another folder"
                ) from error


def terminal(comparison: Comparison) -> Iterator[tuple[str, list[tuple[str, ...]], list[str]]]:
    """Yield for each condition its title, its table with a head (nominal and worst in a cell), and its notes."""
    for condition in comparison.conditions():
        rows = comparison.under(condition)
        head = ("law", *(f"{column.head} {column.unit}" for column in COLUMNS))
        cells = [(row.entry.title(condition.mode), *(_pair(column, row) for column in COLUMNS)) for row in rows]
        yield condition.words, [head, *cells], list(_notes(rows))


def _pair(column: Column, row: Row) -> str:
    nominal = column.text(row.value(column.name))
    return nominal if len(row.runs) == 1 else f"{nominal} / {column.text(row.worst(column.name))}"


def write_markdown(comparison: Comparison, file: Path, command: str, pictures: Sequence[Path] = ()) -> None:
    """Write the page; ``command`` is what made it. Raises BadInputError when it cannot be written."""
    lines = [*_preface(comparison, command)]
    for condition in comparison.conditions():
        rows = comparison.under(condition)
        lines += ["", f"## {condition.words}", ""]
        lines += ["| law | " + " | ".join(f"{column.head} [{column.unit}]" for column in COLUMNS) + " |"]
        lines += ["|---" * (1 + len(COLUMNS)) + "|"]
        for row in rows:
            cells = (_triple(column, row, rows) for column in COLUMNS)
            label = row.entry.title(condition.mode).replace("|", "\\|")
            lines.append(f"| {label} | " + " | ".join(cells) + " |")
        if notes := list(_notes(rows)):
            lines += ["", *(f"- {note}" for note in notes)]
        lines += _shown(pictures, names(condition), file)
    lines += _shown(pictures, (OVERVIEW,), file)
    write_whole(file, ("\n".join(lines) + "\n").encode("utf-8"))


def _preface(comparison: Comparison, command: str) -> Iterator[str]:
    varied = len(comparison.rows[0].runs) > 1
    masses, frictions = (" and ".join(f"{value:g}" for value in values) for values in (MASS_FACTORS, FRICTIONS))
    yield "# Laws compared"
    yield ""
    yield f"Made by `{command}`; do not edit. Scenario `{comparison.scenario}`, seed {comparison.seed}, every run in"
    yield "lockstep through the wire in memory. Less is better in every column. In brackets behind a law are gains of"
    yield "the scenario that are not its defaults."
    yield ""
    if varied:
        yield "A cell has three figures: nominal / worst over the plant's mass / worst over its mass and friction. The"
        yield f"mass is {masses} times the nominal one, the friction {frictions}, each with each; what the law believes"
        yield "does not change. The lowest of the last is bold. A dash says that a run has no such figure; why is below"
        yield "the table."
    else:
        yield "Nominal runs alone. The lowest figure is bold. A dash says that a run has no such figure; the reason is"
        yield "below the table."
    yield ""
    for column in COLUMNS:
        yield f"- {column.head} [{column.unit}]: {column.meaning}."


def _triple(column: Column, row: Row, rows: Sequence[Row]) -> str:
    worst = row.worst(column.name)
    others = [value for value in (other.worst(column.name) for other in rows) if value is not None]
    text = column.text(worst)
    if worst is not None and text == column.text(min(others)):
        text = f"**{text}**"
    if len(row.runs) == 1:
        return text
    return " / ".join([column.text(row.value(column.name)), column.text(row.worst_over_mass(column.name)), text])


def _notes(rows: Sequence[Row]) -> Iterator[str]:
    for row in rows:
        for note in row.notes():
            yield f"{row.entry.label}: {note}"


def _shown(pictures: Sequence[Path], wanted: Sequence[str], file: Path) -> Iterator[str]:
    """Yield the lines that show those of the pictures that have these names, by their paths from the page."""
    for picture in pictures:
        if picture.stem in wanted:
            yield ""
            yield f"![{picture.stem}]({Path(os.path.relpath(picture, file.parent)).as_posix()})"


def write_csv(comparison: Comparison, file: Path) -> None:
    """Write a row for each run. Raises BadInputError when it cannot be written."""
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    first = comparison.rows[0]
    head = (*first.condition._fields, *first.runs[0].variation._fields)
    writer.writerow(["law", *head, *FIGURES, "refused", "failed"])
    for row in comparison.rows:
        for variation, outcome in row.runs:
            figures = [None if outcome.figures is None else outcome.figures[name] for name in FIGURES]
            places = (*row.condition, *variation)
            writer.writerow([row.entry.label, *places, *figures, outcome.refused, outcome.failed])
    write_whole(file, stream.getvalue().encode("utf-8"))
