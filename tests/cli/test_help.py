"""The command line as a whole: groups, help that fits, the same option by the same words, versions, completion."""

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.main import get_group

import hil
import hil.__main__
from hil.cli.commands import by_task, shipped
from hil.cli.main import app
from hil.cli.output import folded, table
from hil.judge.recorded import load
from hil.judge.result import RunResult
from hil.runtime import assembly
from tests.support.processes import environment
from tests.support.processes import hil as call

ANOTHER_MEANING = {
    ("--driver", "hil device"),  # sets it for the run; hil probe looks for one
    ("--driver", "hil probe"),
    ("--json", "hil decode"),  # an object a line
    ("--law", "hil catalogue"),  # with its default gains
    ("--link", "hil catalogue"),  # which of three it takes
    ("--live", "hil serve"),  # which is no run
    ("--mass-kg", "hil identify fit"),  # weighed, not proposed
    *(("--pictures", f"hil {name}") for name in ("compare", "catalogue", "campaign report")),  # beside the page
    ("--port", "hil live"),  # of viewers
    ("--record", "hil replay"),  # without a name there is none
    ("--record", "hil serve"),  # a name in its folder; none by default
    ("--law", "hil replay"),  # alone
    ("--scenario", "hil replay"),  # in place of the recorded one
    *(("--seed", f"hil {name}") for name in ("catalogue", "verify", "identify drive")),  # of their own choices
    ("--set", "hil ctl track"),  # an option of the reference
    ("--token-file", "hil serve"),  # which makes the token
}
"""Options by whose name a command means something of its own."""
OF_EACH_COMMAND = {"--contact", "--for", "--out", "--quick", "--room", "--sample", "--speed"}
"""Options by whose name each command means something of its own."""


def commands(command: Any, name: str = "hil") -> Iterator[tuple[str, Any]]:
    """Yield every command with its name, groups too."""
    yield name, command
    if hasattr(command, "list_commands"):
        context = typer.Context(command)
        for one in command.list_commands(context):
            yield from commands(command.get_command(context, one), f"{name} {one}")


ALL = dict(commands(get_group(app)))


def options() -> Iterator[tuple[str, str, Any]]:
    """Yield the command, the flag and the option of every option."""
    for name, command in ALL.items():
        for one in command.params:
            if one.param_type_name == "option":
                yield name, one.opts[0], one


