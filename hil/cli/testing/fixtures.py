"""The three fixtures of the pytest plugin, as callables. The plugin cleans up after them."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from hil.cli.testing.overrides import Overrides
from hil.cli.testing.robot import RobotLink, RobotProcess
from hil.cli.testing.verdict import add_to_report, run_as_test
from hil.core.errors import HilError
from hil.core.printable import command
from hil.review.result import RunResult
from hil.scenario.values import is_path

Set = Mapping[str, object] | Sequence[str]


@dataclass
class StartRobot:
    """Fixture ``virtual_robot``: starts virtual robots, each in its own process, and ends them after the test.

    A scenario is a shipped name or a path; a relative path starts from the folder of the test file.
    """

    folder: Path
    overrides: Overrides
    resources: contextlib.ExitStack

    def __call__(
        self,
        scenario: str | Path = "paper_circle",
        *,
        set: Set = (),  # noqa: A002 - the name of the option
        mode: str | None = None,
        link: str = "serial:pty",
        seed: int | None = None,
    ) -> RobotProcess:
        """Start the scenario's robot behind ``link``, by default a new pseudo-terminal; return it when it is ready.

        ``set``, ``mode`` and ``seed`` are those of ``hil device`` and override --hil-set, --hil-mode and --hil-seed.
        Raises BadInputError for a wrong scenario or option, DeviceError when the robot does not become ready.
        """
        __tracebackhide__ = True
        overrides = self.overrides.changed(set, mode=mode, link=link, seed=seed)
        try:
            robot = RobotProcess(overrides.load(located(scenario, self.folder)), overrides)
        except HilError as error:
            raise error.with_traceback(None) from None  # without frames of this package
        self.resources.callback(_end, robot)
        return robot


@dataclass
class OpenLink:
    """Fixture ``hil_link``: opens links to virtual robots, and closes them after the test."""

    start_robot: StartRobot
    resources: contextlib.ExitStack

    def __call__(
        self,
        robot: RobotProcess | str | Path = "paper_circle",
        *,
        set: Set = (),  # noqa: A002 - the name of the option
        mode: str | None = None,
    ) -> RobotLink:
        """Return an open link to a robot: one that was started before, or a new one of a scenario.

        ``set`` and ``mode`` are for a new one. Raises LinkError when the link cannot be opened, and the errors of
        ``virtual_robot``.
        """
        __tracebackhide__ = True
        try:
            link = RobotLink(self.start_robot(robot, set=set, mode=mode) if isinstance(robot, str | Path) else robot)
        except HilError as error:
            raise error.with_traceback(None) from None
        self.resources.callback(link.close)
        return link


@dataclass
class RunScenario:
    """Fixture ``hil_run``: runs scenarios as ``hil.run`` does, and adds their figures to the test in pytest's report.

    A scenario is a shipped name or a path; a relative path starts from the folder of the test file.
    """

    item: pytest.Item
    overrides: Overrides
    recording: Callable[[str], Path | None]
    runs: int = 0

    def __call__(
        self,
        scenario: str | Path,
        *,
        set: Set = (),  # noqa: A002 - the name of the option
        mode: str | None = None,
        link: str | None = None,
        seed: int | None = None,
        truth: str | None = None,
        on: RobotProcess | None = None,
        record: bool = True,
        check: bool = True,
    ) -> RunResult:
        """Run a scenario, and return its result; a run that does not pass fails the test, except with ``check=False``.

        ``set``, ``mode``, ``link``, ``seed`` and ``truth`` are those of ``hil run``, and override --hil-set and so on.
        ``on`` is the robot to run on, with its link, truth and mode; it must have been started with the same ``set``.
        With ``record`` the run is recorded into the test's ``tmp_path``, or below ``--hil-record DIR``.

        With ``check=False`` raises BadInputError for a wrong scenario or option, and LinkError or DeviceError when the
        robot cannot be reached or does not arm. Later failures are in the result.
        """
        __tracebackhide__ = True
        if on is not None:
            mode, link, truth = mode or on.mode, link or on.link, truth or on.truth
        overrides = self.overrides.changed(set, mode=mode, link=link, seed=seed, truth=truth)
        try:
            loaded = overrides.load(located(scenario, self.item.path.parent))
        except HilError as error:
            raise (pytest.fail.Exception(str(error)) if check else error.with_traceback(None)) from None
        self.runs += 1
        number = "" if self.runs == 1 else f"-{self.runs}"
        recording = self.recording(f"{loaded.name}{number}") if record else None
        # A robot that the test started ends with the test, so only the test can be repeated.
        repeat = overrides.command(loaded) if on is None else command("pytest", self.item.nodeid)
        verdict = run_as_test(loaded, overrides.truth, recording, repeat, self.item.config)
        add_to_report(self.item, verdict, number)
        if not verdict.passed:
            if check:
                pytest.fail(verdict.text())
            self.item.add_report_section("call", "hil", verdict.text())
        if verdict.result is None:
            assert verdict.error is not None
            raise verdict.error.with_traceback(None)
        return verdict.result


def located(scenario: str | Path, folder: Path) -> str | Path:
    """Return a scenario; if it is a path, as an absolute one."""
    return folder / scenario if isinstance(scenario, Path) or is_path(scenario) else scenario


def _end(robot: RobotProcess) -> None:
    if (sentence := robot.close()) is not None:
        print(sentence)
