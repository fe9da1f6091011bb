"""Prints the summary of a job as Markdown: a row for each test of ``junit.xml``, and a page for each recording.

``python summary.py RESULTS``, as the action beside this file calls it. The pages are written beside the recordings, and
leave the job with its artifact.
"""

import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

_BAD = ("failure", "error")


def rows(junit: Path) -> Iterator[tuple[str, str, str, str]]:
    """Yield verdict, name, seconds and the first line of what went wrong, of each test."""
    for case in ET.parse(junit).getroot().iter("testcase"):
        found = next((child for child in case if child.tag in (*_BAD, "skipped")), None)
        verdict = "passed" if found is None else "FAILED" if found.tag in _BAD else "skipped"
        said = "" if found is None else (found.get("message") or found.text or "").strip()
        yield verdict, case.get("name", ""), f"{float(case.get('time', 0)):.1f}", said.partition("\n")[0]


def page(recording: Path) -> str:
    """Write the page of a recording next to it, and return its link, or the reason for its absence."""
    html = recording.with_suffix(".html")
    command = [sys.executable, "-m", "hil", "review", str(recording), "--html", str(html), "--force"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"`{html.name}`" if html.is_file() else f"no page ({done.stderr.strip()})"


def cell(text: str) -> str:
    """Return a text for a table's cell."""
    return text.replace("|", "\\|")


def lines(results: Path) -> Iterator[str]:
    """Yield the summary."""
    yield "## Scenarios and tests\n"
    junit = results / "junit.xml"
    if not junit.is_file():
        yield "Nothing was run: there is no `junit.xml`."
        return
    found = list(rows(junit))
    failed = sum(row[0] == "FAILED" for row in found)
    yield f"{len(found)} in all, {failed} failed. JUnit: `{junit.name}` in the artifact `hil-results`.\n"
    yield "| verdict | name | s | what went wrong |\n|---|---|---|---|"
    yield from (f"| {' | '.join(map(cell, row))} |" for row in found)
    recordings = sorted(results.rglob("*.rrd"))
    if recordings:
        yield "\n## Pages and recordings, in the artifact\n\n| page | recording |\n|---|---|"
        yield from (f"| {cell(page(one))} | `{one.name}` |" for one in recordings)


if __name__ == "__main__":
    for line in lines(Path(sys.argv[1])):
        print(line)
