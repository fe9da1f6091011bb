"""Which rate is held: ``python -m tools.bench.lateness`` over a pseudo-terminal, with ``--vcan`` over SocketCAN.

Controller and virtual robot are two processes, with what ``[realtime]`` is granted, recorded. In turns with them runs
cyclictest (Debian: apt install rt-tests), whose thread only sleeps: what it is late by is the machine's. The reaction
is from the stamp of the newest feedback to the command that goes out next, as a trace has them. With ``--vcan`` all of
it runs inside ``tools.socketcan``. ``--page docs/results/realtime.md`` writes the row of this machine into the page's
table.
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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_protocol.generated.messages import Tick, TorqueCommand, WheelCommand
from hil.addons.doctor import checks
from hil.runtime.lateness import Lateness
from hil.scenario.tables import PRIORITY
from tools import socketcan

ROOT = Path(__file__).parents[2]
VCAN = "can:socketcan/vcan0"
RATE_HZ, VCAN_RATE_HZ = 1000, 200
ON_STDOUT = "-"
BEGIN, END = "<!-- rates: begin -->", "<!-- rates: end -->"
SCENARIO = "paper_circle"
_HIL = (sys.executable, "-m", "hil.cli.main")
_COMMANDS = (WheelCommand.ID, TorqueCommand.ID)


class Wanted(NamedTuple):
    """What to measure: where the robot opens its link, and for how long in all, in how many turns."""

    link: str
    rate_hz: int
    seconds: float
    turns: int
    is_recorded: bool


class Turn(NamedTuple):
    """One turn of controller and robot."""

    metrics: dict[str, Any]
    reaction_us: list[float]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.lateness", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="in all of each")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--rate", type=int, metavar="HZ", help=f"{RATE_HZ} by default, {VCAN_RATE_HZ} with --vcan")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--link", default="serial:pty", metavar="URL", help="where the robot opens it (%(default)s)")
    where.add_argument("--vcan", action="store_true", help=f"{VCAN}, in a kernel that has it")
    parser.add_argument("--unrecorded", action="store_true", help="without a recorder beside the controller")
    parser.add_argument("--json", metavar="FILE", help=f"write the figures; {ON_STDOUT} for one line and no table")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the row of this machine into its table")
    options = parser.parse_args()
    link, rate_hz = (VCAN, VCAN_RATE_HZ) if options.vcan else (options.link, RATE_HZ)
    wanted = Wanted(link, options.rate or rate_hz, options.seconds, options.turns, not options.unrecorded)
    figures = _measured_inside(wanted) if options.vcan else _measured(wanted)
    if options.json == ON_STDOUT:
        print(json.dumps(figures))
    else:
        _print(figures)
        if options.json is not None:
            Path(options.json).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if options.page is not None:
        _write_row(options.page, figures)


def _measured_inside(wanted: Wanted) -> dict[str, Any]:
    """Return the figures of this bench where vcan is; no file that it writes there is seen here, but its output is."""
    if (sentence := socketcan.missing()) is not None:
        raise SystemExit(sentence)
    command = [sys.executable, "-m", "tools.bench.lateness", "--json", ON_STDOUT, "--link", wanted.link]
    command += ["--rate", str(wanted.rate_hz), "--seconds", str(wanted.seconds), "--turns", str(wanted.turns)]
    command += [] if wanted.is_recorded else ["--unrecorded"]
    limit_s = socketcan.LIMIT_S + 2 * wanted.seconds
    with socketcan.Inside(command, {"PYTHONPATH": str(ROOT)}, limit_s, directory=ROOT) as inside:
        *said, last = inside.output.read().decode(errors="replace").splitlines() or [""]
        code = inside.exit_code()
    for line in said:
        print(line, file=sys.stderr)
    if code != 0:
        how = f"was killed after {limit_s:g} s" if inside.is_out_of_time else f"ended with exit code {code}"
        raise SystemExit(f"where vcan is, this bench {how}: {last}")
    figures: dict[str, Any] = json.loads(last)
    return figures


def _measured(wanted: Wanted) -> dict[str, Any]:
    """Run controller and robot in turns with cyclictest, and return the figures."""
    cyclictest = shutil.which("cyclictest")
    if cyclictest is None:
        print("without cyclictest, which is not installed: apt install rt-tests", file=sys.stderr)
    ours, sleeper, turns = Lateness(), Lateness(), []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(wanted.turns):
            turns.append(_turn(Path(folder), wanted))
            _merge(ours, turns[-1].metrics["lateness_us"])
            if cyclictest is not None:
                _sleep(cyclictest, Path(folder), wanted, sleeper)
    return _figures(wanted, turns, ours, sleeper)


class Robot(NamedTuple):
    """Where a virtual robot is: URLs of its link and of its truth; no truth for one in the run's own process."""

    link: str
    truth: str | None

    def arguments(self) -> list[str]:
        """Return those of ``hil run`` in real time."""
        truth = [] if self.truth is None else ["--truth", self.truth]
        return ["--mode", "realtime", "--link", self.link, *truth]


