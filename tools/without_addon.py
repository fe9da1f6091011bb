"""Removes an add-on's folder from a copy of the checkout, and runs the rest: ``python -m tools.without_addon batch``.

The copy is ``build/without/NAME``; the add-ons that import this one are removed too. There the demo runs, and the tests
of the core, of the firmware and of the plant. A test file that imports the add-on, or that runs one of its commands, is
left out and named. ``--number N`` takes the add-on with that number, in turns; without a name each is taken.
``--quick`` collects all these tests and runs the quick ones of ``QUICK``: one processor for a minute. Other options go
to pytest, as in ``-m 'not slow'``. Exits with 1 when something fails.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

from firmware_protocol.built import ROOT
from hil.core.extensions import addon_commands

ADDONS = sorted(path.parent.name for path in (ROOT / "hil" / "addons").glob("*/__init__.py"))
DEPENDENTS = {"service": ("ros2",), "batch": ("verify",)}
"""The add-ons that import another one; the contracts of pyproject.toml allow no more."""
PLUGIN = "hil.addons.testing.plugin"
NEEDS = "HIL_NEEDS_ADDON"
"""The environment variable with what a test file holds that needs the removed add-ons, as a regular expression."""
TESTED = (
    "core", "laws", "references", "estimation", "faults", "wire", "plant", "robot", "scenario", "runtime", "judge",
    "record", "cli", "firmware_protocol", "plant_fmu",
)  # fmt: skip
QUICK = ("core", "scenario", "cli")


def copy_without(names: Sequence[str], folder: Path) -> None:
    """Copy the tracked files and their build results, except these add-ons and their tests."""
    shutil.rmtree(folder, ignore_errors=True)
    removed = tuple(f"{top}/addons/{name}/" for top in ("hil", "tests") for name in names)
    for options in (
        ("--cached",),
        ("--others", "--ignored", "--exclude-standard", "--", "hil", "plant_fmu", "firmware_protocol"),
    ):
        listed = subprocess.run(
            ["git", "ls-files", "-z", *options], cwd=ROOT, capture_output=True, text=True, check=True
        )
        for file in filter(None, listed.stdout.split("\0")):
            if "__pycache__" not in file and not file.startswith(removed) and (ROOT / file).is_file():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / file, folder / file)


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out a test file that needs the removed add-ons by itself, or through a helper, a tool or other tests.

    This module is a plugin of the pytest in the copy, and of its workers.
    """
    if collection_path.is_dir() or not collection_path.name.startswith("test_"):
        return None
    return True if _needs_it(collection_path) else None


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the folders of ``--quick``."""
    parser.addoption("--rooms", help="run only the tests of these folders, of all that are collected")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests of other folders, which were imported."""
    if rooms := config.getoption("--rooms"):
        items[:] = [
            one for one in items if one.path.relative_to(config.rootpath / "tests").parts[0] in rooms.split(",")
        ]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the files that were left out."""
    files = sorted(
        path for room in TESTED for path in Path("tests", room).glob("test_*.py") if _needs_it(path.absolute())
    )
    terminalreporter.write_line(f"left out: {', '.join(path.stem for path in files) or 'none'}")


@cache
def _needs_it(file: Path) -> bool:
    text = file.read_text(encoding="utf-8")
    if re.search(os.environ[NEEDS], text):
        return True
    helpers = set()
    for place, names in re.findall(r"from ((?:tests|tools)(?:\.\w+)*) import (?:\(|([\w, ]+))", text):
        path = Path(*place.split("."))
        helpers |= {path.with_suffix(".py"), *(path / f"{name}.py" for name in names.split(", "))}
    return any(_needs_it(path) for path in helpers if path.exists() and path.absolute() != file.absolute())


def check(name: str, arguments: Sequence[str], *, quick: bool = False) -> bool:
    """Return whether the demo and the tests pass without an add-on."""
    names = (name, *DEPENDENTS.get(name, ()))
    folder = ROOT / "build" / "without" / name
    copy_without(names, folder)
    print(f"without {' and '.join(names)}", flush=True)
    places = tuple(f"hil.addons.{one}." for one in names)
    commands = "|".join(command for command, row in addon_commands().items() if row.place.startswith(places)) or "(?!)"
    package = rf"\bhil\.addons\.(?:{'|'.join(names)})\b"
    needs = rf'{package}|\bhil\(\s*"(?:{commands})"|HIL,\s*"(?:{commands})"|\["(?:{commands})"'
    # The copy has no history of git: a test that needs one is skipped, which is a failure in CI.
    variables = os.environ | {"PYTHONPATH": str(folder), NEEDS: needs, "HIL_CI": ""}
    demo = ("hil", "run", "paper_circle", "--force")
    chosen = (
        ("-m", "not slow and not alone", f"--rooms={','.join(QUICK)}") if quick else ("-n", "auto", "-m", "not alone")
    )
    rooms = (f"tests/{room}" for room in TESTED)
    tests = ("pytest", "-q", "-p", "tools.without_addon", *rooms, *chosen, *arguments)
    if "testing" in names:  # its plugin is named by the checkout and by the installation
        project = folder / "pyproject.toml"
        project.write_text(project.read_text(encoding="utf-8").replace(f"-p {PLUGIN} ", ""), encoding="utf-8")
        tests += ("-p", f"no:{PLUGIN}")
    passed = all(
        subprocess.run([sys.executable, "-m", *command], cwd=folder, env=variables, check=False).returncode == 0
        for command in (demo, tests)
    )
    print(f"without {' and '.join(names)}: {'passed' if passed else 'FAILED'}", flush=True)
    return passed


def main() -> None:
    """Check without each add-on that is asked for."""
    parser = argparse.ArgumentParser(prog="tools.without_addon", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("addon", nargs="?", choices=ADDONS)
    parser.add_argument("--number", type=int, help="take one add-on, by this number")
    parser.add_argument("--quick", action="store_true", help=f"run only the quick tests of {', '.join(QUICK)}")
    options, arguments = parser.parse_known_args()
    names = [options.addon] if options.addon else ADDONS
    if options.number is not None:
        names = [ADDONS[options.number % len(ADDONS)]]
    passed = [check(name, arguments, quick=options.quick) for name in names]
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
