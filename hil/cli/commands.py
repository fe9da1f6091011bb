"""The commands of ``hil`` by name: the core's, the add-ons', and those of other packages.

A command is imported when it is called. To add one, write a function and a row of ``CORE``, or of ``COMMANDS`` of its
add-on. Another package registers a function or a ``typer.Typer`` under the entry point group ``hil.commands``.
"""

from collections.abc import Mapping
from pkgutil import resolve_name
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from hil.core.errors import BadInputError
from hil.core.extensions import Command, Extensions, addon_commands
from hil.core.interrupts import ends_at_once

TASKS = ("Run", "Look", "Compare and repeat", "Connect and drive", "Your robot", "Tools")
"""The headings of ``hil --help``."""
CORE: Mapping[str, Command] = {
    "run": Command("Run", "hil.cli.run:run", "Run a scenario and judge it."),
    "check": Command(
        "Run",
        "hil.cli.check:check",
        "Check scenarios without running them: their values, laws, FMU, and whether the robot can follow the "
        "reference.",
    ),
    "show": Command("Run", "hil.cli.check:show", "Print every value of a scenario and where it came from."),
    "device": Command(
        "Connect and drive",
        "hil.cli.device:device",
        "Run the scenario's virtual robot in a process of its own; print one line when ready.",
    ),
    "params": Command(
        "Your robot",
        "hil.cli.params:params",
        "Show and change the parameters of a robot's firmware; it must be in IDLE to change. All are checked first.",
    ),
    "list": Command(
        "Tools", "hil.cli.list:list_", "Print signals, figures, laws, references, scenarios, links, faults or drivers."
    ),
}
"""The commands of the core by name."""


def shipped() -> Mapping[str, Command]:
    """Return the commands of the core and of the add-ons that are installed, by name."""
    return {**CORE, **addon_commands()}


def by_task() -> Mapping[str, Mapping[str, str]]:
    """Return the text of each shipped command by name, below each task."""
    return {task: {name: c.text for name, c in shipped().items() if c.task == task} for task in TASKS}


def _extensions() -> Extensions:
    return Extensions("hil.commands", shipped())


class Group(TyperGroup):
    """A group of commands whose help shows the first paragraph of each in full; typer would cut it to one line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a row for each command, wrapped to the width of the terminal."""
        helps = {name: command.help or "" for name, command in self.commands.items() if not command.hidden}
        with formatter.section("Commands"):
            formatter.write_dl([(name, " ".join(text.partition("\n\n")[0].split())) for name, text in helps.items()])


class Commands(TyperGroup):
    """The group ``hil``. Its help prints the shipped commands, then those of other packages; it imports none."""

    _completes = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, shipped ones first."""
        return _extensions().names()

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return what completes a command's name, for a shell. No command is imported."""
        self._completes = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._completes = False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command. Raises BadInputError for an unknown one, and for a broken one of another package."""
        ours = shipped().get(cmd_name)
        if self._completes:
            return TyperCommand(cmd_name, help=None if ours is None else ours.text)
        if ours is not None:
            return _command(cmd_name, shipped_command(cmd_name))
        found = _extensions().load(cmd_name, f"command {cmd_name!r}")
        try:
            return _command(cmd_name, found)
        except Exception as error:
            raise BadInputError(
                f"command {cmd_name!r}: {found!r} is not a command ({type(error).__name__}: {error}); expected a "
                "function or a typer.Typer, see https://typer.tiangolo.com"
            ) from error

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a row for each command, wrapped to the width of the terminal."""
        longest = max(map(len, shipped()))
        for task, rows in by_task().items():
            if rows:
                with formatter.section(task):
                    # As wide as the longest name, so that the texts of all groups are one column.
                    formatter.write_dl([(f"{name:<{longest}}", text) for name, text in rows.items()])
        if others := _extensions().lines():
            with formatter.section("Commands of other packages"):
                formatter.write_dl([(name, f"{package}: {text}") for name, package, text in others])


def shipped_command(name: str) -> Any:
    """Import a shipped command: a function or a ``typer.Typer``."""
    with ends_at_once():
        return resolve_name(shipped()[name].place)


def _command(name: str, found: Any) -> Any:
    holder = typer.Typer(rich_markup_mode=None, add_completion=False)
    holder.callback()(lambda: None)
    if isinstance(found, typer.Typer):
        holder.add_typer(found, name=name)
    else:
        holder.command(name, context_settings=getattr(found, "context_settings", None))(found)
    return get_group(holder).commands[name]
