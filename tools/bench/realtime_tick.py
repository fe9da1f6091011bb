"""A tick's work in real time over a pseudo-terminal, and the ticks skipped: ``python -m tools.bench.realtime_tick``.

The paper's circle at 1 kHz, not recorded, the robot in a process of its own or, with ``--one-process``, in that of the
controller. In turns with it runs a process that only sleeps: from tick to tick, with the same clock and rights. With
``--peer`` the ``hil`` of another checkout takes part in the turns. A busy machine makes all of them slower, so what
counts is the median of the ratios of the turns. ``tools.bench.parts --realtime`` shows where the time goes.
"""

import argparse
import json
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.core.clock import WallClock
from hil.runtime.realtime import real_time
from hil.scenario.tables import RealtimeTable
from tools.bench.lateness import ROOT, Robot, device, environment, run

PERIOD_NS = 1_000_000
THIS = "tools.bench.realtime_tick"
_LINK = "serial:pty"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog=THIS, description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="of each in a turn")
    parser.add_argument("--turns", type=int, default=10)
    parser.add_argument("--one-process", action="store_true", help="the robot in the controller's process")
    parser.add_argument("--peer", type=Path, metavar="CHECKOUT", help="with its own .venv, measured in the same turns")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--only-sleep", action="store_true", help=argparse.SUPPRESS)  # what a process of ours does
    options = parser.parse_args()
    if options.only_sleep:
        print(skipped_asleep(options.seconds))
        return
    checkouts: dict[str, tuple[Sequence[str], Path]] = {"ours": ((sys.executable, "-m", "hil.cli.main"), ROOT)}
    if options.peer is not None:
        root = options.peer.absolute()
        hil = root / ".venv" / Path(sys.executable).with_name("hil").relative_to(sys.prefix)
        checkouts["peer"] = ((str(hil),), root)
    turns: dict[str, list[dict[str, Any]]] = {name: [] for name in checkouts}
    asleep = []
    for _ in range(options.turns):
        for name, (command, root) in checkouts.items():
            turns[name].append(_turn(command, root, options.seconds, is_one_process=options.one_process))
        asleep.append(_sleep(options.seconds))
    figures = figures_of(turns, asleep, options.seconds)
    _print(figures)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def figures_of(turns: dict[str, list[dict[str, Any]]], asleep: Sequence[int], seconds: float) -> dict[str, Any]:
    """Return the figures from the metrics of each checkout's turns, and from the ticks that the sleeper skipped."""
    figures: dict[str, Any] = {}
    for name, runs in turns.items():
        ticks, skipped = (sum(one[key] for one in runs) for key in ("ticks", "deadline_misses"))
        work = {share: statistics.median(one["tick_us"][share] for one in runs) for share in ("p50", "p99")}
        figures[name] = {"tick_us": work, "skipped_percent": 100.0 * skipped / (ticks + skipped)}
    wakes = len(asleep) * seconds * 1e9 / PERIOD_NS
    figures["asleep"] = {"skipped_percent": 100.0 * sum(asleep) / wakes}
    beyond = figures["ours"]["skipped_percent"] - figures["asleep"]["skipped_percent"]
    figures["skipped"] = {"beyond_asleep_percent": beyond}
    if "peer" in turns:
        ratios = [
            ours["tick_us"]["p50"] / peer["tick_us"]["p50"]
            for ours, peer in zip(turns["ours"], turns["peer"], strict=True)
        ]
        figures["of_peer"] = {"median": statistics.median(ratios), "turns": sorted(ratios)}
    return figures


def _turn(hil: Sequence[str], root: Path, seconds: float, *, is_one_process: bool) -> dict[str, Any]:
    # A stall that is longer than the watchdog waits is to be counted, not to end the turn.
    values = ("expect=[]", f"loop.duration_s={seconds}", "loop.rearm=true")
    settings = [word for value in values for word in ("--set", value)]
    unrecorded = ["--record", "none"]
    if is_one_process:
        return run([*Robot(_LINK, None).arguments(), *settings, *unrecorded], hil, root)
    with device(_LINK, settings, hil, root) as robot:
        return run([*robot.arguments(), *settings, *unrecorded], hil, root)


def _sleep(seconds: float) -> int:
    command = [sys.executable, "-m", THIS, "--only-sleep", "--seconds", str(seconds)]
    return int(subprocess.run(command, capture_output=True, check=True, env=environment(), cwd=ROOT).stdout)


def skipped_asleep(seconds: float) -> int:
    """Sleep from tick to tick, as a loop without work would; return how many ticks it could not begin on time."""
    clock, ticks, number, skipped = WallClock(), round(seconds * 1e9 / PERIOD_NS), 0, 0
    with real_time(RealtimeTable()):
        origin_ns = clock.now_ns()
        while number < ticks:
            clock.wait_until(origin_ns + number * PERIOD_NS)
            following = max(number + 1, -(-(clock.now_ns() - origin_ns) // PERIOD_NS))
            skipped += min(following, ticks) - number - 1
            number = following
    return skipped


def _print(figures: dict[str, Any]) -> None:
    table = Table("", "work p50 µs", "p99 µs", "skipped %", title=f"1 kHz over {_LINK}, medians of the turns")
    for name in ("ours", "peer", "asleep"):
        if (row := figures.get(name)) is not None:
            work = [f"{row['tick_us'][share]:.1f}" for share in ("p50", "p99")] if "tick_us" in row else ["", ""]
            table.add_row("only sleeps" if name == "asleep" else name, *work, f"{row['skipped_percent']:.2f}")
    console = Console()
    console.print(table)
    if (ratio := figures.get("of_peer")) is not None:
        shown = ", ".join(f"{one:.2f}" for one in ratio["turns"])
        console.print(f"work p50, of the peer's: {ratio['median']:.2f} (turns: {shown})")


if __name__ == "__main__":
    main()
