"""Runs chosen tests on request, each request in a process forked from this one, which has imported other packages.

A request is a line on stdin, a JSON object: ``files``; ``tests`` (node ids in order, or null for all in the files);
``without`` (tests to leave out); ``slow`` (whether slow tests run); ``limit_s``, after which the whole run is ended;
and optionally ``TOOLS_PROCESSOR_S``, which ``tools.first_failure`` reads. The answer is a line on stdout, a JSON
string: the first test that failed, or the first file that could not be imported; ``limit`` if the run was ended; null
if all passed.
"""

import contextlib
import importlib
import json
import os
import select
import signal
import sys
from typing import Any

import pytest

from tools.first_failure import PROCESSOR_S

_IMPORTED = (
    "_pytest.pytester", "can", "can.interfaces.virtual", "cantools", "fmpy", "hypothesis", "numpy", "pydantic",
    "rerun", "rich.console", "rich.table", "scipy.signal", "serial", "typer.testing",
)  # fmt: skip
_OPTIONS = ("-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "tools.first_failure")


class _Chosen:
    """Runs the tests that are asked for of all that are collected, in that order."""

    def __init__(self, tests: list[str] | None, without: list[str]) -> None:
        self._places = None if tests is None else {test: place for place, test in enumerate(tests)}
        self._without = without

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [one for one in items if one.nodeid not in self._without]
        if (places := self._places) is not None:
            items[:] = sorted((one for one in items if one.nodeid in places), key=lambda one: places[one.nodeid])


class _FirstFailure:
    """Tells the other process what failed first."""

    def __init__(self, to: int) -> None:
        self._to = to

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            os.write(self._to, report.nodeid.encode())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self._to, report.nodeid.encode())


def _run(request: dict[str, Any]) -> str | None:
    """Run tests in a process group of their own, and return the first failure."""
    told, to = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        os.environ |= {PROCESSOR_S: request[PROCESSOR_S]} if PROCESSOR_S in request else {}
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nothing, stream)
        plugins = [_FirstFailure(to), _Chosen(request["tests"], request["without"])]
        marked = "not alone" if request["slow"] else "not slow and not alone"
        os._exit(int(pytest.main([*_OPTIONS, "-m", marked, *request["files"]], plugins)))
    os.close(to)
    ended = os.pidfd_open(child)
    in_time, _, _ = select.select([ended], [], [], request["limit_s"])
    os.close(ended)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # the tests' own processes too
    _, status = os.waitpid(child, 0)
    with os.fdopen(told, "rb", closefd=True) as pipe:
        os.set_blocking(told, False)
        failed = (pipe.read() or b"").decode()
    code = os.waitstatus_to_exitcode(status)
    if not in_time:
        return "limit"
    # 5: none was selected.
    return None if code in (0, 5) else failed or f"pytest ended with {code}"


def main() -> None:
    """Serve until stdin ends."""
    for name in _IMPORTED:
        importlib.import_module(name)
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        print(json.dumps(_run(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
