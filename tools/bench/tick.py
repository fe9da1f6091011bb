"""What a tick costs, in turns with the same loop written first-hand: ``python -m tools.bench.tick``.

The paper's circle at 1 kHz in lockstep, AFDSC with FMU and firmware core in the loop and every byte of the protocol on
the wire, beside ``naive_loop``: FMPy's class, cantools, python-can's virtual bus, NumPy, and ``rr.log`` a signal. Both
without and with a recording, all in turns. The cost is CPU time of the loop's thread, which does not count what others
do on the machine meanwhile; of the turns the least counts. Both have to be on the circle at the end.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_protocol.host import HostNode
from hil.assembly import run_scenario
from hil.bench import plant_start
from hil.loop import Loop
from hil.model import RobotModel
from hil.plant import archive
from hil.plant.description import parameter_names
from hil.scenario import Scenario, load
from tools.bench.naive_loop import NaiveLoop

SCENARIO = "paper_circle"
FIRST_TICKS = 100  # of a run, which do not count for the median
ON_THE_CIRCLE_M = 0.02
LEAST_RATIO = {"not recorded": 8.0, "recorded": 25.0}
"""How much longer the naive loop has to take for a tick."""


class Turn(NamedTuple):
    """One run: CPU time of a tick [µs], the median of its wall time [µs], and how far off the circle it ended [m]."""

    cpu_us: float
    wall_p50_us: float
    error_m: float


def main() -> None:
    """Measure, print and judge."""
    parser = argparse.ArgumentParser(prog="tools.bench.tick", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--turns", type=int, default=5, help="of each; the least counts")
    parser.add_argument("--seconds", type=float, default=5.0, help="of robot time a turn")
    parser.add_argument("--naive-seconds", type=float, default=2.0, help="of robot time a turn of the naive loop")
    parser.add_argument(
        "--check", action="store_true", help="exit 1 where the naive loop is not as slow as it has to be"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    figures = measure(options.turns, options.seconds, options.naive_seconds)
    print_figures(figures)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if options.check and (lost := losses(figures, LEAST_RATIO)):
        raise SystemExit("; ".join(lost))


def measure(turns: int, seconds: float, naive_seconds: float) -> dict[str, dict[str, float]]:
    """Return for each way, recorded and not, what a tick takes, and how many times ours the naive one does."""
    taken: dict[str, dict[str, list[Turn]]] = {name: {"ours": [], "naive": []} for name in LEAST_RATIO}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(turns):
            for name, both in taken.items():
                record = Path(folder, "run.rrd") if name == "recorded" else None
                both["ours"].append(ours(seconds, record))
                both["naive"].append(naive(naive_seconds, record))
    worst = max(turn.error_m for both in taken.values() for some in both.values() for turn in some)
    if worst > ON_THE_CIRCLE_M:
        raise SystemExit(f"a loop ended {worst:.3f} m off the circle: what it cost means nothing")
    figures = {}
    for name, both in taken.items():
        cpu_us = {way: min(turn.cpu_us for turn in some) for way, some in both.items()}
        figures[name] = {
            "ours_cpu_us": cpu_us["ours"],
            "ours_wall_p50_us": min(turn.wall_p50_us for turn in both["ours"]),
            "naive_cpu_us": cpu_us["naive"],
            "naive_wall_p50_us": min(turn.wall_p50_us for turn in both["naive"]),
            "ratio": cpu_us["naive"] / cpu_us["ours"],
        }
    return figures


def losses(figures: dict[str, dict[str, float]], least: dict[str, float]) -> list[str]:
    """Return a sentence for each ratio that is less than it has to be."""
    return [
        f"a tick, {name}: the naive loop takes {figures[name]['ratio']:.1f} times ours; expected {ratio:g} and more"
        for name, ratio in least.items()
        if figures[name]["ratio"] < ratio
    ]


def ours(seconds: float, record: Path | None) -> Turn:
    """Run the bridge; a tick reaches from one STEP to the next, and so has the plant in it."""
    stamps: list[int] = []
    cpu_ns: list[int] = []

    class StampedNode(HostNode):
        """A firmware that notes when it is called."""

        def feed(self, data: bytes) -> None:
            stamps.append(time.perf_counter_ns())
            super().feed(data)

    @contextmanager
    def watch(_loop: Loop) -> Iterator[None]:
        begin_ns = time.thread_time_ns()
        yield
        cpu_ns.append(time.thread_time_ns() - begin_ns)

    result = run_scenario(_scenario(seconds), record=record, make_node=StampedNode, watch=watch)
    if result.failure is not None:
        raise SystemExit(f"the run failed: {result.failure}")
    ticks = int(result.metrics["ticks"])
    walls_us = np.diff(stamps[-ticks:]) * 1e-3
    error_m = float(result.signals["error.planar_m"][-1])
    return Turn(cpu_ns[0] * 1e-3 / ticks, float(np.median(walls_us[FIRST_TICKS:])), error_m)


def naive(seconds: float, record: Path | None) -> Turn:
    """Run the naive loop from the same start."""
    scenario = _scenario(seconds)
    fmu = archive.locate(scenario.plant.fmu, scenario.directory)
    start = plant_start(scenario, parameter_names(fmu))
    loop = NaiveLoop(RobotModel(**dict(scenario.robot)), start, record)
    try:
        done = loop.run(round(seconds * scenario.loop.rate_hz))
    finally:
        loop.close()
    return Turn(done.cpu_us, float(np.median(done.walls_us[FIRST_TICKS:])), done.errors_m[-1])


def _scenario(seconds: float) -> Scenario:
    return load(SCENARIO, mode="lockstep", link="memory:", set={"loop.duration_s": seconds, "expect": []})


def print_figures(figures: dict[str, dict[str, float]]) -> None:
    """Print the table."""
    table = Table("paper's circle", "ours, µs", "naive, µs", "times", "ours p50, wall µs", title="a tick, CPU time")
    for name, row in figures.items():
        cells = (f"{row['ours_cpu_us']:.1f}", f"{row['naive_cpu_us']:.0f}", f"{row['ratio']:.1f}")
        table.add_row(name, *cells, f"{row['ours_wall_p50_us']:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
