"""The viewer: whether it is there, of the recordings' version, and what draws it."""

import importlib.metadata
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks.finding import Finding, note, ok, problem
from hil.core.errors import DeviceError
from hil.record.view import has_display, viewer_environment, viewer_executable

_TIMEOUT_S = 10.0
_RENDER_NODES = Path("/dev/dri")


def check(render_nodes: Path = _RENDER_NODES) -> Iterator[Finding]:
    """Yield the viewer's version against the SDK's, and whether a graphics processor draws."""
    yield _version()
    if not has_display():
        yield note("display", "none, so that no window can be opened", "use hil view RUN.rrd --web and a browser")
    if sys.platform == "linux":
        if any(render_nodes.glob("renderD*")):
            yield ok("graphics", "there is a graphics processor")
        else:
            yield note(
                "graphics",
                "no graphics processor: the viewer is drawn in software, slowly",
                "look at recordings on another machine, or with hil view RUN.rrd --web and its browser",
            )


def _version() -> Finding:
    try:
        sdk = importlib.metadata.version("rerun-sdk")
        executable = viewer_executable()
        done = subprocess.run(
            [executable, "--version"],
            capture_output=True,
            text=True,
            check=True,
            timeout=_TIMEOUT_S,
            env=viewer_environment(),
        )
    except importlib.metadata.PackageNotFoundError:
        return note("viewer", "rerun-sdk is not installed", "pip install rerun-sdk, or record with --record run.mcap")
    except (DeviceError, OSError, subprocess.SubprocessError) as error:
        return problem(
            "viewer", f"rerun's viewer does not run: {error}", f"pip install --force-reinstall rerun-sdk=={sdk}"
        )
    found = re.search(r"\d+\.\d+\.\d+", done.stdout)
    version = found.group() if found else done.stdout.strip()
    if version == sdk:
        return ok("viewer", f"rerun {version}, as the SDK")
    return problem(
        "viewer",
        f"{executable} is rerun {version}, the SDK that records is {sdk}: it may not read the recordings",
        f"pip install --force-reinstall rerun-sdk=={sdk}",
    )
