"""The commands of ``hil``: a table of ours, and those that other packages register as entry points."""

import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from hil.cli.commands import CORE, shipped, shipped_command
from hil.cli.main import app
from hil.core.errors import BadInputError
from tests.support.addon_commands import flags_that_are_on
from tests.support.outside import outside_package
from tests.support.processes import hil

OUTSIDE = """
    import typer

    app = typer.Typer(help="Two of them.")

    @app.command()
    def one(times: int = 2):
        print("one" * times)

    @app.command()
    def two():
        pass

    def wheels(count: int):
        '''Count wheels.'''
        print(f"{count} wheels")

    no_command = 7
"""
POINTS = {
    "tools": "outside_package:app",
    "wheels": "outside_package:wheels",
    "number": "outside_package:no_command",
    "gone": "outside_package:gone",
    "absent": "no_such_package:app",
    "run": "outside_package:wheels",
}


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return outside_package(tmp_path, monkeypatch, OUTSIDE, {"hil.commands": POINTS})


@pytest.mark.parametrize(("name", "row"), [(name, c.text) for name, c in shipped().items()], ids=shipped())
def test_a_row_has_the_first_paragraph_of_its_commands_help(name: str, row: str) -> None:
    command = shipped_command(name)
    text = command.info.help if isinstance(command, typer.Typer) else command.__doc__
    assert " ".join(text.partition("\n\n")[0].split()) == row


def test_no_flag_of_the_cores_commands_is_on_by_itself() -> None:
    assert flags_that_are_on(CORE) == []


def test_commands_of_another_package_run(outside: Path) -> None:
    assert CliRunner().invoke(app, ["tools", "one", "--times", "3"]).output == "oneoneone\n"
    assert CliRunner().invoke(app, ["wheels", "4"]).output == "4 wheels\n"
    assert "Count wheels." in CliRunner().invoke(app, ["wheels", "--help"]).output


def test_help_lists_them_and_imports_none(outside: Path) -> None:
    shown = CliRunner().invoke(app, ["--help"]).output
    assert "wheels  outside-package: outside_package:wheels" in " ".join(shown.split()).replace(
        "wheels out", "wheels  out"
    )
    assert "run outside-package: not used: a shipped one has this name" in " ".join(shown.split())
    CliRunner().invoke(app, ["list", "links"])
    assert "outside_package" not in sys.modules


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("absent", "of the package outside-package: 'no_such_package:app' cannot be loaded: ModuleNotFoundError"),
        ("gone", "'outside_package:gone' cannot be loaded: AttributeError"),
        ("number", "command 'number': 7 is not a command"),
        ("wheel", "command 'wheel': unknown; did you mean 'wheels'?"),
    ],
)
def test_a_broken_one_is_told_in_a_sentence(outside: Path, name: str, words: str) -> None:
    error = CliRunner().invoke(app, [name]).exception
    assert isinstance(error, BadInputError)
    assert words in str(error)


def test_a_broken_one_leaves_the_others_alone(outside: Path) -> None:
    broken = hil("absent", cwd=outside)
    assert (broken.returncode, broken.stderr.count("\n")) == (2, 1)
    assert broken.stderr.startswith("hil: command 'absent'")
    assert hil("list", "links", cwd=outside).returncode == 0
