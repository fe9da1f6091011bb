"""The tables of a summary, and the page PAPER.md, between whose marks this module writes them.

``python -m hil.batch.reproduction.page SUMMARY.json`` does so. The part of the summary that the page shows is kept
beside it, so that ``--check`` can compare them without a run.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.batch.output import markdown_table
from hil.batch.reproduction.plan import DRIVEN, FILTERS, LAWS, LIMITS

Table = list[tuple[str, ...]]
Summary = Mapping[str, Any]

_UNIT = {"s": ("s", 1.0, 2), "m": ("mm", 1e3, 2), "rad": ("mrad", 1e3, 2), "Hz": ("Hz", 1.0, 1)}

PAGE = Path(__file__).with_name("PAPER.md")
KEPT = Path(__file__).with_name("paper.json")
_OF_ONE_RUN = ("folder", "pictures", "recordings", "wall_s")
"""Keys of a summary that belong to one run and not to the results."""
_BEGIN, _END = "<!-- results begin -->\n", "<!-- results end -->\n"


def circle(summary: Summary) -> Table:
    """Return the figures of section IV.A, ours and the paper's, with a header."""
    printed = {(row["law"], row["figure"]): row["value"] for row in summary["paper"]}
    rows: Table = [("law", "filter", "limit", "tracked", "the paper", "steady error", "the paper", "within 10 mm")]
    for row in summary["circle"]:
        # The paper's figures appear once, beside the runs that are nearest to its description.
        law = row["law"] if (row["filter"], row["limit"]) == ("common", "together") else None
        rows.append(
            _line(
                row,
                (LAWS[row["law"]][1].words, FILTERS[row["filter"]].words, LIMITS[row["limit"]].words),
                number(row["tracked_s"], "s"),
                number(printed.get((law, "tracked_s")), "s", 1, missing=""),
                number(row["steady_rms_m"], "m"),
                number(printed.get((law, "steady_rms_m")), "m", missing=""),
                number(row["t10_s"], "s"),
            )
        )
    return rows


def delay(summary: Summary) -> Table:
    """Return the oscillation for each latency, with a header."""
    rows: Table = [("command", "latency", "amplitude", "frequency", "steady error", "largest", "transition")]
    figures = (("amplitude_m", "m"), ("frequency_hz", "Hz"), ("steady_rms_m", "m"), ("steady_max_m", "m"))
    for row in summary["delay"]:
        cells = (number(row[name], unit) for name, unit in (*figures, ("transition_s", "s")))
        rows.append(_line(row, (DRIVEN[row["driven"]].words, f"{row['latency_ms']:g} ms"), *cells))
    return rows


def transition(summary: Summary) -> Table:
    """Return the time that the robot takes to the path, for each start and top speed, with a header."""
    rows: Table = [("command", "case", "distance", "transition")]
    for row in summary["transition"]:
        words = (DRIVEN[row["driven"]].words, row["name"], "-" if row["from_m"] is None else f"{row['from_m']:.2f} m")
        rows.append(_line(row, words, number(row["transition_s"], "s")))
    return rows


def _line(row: Mapping[str, Any], words: tuple[str, ...], *figures: str) -> tuple[str, ...]:
    """Return a line of a table: what the run is, then its figures, or what ended it."""
    return (*words, *figures) if row["failure"] is None else (*words, row["failure"], *[""] * (len(figures) - 1))


def verdicts(summary: Summary) -> Table:
    """Return the verdicts, with a header."""
    rows: Table = [("place", "result", "the paper", "ours", "tolerance", "verdict", "why")]
    for row in summary["verdicts"]:
        figures = (number(row[name], row["unit"]) for name in ("paper", "ours", "tolerance"))
        rows.append((row["place"], row["claim"], *figures, row["verdict"], row["why"]))
    return rows


def assumptions(summary: Summary) -> Table:
    """Return what the paper leaves out and what stands for it, with a header."""
    rows: Table = [("section", "left out", "ours", "why")]
    return rows + [(row["place"], row["what"], row["value"] or "-", row["why"]) for row in summary["assumptions"]]


def number(value: float | None, unit: str, digits: int | None = None, missing: str = "-") -> str:
    """Return a figure with its unit, errors in mm and mrad; ``missing`` for None."""
    shown, scale, usual = _UNIT[unit]
    return missing if value is None else f"{value * scale:.{usual if digits is None else digits}f} {shown}"


def results(summary: Summary) -> str:
    """Return the part of the page that follows from a summary."""
    sections = (
        ("Verdicts", verdicts(summary)),
        ("Section IV.A: the circle", circle(summary)),
        ("Section IV.B: oscillation over latency", delay(summary)),
        ("Section IV.B: the transition", transition(summary)),
        ("What the paper leaves out", assumptions(summary)),
    )
    return "\n".join(f"### {title}\n\n{markdown_table(table)}" for title, table in sections)


def with_results(page: str, summary: Summary) -> str:
    """Return the page with the results of a summary between its marks."""
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}\n{results(summary)}\n{_END}{after}"


def kept() -> dict[str, Any]:
    """Return the summary that the page was written from."""
    summary: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return summary


def main(arguments: list[str]) -> int:
    """Write the results into the page, or with ``--check`` compare them; return the exit code."""
    text = PAGE.read_text(encoding="utf-8")
    if arguments == ["--check"]:
        is_current = with_results(text, kept()) == text
        if not is_current:
            again = f"run: python -m hil.batch.reproduction.page {KEPT}, or with the summary of a new run"
            print(f"{PAGE.name} is out of date with {KEPT.name}; {again}", file=sys.stderr)
        return 0 if is_current else 1
    if len(arguments) != 1:
        print("usage: python -m hil.batch.reproduction.page --check | SUMMARY.json", file=sys.stderr)
        return 2
    summary = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    if summary["quick"]:
        print("a quick run lacks results that the page shows; run hil reproduce without --quick", file=sys.stderr)
        return 2
    results_alone = {name: value for name, value in summary.items() if name not in _OF_ONE_RUN}
    KEPT.write_text(json.dumps(results_alone, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(with_results(text, summary), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
