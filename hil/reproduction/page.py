"""The page PAPER.md: ``python -m hil.reproduction.page SUMMARY.json`` writes the results of a run between its marks."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.reproduction import tables

PAGE = Path(__file__).with_name("PAPER.md")
_BEGIN, _END = "<!-- results begin -->\n", "<!-- results end -->\n"


def results(summary: Mapping[str, Any]) -> str:
    """Return the part of the page that follows from a summary."""
    parts = (
        ("Verdicts", tables.verdicts(summary)),
        ("Section IV.A: the circle", tables.circle(summary)),
        ("Section IV.B: oscillation over latency", tables.delay(summary)),
        ("Section IV.B: the transition", tables.transition(summary)),
        ("What the paper leaves out", tables.assumptions(summary)),
    )
    return "\n".join(f"### {title}\n\n{tables.markdown(table)}" for title, table in parts)


def with_results(page: str, summary: Mapping[str, Any]) -> str:
    """Return the page with the results of a summary between its marks."""
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}\n{results(summary)}\n{_END}{after}"


def main(arguments: list[str]) -> int:
    """Write the results into the page; return the exit code."""
    if len(arguments) != 1:
        print("usage: python -m hil.reproduction.page SUMMARY.json", file=sys.stderr)
        return 2
    summary = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    if summary["quick"]:
        print("a quick run has not all that the page shows; run hil reproduce without --quick", file=sys.stderr)
        return 2
    PAGE.write_text(with_results(PAGE.read_text(encoding="utf-8"), summary), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
