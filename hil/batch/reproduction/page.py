"""The page PAPER.md: ``python -m hil.batch.reproduction.page SUMMARY.json`` writes the results of a run between its
marks.

The part of the summary that the page shows is kept beside it, so that ``--check`` can compare them without a run.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.batch.reproduction import tables

PAGE = Path(__file__).with_name("PAPER.md")
KEPT = Path(__file__).with_name("paper.json")
_OF_ONE_RUN = ("folder", "pictures", "recordings", "wall_s")
"""What a summary has beside its results."""
_BEGIN, _END = "<!-- results begin -->\n", "<!-- results end -->\n"


def results(summary: Mapping[str, Any]) -> str:
    """Return the part of the page that follows from a summary."""
    sections = (
        ("Verdicts", tables.verdicts(summary)),
        ("Section IV.A: the circle", tables.circle(summary)),
        ("Section IV.B: oscillation over latency", tables.delay(summary)),
        ("Section IV.B: the transition", tables.transition(summary)),
        ("What the paper leaves out", tables.assumptions(summary)),
    )
    return "\n".join(f"### {title}\n\n{tables.markdown(table)}" for title, table in sections)


def with_results(page: str, summary: Mapping[str, Any]) -> str:
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
            print(f"{PAGE.name} is not what {KEPT.name} gives; {again}", file=sys.stderr)
        return 0 if is_current else 1
    if len(arguments) != 1:
        print("usage: python -m hil.batch.reproduction.page --check | SUMMARY.json", file=sys.stderr)
        return 2
    summary = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    if summary["quick"]:
        print("a quick run has not all that the page shows; run hil reproduce without --quick", file=sys.stderr)
        return 2
    results_alone = {name: value for name, value in summary.items() if name not in _OF_ONE_RUN}
    KEPT.write_text(json.dumps(results_alone, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(with_results(text, summary), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
