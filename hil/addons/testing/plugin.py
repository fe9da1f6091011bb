"""Scenarios as tests: the plugin that pytest loads wherever this package is installed.

It collects every ``*.hil.toml`` file as a test and has the fixture ``hil_run``.
hil/addons/testing/PYTEST.md documents it. pytest imports this module at every start: heavy imports wait until a
scenario is collected or a fixture is used.
"""

import dataclasses
import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest

from hil.core import TEST_SUFFIX

if TYPE_CHECKING:
    from hil.addons.testing.fixtures import RunScenario
    from hil.addons.testing.overrides import Overrides
    from hil.runtime.run_options import RunOptions
    from hil.scenario import Scenario

_LONGEST_NAME = 100


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hil", "hardware in the loop (*.hil.toml, and the fixture hil_run)")
    group.addoption(
        "--hil-record",
        metavar="DIR|none",
        help="keep the recordings of all runs in this folder, or make none; by default failed runs are kept in "
        "pytest's temporary folder",
    )
    group.addoption("--hil-link", metavar="LINK", help="as hil run --link, for every run that a test gives no other")
    group.addoption("--hil-truth", metavar="URL", help="as hil run --truth, for --hil-link to a robot elsewhere")
    group.addoption("--hil-mode", metavar="lockstep|realtime", help="as hil run --mode")
    group.addoption("--hil-seed", metavar="N", type=int, help="as hil run --seed")
    group.addoption(
        "--hil-set", metavar="KEY=VALUE", action="append", default=[], help="as hil run --set; may be given often"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "hil: a scenario, or a test with the fixture hil_run")


class Hooks:
    """The hook of this plugin, for other plugins."""

    @staticmethod
    @pytest.hookspec(firstresult=True)
    def pytest_hil_run_options(options: "RunOptions") -> "RunOptions | None":
        """Return the options of a run that a test makes, changed; None to leave them. ``hil verify`` wraps parts so."""


def pytest_addhooks(pluginmanager: pytest.PytestPluginManager) -> None:
    pluginmanager.add_hookspecs(Hooks)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> "ScenarioFile | BaselineFile | None":
    if file_path.name.endswith(TEST_SUFFIX):
        return ScenarioFile.from_parent(parent, path=file_path)
    stem = file_path.name.removesuffix(".baseline.toml")
    if stem != file_path.name and file_path.with_name(stem + TEST_SUFFIX).is_file():
        return BaselineFile.from_parent(parent, path=file_path)
    return None


def pytest_itemcollected(item: pytest.Item) -> None:
    if isinstance(item, ScenarioTest) or "hil_run" in getattr(item, "fixturenames", ()):
        item.add_marker(pytest.mark.hil)


class BaselineFile(pytest.File):
    """The baseline of a ``*.hil.toml`` file: no test, and no error where a shell's ``*.toml`` names it."""

    def collect(self) -> Iterable[pytest.Item]:
        return ()


class ScenarioFile(pytest.File):
    """A ``*.hil.toml`` file: one test. A wrong scenario is a collection error of one sentence."""

    def collect(self) -> Iterable["ScenarioTest"]:
        from hil.addons.testing.overrides import shown
        from hil.core.errors import BadInputError

        overrides = _overrides(self.config)
        try:
            scenario = overrides.load(shown(self.path))
        except BadInputError as error:
            raise self.CollectError(str(error)) from None
        yield ScenarioTest.from_parent(self, name=scenario.name, scenario=scenario, overrides=overrides)


class ScenarioTest(pytest.Item):
    """A scenario as a test: it passes when ``hil run`` would."""

    def __init__(self, *, scenario: "Scenario", overrides: "Overrides", **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self._scenario = scenario
        self._overrides = overrides

    def runtest(self) -> None:
        from hil.addons.testing.checked_run import add_to_report, forget_runs, run_as_test
        from hil.core.outputs import free_name

        forget_runs(self)
        folder = _folder(self, None)
        record = None if folder is None else free_name(folder / f"{self.name}.rrd")
        repeat = self._overrides.command(self._scenario)
        checked = run_as_test(self._scenario, self._overrides.truth, record, repeat, self.config)
        if checked.passed and checked.recording is not None and not self.config.getoption("hil_record"):
            checked.recording.unlink()
            checked = dataclasses.replace(checked, recording=None)
        add_to_report(self, checked)
        if not checked.passed:
            pytest.fail(checked.text(), pytrace=False)

    def reportinfo(self) -> tuple[Path, None, str]:
        return self.path, None, f"scenario {self.name}"


@pytest.fixture
def hil_run(request: pytest.FixtureRequest) -> "RunScenario":
    """Run scenarios with overrides, record each, and add its figures to the pytest report.

    Recordings go into the test's ``tmp_path``, or below ``--hil-record DIR``.
    ``hil_run("paper_circle", set={"robot.mass_kg": 24.0})`` returns a ``hil.RunResult``; a run that does not pass fails
    the test, except with ``check=False``.
    """
    from hil.addons.testing.checked_run import forget_runs
    from hil.addons.testing.fixtures import RunScenario
    from hil.core.outputs import free_name

    forget_runs(request.node)

    def recording(name: str) -> Path | None:
        folder = _folder(request.node, request)
        return None if folder is None else free_name(folder / f"{name}.rrd")

    return RunScenario(request.node, _overrides(request.config), recording)


def _overrides(config: pytest.Config) -> "Overrides":
    from hil.addons.testing.overrides import Overrides

    mode, link, seed, truth = (config.getoption(f"hil_{name}") for name in ("mode", "link", "seed", "truth"))
    return Overrides(tuple(config.getoption("hil_set")), mode, link, seed, truth)


def _folder(item: pytest.Item, request: pytest.FixtureRequest | None) -> Path | None:
    """Return the folder for a test's recordings, made if missing; None with ``--hil-record none``.

    ``request`` is given for a test with fixtures: its folder is ``tmp_path``.
    """
    requested = item.config.getoption("hil_record")
    if requested == "none":
        return None
    if requested is not None:
        folder = item.config.invocation_params.dir.joinpath(requested, *_places(item.nodeid))
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            pytest.fail(f"--hil-record {requested}: {folder} cannot be made ({error.strerror})", pytrace=False)
        return folder
    if request is not None:
        return Path(request.getfixturevalue("tmp_path"))
    # pytest gives tmp_path only to functions; the factory behind it has no public name (pytest 7 to 9).
    factory: pytest.TempPathFactory | None = getattr(item.config, "_tmp_path_factory", None)
    if factory is None:
        pytest.fail("recordings need a folder: give --hil-record DIR, or remove -p no:tmpdir", pytrace=False)
    return factory.mktemp(item.name)


def _places(nodeid: str) -> list[str]:
    """Return the folder names of a test's recordings below ``--hil-record``; no two tests share a folder."""
    file, *names = nodeid.split("::")
    folders = file.split("/")
    places = folders[:-1] if file.endswith(TEST_SUFFIX) else [*folders, *names]  # a scenario's recording has its name
    parts = [quote(part, safe=" []()+,=@").replace("..", "%2E%2E") for part in places]
    return [
        part if len(part) <= _LONGEST_NAME else part[:_LONGEST_NAME] + hashlib.sha256(part.encode()).hexdigest()[:8]
        for part in parts
    ]