@contextmanager
def device(link: str, settings: Sequence[str], hil: Sequence[str] = _HIL, root: Path = ROOT) -> Iterator[Robot]:
    """Run the virtual robot of a checkout."""
    command = [*hil, "device", SCENARIO, "--mode", "realtime", "--link", link, *settings]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment(root), cwd=root)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line.startswith("ready "):
            raise SystemExit(f"the robot did not start: {line}")
        told = dict(part.split("=", 1) for part in line.split()[1:])
        yield Robot(told["link"], told["truth"])
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def _turn(folder: Path, wanted: Wanted) -> Turn:
    # A stall that is longer than the watchdog waits is to be measured, not to end the turn.
    values = (f"rate_hz={wanted.rate_hz}", f"duration_s={wanted.seconds / wanted.turns}", "rearm=true")
    settings = ["--set", "expect=[]", *(word for value in values for word in ("--set", f"loop.{value}"))]
    trace = folder / "bus.log"
    files = ["--record", str(folder / "run.rrd") if wanted.is_recorded else "none", "--trace", str(trace), "--force"]
    with device(wanted.link, settings) as robot:
        metrics = run([*robot.arguments(), *settings, *files])
    return Turn(metrics, list(_reactions_us(trace)))


def run(arguments: Sequence[str], hil: Sequence[str] = _HIL, root: Path = ROOT) -> dict[str, Any]:
    """Run the scenario with the ``hil run`` of a checkout, and return its metrics."""
    command = [*hil, "run", SCENARIO, "--json", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment(root), cwd=root)
    if done.returncode not in (0, 1):  # one that was judged bad, after a stall, was measured as well
        raise SystemExit(f"the run failed: {done.stderr or done.stdout}")
    metrics: dict[str, Any] = json.loads(done.stdout)
    return metrics


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


