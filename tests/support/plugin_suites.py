"""Test suites of a user, run by pytest in a process of its own."""

import functools
import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support.processes import ROOT

PLUGIN = ("-p", "hil.addons.testing.plugin")  # changes nothing where the package is installed

_HEAD = 'extends = "paper_circle"\n'
_SHORT = "[loop]\nduration_s = 0.2\n"
PASSING = f"{_HEAD}expect = []\n{_SHORT}"
TOO_STRICT = f'{_HEAD}{_SHORT}[[expect]]\nsignal = "error.planar_m"\nfrom_s = 0.1\nbelow = 0.001\n'
HOLDING = f'{_HEAD}{_SHORT}[[expect]]\nsignal = "error.planar_m"\nbelow = 1.0\n'
NEVER_APPLIED = f'{PASSING}[[fault]]\nkind = "mute"\ntarget = "ESTOP"\nstart_s = 0.1\n'
WATCHDOG = f'{PASSING}[[fault]]\nkind = "mute"\ntarget = "TORQUE_COMMAND"\nstart_s = 0.05\n'
BAD_KEY = f"{_HEAD}[robot]\nmas_kg = 20.0\n"
NO_FMU = f'{PASSING}[plant]\nfmu = "./missing.fmu"\n'


def environment() -> dict[str, str]:
    """Return the environment of a user's pytest: our packages, and none of the options that we run under."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "HIL_", "COV_"))}
    return kept | {"PYTHONPATH": str(ROOT), "COLUMNS": "160"}


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A folder for a suite."""
    for name in set(os.environ) - set(environment()):
        monkeypatch.delenv(name)
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    return pytester


def write(suite: pytest.Pytester, **scenarios: str) -> None:
    """Write ``NAME.hil.toml`` for each name."""
    for name, text in scenarios.items():
        (suite.path / f"{name}.hil.toml").write_text(text)


def run(suite: pytest.Pytester, *arguments: str | Path) -> pytest.RunResult:
    """Run the suite to its end, by a pytest within this process."""
    _import_all()
    return suite.runpytest_inprocess(*PLUGIN, *arguments)


@functools.cache
def _import_all() -> None:
    """Import the modules of a run: pytester forgets those first imported within it; NumPy is not imported twice."""
    import hil
    import hil.addons.testing.fixtures

    hil.run("paper_circle", set=["loop.duration_s=0.1", "expect=[]"])


def run_process(suite: pytest.Pytester, *arguments: str | Path) -> pytest.RunResult:
    """Run the suite to its end, in a process of its own."""
    return suite.runpytest_subprocess(*PLUGIN, *arguments, timeout=120)


def cases(report: Path) -> dict[str, ElementTree.Element]:
    """Return the test cases of a JUnit report by name."""
    return {case.attrib["name"]: case for case in ElementTree.parse(report).iter("testcase")}


def properties(case: ElementTree.Element) -> dict[str, str]:
    """Return the properties of a test case."""
    return {row.attrib["name"]: row.attrib["value"] for row in case.iterfind("properties/property")}
