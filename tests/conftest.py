"""In CI a skipped test is a failure, unless .ci/run names it; on a user's machine it says what to install.

``HIL_SLOW_PART=7/4``: of the files of slow tests only each fourth, others for the numbers 8, 9 and 10.
"""

import os
import signal
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

import pytest

from tests.support import examples, once, processes, socketcan_runner
from tests.support.plugin_suites import suite
from tests.support.slow import is_slow

if TYPE_CHECKING:
    from tests.support.service_testbed import ControlSide

__all__ = ["suite"]

_CI = os.environ.get("HIL_CI") == "1"
# A shell's background job begins deaf to the first, and one of nohup to the second; so would every process of a test.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
_HANDLERS = processes.signal_handlers()
examples.load_profile()

# They begin first, so that no process is left with one of them when the others have ended.
_LONGEST = ("test_install.py", "test_fmu_platforms.py")
_MAY_SKIP = tuple(filter(None, os.environ.get("HIL_CI_MAY_SKIP", "").split()))


def pytest_report_header() -> str | None:
    return f"HIL_SEED={os.environ['HIL_SEED']}: other examples for each seed" if os.environ.get("HIL_SEED") else None


@pytest.hookimpl(tryfirst=True)  # before -m
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker(socketcan_runner.MARKER) is not None:
            if not item.path.name.startswith("test_socketcan_"):
                raise pytest.UsageError(f"{item.nodeid}: make runs socketcan tests in test_socketcan_*.py alone")
            item.add_marker(pytest.mark.alone)
        elif item.get_closest_marker("alone") and "pytest.mark.alone" not in item.path.read_text(encoding="utf-8"):
            raise pytest.UsageError(f"{item.nodeid}: make looks for alone tests in files with pytest.mark.alone")
        if is_slow(item.path.name, item.name):
            item.add_marker(pytest.mark.slow)
    if part := os.environ.get("HIL_SLOW_PART"):
        number, parts = map(int, part.split("/"))
        # Without // 16 the longest are in one part.
        others = [
            one
            for one in items
            if one.get_closest_marker("slow") and crc32(one.path.name.encode()) // 16 % parts != number % parts
        ]
        config.hook.pytest_deselected(items=others)
        left_out = set(others)
        items[:] = [one for one in items if one not in left_out]
    if os.environ.get("HIL_ORDER") == "shuffled":
        # Files, and the tests of each: what a file has made for all its tests is made once.
        chance = examples.chance()
        files = sorted({item.path for item in items})
        chance.shuffle(files)
        places = {path: place for place, path in enumerate(files)}
        chance.shuffle(items)
        items.sort(key=lambda item: places[item.path])
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: item.path.name not in _LONGEST)


def pytest_configure(config: pytest.Config) -> None:
    _check_entry_points()
    config.pluginmanager.register(socketcan_runner.plugin(config))


def _check_entry_points() -> None:
    """Raise UsageError if this package registers other entry points than those installed: parts would be missing."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = {(group, *point) for group, points in project["entry-points"].items() for point in points.items()}
    found = {(point.group, point.name, point.value) for point in distribution(project["name"]).entry_points}
    if wanted - found:
        raise pytest.UsageError("pyproject.toml has new entry points; run: pip install --no-deps --editable .")


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    processes.release_terminals()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if _CI:
        for name in _unwanted(terminalreporter):
            terminalreporter.write_line(f"skipped in CI, which is a failure: {name}", red=True)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if _CI and exitstatus == 0 and reporter is not None and _unwanted(reporter):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _unwanted(reporter: pytest.TerminalReporter) -> list[str]:
    skipped = [report.nodeid for report in reporter.stats.get("skipped", [])]
    return [nodeid for nodeid in skipped if not nodeid.endswith(_MAY_SKIP or ("\0",))]


@pytest.fixture(scope="session", autouse=True)
def _made_once(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Let tests.support.once work; the folder of a worker of xdist is in that of the session."""
    folder = tmp_path_factory.getbasetemp()
    once.share(folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder)


@pytest.fixture(scope="session", autouse=True)
def _own_state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep tokens and locks apart from the user's, and from those of other workers of xdist.

    A server removes the tokens of ports where nobody listens. In a network namespace that is all ports of the others.
    """
    with processes.own_state(tmp_path_factory.mktemp("state")):
        yield


@pytest.fixture(autouse=True)
def _handlers_of_signals() -> Iterator[None]:
    """Give each test the handlers of a new process: a command that ran in this one may have left its own."""
    yield
    processes.set_signal_handlers(_HANDLERS)


@pytest.fixture
def state_home(tmp_path: Path) -> Iterator[None]:
    """Keep tokens and locks of a test in its folder, for all its processes."""
    with processes.own_state(tmp_path / "state"):
        yield


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[ControlSide]":
    """A real API process, for all tests of a module."""
    from tests.support.service_testbed import served  # most tests do without what it imports

    with processes.own_state(tmp_path_factory.mktemp("state")), served() as side:
        yield side


@pytest.fixture
def side(service: "ControlSide") -> "ControlSide":
    """The control side of ``service``, as it is in the beginning."""
    service.forget()
    service.wait_until_it_answers()
    return service
