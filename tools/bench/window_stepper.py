"""What stepping an FMU through many windows costs, beside the FMU alone.

``python -m tools.bench.window_stepper`` steps the shipped FMU through windows of half a second with
``hil.plant.window_stepper``, each from its own start values, and as many steps in a C loop over the FMU's own
functions, which neither resets nor sets a start. Both take turns; the numbers are medians of CPU time. Needs a C
compiler.
"""

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import plant_fmu
from firmware_protocol.built import BuildError
from hil.core.errors import HilError
from hil.core.plant_signals import OUTPUTS
from hil.plant.fmu import FmuPlant
from hil.plant.start import Value
from hil.plant.window_stepper import WindowStepper
from tools.bench.fmu_step import EVERY, TORQUE, RawLoop

READ = OUTPUTS[:21]  # those that the bridge reads of a plant that has them all
VARIED = ("mass_kg", "inertia_kg_m2", "start_vx_m_s", "start_vy_m_s", "start_yaw_rate_rad_s")
START = (20.0, 0.56, 0.3, -0.2, 0.5)
WINDOWS = 200
WINDOW_MS = 500


class Case(NamedTuple):
    """What is stepped: start values, and how long a step is [ms]."""

    start: Mapping[str, Value]
    step_ms: int


FRICTION: dict[str, Value] = {"friction_coefficient": 0.03, "viscous_n_m_s_rad": 0.02}
CASES = {
    "rigid, steps of 10 ms": Case({"longest_step_s": 0.01}, 10),
    "rigid, steps of 1 ms": Case({}, 1),
    "rigid, friction, steps of 10 ms": Case({"longest_step_s": 0.01, **FRICTION}, 10),
    "slip, friction, steps of 10 ms": Case({"contact": "slip", "longest_step_s": 0.01, **FRICTION}, 10),
}


def measure(raw: RawLoop, fmu: Path, case: Case, repeats: int) -> tuple[float, float]:
    """Return the CPU time of a step [us]: in the C loop, and in the windows."""
    rows = WINDOW_MS // case.step_ms
    torque = np.full((1, rows, 4), TORQUE, np.float32)
    with contextlib.ExitStack() as opened:
        plant = opened.enter_context(FmuPlant(fmu, case.start))
        way = raw.way("floor", plant, EVERY, READ, case.step_ms)
        stepper = opened.enter_context(
            WindowStepper(fmu, case.start, varied=VARIED, outputs=READ, step_ns=case.step_ms * 1_000_000)
        )
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(repeats):
            spent = 0
            for _ in range(WINDOWS):
                plant.restart({**case.start, **dict(zip(VARIED, START, strict=True))})
                begin = time.process_time_ns()
                way.run(rows)
                spent += time.process_time_ns() - begin
            times[0].append(spent / 1000 / WINDOWS / rows)
            begin = time.process_time_ns()
            stepper.run(torque, [0] * WINDOWS, [START] * WINDOWS)
            times[1].append((time.process_time_ns() - begin) / 1000 / WINDOWS / rows)
    return statistics.median(times[0]), statistics.median(times[1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="tools.bench.window_stepper", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=11, help="of every measurement; the median counts")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    figures: dict[str, dict[str, Any]] = {}
    table = Table(
        "windows of 0.5 s", "C loop, us a step", "windows, us a step", "times", title="FMI 2, 21 outputs read"
    )
    try:
        with tempfile.TemporaryDirectory() as folder:
            raw = RawLoop(Path(folder))
            for name, case in CASES.items():
                floor, ours = measure(raw, plant_fmu.path(2), case, options.repeats)
                figures[name] = {"floor_us": floor, "windows_us": ours, "times": ours / floor}
                table.add_row(name, f"{floor:.3f}", f"{ours:.3f}", f"{ours / floor:.2f}")
    except (BuildError, HilError) as error:
        raise SystemExit(f"tools.bench.window_stepper: {error}") from error
    Console().print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