@pytest.mark.parametrize("columns", [80, 120])
def test_every_help_fits_and_is_not_cut(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for name, command in ALL.items():
        text = command.get_help(command.make_context(name, [], resilient_parsing=True, max_content_width=120))
        assert [line for line in text.splitlines() if len(line) > columns] == [], name
        cut = [line for line in text.splitlines() if line.endswith("...") and not line.startswith("Usage")]
        assert cut == [], name


def test_usage_brackets_an_argument_once() -> None:
    """typer adds the brackets of optional arguments, and the dots of repeatable ones."""
    for name, command in ALL.items():
        for one in command.params:
            if one.param_type_name == "argument":
                assert not set(one.metavar) & set("[]{}"), name
                assert not one.metavar.endswith("."), name


def test_help_shows_the_commands_by_task() -> None:
    text = call("--help").stdout
    places = [text.index(f"\n{task}:\n") for task, rows in by_task().items() if rows]
    assert places == sorted(places)
    assert all(f"\n  {name} " in text for name in shipped())


def test_an_option_that_commands_share_has_one_form_in_all() -> None:
    """The same name is the same meaning, type and range, but for those that are listed."""
    forms: dict[tuple[str, str], set[tuple[object, ...]]] = defaultdict(set)
    for name, flag, option in options():
        kind = option.type_descriptor.annotation, option.is_flag, option.multiple
        limits = [getattr(option, end, None) for end in ("min", "max")]
        own = name if (flag, name) in ANOTHER_MEANING or flag in OF_EACH_COMMAND else ""
        forms[flag, own].add((option.metavar, option.help, *kind, *limits))
    assert [place for place, found in forms.items() if len(found) > 1] == []
    listed = {(flag, own) for flag, own in forms if own and flag not in OF_EACH_COMMAND}
    # Not of an add-on that has been removed.
    assert listed == {(flag, name) for flag, name in ANOTHER_MEANING if name.split()[1] in shipped()}
    needless = [place for place, found in forms.items() if place[1] and found == forms.get((place[0], ""))]
    assert needless == []


def test_an_option_takes_a_value_in_all_commands_or_in_none() -> None:
    assert {flag for _, flag, option in options() if option.is_flag} & {
        flag for _, flag, option in options() if not option.is_flag
    } == set()


def test_an_output_is_a_folder_or_a_file_by_its_endings() -> None:
    forms = {option.metavar for _, flag, option in options() if flag in ("--out", "--html", "--export")}
    assert all(form == "DIR" or form.startswith("FILE.") for form in forms), forms


def test_pictures_come_in_three_formats_wherever_there_are_some() -> None:
    forms = {(name, option.metavar) for name, flag, option in options() if flag == "--pictures"}
    named = ("catalogue", "compare", "reproduce", "campaign report")
    with_pictures = {f"hil {name}" for name in named} & ALL.keys()
    assert forms == {(name, "png|svg|pdf") for name in with_pictures}


def test_every_option_that_takes_a_value_names_it_and_is_explained() -> None:
    bare = [f"{name} {flag}" for name, flag, option in options() if not option.is_flag and not option.metavar]
    assert [one for one in bare if "completion" not in one] == []
    unexplained = [f"{name} {flag}" for name, flag, option in options() if not option.help]
    assert unexplained == []
    words = {option.metavar for _, _, option in options()}
    assert words & {"FOLDER", "SECONDS", "METRE", "M_S", "RAD_S", "RECORDING"} == set()


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("what", ["faults", "drivers", "signals", "figures"])
def test_lists_fit_the_terminal_and_lose_no_word(what: str, columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.cli.list import listing

    monkeypatch.setattr("hil.cli.output.terminal_width", lambda: columns)
    head, rows = listing(what)
    lines = list(table([head, *rows]))
    assert max(map(len, lines)) <= columns
    for row in rows:
        assert {word for cell in row for word in cell.split()} <= {word for line in lines for word in line.split()}


def test_what_goes_to_a_file_is_not_folded() -> None:
    lines = call("list", "faults").stdout.splitlines()
    assert any(len(line) > 300 for line in lines)


def test_a_long_line_hangs_below_its_text_and_a_command_stays_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.cli.output.terminal_width", lambda _stream: 60)
    line = "note     kernel          " + "a real-time kernel makes ticks less late " * 2
    first, *others = folded(line.rstrip())
    assert first.startswith("note     kernel          a real-time")
    assert all(one.startswith(" " * 25) and one[25] != " " and len(one) <= 60 for one in others)
    command = f"  .venv/bin/hil run {'x' * 80}"
    assert folded(command) == [command]


def test_the_module_is_the_command_and_says_its_version() -> None:
    done = subprocess.run([sys.executable, "-m", "hil", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"hil {hil.__version__}\n"


def test_the_package_has_what_a_program_needs_and_imports_it_when_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (hil.run, hil.RunResult, hil.load) == (assembly.run, RunResult, load)
    assert set(hil.__all__) <= {*dir(hil), "run", "RunResult", "load"}
    with pytest.raises(AttributeError, match=r"^module 'hil' has no attribute 'laod'$"):
        hil.laod  # noqa: B018
    called: list[str] = []
    monkeypatch.setattr("hil.cli.main.main", lambda: called.append("main"))
    hil.__main__.main()
    assert called == ["main"]


def test_a_shell_completes_commands_and_options() -> None:
    def completed(words: str) -> set[str]:
        count = str(len(words.split(" ")) - 1)
        asked = {"_HIL_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": count}
        command = [sys.executable, "-c", "from hil.cli.main import main; main()"]
        variables = {**os.environ, **environment(), **asked}
        return set(subprocess.run(command, env=variables, capture_output=True, text=True, check=False).stdout.split())

    assert completed("hil re") == {"review", "replay", "reproduce"} & shipped().keys()
    assert {"--robot", "--record"} <= completed("hil run --r")
