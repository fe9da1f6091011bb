"""Which rate is held: ``python -m tools.bench.lateness``.

Controller and virtual robot are two processes over a pseudo-terminal, with what ``[realtime]`` is granted, recorded. In
turns with them runs cyclictest (Debian: apt install rt-tests), whose thread only sleeps: what it is late by is the
machine's. The reaction is from the stamp of the newest feedback to the command that goes out next, as a trace has them.
``--page hil/LIMITS.md`` writes the row of this machine into the page's table.
"""

import argparse
import json
import os
import platform
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_protocol.generated.messages import Tick, TorqueCommand, WheelCommand
from hil.doctor import kernel
from hil.lateness import Lateness
from hil.realtime import PRIORITY

ROOT = Path(__file__).parents[2]
BEGIN, END = "<!-- rates: begin -->", "<!-- rates: end -->"
SCENARIO = "paper_circle"
_HIL = (sys.executable, "-m", "hil.cli")
_COMMANDS = (WheelCommand.ID, TorqueCommand.ID)


class Turn(NamedTuple):
    """One turn of controller and robot."""

    metrics: dict[str, Any]
    reaction_us: list[float]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.lateness", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="in all of each")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--rate", type=int, default=1000, metavar="HZ")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the row of this machine into its table")
    options = parser.parse_args()
    cyclictest = shutil.which("cyclictest")
    if cyclictest is None:
        print("without cyclictest, which is not installed: apt install rt-tests", file=sys.stderr)
    seconds = options.seconds / options.turns
    ours, sleeper, turns = Lateness(), Lateness(), []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(options.turns):
            turns.append(_turn(Path(folder), options.rate, seconds))
            _merge(ours, turns[-1].metrics["lateness_us"])
            if cyclictest is not None:
                _sleep(cyclictest, Path(folder), options.rate, seconds, sleeper)
    figures = _figures(options.rate, turns, ours, sleeper)
    _print(figures)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if options.page is not None:
        _write_row(options.page, figures)


@contextmanager
def _device(settings: list[str]) -> Iterator[tuple[str, str]]:
    """Run the virtual robot; yield its link and its truth."""
    command = [*_HIL, "device", SCENARIO, "--mode", "realtime", "--link", "serial:pty", *settings]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=_environment())
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line.startswith("ready "):
            raise SystemExit(f"the robot did not start: {line}")
        told = dict(part.split("=", 1) for part in line.split()[1:])
        yield told["link"], told["truth"]
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def _turn(folder: Path, rate_hz: int, seconds: float) -> Turn:
    settings = ["--set", f"loop.rate_hz={rate_hz}", "--set", f"loop.duration_s={seconds}", "--set", "expect=[]"]
    trace = folder / "bus.log"
    files = ["--record", str(folder / "run.rrd"), "--trace", str(trace)]
    with _device(settings) as (link, truth):
        done = subprocess.run(
            [
                *_HIL,
                "run",
                SCENARIO,
                "--mode",
                "realtime",
                "--link",
                link,
                "--truth",
                truth,
                *settings,
                "--json",
                *files,
            ],
            capture_output=True,
            text=True,
            check=False,
            env=_environment(),
        )
    if done.returncode != 0:
        raise SystemExit(f"the run failed: {done.stderr}")
    return Turn(json.loads(done.stdout), list(_reactions_us(trace)))


def _reactions_us(trace: Path) -> Iterator[float]:
    """Yield for each command how long before it the newest feedback was stamped [µs]."""
    stamped_s: float | None = None
    for message in can.LogReader(trace):
        if message.arbitration_id == Tick.ID and message.is_rx:
            stamped_s = message.timestamp
        elif message.arbitration_id in _COMMANDS and stamped_s is not None:
            yield (message.timestamp - stamped_s) * 1e6
            stamped_s = None


def _merge(into: Lateness, figures: dict[str, Any]) -> None:
    into.counts = [one + more for one, more in zip(into.counts, figures["counts"], strict=True)]
    into.worst_ns = max(into.worst_ns, round(figures["max"] * 1e3))


