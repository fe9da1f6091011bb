"""How a list of commands is laid out in a help text."""

from typing import Any

import typer
from typer.core import TyperGroup


class Commands(TyperGroup):
    """A group of commands whose help says of each the whole first paragraph, where the default cuts it to a line."""

    def format_commands(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]
        """Write a row for each command, wrapped to the width of the terminal."""
        rows = []
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                rows.append((name, " ".join((command.help or "").partition("\n\n")[0].split())))
        with formatter.section("Commands"):
            formatter.write_dl(rows)
