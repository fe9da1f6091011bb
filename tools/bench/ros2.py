"""The ROS 2 node measured: what it costs the control loop, and the paper's circle with the law in a node of its own.

    python -m tools.bench.ros2 loop [--turns 4 --seconds 15]    lateness with and without the node, in turns
    python -m tools.bench.ros2 circle                            the direct run, and through topics

Prints tables in Markdown, which hil/addons/ros2/ROS2.md shows, and with --json one object.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import hil
from hil.addons.service.client import Client, find
from hil.addons.service.discovery import running
from hil.addons.service.messages import Action
from hil.core.errors import LinkError
from hil.core.subprocesses import child_environment, module_command

SCENARIO = "paper_circle"
RATE_HZ = 200
_FREE = ("service.speed_m_s=20", "service.yaw_rate_rad_s=50", "service.acceleration_m_s2=50")
CIRCLE = (f"loop.rate_hz={RATE_HZ}", *_FREE)
_STEADY_S = 10.0


def environment(folder: Path) -> dict[str, str]:
    """Return an environment in which services and nodes find only each other."""
    apart = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(101 + os.getpid() % 100)}
    return child_environment() | apart | {"XDG_STATE_HOME": str(folder)}


@contextlib.contextmanager
def process(variables: Mapping[str, str], *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command of hil, ended by SIGINT; what it says is dropped."""
    command = module_command("hil.cli.main", *words)
    one = subprocess.Popen(command, env=variables, stderr=subprocess.DEVNULL)
    try:
        yield one
    finally:
        one.send_signal(signal.SIGINT)
        one.wait(timeout=60)


def settings(sets: Sequence[str]) -> list[str]:
    """Return --set for each."""
    return [word for one in sets for word in ("--set", one)]


def direct(latency_s: float) -> dict[str, float]:
    """Return the errors of a run without ROS, with this latency of its commands."""
    result = hil.run(SCENARIO, set=[*CIRCLE, f"link.command_latency_s={latency_s}"], lenient=True)
    t_s, error_mm = (np.asarray(result.signals[name]) for name in ("loop.t_s", "error.planar_m"))
    steady_mm = 1e3 * error_mm[t_s >= _STEADY_S]
    return {"rms_mm": float(np.sqrt(np.mean(steady_mm**2))), "largest_mm": float(steady_mm.max())}


def through_topics(folder: Path, *parameters: str) -> dict[str, float]:
    """Return the figures of the circle with the law in a node of its own."""
    variables = environment(folder)
    given = [word for one in (f"publish_rate_hz:={RATE_HZ}.0", *parameters) for word in ("-p", one)]
    with process(variables, "ros2", SCENARIO, *settings(CIRCLE), "--ros-args", *given):
        law = module_command("tools.bench.ros2_law", SCENARIO, *settings(CIRCLE), "--latency-s", str(1 / RATE_HZ))
        done = subprocess.run(law, env=variables, capture_output=True, text=True, check=False, timeout=900)
    if done.returncode:
        sys.exit(done.stderr)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def circle(folder: Path) -> dict[str, dict[str, float]]:
    """Run the paper's circle directly and through topics."""
    return {
        "direct": direct(0.0),
        "direct, commands one period late": direct(1 / RATE_HZ),
        "law in a node, time waits for it": through_topics(folder, "wait_for_wheels_s:=5.0"),
        "law in a node, a quarter of real time": through_topics(folder, "real_time_factor:=0.25"),
        "law in a node, real time": through_topics(folder),
    }


def circle_table(rows: Mapping[str, Mapping[str, float]]) -> str:
    """Return the circle's figures as a table."""
    columns = {"rms_mm": 2, "largest_mm": 2, "latency_p50_ms": 1, "latency_p99_ms": 1, "jitter_ms": 2}
    lines = [
        "| run | error rms [mm] | largest [mm] | latency p50 [ms] | p99 [ms] | jitter σ [ms] |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        cells = [f"{row[key]:.{digits}f}" if key in row else "–" for key, digits in columns.items()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def lateness(folder: Path, seconds: float, *, with_node: bool) -> dict[str, float]:
    """Return the lateness of a service's loop [µs]: armed and held, or driven through the node at 100 Hz."""
    variables = environment(folder)
    os.environ["XDG_STATE_HOME"] = str(folder)
    words = ("serve", "circle_speed", "--set", f"loop.rate_hz={RATE_HZ}", "--set", "service.port=0")
    with process(variables, *words) as service, contextlib.ExitStack() as resources:
        client = _client(service.pid)
        if with_node:
            port = next(one.port for one in running() if one.pid == service.pid)
            sent = ("circle_speed", "--port", str(port), "--ros-args", "-p", f"publish_rate_hz:={RATE_HZ}.0")
            resources.enter_context(process(variables, "ros2", *sent))
            driver = subprocess.Popen(module_command("tools.bench.ros2_driver"), env=variables)
            resources.callback(driver.wait)
            resources.callback(driver.terminate)
            while (_status(client)["twist_age_s"] is None) and driver.poll() is None:
                time.sleep(0.1)
        else:
            while _status(client)["phase"] != "disarmed":
                time.sleep(0.1)
            client.order(Action.ARM)
        time.sleep(1.0)
        before = _status(client)["ticks"]
        time.sleep(seconds)
        status = _status(client)
        figures: dict[str, float] = dict(status["lateness_us"])
        return figures | {"ticks": status["ticks"] - before, "misses": status["deadline_misses"]}


def _status(client: Client) -> dict[str, Any]:
    """Return the status, as soon as the service has time to tell it."""
    for _ in range(100):
        with contextlib.suppress(LinkError):
            return client.status()
        time.sleep(0.1)
    sys.exit("the service did not tell its status within 10 s")


def _client(pid: int) -> Client:
    for _ in range(1200):
        for one in running():
            if one.pid == pid:
                return find(one.url)
        time.sleep(0.1)
    sys.exit("the service was not ready within 120 s")


def loop(folder: Path, turns: int, seconds: float) -> dict[str, Any]:
    """Measure the loop with and without the node, in turns."""
    runs: dict[str, list[dict[str, float]]] = {"without the node": [], "with the node": []}
    for _ in range(turns):
        for name, found in runs.items():
            found.append(lateness(folder, seconds, with_node=name == "with the node"))
    medians = {
        name: {key: statistics.median(one[key] for one in found) for key in ("p50", "p99", "p99.9")}
        for name, found in runs.items()
    }
    return {
        "runs": runs,
        "medians": medians,
        "ratio_p99": medians["with the node"]["p99"] / medians["without the node"]["p99"],
    }


def loop_table(figures: Mapping[str, Any]) -> str:
    """Return the loop's figures as a table."""
    lines = ["| lateness of the loop [µs], median of the runs | p50 | p99 | p99.9 |", "|---|---|---|---|"]
    for name, row in figures["medians"].items():
        lines.append(f"| {name} | {row['p50']:.0f} | {row['p99']:.0f} | {row['p99.9']:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what the command line asks for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("loop", "circle"))
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        figures = circle(folder) if asked.what == "circle" else loop(folder, asked.turns, asked.seconds)
    if asked.json:
        print(json.dumps(figures))
    else:
        print(circle_table(figures) if asked.what == "circle" else loop_table(figures))


if __name__ == "__main__":
    main()
