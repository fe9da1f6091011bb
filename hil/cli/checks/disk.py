"""The disk under the recordings: its space, and how fast it takes them."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks.finding import Finding, note, ok, problem

A_SECOND_BYTES = 700_000  # of a recording at 1 kHz, as telemetry_cost measures it, rounded up
_LOW_S = 3600
_SEQUENTIAL = 8
_CHUNK = bytes(1 << 20)
_SYNCS = 20
_SLOW_BYTES_S = 10 * A_SECOND_BYTES
_SLOW_SYNC_S = 0.5


def check(folder: Path) -> Iterator[Finding]:
    """Yield space and speed where recordings go, measured with a file that is gone afterwards."""
    there = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.is_dir())
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            speed_bytes_s, sync_s = _measured(file.fileno())
    except OSError as error:
        yield problem(
            "disk", f"{there}: a recording cannot be written ({error.strerror})", "go to another folder, or free space"
        )
        return
    free = shutil.disk_usage(there).free
    hours = free / A_SECOND_BYTES / 3600
    space = f"{there}: {free / 1e9:.1f} GB free, about {hours:.0f} h of recording at 1 kHz"
    if free < _LOW_S * A_SECOND_BYTES:
        yield note("disk", space, "free some, or record elsewhere with --record FILE")
    else:
        yield ok("disk", space)
    speed = f"writes {speed_bytes_s / 1e6:.0f} MB/s, fsync p99 {sync_s * 1e3:.1f} ms"
    if speed_bytes_s < _SLOW_BYTES_S or sync_s > _SLOW_SYNC_S:
        needed = f"a recording at 1 kHz takes {A_SECOND_BYTES / 1e6:g} MB/s"
        yield note("disk speed", f"{speed}; {needed}", "record on a local disk with --record FILE")
    else:
        yield ok("disk speed", speed)


def _measured(descriptor: int) -> tuple[float, float]:
    """Return the speed of writing [bytes/s], until it is on the disk, and the 99th percentile of a small fsync [s]."""
    begin = time.perf_counter()
    for _ in range(_SEQUENTIAL):
        os.write(descriptor, _CHUNK)
    os.fsync(descriptor)
    speed_bytes_s = _SEQUENTIAL * len(_CHUNK) / (time.perf_counter() - begin)
    took_s = []
    for _ in range(_SYNCS):
        begin = time.perf_counter()
        os.write(descriptor, _CHUNK[:4096])
        os.fsync(descriptor)
        took_s.append(time.perf_counter() - begin)
    # Of so few the 99th percentile is the slowest.
    return speed_bytes_s, max(took_s)
