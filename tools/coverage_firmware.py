"""Measures which lines and branches of the firmware core are run by its tests, with gcc's --coverage and gcov.

The host's half of the protocol is measured too. ``python -m tools.coverage_firmware`` builds an instrumented host
library aside, runs the tests of the core on it, and prints a row a file. It fails when a test fails, a line was not
run, or a branch was not taken that ``unreached_branches.toml`` does not explain.

Neither gcc 12 nor clang 14 measures MC/DC (modified condition/decision coverage; gcc 14 and clang 18 do). Branches
stand for it: here each condition of a decision has a jump of its own. If no condition is reached in two ways, every
jump taken both ways is MC/DC (Comar et al., "Formalization and comparison of MCDC and object branch coverage criteria",
ERTS 2012). So the tool reads the decisions of the sources, and fails for one in which a condition is reached in two
ways, as c is in ``(a || b) && c``.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pycparser import c_ast, c_parser

from firmware_protocol.built import FIRMWARE_FLAGS, SOURCES
from tools.build.compiler import compiler

ROOT = Path(__file__).parent.parent
CORE = tuple(source for source in SOURCES if source.parent.name in ("firmware", "client") or source.name == "direct.c")
TESTS = (
    "tests/firmware_protocol/test_node.py",
    "tests/firmware_protocol/test_node_faults.py",
    "tests/firmware_protocol/test_node_feedback.py",
    "tests/firmware_protocol/test_node_means.py",
    "tests/firmware_protocol/test_node_replay.py",
    "tests/firmware_protocol/test_node_sessions.py",
    "tests/firmware_protocol/test_node_states.py",
    "tests/firmware_protocol/test_node_thresholds.py",
    "tests/firmware_protocol/test_wheel_loops.py",
    "tests/firmware_protocol/test_client.py",
    "tests/firmware_protocol/test_client_frames.py",
    "tests/robot/test_freshness.py",
    "tests/firmware_protocol/test_wheel_timing.py",
    "tests/firmware_protocol/test_wheel_motion.py",
    "tests/wire/test_statistics.py",
    "tests/robot/test_latency.py",
    "tests/robot/test_direct.py",
    "tests/firmware_protocol/test_line_of_the_library.py",
    "tests/firmware_protocol/test_parameters.py",
    "tests/firmware_protocol/test_stored_parameters.py",
    "tests/firmware_protocol/test_protocol_rules.py",
    "tests/robot/test_snapshot.py",
    "tests/firmware_protocol/test_snapshot_twin.py",
)
UNREACHED = Path(__file__).parent / "unreached_branches.toml"
# Each condition of a decision keeps its own jump, and each line its own counter.
_FLAGS = ("-O0", "--param", "logical-op-non-short-circuit=0", "--coverage")
# What pycparser does not know of the headers of a C library.
_PLAIN_C = (
    *("-D__attribute__(x)=", "-D__asm__(x)=", "-D__extension__=", "-D__restrict=", "-D__inline=inline"),
    *("-D_Float128=double", "-D__builtin_va_list=int", "-D_Static_assert(a,b)=struct nothing"),
)
_OTHER = {"&&": "||", "||": "&&"}


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
        command = [*compiler(), *FIRMWARE_FLAGS, *_FLAGS, "-fPIC", "-c", str(source), "-o", str(target)]
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
        environment = os.environ | {"WHEEL_HOST_LIBRARY": str(library), "HIL_CI": "1"}
        environment["HIL_SEED"] = ""  # the same examples each time
        subprocess.run([sys.executable, "-m", "pytest", *TESTS], check=True, env=environment, cwd=ROOT)
        return read_counts(folder)


def unexplained(rows: list[Coverage]) -> tuple[list[str], int]:
    """Return a sentence for each branch without a reason and each reason without a branch; and how many have one."""
    reasons = tomllib.loads(UNREACHED.read_text(encoding="utf-8"))["branch"]
    used: set[int] = set()
    wrong, explained = [], 0
    for source, row in zip(CORE, rows, strict=True):
        lines = source.read_text(encoding="utf-8").splitlines()
        for number, missed in sorted(Counter(row.missed_branches).items()):
            text = lines[number - 1].strip()
            places = {
                place: reason.get("branches", 1)
                for place, reason in enumerate(reasons)
                if reason["file"] == row.name and text.startswith(reason["line"])
            }
            used |= places.keys()
            allowed = sum(places.values())
            explained += min(missed, allowed)
            if missed > allowed:
                wrong.append(f"{row.name}:{number}: {missed - allowed} branches not taken: {text}")
    for place, reason in enumerate(reasons):
        if place not in used:
            wrong.append(f"{UNREACHED.name} explains a branch that is taken, or is none: {reason['line']}")
    return wrong, explained


# Decisions


class _Decisions(c_ast.NodeVisitor):  # type: ignore[misc]
    """Collects the decisions of a file: the largest expressions of && and ||."""

    def __init__(self) -> None:
        self.found: list[Any] = []

    def visit_BinaryOp(self, node: Any) -> None:  # noqa: N802
        if node.op in _OTHER:
            self.found.append(node)
            for condition in _conditions(node):
                self.visit(condition)
        else:
            self.generic_visit(node)


def _conditions(node: Any) -> Iterator[Any]:
    for side in (node.left, node.right):
        operator, inner, _ = _operator(side, False)
        yield from _conditions(inner) if operator else (inner,)


def _operator(node: Any, negated: bool) -> tuple[str | None, Any, bool]:
    """Return && or || as it acts behind negations, None for a condition; the expression; whether it is negated."""
    while isinstance(node, c_ast.UnaryOp) and node.op == "!":
        node, negated = node.expr, not negated
    if isinstance(node, c_ast.BinaryOp) and node.op in _OTHER:
        return _OTHER[node.op] if negated else node.op, node, negated
    return None, node, negated


def is_joined(node: Any, negated: bool = False) -> bool:
    """Return whether a condition of the decision is reached in two ways."""
    operator, inner, negated = _operator(node, negated)
    if operator is None:
        return False
    parts: list[tuple[str | None, Any, bool]] = []
    rest = [(inner.left, negated), (inner.right, negated)]
    while rest:
        part = _operator(*rest.pop(0))
        if part[0] == operator:
            rest[:0] = [(part[1].left, part[2]), (part[1].right, part[2])]
        else:
            parts.append(part)
    return any(part[0] for part in parts[:-1]) or any(is_joined(*part[1:]) for part in parts)


def decisions(text: str, name: str) -> list[Any]:
    """Return the decisions of C that was preprocessed."""
    visitor = _Decisions()
    visitor.visit(c_parser.CParser().parse(text, name))
    return visitor.found


def joined_decisions() -> tuple[list[str], int]:
    """Return a sentence for each decision in which a condition is reached in two ways; and the number of all."""
    wrong, number = [], 0
    for source in CORE:
        command = [*compiler(), "-E", "-std=c11", *_PLAIN_C, str(source)]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        for node in decisions(text, source.name):
            if Path(node.coord.file) == source:
                number += 1
                if is_joined(node):
                    wrong.append(
                        f"{source.name}:{node.coord.line}: a condition is reached in two ways: split the decision"
                    )
    return wrong, number


def percent(missed: int, all_of_them: int) -> str:
    return f"{100 * (all_of_them - missed) / max(all_of_them, 1):6.1f} %"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.parse_args()
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
    missed = sum(len(row.missed_lines) for row in rows)
    branches_missed = sum(len(row.missed_branches) for row in rows)
    all_lines, all_branches = sum(row.lines for row in rows), sum(row.branches for row in rows)
    print(f"{'all':16}{percent(missed, all_lines):>14}{percent(branches_missed, all_branches):>14}")
    wrong, explained = unexplained(rows)
    joined, number = joined_decisions()
    reached = percent(branches_missed - explained, all_branches - explained).strip()
    print(f"{reached} of the branches that can be reached; {explained} cannot, for the reasons in {UNREACHED.name}")
    print(f"{number} decisions of several conditions; in {len(joined)} one is reached in two ways")
    print(*wrong, *joined, sep="\n", end="\n" * bool(wrong or joined))
    return int(missed > 0 or bool(wrong or joined))


if __name__ == "__main__":
    sys.exit(main())
