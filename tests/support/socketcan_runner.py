"""Runs the tests marked ``socketcan`` where real SocketCAN is, and reports each of them as if it had run here.

The first of them starts a pytest inside ``tools.socketcan`` that runs them all. Its reports come back one by one on
its standard output, between whatever else is written there, as JSON text sequences (RFC 7464): a record separator, a
report, a line feed.
"""

import collections
import compileall
import json
import os
import sys
from typing import Any

import pytest

from tools import socketcan

MARKER = "socketcan"
_INSIDE = "HIL_SOCKETCAN_INSIDE"
_RECORD = b"\x1e"
_SAID_LINES = 60


def plugin(config: pytest.Config) -> object:
    """Return the plugin for this pytest: a runner of those tests elsewhere; inside, their reporter."""
    return Reporter(config) if os.environ.get(_INSIDE) else Runner(config)


class Reporter:
    """Inside: writes every report to the standard output, which is captured only while a test runs."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._output = os.fdopen(os.dup(1), "wb", buffering=0)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        self._output.write(b"\n" + _RECORD + json.dumps(data).encode() + b"\n")


class Runner:
    """Outside: has the tests run, and replays their reports. Without a place to run them they are skipped."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._inside: socketcan.Inside | None = None
        self._reports: dict[str, list[Any]] = collections.defaultdict(list)
        self._said: collections.deque[str] = collections.deque(maxlen=_SAID_LINES)

    @pytest.hookimpl(trylast=True)  # after -k and -m
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        marked = [item for item in items if item.get_closest_marker(MARKER)]
        if marked and (sentence := socketcan.missing()) is not None:
            for item in marked:
                item.add_marker(pytest.mark.skip(reason=sentence))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        if item.get_closest_marker(MARKER) is None or socketcan.missing() is not None:
            return None
        if self._inside is None:
            self._inside = self._start(item.session)
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports_of(item, self._inside):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_unconfigure(self) -> None:
        if self._inside is not None:
            self._inside.close()

    @staticmethod
    def _start(session: pytest.Session) -> socketcan.Inside:
        tests = [item.nodeid for item in session.items if item.get_closest_marker(MARKER)]
        # The root may be read-only there: no cache, and only bytecode that is made here.
        for package in ("firmware_protocol", "hil"):
            compileall.compile_dir(socketcan.ROOT / package, quiet=2)
        command = [
            sys.executable,
            "-B",
            "-m",
            "pytest",
            "-p",
            "no:cacheprovider",
            f"--rootdir={session.config.rootpath}",
        ]
        paths = os.pathsep.join(filter(None, [str(socketcan.ROOT), os.environ.get("PYTHONPATH")]))
        return socketcan.Inside(
            [*command, *tests], {_INSIDE: "1", "PYTHONPATH": paths}, directory=session.config.rootpath
        )

    def _reports_of(self, item: pytest.Item, inside: socketcan.Inside) -> list[Any]:
        """Return the test's reports, waiting for the last of them; one of a failure when it never comes."""
        reports = self._reports[item.nodeid]
        while not reports or reports[-1].when != "teardown":
            line = inside.output.readline()
            if not line:
                return [*reports, self._failure(item, inside)]
            if line.startswith(_RECORD):
                data = json.loads(line[1:])
                report = self._config.hook.pytest_report_from_serializable(config=self._config, data=data)
                if isinstance(report.longrepr, list):  # where and why it was skipped; JSON has no tuples
                    report.longrepr = tuple(report.longrepr)
                self._reports[report.nodeid].append(report)
            elif line.strip():
                self._said.append(line.decode(errors="replace"))
        return reports

    def _failure(self, item: pytest.Item, inside: socketcan.Inside) -> pytest.TestReport:
        if inside.is_out_of_time:
            why = f"was killed after {inside.limit_s:g} s"
        else:
            code = inside.exit_code()
            why = f"ended with exit code {code}" if code is not None else "ended before pytest did"
        text = f"what runs the socketcan tests {why}; this test has no result. It said last:\n{''.join(self._said)}"
        return pytest.TestReport(item.nodeid, item.location, {}, "failed", text, "call")