def _sleep(cyclictest: str, folder: Path, rate_hz: int, seconds: float, into: Lateness) -> None:
    """Run cyclictest for as long, at the same priority and period, and count its histogram of microseconds."""
    file = folder / "cyclictest.json"
    period_us = str(1_000_000 // rate_hz)
    options = ["-q", "-m", "-p", str(PRIORITY), "-i", period_us, "-D", str(round(seconds)), "-h", "1000000"]
    subprocess.run([cyclictest, *options, f"--json={file}"], stdout=subprocess.DEVNULL, check=True)
    for late_us, count in json.loads(file.read_text("utf-8"))["thread"]["0"]["histogram"].items():
        for _ in range(count):
            into.add(int(late_us) * 1000)


def _figures(rate_hz: int, turns: list[Turn], ours: Lateness, sleeper: Lateness) -> dict[str, Any]:
    reaction_us = np.percentile(np.concatenate([turn.reaction_us for turn in turns]), [50, 99])
    last = turns[-1].metrics
    kernels = [finding.sentence.partition(":")[0] for finding in kernel.check() if finding.subject == "kernel"]
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "kernel": kernels[0] if kernels else platform.platform(),
        "rate_hz": rate_hz,
        "ticks": sum(turn.metrics["ticks"] for turn in turns),
        "deadline_misses": sum(turn.metrics["deadline_misses"] for turn in turns),
        "tick_us": {
            name: statistics.median(turn.metrics["tick_us"][name] for turn in turns) for name in ("p50", "p99")
        },
        "lateness_us": ours.figures(),
        "cyclictest_us": sleeper.figures(),
        "reaction_us": dict(zip(("p50", "p99"), map(float, reaction_us), strict=True)),
        "round_trip_ms": last["link_statistics"]["round_trip_ms"],
        "realtime": last["realtime"],
        "recorded": {name: sum(turn.metrics["recorded"][name] for turn in turns) for name in ("rows", "dropped")},
    }


def _print(figures: dict[str, Any]) -> None:
    ticks = figures["ticks"] + figures["deadline_misses"]
    table = Table("", "p50 µs", "p99 µs", "p99.9 µs", "max µs", title=f"{figures['rate_hz']} Hz over a pseudo-terminal")
    for label, name in (("lateness of ticks", "lateness_us"), ("cyclictest", "cyclictest_us")):
        if (row := figures[name]) is not None:
            table.add_row(label, *(f"{row[column]:.0f}" for column in ("p50", "p99", "p99.9", "max")))
    for label, name in (("work of a tick", "tick_us"), ("feedback stamped to command sent", "reaction_us")):
        table.add_row(label, *(f"{figures[name][column]:.0f}" for column in ("p50", "p99")), "", "")
    console = Console()
    console.print(table)
    console.print(f"{figures['machine']}, {figures['kernel']}")
    console.print(f"{figures['deadline_misses']} of {ticks} ticks skipped; refused: {figures['realtime']['refused']}")


def _write_row(page: Path, figures: dict[str, Any]) -> None:
    """Write the row into the table between the page's marks, in the place of an older one of this machine and rate."""
    late, cyclictest = figures["lateness_us"], figures["cyclictest_us"]
    ticks = figures["ticks"] + figures["deadline_misses"]
    where = f"| {figures['machine']}, {figures['kernel']} | serial:pty, {figures['rate_hz']} Hz |"
    of_three = [
        " / ".join(f"{row[name]:.0f}" for name in ("p50", "p99", "p99.9")) if row else "" for row in (late, cyclictest)
    ]
    missed = f"{100 * figures['deadline_misses'] / ticks:.2g} %"
    reaction = f"{figures['reaction_us']['p50']:.0f} / {figures['reaction_us']['p99']:.0f}"
    head, _, rest = page.read_text("utf-8").partition(BEGIN)
    table, _, tail = rest.partition(END)
    rows = [line for line in table.strip().splitlines() if not line.startswith(where)]
    rows.append(f"{where} {missed} | {of_three[0]} | {of_three[1]} | {reaction} |")
    page.write_text("\n".join([f"{head}{BEGIN}", *rows, f"{END}{tail}"]), encoding="utf-8")


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT)}


if __name__ == "__main__":
    main()
