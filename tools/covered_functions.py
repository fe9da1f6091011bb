"""Which tests call which function: ``python -m tools.covered_functions`` notes it in ``build/covered``.

It runs the tests of ``make test`` with this module as plugin, which writes for each process of pytest the functions of
``hil``, ``firmware_protocol`` and ``plant_fmu`` that each test called in it, and the time that each test took. By
lines in place of functions it would take six times as long as the tests.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
NOTES = ROOT / "build" / "covered"
_PACKAGES = tuple(f"{ROOT}{os.sep}{name}{os.sep}" for name in ("hil", "firmware_protocol", "plant_fmu"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the folder for the notes."""
    parser.addoption("--covered-functions", metavar="FOLDER", help="write there which functions each test calls")


def pytest_configure(config: pytest.Config) -> None:
    """Begin in a process that runs tests: in each worker of xdist, and not in the one that only gives out work."""
    folder = config.getoption("--covered-functions")
    if folder and (hasattr(config, "workerinput") or not config.getoption("numprocesses", None)):
        config.pluginmanager.register(_Notes(Path(folder)))


class _Notes:
    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{os.getpid()}.json"
        self._seconds: dict[str, float] = {}
        self._tests: dict[str, list[int]] = defaultdict(list)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        called: set[CodeType] = set()  # threads that outlive the test go on adding

        def trace(frame: FrameType, event: str, argument: object) -> None:
            called.add(frame.f_code)

        begin_s = time.perf_counter()
        threading.settrace(trace)
        sys.settrace(trace)
        result = yield
        sys.settrace(None)
        threading.settrace(None)
        for code in called.copy():
            if place := _place(code):
                self._tests[place].append(len(self._seconds))
        self._seconds[item.nodeid] = time.perf_counter() - begin_s
        return result

    def pytest_sessionfinish(self) -> None:
        # Short, because xdist ends a worker that takes 10 s for this; so tests are numbers here.
        self._path.write_text(json.dumps({"seconds": self._seconds, "tests": self._tests}), encoding="utf-8")


@cache
def _place(code: CodeType) -> str | None:
    """Return file, first and last line of a function of ours."""
    if not code.co_filename.startswith(_PACKAGES) or code.co_name == "<module>":
        return None
    last = max(line for *_, line in code.co_lines() if line)
    return f"{Path(code.co_filename).relative_to(ROOT).as_posix()}:{code.co_firstlineno}:{last}"


class _Function(NamedTuple):
    first_line: int
    last_line: int
    tests: set[str]


class CoveredFunctions:
    """The notes of a folder. A test is its node id, as in ``tests/wire/test_trace.py::test_name[case]``."""

    def __init__(self, folder: Path) -> None:
        self.seconds: dict[str, float] = {}
        together: dict[str, set[str]] = defaultdict(set)
        for path in sorted(folder.glob("*.json")):
            notes = json.loads(path.read_text(encoding="utf-8"))
            self.seconds |= notes["seconds"]
            names = list(notes["seconds"])
            for place, tests in notes["tests"].items():
                together[place].update(names[number] for number in tests)
        self._functions: dict[str, list[_Function]] = defaultdict(list)
        for place, found in together.items():
            file, first, last = place.rsplit(":", 2)
            self._functions[file].append(_Function(int(first), int(last), found))

    def tests(self, file: str, line: int) -> list[str]:
        """Return the tests that call the function of a line, or any of the file for a line of none; quickest first."""
        functions = self._functions.get(file, [])
        around = [one for one in functions if one.first_line <= line <= one.last_line]
        inmost = max(around, key=lambda one: one.first_line).tests if around else set()
        found = inmost or {test for one in functions for test in one.tests}
        return sorted(found, key=lambda test: self.seconds[test])


def main() -> int:
    """Run the tests."""
    parser = argparse.ArgumentParser(prog="tools.covered_functions", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, metavar="FOLDER", default=NOTES, help="where the notes go")
    out = parser.parse_args().out
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "pytest", "-n", "auto", "-m", "not slow and not alone", "-p", __spec__.name]
    return subprocess.run([*command, "--covered-functions", str(out)], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
