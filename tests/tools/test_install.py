"""The wheel on a machine without a C compiler: built, installed into a fresh environment, and run from there.

No extra is installed at first, so what runs here needs none.
"""

import email
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from functools import partial
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

import plant_fmu
from firmware_protocol.built import EXTENSION_SUFFIX, SUFFIX
from plant_fmu.sources import DESCRIPTIONS

ROOT = Path(__file__).parents[2]
NOT_SOURCES = shutil.ignore_patterns(".*", "__pycache__", "*.so", "*.dylib", "*.dll", "*.fmu", "runs", "dist")


def run(*command: str | Path, cwd: Path, environment: dict[str, str]) -> str:
    """Run a command that has to succeed and return its output."""
    done = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


NEED_AN_EXTRA = {
    "service": [["serve", "paper_circle"], ["ctl", "status"]],
    "plots": [
        ["review", "run.rrd", "--html", "run.html"],
        ["compare", "pid", "paper_circle", "--html", "compared.html"],
        ["reproduce", "--quick"],
        ["campaign", "report", "."],
    ],
    "hunt": [["hunt", "paper_circle"]],
    "mpc": [["run", "paper_circle", "--set", "controller.law=mpc"]],
    "targets": [["device", "paper_circle", "--link", "serial:pty", "--target", "unicorn"]],
}


def over_a_line(hil: Path, circle: Iterable[str], folder: Path, environment: dict[str, str]) -> None:
    """Run the circle on a virtual robot in another process, over a pseudo terminal."""
    with subprocess.Popen(
        [hil, "device", "paper_circle", "--link", "serial:pty"],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as device:
        assert device.stdout is not None
        facts = dict(word.partition("=")[::2] for word in device.stdout.readline().split())
        try:
            said = run(
                hil,
                *(*circle, "--record", "none", "--link", facts["link"], "--truth", facts["truth"]),
                cwd=folder,
                environment=environment,
            )
        finally:
            device.terminate()
    assert json.loads(said)["passed"] is True


def link_packages(site: Path, requirements: Iterable[str], extra: str = "") -> None:
    """Put links to packages of this environment into another one: those required, and what they declare to need."""
    waiting, seen = [(Requirement(words), (extra,)) for words in requirements], set[str]()
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
    assert {*fmus, f"firmware_protocol/_wheel{EXTENSION_SUFFIX}", f"hil/plant/libcosim{SUFFIX}"} <= names
    assert {"hil/addons/testing/plugin.py", "hil/py.typed", "firmware_protocol/py.typed", "plant_fmu/py.typed"} <= names
    pages = {
        "runtime/LIMITS.md",
        "addons/testing/PYTEST.md",
        "laws/LAWS.md",
        "record/RECORDING.md",
        "faults/FAULTS.md",
        "wire/LINKS.md",
        "wire/STATISTICS.md",
    }
    assert {f"hil/{page}" for page in pages} <= names
    assert "[pytest11]\nhil.addons.testing.plugin = hil.addons.testing.plugin" in entry_points
    assert re.fullmatch(r"mecanum_hil-[\d.]+-cp311-abi3-(?!any)\w+\.whl", wheel.name), "one for all Pythons"

    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv", cwd=tmp_path, environment=bare)
    scripts = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    python, hil = scripts / "python", scripts / "hil"
    there = [*pip, "--python", python]
    # Only the wheel's declared needs: make has fetched them for this environment, by the same declaration.
    [site] = (tmp_path / "venv").rglob("site-packages")
    with zipfile.ZipFile(wheel) as archive:
        [about] = [archive.read(name) for name in names if name.endswith(".dist-info/METADATA")]
    requirements = email.message_from_bytes(about).get_all("Requires-Dist", [])
    link_packages(site, requirements)
    install = (*there, "install", "--no-index", "--no-compile", "--find-links", wheels)
    run(*install, "mecanum-hil", cwd=tmp_path, environment=bare)
    assert "No broken requirements" in run(*there, "check", cwd=tmp_path, environment=bare)
    short = ("--set", "loop.duration_s=2", "--set", "expect.1.from_s=1", "--set", "expect.1.to_s=2")
    circle = ("run", "paper_circle", *short, "--json")
    run_here = partial(run, hil, cwd=tmp_path, environment=bare)
    assert json.loads(run_here(*circle, "--record", "run.rrd"))["passed"] is True
    assert run_here("review", "run.rrd").startswith("PASSED")
    over_a_line(hil, circle, tmp_path, bare)
    for fmu in sorted(Path(name).stem for name in fmus):
        assert "no violations" in run(hil, "fmu", "check", fmu, cwd=tmp_path, environment=bare)

    # pytest is a dependency, and finds the plugin by itself.
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "circle.hil.toml").write_text(
        'extends = "paper_circle"\nloop.duration_s = 0.2\nexpect = []\n'
    )
    assert "1 passed" in run(python, "-m", "pytest", "suite", cwd=tmp_path, environment=bare)

    for extra, commands in NEED_AN_EXTRA.items():
        for words in commands:
            done = subprocess.run([hil, *words], cwd=tmp_path, env=bare, capture_output=True, text=True, check=False)
            assert done.returncode == 2, done.stdout + done.stderr
            told = r"hil: .+ needs .+ not installed; run: venv/bin/python3? -m pip install 'mecanum-hil\[(.+)\]'\n"
            assert (found := re.fullmatch(told, done.stderr)), done.stderr
            assert found[1] == extra
        # The named command finds our package without an index; make has fetched the packages of the extra.
        link_packages(site, [text for text in requirements if f"extra == '{extra}'" in text], extra)
        again = run(*there, "install", "--no-index", f"mecanum-hil[{extra}]", cwd=tmp_path, environment=bare)
        assert "Successfully" not in again
    run_here("review", "run.rrd", "--html", "run.html")
