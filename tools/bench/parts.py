"""Where the time of a tick goes, part by part: ``python -m tools.bench.parts``.

The paper's circle in lockstep over ``memory:``, as in ``tools.bench.tick``; with ``--realtime`` over a pseudo-terminal
to a robot in a process of its own. Each part is timed in a run of its own, so that the timers of others do not add to
it; figures are medians. A part that is indented is contained in the one above. The share is that of the tick in the
same run: it can be compared between parts where a busy machine changes the times.
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.core.guard import Guard
from hil.estimation.estimators import TruthEstimator
from hil.judge.memory_sink import MemorySink
from hil.judge.result import RunResult
from hil.laws.surface import SurfaceLaw
from hil.references.shapes import Circle
from hil.robot.direct import DirectLink
from hil.robot.stm32 import Stm32
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.freshness import Freshness
from hil.runtime.lateness import Lateness
from hil.runtime.loop import Loop
from hil.runtime.row import RowWriter
from hil.runtime.sampling import Sampling
from hil.runtime.tick import Tick
from hil.scenario import load
from hil.wire.framed import StreamLink
from hil.wire.link_statistics import LinkStatistics
from hil.wire.serial_port import SerialStream
from tools.bench.lateness import Robot, device

SCENARIO = "paper_circle"
FIRST = 600  # calls that do not count


class Part(NamedTuple):
    """A part of a tick: a text on it, its method, and how deep it is contained in others."""

    what: str
    kind: type
    method: str
    depth: int = 0


PARTS = (
    Part("wait: the robot's time passes; the true pose", Sampling, "wait"),
    Part("STEP, firmware, FMU, answer: one call of the library", DirectLink, "step", 1),
    Part("the tick", Loop, "_tick"),
    Part("feedback: fresh? the robot ACTIVE?", Freshness, "poll", 1),
    Part("heartbeat, and feedback from the snapshot", Stm32, "poll", 2),
    Part("estimate", TruthEstimator, "update", 1),
    Part("reference", Circle, "at", 1),
    Part("law, guard, command, row", Tick, "drive", 1),
    Part("law (AFDSC)", SurfaceLaw, "update", 2),
    Part("guard", Guard, "apply", 2),
    Part("guard: wheels near a limit, or slipping?", Guard, "fade", 2),
    Part("command to the library", Stm32, "send", 2),
    Part("row", RowWriter, "write", 2),
    Part("figures of the run", MemorySink, "put", 3),
)


REALTIME_PARTS = (
    Part("the tick", Loop, "_tick"),
    Part("feedback: fresh? the robot ACTIVE?", Freshness, "poll", 1),
    Part("poll", Stm32, "poll", 2),
    Part("bytes from the line to the client", StreamLink, "receive_waiting", 3),
    Part("the read: two system calls", SerialStream, "read", 4),
    Part("estimate", TruthEstimator, "update", 1),
    Part("reference", Circle, "at", 1),
    Part("law, guard, command, row", Tick, "drive", 1),
    Part("law (AFDSC)", SurfaceLaw, "update", 2),
    Part("guard", Guard, "apply", 2),
    Part("guard: wheels near a limit, or slipping?", Guard, "fade", 2),
    Part("command", Stm32, "send", 2),
    Part("bytes from the client to the line", StreamLink, "send_waiting", 3),
    Part("the write: one system call", SerialStream, "write", 4),
    Part("row", RowWriter, "write", 2),
    Part("load of the line", LinkStatistics, "load_percent", 3),
    Part("figures of the run", MemorySink, "put", 3),
    Part("lateness", Lateness, "add", 1),
)


class Took(NamedTuple):
    """The median time of a part's calls, and its share of a tick."""

    part_us: float
    of_tick: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.parts", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="of robot time a part")
    parser.add_argument("--realtime", action="store_true", help="over a pseudo-terminal, at 1 kHz")
    options = parser.parse_args()
    table = Table("part", "µs p50", "of the tick", title="where a tick goes")
    for part in REALTIME_PARTS if options.realtime else PARTS:
        took = took_of(part, options.seconds, is_realtime=options.realtime)
        table.add_row("  " * part.depth + part.what, f"{took.part_us:.2f}", f"{took.of_tick:.2f}")
    Console().print(table)


def took_of(part: Part, seconds: float, *, is_realtime: bool) -> Took:
    """Return the time of a part in one run, without the timer's own."""
    plain: Callable[..., Any] = getattr(part.kind, part.method)
    taken_ns: list[int] = []
    now_ns = time.perf_counter_ns

    def timed(*arguments: Any, **named: Any) -> Any:
        begin_ns = now_ns()
        result = plain(*arguments, **named)
        taken_ns.append(now_ns() - begin_ns)
        return result

    setattr(part.kind, part.method, timed)
    settings = {"loop.duration_s": seconds, "expect": [], "loop.rearm": True}
    try:
        if is_realtime:
            words = [word for name, value in settings.items() for word in ("--set", f"{name}={json.dumps(value)}")]
            with device("serial:pty", words) as robot:
                result = _run("realtime", settings, robot)
        else:
            result = _run("lockstep", settings, Robot("memory:", None))
    finally:
        setattr(part.kind, part.method, plain)
    part_us = (float(np.median(taken_ns[FIRST:])) - _timer_ns()) * 1e-3
    return Took(part_us, part_us / result.metrics["tick_us"]["p50"])


def _run(mode: str, settings: Mapping[str, object], robot: Robot) -> RunResult:
    scenario = load(SCENARIO, mode=mode, link=robot.link, set=settings)
    return run_scenario(scenario, RunOptions(truth=robot.truth, record=None, keep_signals=False))


def _timer_ns() -> float:
    """Return what reading the clock twice takes [ns]."""
    now_ns = time.perf_counter_ns
    return float(np.median([-(now_ns() - now_ns()) for _ in range(1000)]))


if __name__ == "__main__":
    main()
