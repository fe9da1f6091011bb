"""What all commands of an add-on have in common."""

from collections.abc import Iterator, Mapping
from typing import Any

import click
from typer.main import get_command

from hil.cli.commands import TASKS
from hil.cli.main import app
from hil.core.extensions import Command


def flags_that_are_on(commands: Mapping[str, Command]) -> list[str]:
    """Return the flags of commands that are on where nobody gives them; every command can be imported and listed."""
    group: Any = get_command(app)
    context = click.Context(group)
    assert {command.task for command in commands.values()} <= set(TASKS)
    each = (one for name in commands for one in _with_parts(group.get_command(context, name), name))
    options = [
        (name, option) for name, command in each for option in command.params if getattr(option, "is_flag", False)
    ]
    return [f"{name} {option.opts[0]}" for name, option in options if option.name != "help" and option.default]


def _with_parts(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    yield name, command
    for part, inner in getattr(command, "commands", {}).items():
        yield from _with_parts(inner, f"{name} {part}")
