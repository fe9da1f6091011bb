"""Where the time of a tick goes, part by part: ``python -m tools.bench.parts``.

The paper's circle in lockstep over ``memory:``, as in ``tools.bench.tick``. Each part is timed in a run of its own, so
that the timers of others do not add to it; figures are medians. A part that is indented is contained in the one above.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_protocol.client import Client
from hil.core.guard import Guard
from hil.estimation.truth import TruthEstimator
from hil.judge.results import MemorySink
from hil.laws.surface import SurfaceLaw
from hil.plant.fmu import FmuPlant
from hil.references.circle import Circle
from hil.robot.direct import DirectLink
from hil.robot.stm32 import Stm32
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.freshness import Freshness
from hil.runtime.loop import Loop
from hil.runtime.row import RowWriter
from hil.runtime.sampling import Sampling
from hil.runtime.tick import Tick
from hil.scenario import load

SCENARIO = "paper_circle"
FIRST = 600  # calls that do not count


class Part(NamedTuple):
    """A part of a tick: what it does, the method that does it, and how deep it is contained in others."""

    what: str
    kind: type
    method: str
    depth: int = 0


PARTS = (
    Part("wait: the robot's time passes", Sampling, "wait"),
    Part("STEP, firmware, FMU, answer: one call of the library", DirectLink, "step", 1),
    Part("the true pose", FmuPlant, "truth", 1),
    Part("the tick", Loop, "_tick"),
    Part("feedback: fresh? the robot ACTIVE?", Freshness, "poll", 1),
    Part("feedback from the snapshot", Client, "feedback", 2),
    Part("estimate", TruthEstimator, "update", 1),
    Part("reference", Circle, "at", 1),
    Part("law, guard, command, row", Tick, "drive", 1),
    Part("law (AFDSC)", SurfaceLaw, "update", 2),
    Part("guard", Guard, "apply", 2),
    Part("command to the library", Stm32, "send", 2),
    Part("row", RowWriter, "write", 2),
    Part("figures of the run", MemorySink, "put", 3),
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.parts", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="of robot time a part")
    seconds = parser.parse_args().seconds
    table = Table("part", "µs p50", title="where a tick goes")
    for part in PARTS:
        table.add_row("  " * part.depth + part.what, f"{took_us(part, seconds):.2f}")
    Console().print(table)


def took_us(part: Part, seconds: float) -> float:
    """Return the median time of a part's calls in one run [µs], without what the timer takes."""
    plain: Callable[..., Any] = getattr(part.kind, part.method)
    taken_ns: list[int] = []
    now_ns = time.perf_counter_ns

    def timed(*arguments: Any, **named: Any) -> Any:
        begin_ns = now_ns()
        result = plain(*arguments, **named)
        taken_ns.append(now_ns() - begin_ns)
        return result

    setattr(part.kind, part.method, timed)
    try:
        scenario = load(SCENARIO, mode="lockstep", link="memory:", set={"loop.duration_s": seconds, "expect": []})
        run_scenario(scenario, RunOptions(record=None, keep_signals=False))
    finally:
        setattr(part.kind, part.method, plain)
    return (float(np.median(taken_ns[FIRST:])) - _timer_ns()) * 1e-3


def _timer_ns() -> float:
    """Return what reading the clock twice takes [ns]."""
    now_ns = time.perf_counter_ns
    return float(np.median([-(now_ns() - now_ns()) for _ in range(1000)]))


if __name__ == "__main__":
    main()
