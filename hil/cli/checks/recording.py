"""What recordings need: free space and speed of the disk, and rerun's viewer."""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks import Finding, note, ok, ok_or_note, problem
from hil.core.errors import DeviceError
from hil.record.viewer import has_display, viewer_environment, viewer_executable

A_SECOND_BYTES = 700_000  # of a recording at 1 kHz, as measured by telemetry_cost, rounded up
_LOW_S = 3600
_SEQUENTIAL = 8
_CHUNK = bytes(1 << 20)
_SYNCS = 20
_SLOW_BYTES_S = 10 * A_SECOND_BYTES
_SLOW_SYNC_S = 0.5
_TIMEOUT_S = 10.0
_RENDER_NODES = Path("/dev/dri")


def check_disk(folder: Path) -> Iterator[Finding]:
    """Yield free space and speed of the disk under ``folder``, measured with a temporary file."""
    place = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.is_dir())
    try:
        with tempfile.TemporaryFile(dir=place) as file:
            speed_bytes_s, sync_s = _measured(file.fileno())
    except OSError as error:
        sentence = f"{place}: a recording cannot be written ({error.strerror})"
        yield problem("disk", sentence, "go to another folder, or free space")
        return
    free_bytes = shutil.disk_usage(place).free
    hours = free_bytes / A_SECOND_BYTES / 3600
    space = f"{place}: {free_bytes / 1e9:.1f} GB free, about {hours:.0f} h of recording at 1 kHz"
    is_enough = free_bytes >= _LOW_S * A_SECOND_BYTES
    yield ok_or_note("disk", is_enough, space, space, "free some, or record elsewhere with --record FILE")
    speed = f"writes {speed_bytes_s / 1e6:.0f} MB/s, fsync p99 {sync_s * 1e3:.1f} ms"
    is_fast = speed_bytes_s >= _SLOW_BYTES_S and sync_s <= _SLOW_SYNC_S
    slow = f"{speed}; a recording at 1 kHz takes {A_SECOND_BYTES / 1e6:g} MB/s"
    yield ok_or_note("disk speed", is_fast, speed, slow, "record on a local disk with --record FILE")


def _measured(descriptor: int) -> tuple[float, float]:
    """Return the speed of writing to the disk [bytes/s], and the slowest of 20 small fsyncs [s], their p99."""
    begin = time.perf_counter()
    for _ in range(_SEQUENTIAL):
        os.write(descriptor, _CHUNK)
    os.fsync(descriptor)
    speed_bytes_s = _SEQUENTIAL * len(_CHUNK) / (time.perf_counter() - begin)
    syncs_s = []
    for _ in range(_SYNCS):
        begin = time.perf_counter()
        os.write(descriptor, _CHUNK[:4096])
        os.fsync(descriptor)
        syncs_s.append(time.perf_counter() - begin)
    return speed_bytes_s, max(syncs_s)


def check_viewer(render_nodes: Path = _RENDER_NODES) -> Iterator[Finding]:
    """Yield the viewer's version compared with the SDK's, and whether there is a display and a graphics processor."""
    yield _viewer_version()
    if not has_display():
        yield note("display", "none, so that no window can be opened", "use hil view RUN.rrd --web and a browser")
    if sys.platform == "linux":
        yield ok_or_note(
            "graphics",
            any(render_nodes.glob("renderD*")),
            "there is a graphics processor",
            "no graphics processor: the viewer is drawn in software, slowly",
            "look at recordings on another machine, or with hil view RUN.rrd --web and its browser",
        )


def _viewer_version() -> Finding:
    try:
        sdk = importlib.metadata.version("rerun-sdk")
    except importlib.metadata.PackageNotFoundError:
        return note("viewer", "rerun-sdk is not installed", "pip install rerun-sdk, or record with --record run.mcap")
    remedy = f"pip install --force-reinstall rerun-sdk=={sdk}"
    try:
        executable = viewer_executable()
        output = subprocess.run(
            [executable, "--version"],
            capture_output=True,
            text=True,
            check=True,
            timeout=_TIMEOUT_S,
            env=viewer_environment(),
        ).stdout
    except (DeviceError, OSError, subprocess.SubprocessError) as error:
        return problem("viewer", f"rerun's viewer does not run: {error}", remedy)
    found = re.search(r"\d+\.\d+\.\d+", output)
    version = found.group() if found else output.strip()
    if version == sdk:
        return ok("viewer", f"rerun {version}, as the SDK")
    sentence = f"{executable} is rerun {version}, the SDK that records is {sdk}: it may not read the recordings"
    return problem("viewer", sentence, remedy)
