"""Writes docs/results/comparison.md and .csv: ``python -m tools.comparison_page TRUE.json ESTIMATED.json``.

The two files are what ``hil compare --json`` prints, with the true and with the estimated state. The page shows two
figures of each law; the CSV file has all of them.
"""

import csv
import json
import sys
from pathlib import Path

from hil.addons.batch.columns import shown_columns
from hil.addons.batch.comparison.comparison import OVER, Condition
from hil.addons.batch.results_page import markdown_table

PAGE = Path(__file__).parents[1] / "docs/results/comparison.md"
SHOWN = ("t10 [s]", "rms [mm]")
_MARK = "<!-- tables -->\n"
Tables = dict[str, dict[str, dict[str, str]]]
"""The cells by condition, law and figure."""


def read(path: Path) -> Tables:
    """Return the tables of a file of ``hil compare --json``."""
    tables: Tables = {}
    for row in json.loads(path.read_text(encoding="utf-8"))["rows"]:
        cells = {
            f"{column.head} [{column.unit}]": " / ".join(column.text(row[over][column.name]) for over in OVER)
            for column in shown_columns()
        }
        tables.setdefault(Condition(**row["condition"]).words, {})[row["title"]] = cells
    return tables


def shown(cell: str) -> str:
    """Return the nominal figure and the worst, or one where they are the same."""
    nominal, *_, worst = cell.split(" / ")
    return nominal if nominal == worst else f"{nominal} / {worst}"


def section(title: str, tables: Tables) -> str:
    """Return a section: a table of each shown figure, with a column for each condition."""
    text = f"## {title}\n\n"
    laws = list(dict.fromkeys(law for rows in tables.values() for law in rows))
    for figure in SHOWN:
        rows = [[law, *(shown(rows[law][figure]) if law in rows else "" for rows in tables.values())] for law in laws]
        text += f"**{figure}**\n\n{markdown_table([['law', *tables], *rows]).rstrip()}\n\n"
    return text


def main(true: str, estimated: str) -> None:
    """Write the page below its mark, and the CSV file beside it."""
    found = {"True state": read(Path(true)), "Estimated state, slip contact": read(Path(estimated))}
    head = PAGE.read_text(encoding="utf-8").partition(_MARK)[0]
    text = "".join(section(title, tables) for title, tables in found.items())
    PAGE.write_text(f"{head}{_MARK}\n{text.rstrip()}\n", encoding="utf-8")
    with PAGE.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("condition", "law", "figure", "nominal", "worst over mass", "worst over mass and friction"))
        for tables in found.values():
            for condition, laws in tables.items():
                for law, cells in laws.items():
                    rows.writerows((condition, law, figure, *cell.split(" / ")) for figure, cell in cells.items())


if __name__ == "__main__":
    main(*sys.argv[1:])
