"""Measures which lines and branches of the firmware core are run by its tests, with gcc's --coverage and gcov.

The host's half of the protocol is measured too. ``python -m tools.coverage_firmware`` builds an instrumented host
library aside, runs the tests of the core on it, and prints a row a file. It fails when a test fails or a line was not
run. ``--missing`` names the branches not taken.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol.built import FIRMWARE_FLAGS, SOURCES
from tools.build.compiler import compiler

ROOT = Path(__file__).parent.parent
CORE = tuple(source for source in SOURCES if source.parent.name in ("firmware", "client") or source.name == "direct.c")
TESTS = (
    "tests/test_node.py",
    "tests/test_node_faults.py",
    "tests/test_node_feedback.py",
    "tests/test_node_replay.py",
    "tests/test_node_sessions.py",
    "tests/test_node_states.py",
    "tests/test_node_thresholds.py",
    "tests/test_current_loop.py",
    "tests/test_client.py",
    "tests/test_direct.py",
    "tests/test_line_of_the_library.py",
    "tests/test_parameters.py",
    "tests/test_snapshot.py",
    "tests/test_snapshot_twin.py",
)


class Coverage(NamedTuple):
    """What of a source file was run."""

    name: str
    lines: int
    missed_lines: list[int]
    branches: int
    missed_branches: list[int]
    """The line of each branch that was never taken; a line appears once a branch."""


def build_instrumented(folder: Path) -> Path:
    """Build the host library with counters; objects and notes stay in the folder, where the counts arrive."""
    objects = []
    for source in SOURCES:
        target = folder / f"{source.stem}.o"
        # Without optimisation, so that each line keeps its own counter.
        command = [*compiler(), *FIRMWARE_FLAGS, "-O0", "--coverage", "-fPIC", "-c", str(source), "-o", str(target)]
        subprocess.run(command, check=True)
        objects.append(str(target))
    library = folder / "libwheel_coverage.so"
    subprocess.run([*compiler(), "--coverage", "-shared", "-o", str(library), *objects], check=True)
    return library


def read_counts(folder: Path) -> list[Coverage]:
    """Return the coverage of the core's files, from what gcov makes of the counts."""
    found = []
    for source in CORE:
        command = ["gcov", "--json-format", "--stdout", "--branch-probabilities", f"{source.stem}.gcda"]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder)
        files: list[dict[str, Any]] = json.loads(done.stdout)["files"]
        lines = next(file["lines"] for file in files if Path(file["file"]).name == source.name)
        branches = [(line["line_number"], branch["count"]) for line in lines for branch in line["branches"]]
        found.append(
            Coverage(
                source.name,
                len(lines),
                [line["line_number"] for line in lines if line["count"] == 0],
                len(branches),
                [number for number, count in branches if count == 0],
            )
        )
    return found


def measure() -> list[Coverage]:
    """Run the tests on an instrumented library. Raises CalledProcessError when one fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = build_instrumented(folder)
        environment = os.environ | {"WHEEL_HOST_LIBRARY": str(library)}
        subprocess.run([sys.executable, "-m", "pytest", *TESTS], check=True, env=environment, cwd=ROOT)
        return read_counts(folder)


def percent(missed: int, all_of_them: int) -> str:
    return f"{100 * (all_of_them - missed) / max(all_of_them, 1):6.1f} %"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--missing", action="store_true", help="name the branches that were not taken")
    arguments = parser.parse_args()
    if shutil.which("gcov") is None:
        print("tools.coverage_firmware: no gcov on this machine; it comes with gcc", file=sys.stderr)
        return 2
    try:
        rows = measure()
    except subprocess.CalledProcessError as error:
        print(f"tools.coverage_firmware: {' '.join(map(str, error.cmd[:3]))} failed", file=sys.stderr)
        return 1
    print(f"{'file':16}{'lines':>14}{'branches':>14}")
    for row in rows:
        lines = percent(len(row.missed_lines), row.lines)
        branches = percent(len(row.missed_branches), row.branches) if row.branches else "-"
        print(f"{row.name:16}{lines:>14}{branches:>14}")
        if row.missed_lines:
            print(f"  lines not run: {row.missed_lines}")
        if row.missed_branches and arguments.missing:
            print(f"  branches not taken in lines: {row.missed_branches}")
    missed = sum(len(row.missed_lines) for row in rows)
    branches_missed = sum(len(row.missed_branches) for row in rows)
    all_lines, all_branches = sum(row.lines for row in rows), sum(row.branches for row in rows)
    print(f"{'all':16}{percent(missed, all_lines):>14}{percent(branches_missed, all_branches):>14}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
