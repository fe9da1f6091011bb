"""The files of a Debian in a folder, for tools that show what happens on another machine. It needs a network."""

import subprocess
from pathlib import Path


def make_debian(
    root: Path, packages: str, *, suite: str = "bookworm", variant: str = "minbase", machine: str | None = None
) -> Path:
    """Make a Debian with these packages (joined by commas) in the new folder ``root``, and return that.

    ``variant`` is mmdebstrap's: "extract" runs none of the packages' scripts, so that another ``machine``, by Debian's
    name, needs no emulator. A failure, or a missing mmdebstrap, ends the tool with a sentence.
    """
    command = ["mmdebstrap", f"--variant={variant}", f"--include={packages}", suite, str(root)]
    command[1:1] = [] if machine is None else [f"--architectures={machine}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise SystemExit("mmdebstrap is not installed; on Debian: apt install mmdebstrap") from None
    if done.returncode != 0:
        raise SystemExit(f"no Debian was made: {' '.join(command)}\n{done.stderr[-2000:]}")
    return root
