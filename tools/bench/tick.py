"""What a tick costs, in turns with the same loop written first-hand: ``python -m tools.bench.tick``.

The paper's circle at 1 kHz in lockstep, AFDSC with FMU and firmware core in the loop and every byte of the protocol on
the wire, beside ``naive_loop``: FMPy's class, cantools, python-can's virtual bus, NumPy, and ``rr.log`` a signal. Both
without and with a recording, all in turns. A tick reaches from one exchange with the robot to the next. Ratios are of
the 10th percentiles, the ticks in which nobody else had the processor or its caches; of the turns the least counts.
Both loops have to be on the circle at the end.

Under conditions of the link, or with a trace, a tick is compared with ours without, in the same turns.
"""

import argparse
import contextlib
import json
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.core.types import PoseFix
from hil.plant import archive
from hil.plant.archive import read_header
from hil.robot.virtual import MakeNode, VirtualRobot, VirtualStm32, new_robot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.robots import plant_start
from hil.scenario import Scenario, load
from tools.bench.naive_loop import NaiveLoop

SCENARIO = "paper_circle"
FIRST = 600  # ticks that do not count
ON_THE_CIRCLE_M = 0.02
WAYS = ("not recorded", "recorded")
_NOTHING: Mapping[str, Any] = MappingProxyType({})
_LATER = {"start_s": 1000.0}
# Without latency the robot stays on the circle even if some commands or feedback are lost.
CONDITIONS: Mapping[str, Mapping[str, Any]] = {
    "frame fault, armed for later": {"fault": [{"kind": "drop", "target": "command", "value": 0.05, **_LATER}]},
    "freeze, armed for later": {"fault": [{"kind": "freeze", "target": "feedback", **_LATER}]},
    "frame fault on commands": {"fault": [{"kind": "drop", "target": "command", "value": 0.05}]},
    "frame fault on feedback": {"fault": [{"kind": "drop", "target": "feedback", "value": 0.01}]},
    "frame fault on a message": {"fault": [{"kind": "mute", "target": "STATUS"}]},
    "jitter of feedback": {"fault": [{"kind": "jitter", "target": "feedback", "value": 0.003}]},
    "latency of 2 + 2 ms": {"link.command_latency_s": 0.002, "link.feedback_latency_s": 0.002},
    "trace": {},
}
"""What to set for each; ``trace`` also writes one."""


