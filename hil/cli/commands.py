"""The commands of ``hil`` by name: shipped ones, and those of other packages. A command is imported when it is called.

To add a shipped one, write a file with a function of the command's name, and a row of ``GROUPS``. Another package
registers a function or a ``typer.Typer`` under the entry point group ``hil.commands``.
"""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.core.interrupts import ends_at_once

GROUPS = {
    "Run": {
        "run": "Run a scenario and judge it.",
        "check": "Check scenarios without running them: their values, laws, FMU, and whether the robot can "
        "follow the reference.",
        "show": "Print every value of a scenario and where it came from.",
        "baseline": "Write the figures of a scenario's runs beside it, for later runs to be compared with.",
    },
    "Look": {
        "review": "Report from its recording alone how a run went and why; with two runs, which figures became "
        "better or worse.",
        "view": "Open a recording in the rerun viewer.",
        "live": "Open the rerun viewer on a run or service under way, and on each one after it; start it before "
        "or after those.",
        "replay": "Open loop: feed a recording's states and references to another law, and show how its "
        "commands differ.",
        "decode": "Print a trace of the bus in the terms of the wheel-command protocol.",
    },
    "Compare and repeat": {
        "compare": "Run laws under the same conditions and print one table for each; exit 1 when a run failed.",
        "campaign": "Run a scenario thousands of times, over axes, laws, faults and seeds, and judge it on one page.",
        "hunt": "Search for a run that breaks an expectation, make it as small as possible and save it; exit 1 "
        "when found.",
        "catalogue": "Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be.",
        "verify": "Put known defects into a suite of tests, one at a time, and say which it notices; exit 1 "
        "when one survives.",
        "reproduce": "Run section IV of the paper and say which of its figures come out, which do not, and why.",
    },
    "Connect and drive": {
        "device": "Run the scenario's virtual robot in a process of its own; print one line when ready.",
        "serve": "Serve a robot: armed, driven and recorded by `hil ctl` or over HTTP, until SIGTERM.",
        "ctl": "Drive the robot that hil serve runs; an order returns when accepted.",
        "ros2": "Be a ROS 2 node for a robot or its simulation: cmd_vel in; odometry, tf, joint states and more out.",
        "teleop": "Drive the robot that hil serve runs, by hand: it moves while a key or the gamepad's button is held.",
    },
    "Your robot": {
        "init": "Write what tests your robot: its file, a law, scenarios, tests, a baseline and a CI workflow.",
        "commission": "Find out, step by step, how a robot is wired, on blocks and on the floor, and write it "
        "into its file.",
        "identify": "Drive your robot so that it shows what it is made of, and fit a plant to the recordings.",
        "probe": "Find the motor controllers on a bus or a port, and print a robot file for them.",
        "jog": "Turn one wheel slowly, with its name typed first, to check order and direction of the motors.",
        "params": "Show and change the parameters of a robot's firmware; it must be in IDLE to change. All are "
        "checked first.",
    },
    "Tools": {
        "list": "Print signals, figures, laws, references, scenarios, those of the suite, links, faults or drivers.",
        "doctor": "Check this machine and print remedies; exit 1 when there is a problem.",
        "fmu": "The plant: build, look at and check FMUs.",
        "export": "Write a robot for other programs: its description as a URDF.",
        "fuzzy": "Draw both gain surfaces of AFDSC's fuzzy block.",
    },
}
"""The shipped commands by task: the first paragraph of the help of each, by name."""
SHIPPED = {name: text for group in GROUPS.values() for name, text in group.items()}
_PLACES = {
    "show": "check:show", "list": "list:list_", "live": "view:live",
    "campaign": "campaign:app", "ctl": "ctl:app", "export": "export:app", "fmu": "fmu:app", "identify": "identify:app",
}  # fmt: skip
"""Module and name of each command that is not simply ``hil.cli.NAME:NAME``."""

_EXTENSIONS = Extensions("hil.commands", SHIPPED)
_LONGEST = max(map(len, SHIPPED))


class Group(TyperGroup):
    """A group of commands whose help shows the first paragraph of each in full; typer would cut it to one line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a row for each command, wrapped to the width of the terminal."""
        helps = {name: command.help or "" for name, command in self.commands.items() if not command.hidden}
        with formatter.section("Commands"):
            formatter.write_dl([(name, " ".join(text.partition("\n\n")[0].split())) for name, text in helps.items()])


class Commands(TyperGroup):
    """The group ``hil``. Its help prints the rows of ``SHIPPED``, then other packages' commands; it imports none."""

    _completes = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, shipped ones first."""
        return _EXTENSIONS.names()

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return what completes a command's name, for a shell. No command is imported."""
        self._completes = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._completes = False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command. Raises BadInputError for an unknown one, and for a broken one of another package."""
        if self._completes:
            return TyperCommand(cmd_name, help=SHIPPED.get(cmd_name))
        if cmd_name in SHIPPED:
            return _command(cmd_name, shipped_command(cmd_name))
        found = _EXTENSIONS.load(cmd_name, f"command {cmd_name!r}")
        try:
            return _command(cmd_name, found)
        except Exception as error:
            raise BadInputError(
                f"command {cmd_name!r}: {found!r} is not a command ({type(error).__name__}: {error}); expected a "
                "function or a typer.Typer, see https://typer.tiangolo.com"
            ) from error

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a row for each command, wrapped to the width of the terminal."""
        for task, rows in GROUPS.items():
            with formatter.section(task):
                # As wide as the longest name, so that the texts of all groups are one column.
                formatter.write_dl([(f"{name:<{_LONGEST}}", text) for name, text in rows.items()])
        if others := _EXTENSIONS.lines():
            with formatter.section("Commands of other packages"):
                formatter.write_dl([(name, f"{package}: {text}") for name, package, text in others])


def shipped_command(name: str) -> Any:
    """Import a shipped command: a function or a ``typer.Typer``."""
    module, _, attribute = _PLACES.get(name, f"{name}:{name}").partition(":")
    with ends_at_once():
        return getattr(import_module(f"hil.cli.{module}"), attribute)


def _command(name: str, found: Any) -> Any:
    holder = typer.Typer(rich_markup_mode=None, add_completion=False)
    holder.callback()(lambda: None)
    if isinstance(found, typer.Typer):
        holder.add_typer(found, name=name)
    else:
        holder.command(name, context_settings=getattr(found, "context_settings", None))(found)
    return get_group(holder).commands[name]