def _sleep(cyclictest: str, folder: Path, wanted: Wanted, into: Lateness) -> None:
    """Run cyclictest for as long, at the same priority and period, and count its histogram of microseconds."""
    file = folder / "cyclictest.json"
    period_us, wakes = str(1_000_000 // wanted.rate_hz), str(round(wanted.seconds / wanted.turns * wanted.rate_hz))
    options = ["-q", "-m", "-p", str(PRIORITY), "-i", period_us, "-l", wakes, "-h", "1000000"]
    done = subprocess.run([cyclictest, *options, f"--json={file}"], capture_output=True, text=True, check=False)
    if done.returncode != 0:  # unlike the controller, it does not run without the right to a real-time priority
        print(
            f"without cyclictest, which ended with exit code {done.returncode}: {done.stderr.strip()}", file=sys.stderr
        )
        return
    for late_us, count in json.loads(file.read_text("utf-8"))["thread"]["0"]["histogram"].items():
        for _ in range(count):
            into.add(int(late_us) * 1000)


def _figures(wanted: Wanted, turns: list[Turn], ours: Lateness, sleeper: Lateness) -> dict[str, Any]:
    reaction_us = np.percentile(np.concatenate([turn.reaction_us for turn in turns]), [50, 99])
    last = turns[-1].metrics
    recorded = [turn.metrics["recorded"] for turn in turns if wanted.is_recorded]
    count = os.cpu_count() or 1
    return {
        "machine": f"{platform.machine()}, {count} processor{'s' if count > 1 else ''}",
        "kernel": _kernel(),
        "link": wanted.link,
        "rate_hz": wanted.rate_hz,
        "ticks": sum(turn.metrics["ticks"] for turn in turns),
        "deadline_misses": sum(turn.metrics["deadline_misses"] for turn in turns),
        "watchdog_stops": sum(len(turn.metrics["recoveries"]) for turn in turns),
        "tick_us": {
            name: statistics.median(turn.metrics["tick_us"][name] for turn in turns) for name in ("p50", "p99")
        },
        "lateness_us": ours.figures(),
        "cyclictest_us": sleeper.figures(),
        "reaction_us": dict(zip(("p50", "p99"), map(float, reaction_us), strict=True)),
        "round_trip_ms": last["link_statistics"]["round_trip_ms"],
        "realtime": last["realtime"],
        "recorded": {name: sum(one[name] for one in recorded) for name in ("rows", "dropped")} if recorded else None,
    }


def _kernel() -> str:
    """Return the kernel's name and version, also of one that is itself a process: there the processor says so."""
    said = [finding.sentence.partition(":")[0] for finding in checks.check_kernel() if finding.subject == "kernel"]
    if not said:
        return platform.platform()
    is_process = "User Mode Linux" in Path("/proc/cpuinfo").read_text("utf-8")
    return f"user-mode {said[0]}" if is_process else said[0]


def _print(figures: dict[str, Any]) -> None:
    ticks = figures["ticks"] + figures["deadline_misses"]
    title = f"{figures['rate_hz']} Hz over {figures['link']}"
    table = Table("", "p50 µs", "p99 µs", "p99.9 µs", "max µs", title=title)
    for label, name in (("lateness of ticks", "lateness_us"), ("cyclictest", "cyclictest_us")):
        if (row := figures[name]) is not None:
            table.add_row(label, *(f"{row[column]:.0f}" for column in ("p50", "p99", "p99.9", "max")))
    for label, name in (("work of a tick", "tick_us"), ("feedback stamped to command sent", "reaction_us")):
        table.add_row(label, *(f"{figures[name][column]:.0f}" for column in ("p50", "p99")), "", "")
    console = Console()
    console.print(table)
    console.print(f"{figures['machine']}, {figures['kernel']}")
    console.print(f"{figures['deadline_misses']} of {ticks} ticks skipped, {figures['watchdog_stops']} watchdog stops")
    for sentence in figures["realtime"]["refused"].values():
        console.print(f"not granted: {sentence}")


def _write_row(page: Path, figures: dict[str, Any]) -> None:
    """Write the row into the table between the page's marks, in the place of an older one of this machine and rate."""
    late, cyclictest = figures["lateness_us"], figures["cyclictest_us"]
    ticks = figures["ticks"] + figures["deadline_misses"]
    how = f"{figures['link']}, {figures['rate_hz']} Hz{'' if figures['recorded'] else ', not recorded'}"
    where = f"| {figures['machine']}, {figures['kernel']} | {how} |"
    of_three = [
        " / ".join(f"{row[name]:.0f}" for name in ("p50", "p99", "p99.9")) if row else "" for row in (late, cyclictest)
    ]
    stops = figures["watchdog_stops"]
    missed = f"{100 * figures['deadline_misses'] / ticks:.2g} %{f', {stops} watchdog stops' if stops else ''}"
    reaction = f"{figures['reaction_us']['p50']:.0f} / {figures['reaction_us']['p99']:.0f}"
    head, _, rest = page.read_text("utf-8").partition(BEGIN)
    table, _, tail = rest.partition(END)
    rows = [line for line in table.strip().splitlines() if not line.startswith(where)]
    rows.append(f"{where} {missed} | {of_three[0]} | {of_three[1]} | {reaction} |")
    page.write_text("\n".join([f"{head}{BEGIN}", *rows, f"{END}{tail}"]), encoding="utf-8")


def environment(root: Path = ROOT) -> dict[str, str]:
    """Return the environment of a process of a checkout."""
    return os.environ | {"PYTHONPATH": str(root)}


if __name__ == "__main__":
    main()
