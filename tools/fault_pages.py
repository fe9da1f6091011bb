"""Writes the kinds of faults and the catalogue's cases as sections of docs/reference/faults.md."""

from collections.abc import Iterator

from hil.addons.batch.catalogue.fault_cases import CASES, PAIRS, Row
from hil.core.options import format_value
from hil.faults.kinds import KINDS, Kind, Quantity

_TITLES = {"link": "On the link", "device": "On the device", "plant": "On the plant", "signal": "On signals"}


def sections() -> str:
    """Return a section for each kind, below where it acts, and one with the cases."""
    text = ""
    for acts_on, title in _TITLES.items():
        text += f"\n## {title}\n\n" + "\n".join(_section(kind) for kind in KINDS if kind.acts_on == acts_on)
    return f"{text}\n## Cases of hil catalogue\n\n{_cases()}"


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
    return "\n".join(rows) + "\n"


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
