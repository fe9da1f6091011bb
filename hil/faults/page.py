"""Writes the kinds and cases into FAULTS.md, between its marks; the text around them is written by hand.

``python -m hil.faults.page`` writes it, ``--check`` fails when it is out of date.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from hil.core.options import format_value
from hil.faults.cases import CASES, PAIRS, Row
from hil.faults.kind import Kind, Quantity
from hil.faults.kinds import KINDS

PAGE = Path(__file__).with_name("FAULTS.md")

_BLOCK = re.compile(r"(<!-- (?:kinds: )?(\w+) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def page() -> str:
    """Return the page with the blocks between its marks written from the tables."""
    blocks = {"cases": _cases()}
    for kind in KINDS:
        blocks[kind.acts_on] = blocks.get(kind.acts_on, "") + _section(kind) + "\n"
    return _BLOCK.sub(lambda found: f"{found[1]}\n{blocks[found[2]]}{found[3]}", PAGE.read_text(encoding="utf-8"))


def _cases() -> str:
    """Return the table of the catalogue's cases."""
    rows = ["| case | rows | outcome | in pairs | in real time |", "|---|---|---|---|---|"]
    for case in CASES:
        given = "; ".join(" ".join(_given(row)) for row in case.rows)
        marks = ("yes" if mark else "-" for mark in (case.in_pairs, case.realtime))
        rows.append(f"| {case.name} | {given} | {' | '.join([case.outcome, *marks])} |")
    rows += ["", "Pairs in which one fault changes the outcome of the other:", ""]
    rows += ["| pair | outcome | why |", "|---|---|---|"]
    rows += [f"| {' + '.join(names)} | {pair.outcome} | {pair.why} |" for names, pair in PAIRS.items()]
    return "\n".join(rows) + "\n\n"


def _given(row: Row) -> Iterator[str]:
    """Yield KEY = VALUE for each key of a case's row except kind and target."""
    for key, value in row.items():
        if key not in ("kind", "target"):
            yield f"{key} = {value}"


def _section(kind: Kind) -> str:
    rows = [f"- target: {kind.target_words}"]
    rows += [_quantity(quantity) for quantity in (kind.value, *kind.further) if quantity is not None]
    if kind.is_instant:
        rows.append("- no `end_s`: it happens at `start_s`")
    rows.append(f"- applied counts: {kind.counts}")
    if kind.explains:
        where = "; of wheel speeds, `robot.*` and `truth.*` only" if kind.acts_on == "signal" else ""
        rows.append(f"- explains ticks in which the robot is not driven{where}")
    keys = {"kind": kind.name, **kind.example}
    example = [f"    {key} = {format_value(value)}" for key, value in keys.items()]
    return "\n".join([f"### {kind.name}", "", kind.meaning, "", *rows, "", "    [[fault]]", *example, ""])


def _quantity(quantity: Quantity) -> str:
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    default = "" if quantity.default is None else f"; by default {quantity.default:g}"
    return f"- `{quantity.name}`{unit}: {quantity.meaning}, {quantity.range}{default}"


def main(arguments: list[str]) -> int:
    """Write the page, or with ``--check`` compare it; return the exit code."""
    if arguments == ["--check"]:
        is_current = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page()
        if not is_current:
            print(f"{PAGE.name} is out of date; run: python -m hil.faults.page", file=sys.stderr)
        return 0 if is_current else 1
    if arguments:
        print("usage: python -m hil.faults.page [--check]", file=sys.stderr)
        return 2
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
