"""The wheel on a machine without a C compiler: built, installed into a fresh environment, and run from there."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

import plant_fmu
from firmware_protocol.built import SUFFIX
from plant_fmu.sources import DESCRIPTIONS

ROOT = Path(__file__).parents[1]
NOT_SOURCES = shutil.ignore_patterns(".*", "__pycache__", "*.so", "*.dylib", "*.dll", "*.fmu", "runs", "dist")


def run(*command: str | Path, cwd: Path, environment: dict[str, str]) -> str:
    """Run a command that has to succeed and return what it printed."""
    done = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def link_packages(site: Path, requirements: Iterable[str]) -> None:
    """Put links to packages of this environment into another one: those required, and what they declare to need."""
    waiting, seen = [(Requirement(words), ("",)) for words in requirements], set[str]()
    while waiting:
        required, extras_of_asker = waiting.pop()
        applies = required.marker is None or any(required.marker.evaluate({"extra": one}) for one in extras_of_asker)
        if not applies or str(required) in seen:
            continue
        seen.add(str(required))
        package = distribution(required.name)
        for top in {file.parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(str(package.locate_file(top)))
        waiting += [(Requirement(words), ("", *required.extras)) for words in package.requires or ()]


def test_a_machine_without_a_compiler_builds_installs_and_runs_the_wheel(tmp_path: Path) -> None:
    """Zig comes as a build requirement. The wheel is made of the source distribution, which is therefore whole."""
    tree, sources, wheels = tmp_path / "tree", tmp_path / "sources", tmp_path / "wheels"
    shutil.copytree(ROOT, tree, ignore=NOT_SOURCES)
    (tmp_path / "no-tools").mkdir()
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV", "CC"))}
    bare = {**kept, "PATH": str(tmp_path / "no-tools")}
    assert shutil.which("cc", path=bare["PATH"]) is None

    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", sources, cwd=tree, environment=bare)
    [source] = sources.iterdir()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    run(*pip, "wheel", "--no-deps", "--wheel-dir", wheels, source, cwd=tmp_path, environment=bare)
    [wheel] = wheels.iterdir()
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        [entry_points] = [archive.read(name).decode() for name in names if name.endswith("/entry_points.txt")]
    fmus = {f"plant_fmu/{plant_fmu.path(fmi).name}" for fmi in DESCRIPTIONS}
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {
        "hil",
        "plant_fmu",
        "firmware_protocol",
    }
    assert {*fmus, f"firmware_protocol/libwheel_host{SUFFIX}", f"hil/plant/libcosim{SUFFIX}"} <= names
    assert {"hil/cli/pytest_plugin.py", "hil/py.typed", "firmware_protocol/py.typed", "plant_fmu/py.typed"} <= names
    pages = {
        "runtime/LIMITS.md",
        "cli/testing/PYTEST.md",
        "laws/LAWS.md",
        "laws/SHADOWS.md",
        "record/STREAMS.md",
        "faults/FAULTS.md",
        "wire/LINKS.md",
        "wire/STATISTICS.md",
    }
    assert {f"hil/{page}" for page in pages} <= names
    assert "[pytest11]\nhil.cli.pytest_plugin = hil.cli.pytest_plugin" in entry_points
    assert re.fullmatch(r"mecanum_hil-[\d.]+-py3-none-(?!any)\w+\.whl", wheel.name), "one for all Pythons"

    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv", cwd=tmp_path, environment=bare)
    scripts = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    python, hil = scripts / "python", scripts / "hil"
    there = [*pip, "--python", python]
    run(*there, "install", "--no-deps", "--no-index", "--no-compile", wheel, cwd=tmp_path, environment=bare)
    # Nothing but what the wheel declares to need: make has fetched it for this environment, by the same declaration.
    [installed] = (tmp_path / "venv").rglob("mecanum_hil-*.dist-info")
    link_packages(installed.parent, Distribution.at(installed).requires or ())
    assert "No broken requirements" in run(*there, "check", cwd=tmp_path, environment=bare)
    short = ("--set", "loop.duration_s=2", "--set", "expect.1.from_s=1", "--set", "expect.1.to_s=2")
    said = run(hil, "run", "paper_circle", *short, "--record", "none", "--json", cwd=tmp_path, environment=bare)
    assert json.loads(said)["passed"] is True
    for fmu in sorted(Path(name).stem for name in fmus):
        assert "no violations" in run(hil, "fmu", "check", fmu, cwd=tmp_path, environment=bare)

    # pytest is the user's own, and finds the plugin by itself.
    link_packages(installed.parent, ["pytest"])
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "circle.hil.toml").write_text(
        'extends = "paper_circle"\nloop.duration_s = 0.2\nexpect = []\n'
    )
    assert "1 passed" in run(python, "-m", "pytest", "suite", cwd=tmp_path, environment=bare)
