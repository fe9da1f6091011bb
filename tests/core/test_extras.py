"""The extras: the imports of each match pyproject.toml, and a missing package is named with its extra."""

import importlib.metadata
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from hil.core import extras
from hil.core.errors import BadInputError

ROOT = Path(__file__).parents[2]
OF_OTHERS = {"mujoco", "ros2", "dev", "all"}
"""Extras that only a build or a sourced installation needs, with messages of their own."""


def declared() -> dict[str, list[Requirement]]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {name: [*map(Requirement, texts)] for name, texts in project["optional-dependencies"].items()}


def test_every_extra_is_known_by_what_is_imported_of_it() -> None:
    assert extras.EXTRAS.keys() | OF_OTHERS == declared().keys()
    packages = importlib.metadata.packages_distributions()
    for extra, modules in extras.EXTRAS.items():
        named = {canonicalize_name(one.name) for one in declared()[extra]}
        for module in modules:
            assert {canonicalize_name(name) for name in packages[module]} & named, (
                f"{module} is of no package of {extra}"
            )


def test_what_is_always_installed_is_in_no_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    always = {Requirement(text).name for text in project["dependencies"]}
    assert {"fmpy", "pyserial", "python-can", "rerun-sdk", "numpy", "pytest"} <= always
    assert not always & {one.name for name, some in declared().items() if name != "dev" for one in some}


def test_all_has_every_extra_of_a_user() -> None:
    [everything] = declared()["all"]
    assert everything.extras == declared().keys() - {"ros2", "dev", "all"}


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command is typed as it is printed, and pip takes it: the extra is of the package that is installed."""
    monkeypatch.setitem(extras.EXTRAS, "hunt", ("no_such_module",))
    monkeypatch.delenv("VIRTUAL_ENV", raising=False)
    with pytest.raises(BadInputError) as raised:
        extras.need("hunt", "hil hunt")
    found = re.fullmatch(r"hil hunt needs no_such_module, which is not installed; run: (.+)", str(raised.value))
    assert found is not None
    python, *words = shlex.split(found[1])
    assert Path(python).absolute() == Path(sys.executable)
    done = subprocess.run([python, *words, "--no-index"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "mecanum-hil[hunt]" in done.stdout


def test_of_several_extras_those_that_are_missing_are_named_in_one_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(extras.EXTRAS, "hunt", ("no_such_module",))
    monkeypatch.setitem(extras.EXTRAS, "mpc", ("nor_this_one", "json"))
    with pytest.raises(BadInputError, match=r"a test needs no_such_module, nor_this_one, which are .*\[hunt,mpc\]'$"):
        extras.need("hunt,dbc,mpc", "a test")


def test_a_package_that_is_there_is_not_needed() -> None:
    for extra in extras.EXTRAS:
        extras.need(extra, "a test")
