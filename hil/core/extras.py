"""Packages that not every installation has: an extra brings them, and a message names it where one is missing."""

import importlib.util
import os
import sys
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE
from hil.core.printable import command, seen_from_here

EXTRAS = {
    "service": ("fastapi", "httpx", "prometheus_client", "pydantic", "uvicorn", "websockets"),
    "plots": ("matplotlib", "pandas", "plotly"),
    "hunt": ("optuna",),
    "dbc": ("cantools",),
    "teleop": ("sdl2",),
    "targets": ("unicorn",),
    "mpc": ("osqp",),
}
"""What is imported of each extra of pyproject.toml that a command may need."""


def need(extra: str, subject: str) -> None:
    """Raise BadInputError if a package of an extra is missing. Imports none of them.

    ``extra`` may be several, with commas. ``subject`` begins the message and is what needs the package, for example
    ``hil serve``. Call it before the first import, and before work that would be lost.
    """
    lacking = {one: found for one in extra.split(",") if (found := missing_of(one))}
    if missing := [name for found in lacking.values() for name in found]:
        verb = "is" if len(missing) == 1 else "are"
        install = install_command(",".join(lacking))
        raise BadInputError(f"{subject} needs {', '.join(missing)}, which {verb} not installed; run: {install}")


def missing_of(extra: str) -> list[str]:
    """Return the modules of an extra that are not installed."""
    return [name for name in EXTRAS[extra] if importlib.util.find_spec(name) is None]


def install_command(extra: str) -> str:
    """Return the command that adds an extra to this installation. No index has to know our package: it is there."""
    python = Path(sys.executable)
    pip = ["pip"] if os.environ.get("VIRTUAL_ENV") == sys.prefix else [str(seen_from_here(python)), "-m", "pip"]
    return command(*pip, "install", f"{OUR_PACKAGE}[{extra}]")
