"""The fixture of the pytest plugin, as a callable."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from hil.addons.testing.checked_run import add_to_report, run_as_test
from hil.addons.testing.overrides import Overrides
from hil.core.errors import HilError
from hil.judge.result import RunResult
from hil.scenario.values import is_path

Set = Mapping[str, object] | Sequence[str]


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
        record: bool = True,
        check: bool = True,
    ) -> RunResult:
        """Run a scenario, and return its result; a run that does not pass fails the test, except with ``check=False``.

        ``set``, ``mode``, ``link``, ``seed`` and ``truth`` are those of ``hil run``, and override --hil-set and so on.
        With ``record`` the run is recorded into the test's ``tmp_path``, or below ``--hil-record DIR``.

        With ``check=False`` raises BadInputError for a wrong scenario or option, and LinkError or DeviceError when the
        robot cannot be reached or does not arm. Later failures are in the result.
        """
        __tracebackhide__ = True
        overrides = self.overrides.changed(set, mode=mode, link=link, seed=seed, truth=truth)
        try:
            loaded = overrides.load(_located(scenario, self.item.path.parent))
        except HilError as error:
            raise (pytest.fail.Exception(str(error)) if check else error.with_traceback(None)) from None
        self.runs += 1
        number = "" if self.runs == 1 else f"-{self.runs}"
        recording = self.recording(f"{loaded.name}{number}") if record else None
        checked = run_as_test(loaded, overrides.truth, recording, overrides.command(loaded), self.item.config)
        add_to_report(self.item, checked, number)
        if not checked.passed:
            if check:
                pytest.fail(checked.text())
            self.item.add_report_section("call", "hil", checked.text())
        if checked.result is None:
            assert checked.error is not None
            raise checked.error.with_traceback(None)
        return checked.result


def _located(scenario: str | Path, folder: Path) -> str | Path:
    """Return a scenario; if it is a path, as an absolute one."""
    return folder / scenario if isinstance(scenario, Path) or is_path(scenario) else scenario
