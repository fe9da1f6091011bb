"""Runs chosen tests on request, each request in a process of its own.

A request is a line on stdin, a JSON object: ``files``; ``tests`` (node ids in order, or null for all in the files);
``without`` (tests to leave out); ``slow`` (whether slow tests run); ``limit_s``, after which the whole run is ended;
and optionally ``TOOLS_PROCESSOR_S``, which ``tools.first_failure`` reads. The answer is a line on stdout, a JSON
string: the first test that failed, or the first file that could not be imported; ``limit`` if the run was ended; null
if all passed.

A request with ``module`` and ``was`` is quicker. ``module`` is the path of a changed Python file, ``was`` its text
before the change. The process is forked from this one, which collected the test files earlier; a request with
``collect`` does that alone. In the fork each changed function gets its new code. Results that are older, such as the
parameters of a test, stay. So null is no proof there. The answer is ``new process`` if more than functions changed.
"""

import contextlib
import gc
import inspect
import json
import os
import select
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

from tools.first_failure import PROCESSOR_S, limit_processor

_OPTIONS = (
    "-x", "-q", "--tb=no", "-m", "not alone", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "tools.first_failure",
)  # fmt: skip
NEW_PROCESS = "new process"
_SHELL = (
    "co_code", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_argcount", "co_kwonlyargcount",
    "co_posonlyargcount", "co_flags", "co_exceptiontable", "co_name",
)  # fmt: skip


class _Chosen:
    """Runs the tests that are asked for of all that are collected, in that order."""

    def __init__(self, request: dict[str, Any]) -> None:
        self._request = request

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = chosen(items, self._request)


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


def chosen(items: list[pytest.Item], request: dict[str, Any]) -> list[pytest.Item]:
    """Return the tests that a request asks for, in its order."""
    found = [
        one
        for one in items
        if one.nodeid not in request["without"] and (request["slow"] or not one.get_closest_marker("slow"))
    ]
    if request["tests"] is None:
        return found
    places = {test: place for place, test in enumerate(request["tests"])}
    return sorted((one for one in found if one.nodeid in places), key=lambda one: places[one.nodeid])


def changed_functions(before: CodeType, after: CodeType) -> Iterator[tuple[CodeType, CodeType]]:
    """Yield the code of each function that differs, with the new one. Lines do not count.

    Raises ValueError if more differs than functions.
    """
    pairs = [
        (one, two)
        for one, two in zip(before.co_consts, after.co_consts, strict=False)
        if isinstance(one, CodeType) and isinstance(two, CodeType)
    ]
    rest = [
        [repr(one) for one in code.co_consts if not isinstance(one, CodeType)] + [getattr(code, n) for n in _SHELL]
        for code in (before, after)
    ]
    if rest[0] != rest[1]:
        if not _is_function(before) or before.co_freevars != after.co_freevars:
            raise ValueError
        yield before, after
        return
    inner = [pair for one, two in pairs for pair in changed_functions(one, two)]
    if inner and _is_function(before):
        yield before, after
    yield from inner


def _is_function(code: CodeType) -> bool:
    return bool(code.co_flags & inspect.CO_NEWLOCALS)  # a module or class has none of its own


def take_over(path: Path, text: str) -> None:
    """Give the functions of a module the code of its file, which had another text.

    Raises ValueError if more was changed, or if a function is not found.
    """
    names = (str(path), "exec")
    pairs = list(changed_functions(compile(text, *names), compile(path.read_text(encoding="utf-8"), *names)))
    loaded = any(getattr(one, "__file__", None) == str(path) for one in list(sys.modules.values()))
    live = [one for one in gc.get_objects() if type(one) is FunctionType and one.__code__.co_filename == str(path)]
    for before, after in pairs:
        found = [one for one in live if one.__code__ == before]
        if loaded and not found and "<locals>" not in before.co_qualname:
            raise ValueError
        for function in found:
            function.__code__ = after


class _Server:
    """A session of pytest that collects what it is asked for."""

    def __init__(self) -> None:
        self._requests, self._answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
        _close_streams()  # pytest and tests use these too
        self._items: dict[str, list[pytest.Item]] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> bool:
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for line in self._requests:
            print(json.dumps(self._answer(session, json.loads(line))), file=self._answers, flush=True)
        return True

    def _answer(self, session: pytest.Session, request: dict[str, Any]) -> str | None:
        if request.get("collect"):
            for file in request["files"]:
                if file not in self._items:
                    self._items[file] = list(session.perform_collect([file]))
            return None
        if "module" in request:
            return _run(request, lambda to: self._run_here(session, request, to))
        return _run(request, lambda to: _run_in_new_process(request, to))

    def _run_here(self, session: pytest.Session, request: dict[str, Any], to: int) -> int:
        try:
            take_over(Path(request["module"]), request["was"])
        except (ValueError, SyntaxError):
            os.write(to, NEW_PROCESS.encode())
            return 1
        limit_processor(request.get(PROCESSOR_S))
        session.config.pluginmanager.register(_FirstFailure(to))
        items = chosen([item for file in request["files"] for item in self._items[file]], request)
        for item, after in zip(items, [*items[1:], None], strict=True):
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if session.shouldfail:
                return 1
        return 0


def _run_in_new_process(request: dict[str, Any], to: int) -> int:
    with tempfile.NamedTemporaryFile("w", delete=False) as file:
        json.dump(request, file)
    os.set_inheritable(to, True)
    os.environ |= {PROCESSOR_S: request[PROCESSOR_S]} if PROCESSOR_S in request else {}
    os.execv(sys.executable, (sys.executable, "-m", "tools.test_server", file.name, str(to)))


def _close_streams() -> None:
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)


def _run(request: dict[str, Any], child_runs: Callable[[int], int]) -> str | None:
    """Run tests in a process group of their own, and return the first failure."""
    told, to = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        _close_streams()
        os._exit(child_runs(to))
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
    """Serve until stdin ends; or run one request, whose file and descriptor are given."""
    if len(sys.argv) == 1:
        pytest.main([*_OPTIONS], [_Server()])
        return
    path, to = Path(sys.argv[1]), int(sys.argv[2])
    request = json.loads(path.read_text(encoding="utf-8"))
    path.unlink()
    sys.exit(int(pytest.main([*_OPTIONS, *request["files"]], [_FirstFailure(to), _Chosen(request)])))


if __name__ == "__main__":
    main()