class Turn(NamedTuple):
    """One run: percentiles of what a tick took [µs]."""

    p10_us: float
    p50_us: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.tick", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--turns", type=int, default=5, help="of each; the least counts")
    parser.add_argument("--seconds", type=float, default=5.0, help="of robot time a turn")
    parser.add_argument("--naive-seconds", type=float, default=2.0, help="of robot time a turn of the naive loop")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    figures = measure(options.turns, options.seconds, options.naive_seconds)
    print_figures(figures)
    under = measure_conditions(options.turns, options.seconds)
    print_conditions(under)
    figures |= under
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def measure(turns: int, seconds: float, naive_seconds: float) -> dict[str, dict[str, float]]:
    """Return for each way, recorded and not, what a tick takes, and how many times ours the naive one does."""
    taken: dict[str, dict[str, list[Turn]]] = {name: {"ours": [], "naive": []} for name in WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(turns):
            for name, both in taken.items():
                record = Path(folder, "run.rrd") if name == "recorded" else None
                both["ours"].append(ours(seconds, record))
                both["naive"].append(naive(naive_seconds, record))
    figures = {}
    for name, both in taken.items():
        figures[name] = {
            f"{way}_{percentile}": min(getattr(turn, percentile) for turn in some)
            for way, some in both.items()
            for percentile in ("p10_us", "p50_us")
        }
        figures[name]["ratio"] = figures[name]["naive_p10_us"] / figures[name]["ours_p10_us"]
    return figures


def measure_conditions(turns: int, seconds: float) -> dict[str, dict[str, float]]:
    """Return for each of ``CONDITIONS`` what a tick takes, and how many times a plain one."""
    taken: dict[str, list[Turn]] = {name: [] for name in ("plain", *CONDITIONS)}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(turns):
            for name, some in taken.items():
                trace = Path(folder, "bus.blf") if name == "trace" else None
                some.append(ours(seconds, None, trace, CONDITIONS.get(name, {})))
    p10_us = {name: min(turn.p10_us for turn in some) for name, some in taken.items()}
    p50_us = {name: min(turn.p50_us for turn in some) for name, some in taken.items()}
    return {
        name: {"p10_us": p10_us[name], "p50_us": p50_us[name], "of_plain": p10_us[name] / p10_us["plain"]}
        for name in taken
    }


def ours(seconds: float, record: Path | None, trace: Path | None = None, changes: Mapping[str, Any] = _NOTHING) -> Turn:
    """Run the bridge, as ``hil run`` does with and without a recording and a trace. ``changes`` are of the scenario."""
    stamps_ns: list[int] = []

    @contextlib.contextmanager
    def stamped_robot(made_of: VirtualRobot, make_node: MakeNode) -> Iterator[VirtualStm32]:
        """Make a robot that notes when it is asked for the truth: once a tick, between its answer and the law."""
        with new_robot(made_of, make_node) as robot:
            truth = robot.plant.truth

            def stamped_truth() -> PoseFix:
                stamps_ns.append(time.perf_counter_ns())
                return truth()

            robot.plant.truth = stamped_truth
            yield robot

    options = RunOptions(record=record, trace=trace, existing="replace", make_robot=stamped_robot, keep_signals=False)
    scenario = _scenario(seconds, changes)
    result = run_scenario(scenario, options)
    end = result.metrics["expect"][0]
    if result.failure is not None or not end["passed"]:  # a fault that was not applied also fails a run
        raise SystemExit(f"the run failed: {result.failure or end['text']}")
    # The rest is the stop, without calls of the law.
    return _turn(stamps_ns[: round(seconds * scenario.loop.rate_hz)])


def naive(seconds: float, record: Path | None) -> Turn:
    """Run the naive loop from the same start."""
    scenario = _scenario(seconds)
    fmu = archive.locate(scenario.plant.fmu, scenario.directory)
    start = plant_start(scenario, read_header(fmu).parameters)
    loop = NaiveLoop(scenario.robot, start, record)
    try:
        stamps_ns, error_m = loop.run(round(seconds * scenario.loop.rate_hz))
    finally:
        loop.close()
    if error_m > ON_THE_CIRCLE_M:
        raise SystemExit(f"the naive loop ended {error_m:.3f} m off the circle: what it cost means nothing")
    return _turn(stamps_ns)


def _turn(stamps_ns: list[int]) -> Turn:
    p10_us, p50_us = np.percentile(np.diff(stamps_ns)[FIRST:] * 1e-3, [10, 50])
    return Turn(float(p10_us), float(p50_us))


def _scenario(seconds: float, changes: Mapping[str, Any] = _NOTHING) -> Scenario:
    at_the_end = {"signal": "error.planar_m", "below": ON_THE_CIRCLE_M, "from_s": seconds - 0.01}
    changed = {"loop.duration_s": seconds, "expect": [at_the_end], **changes}
    return load(SCENARIO, mode="lockstep", link="memory:", set=changed)


def print_figures(figures: dict[str, dict[str, float]]) -> None:
    """Print the table."""
    table = Table("paper's circle", "ours p50", "naive p50", "ours p10", "naive p10", "times", title="a tick, µs")
    for name, row in figures.items():
        took = [f"{row[f'{way}_{percentile}']:.1f}" for percentile in ("p50_us", "p10_us") for way in ("ours", "naive")]
        table.add_row(name, *took, f"{row['ratio']:.1f}")
    Console().print(table)


def print_conditions(figures: dict[str, dict[str, float]]) -> None:
    """Print the table of the conditions."""
    table = Table("conditions", "p50", "p10", "of a plain one", title="a tick, µs")
    for name, row in figures.items():
        table.add_row(name, f"{row['p50_us']:.1f}", f"{row['p10_us']:.1f}", f"{row['of_plain']:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
