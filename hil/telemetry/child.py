"""Starting a Python process of ours that uses rerun."""

import os
import sys
from pathlib import Path


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs one of our modules in the interpreter that runs now."""
    # -P: a file of the user's in the working directory must not shadow a module.
    return [sys.executable, "-P", "-m", module, *arguments]


def child_environment() -> dict[str, str]:
    """Return the environment for it: our packages are found, and the user's settings for rerun do not apply.

    RERUN=0, for one, would leave a recording empty.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RERUN")}
    root = str(Path(__file__).resolve().parents[2])
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    environment["RUST_LOG"] = "error"
    return environment
