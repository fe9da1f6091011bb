"""The installed plugin: loaded by its entry point, once, light, typed, and no burden for users without pytest."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.plugin_suites import HOLDING, PLUGIN, environment, run, write
from tests.support.processes import ROOT
from tools.page_blocks import blocks

EVERYDAY_TEST = """\
from hil import RunResult
from hil.addons.testing.fixtures import RunScenario


def test_figures(hil_run: RunScenario) -> None:
    result: RunResult = hil_run("paper_circle", set={"robot.mass_kg": 24.0}, check=False)
    assert result.passed and float(result.signals["error.planar_m"].max()) < 1.0
"""


@pytest.fixture
def installed(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A suite where the entry points of pyproject.toml are those of an installed distribution."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    entries = project["entry-points"]["pytest11"]
    about = suite.path / "site" / "the_plugin-0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: the-plugin\nVersion: 0\n")
    (about / "entry_points.txt").write_text(
        "[pytest11]\n" + "".join(f"{name} = {module}\n" for name, module in entries.items())
    )
    monkeypatch.setenv("PYTHONPATH", f"{about.parent}{os.pathsep}{ROOT}")
    return suite


@pytest.mark.parametrize("options", [(), PLUGIN], ids=["by its entry point", "named as well"])
def test_the_plugin_is_loaded_once(installed: pytest.Pytester, options: tuple[str, ...]):
    write(installed, good=HOLDING)
    installed.makeconftest("pytest_plugins = ['hil.addons.testing.plugin']" if options else "")
    done = installed.runpytest_subprocess(*options, "--strict-markers", "-v", timeout=120)
    done.assert_outcomes(passed=1)
    assert installed.runpytest_subprocess(*options, "--help").stdout.str().count("--hil-record=") == 1


def test_the_plugin_can_be_left_out(installed: pytest.Pytester):
    write(installed, good=HOLDING)
    done = installed.runpytest_subprocess("-p", "no:hil.addons.testing.plugin")
    assert done.ret == pytest.ExitCode.NO_TESTS_COLLECTED


def test_pytest_starts_without_what_only_scenarios_need(installed: pytest.Pytester):
    heavy = {"numpy", "pydantic", "pandas", "rerun", "fmpy", "can", "serial", "cffi", "cobs", "typer", "rich"}
    installed.makepyfile(
        f"""
        import sys

        def test_lean():
            assert "hil.addons.testing.plugin" in sys.modules
            assert not {heavy} & set(sys.modules)
            ours = {{name for name in sys.modules if name.startswith("hil.")}}
            assert ours == {{"hil.addons", "hil.addons.testing", "hil.addons.testing.plugin", "hil.core"}}
        """
    )
    installed.runpytest_subprocess("-p", "no:hypothesispytest").assert_outcomes(passed=1)


def test_a_run_does_not_import_pytest():
    program = (
        "import sys; sys.modules['pytest'] = None; import hil, hil.cli.main, pkgutil, importlib; "
        "hil.run('paper_circle', set={'loop.duration_s': 0.1, 'expect': []}); print('ran')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment()
    )
    assert done.stdout == "ran\n"


def test_a_users_test_is_typed(tmp_path: Path):
    pytest.importorskip("mypy", reason="install mypy")
    (tmp_path / "test_everyday.py").write_text(EVERYDAY_TEST)
    (tmp_path / "test_wrong.py").write_text(EVERYDAY_TEST.replace("check=", "chek="))
    for package in ("hil", "firmware_protocol", "plant_fmu"):
        assert (ROOT / package / "py.typed").is_file()
    check = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(ROOT / ".mypy_cache")]
    # As a user's own: what is installed for a later Python, NumPy's stubs among it, may not be readable as 3.11.
    check += ["--python-version", "{}.{}".format(*sys.version_info)]
    said = {}
    for name in ("test_everyday.py", "test_wrong.py"):
        done = subprocess.run(
            [*check, "--config-file", str(ROOT / "pyproject.toml"), name],
            cwd=tmp_path,
            env=environment() | {"MYPYPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        said[name] = done.stdout
    assert said["test_everyday.py"] == "Success: no issues found in 1 source file\n"
    assert 'Unexpected keyword argument "chek" for "__call__" of "RunScenario"' in said["test_wrong.py"]


def test_the_page_is_true(suite: pytest.Pytester):
    """Its files run as they stand there, and its failure is what a failure looks like."""
    page = (ROOT / "hil" / "addons" / "testing" / "PYTEST.md").read_text()
    files = [(name, block.text) for block in blocks(page) if (name := block.options.get("caption")) is not None]
    assert len(files) == 2
    (suite.path / "tests").mkdir()
    for name, text in files:
        (suite.path / name).write_text(text)
    run(suite, "-m", "hil").assert_outcomes(passed=5)

    [shown] = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    done = run(suite, "-k", "heavy", "--hil-set", "plant.start.mass_kg=32")
    done.assert_outcomes(failed=1, deselected=4)
    output = timeless(done.stdout.str())
    for line in timeless(shown).splitlines()[1:]:
        assert line in output


def timeless(text: str) -> str:
    """Return the text without the parts that depend on the machine or on a random number."""
    return re.sub(r"\S*/heavy_circle.rrd|(?<=failed, )\S+ at t = \S+|(?<=applied )\d+", "#", text)
