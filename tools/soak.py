"""Drives a service for hours: ``python -m tools.soak --minutes 120`` looks for what grows, ends or goes wrong.

Each cycle arms, records, follows the circle, drives by twist, goes to a pose, stops and disarms the virtual robot over
the service's HTTP API. After each the memory and the open files of the service's processes are read. It prints one JSON
object, and exits with 1 when memory or files grew, when the service refused or logged an error, or ended by itself.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

from hil.addons.service.client import Client, find
from hil.addons.service.messages import Action
from hil.core.errors import HilError

SERVE = ("serve", "circle_speed", "--set", "loop.rate_hz=100", "--set", "service.port=0", "--log", "json")
MEMORY_GROWTH = 0.1
"""Of the memory after the first quarter of the cycles; allocators settle in the first ones."""
FILES_GROWTH = 4
WAIT_S = 30.0


def main() -> int:
    """Run, print and judge."""
    parser = argparse.ArgumentParser(prog="tools.soak", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=120.0, help="how long to drive")
    parser.add_argument("--track-s", type=float, default=20.0, help="how long each cycle follows the circle")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hil_soak_") as name:
        figures = soak(Path(name), options.minutes, options.track_s)
    print(json.dumps(figures, indent=2))
    return int(bool(figures["trouble"]))


def soak(folder: Path, minutes: float, track_s: float) -> dict[str, Any]:
    """Drive a new service for that long; ``trouble`` of the result lists the errors."""
    os.environ["XDG_STATE_HOME"] = str(folder / "state")  # where it leaves its token, and we find it
    log = folder / "log.jsonl"
    with log.open("w", encoding="utf-8") as errors:
        service = subprocess.Popen([sys.executable, "-m", "hil", *SERVE], cwd=folder, stderr=errors)
        trouble: list[str] = []
        sizes: list[dict[str, float]] = []
        begin_s = time.monotonic()
        try:
            client = _until(lambda: _client(service), "the service listens")
            while not sizes or time.monotonic() - begin_s < 60.0 * minutes:
                drive(client, folder / "runs" / f"{len(sizes)}.rrd", track_s)
                sizes.append(_size(service.pid))
            client.order(Action.SHUTDOWN)
            if code := service.wait(WAIT_S):
                trouble.append(f"the service ended with exit code {code}")
        except (HilError, TimeoutError, subprocess.TimeoutExpired) as error:
            trouble.append(f"cycle {len(sizes)}: {error}")
        finally:
            service.kill()
            service.wait()
    lines = [json.loads(line) if line.startswith("{") else {"event": line} for line in log.read_text().splitlines()]
    trouble += [f"logged: {line}" for line in lines if line.get("level", "error") not in ("debug", "info")]
    trouble += grown(sizes)
    return {"minutes": (time.monotonic() - begin_s) / 60.0, "cycles": len(sizes), "sizes": sizes, "trouble": trouble}


def drive(client: Client, recording: Path, track_s: float) -> None:
    """Do once what a robot does in a day, and delete the recording of it."""
    _until(lambda: client.status()["phase"] == "disarmed", "the robot is disarmed")
    client.order(Action.ARM)
    _until(lambda: client.status()["phase"] == "active", "the robot is active")
    client.order(Action.RECORD, {"name": recording.name})
    client.order(Action.TRACK, {"here": True})
    end_s = time.monotonic() + track_s
    while time.monotonic() < end_s:
        status = client.status()
        if status["phase"] != "active":
            raise TimeoutError(f"the robot left the circle: {status['phase']}, {status.get('why')}")
    client.twist({"vx_m_s": 0.2, "vy_m_s": 0.1, "yaw_rate_rad_s": 0.3}, 2.0)
    _until(lambda: client.status()["task"] == "hold", "the robot stands after its twist")
    pose = (0.5, 0.0, 0.0)
    client.order(Action.GO, dict(zip(("x_m", "y_m", "heading_rad"), pose, strict=True)))
    _until(lambda: math.dist(client.status()["pose"], pose) < 0.01, "the robot has come to its pose")
    client.order(Action.STOP_RECORDING)
    client.order(Action.DISARM)
    for path in recording.parent.glob(f"{recording.stem}*"):
        path.unlink()


def grown(sizes: list[dict[str, float]]) -> list[str]:
    """Return a sentence for each size whose median of the last quarter is above that of the second one."""
    quarter = len(sizes) // 4
    if quarter < 1:
        return []
    sentences = []
    for what, allowed in (("memory_mib", 1.0 + MEMORY_GROWTH), ("files", None)):
        before = statistics.median(size[what] for size in sizes[quarter : 2 * quarter])
        after = statistics.median(size[what] for size in sizes[-quarter:])
        if after > (before + FILES_GROWTH if allowed is None else before * allowed):
            sentences.append(f"{what} grew from {before:.1f} to {after:.1f} in {len(sizes)} cycles")
    return sentences


def _size(pid: int) -> dict[str, float]:
    """Return memory and open files of a process with all its children."""
    parent = psutil.Process(pid)
    processes = [parent, *parent.children(recursive=True)]
    return {
        "memory_mib": sum(one.memory_info().rss for one in processes) / 2**20,
        "files": float(sum(one.num_fds() if hasattr(one, "num_fds") else one.num_handles() for one in processes)),
        "processes": float(len(processes)),
    }


def _client(service: "subprocess.Popen[bytes]") -> Client | None:
    """Return a client of the service, or None while it does not listen yet. Raises TimeoutError when it has ended."""
    if service.poll() is not None:
        raise TimeoutError(f"the service ended with exit code {service.returncode}")
    try:
        client = find()
        client.status()
    except HilError:
        return None
    return client


def _until(condition: Callable[[], Any], words: str) -> Any:
    """Return the first true value of a condition. Raises TimeoutError when there is none in time."""
    end_s = time.monotonic() + WAIT_S
    while not (value := condition()):
        if time.monotonic() > end_s:
            raise TimeoutError(f"not within {WAIT_S:g} s: {words}")
        time.sleep(0.02)
    return value


if __name__ == "__main__":
    sys.exit(main())
