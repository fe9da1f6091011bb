"""Keeps the results of ``hil reproduce`` for docs: ``python -m tools.reproduction_page SUMMARY.json``.

``make docs`` makes a page of the kept results.
"""

import json
import sys
from pathlib import Path
from typing import Any

from hil.addons.batch.reproduction.section_iv_page import Summary, markdown

KEPT = Path(__file__).parents[1] / "docs/results/reproduction.json"
_OF_ONE_RUN = ("folder", "pictures", "recordings", "wall_s")
"""Keys of a summary that belong to one run and not to the results."""
_HEAD = """\
# Section IV of the paper, reproduced

Made from `docs/results/reproduction.json`, the results of `hil reproduce`. "Fitted" means that a value that the paper
leaves out was chosen for this result: the filter constant for DSC's steady error, the initial pose and the torque limit
for both tracking times, and so for the lead of AFDSC too. "Cannot be compared" means that the paper has no number, or
that any such run would give it. [PAPER.md](../../hil/addons/batch/reproduction/PAPER.md) has the place of each part of
the paper in this repository.

## Results

"""


def page() -> str:
    """Return the page of docs/reference with the kept results."""
    return _HEAD + markdown(kept())


def kept() -> Summary:
    """Return the summary that was kept."""
    summary: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return summary


def main(arguments: list[str]) -> int:
    """Keep the results of a summary; return the exit code."""
    if len(arguments) != 1:
        print("usage: python -m tools.reproduction_page SUMMARY.json", file=sys.stderr)
        return 2
    summary = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    if summary["quick"]:
        print("a quick run lacks results that the page shows; run hil reproduce without --quick", file=sys.stderr)
        return 2
    results_alone = {name: value for name, value in summary.items() if name not in _OF_ONE_RUN}
    KEPT.write_text(json.dumps(results_alone, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
