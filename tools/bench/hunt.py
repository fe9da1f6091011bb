"""Runs that ``hil hunt`` needs to find a planted defect, against random search: ``python -m tools.bench.hunt``.

Each defect is a law of ``planted_law.py`` or a value of the scenario. All are looked for in the same space of start
states, parameters, link conditions and faults, by the same expectations, which hold there without a defect: what is
found is run once more without the defect, and has to pass. Random search draws from the same space. Its median follows
from the share of its runs that break something; where none does, from one in as many as it did. Either counts at most
20,000 runs. Defects that random search meets in more than 1 % of its runs are not counted.
"""

import argparse
import json
import math
import random
import statistics
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hil.batch.hunt.hunt import Hunt, Request
from hil.batch.hunt.space import Case
from hil.batch.job import PASSED, Job, Outcome
from hil.batch.run import run
from hil.scenario import from_plain

LAW = Path(__file__).with_name("planted_law.py")
CAP = 20_000
RARE, MOST = 0.01, 0.2
SCENARIO = """
extends = "circle_speed"

[controller]
law = {law}
command = "speed"

[controller.gains]
k1_1_s = 8.0

[loop]
duration_s = 0.8

[plant.start]
start_x_m = 1.0
start_y_m = 0.0
start_heading_rad = 0.785
mass_kg = 20.0

[[expect]]
signal = "error.planar_m"
below = 0.38

[[expect]]
signal = "error.heading_rad"
within = [-0.45, 0.45]

[[expect]]
signal = "error.planar_m"
from_s = 0.6
below = 0.3

[[expect]]
signal = "error.heading_rad"
from_s = 0.6
within = [-0.25, 0.25]
"""
HUNT = """
runs = {runs}
seed = {seed}
at_once = 1

[set]
{sets}

[range]
plant.start.mass_kg = [17, 23]
plant.start.friction_coefficient = {{ log_uniform = [0.02, 0.1] }}
plant.start.start_x_m = [0.9, 1.1]
plant.start.start_y_m = [-0.1, 0.1]
plant.start.start_heading_rad = [0.585, 0.985]
reference.period_s = [9, 20]
link.command_latency_s = {{ uniform = [0.0, 0.01], step = 0.001 }}

[[fault]]
kind = "drop"
target = "command"
start_s = [0.0, 0.7]
duration_s = [0.02, 0.08]
value = [0.1, 0.9]

[[fault]]
kind = "push"
target = ["force_x_n", "force_y_n"]
start_s = [0.0, 0.7]
duration_s = [0.05, 0.2]
value = [-30, 30]

[[fault]]
kind = "push"
target = "moment_n_m"
start_s = [0.0, 0.7]
duration_s = [0.05, 0.2]
value = [-4, 4]

[[fault]]
kind = "dead_motor"
target = ["fl", "rr"]
start_s = [0.0, 0.7]
duration_s = [0.02, 0.06]
"""


class Defect(NamedTuple):
    """A planted defect: its name, and the keys of the scenario that plant it."""

    name: str
    sets: Mapping[str, Any]


def law(name: str, level: float) -> Defect:
    """Return a defect of the law."""
    return Defect(name, {"controller.gains.defect": name, "controller.gains.level": level})


HEALTHY = Defect("healthy", {})
DEFECTS = (
    law("heading_sign", 0.1993), law("y_sign", 0.19), law("x_sign", 0.0992), law("heading_wrap", 0.1993),
    law("left_behind", 0.0997), law("needle", 0.01), law("slow_reference", 0.69), law("far", 0.19),
    law("corner", 0.088), law("far_and_turned", 0.17), law("fast", 1.11), law("backwards", 0.95),
    law("sideways", 1.02), law("turning", 1.25), law("turning_back", 1.22), law("spinning", 1.33),
    law("quadrant", 0.9835), law("windup", 12.0), law("slow_rate", 34.0), law("clipped", 8.0),
    law("reversed_wheel", 14.0),
    Defect("weak motors", {"firmware.torque_limit_n_m": 1.05}),
    Defect("slow tracking filter", {"firmware.tracking_bandwidth_rad_s": 22.0}),
    Defect("large wheels believed", {"robot.wheel_radius_m": 0.1}),
)  # fmt: skip


def hunt_of(defect: Defect, folder: Path, runs: int, seed: int) -> Hunt:
    """Return a hunt for a defect."""
    (folder / "planted.toml").write_text(SCENARIO.format(law=json.dumps(f"{LAW}:Planted")), encoding="utf-8")
    sets = "\n".join(f"{key} = {json.dumps(value)}" for key, value in defect.sets.items())
    (folder / "planted.hunt.toml").write_text(HUNT.format(runs=runs, seed=seed, sets=sets), encoding="utf-8")
    return Hunt(Request(str(folder / "planted.toml")))


def done(job: Job | None) -> Outcome:
    """Do a run in this process."""
    assert job is not None, "all cases of this space are valid"
    return run(job, from_plain(job.scenario))


def runs_of_hunt(defect: Defect, folder: Path, runs: int, seed: int) -> tuple[int | None, Case | None]:
    """Return after how many runs a hunt found something, and what; None where it found nothing."""
    hunt = hunt_of(defect, folder, runs, seed)
    outcomes: list[Outcome] = []
    while (jobs := hunt.next_jobs(outcomes, runs)) and hunt.found_case is None:
        outcomes = [done(job) for job in jobs]
    return (None, None) if hunt.found_case is None else (hunt.runs, hunt.found_case)


def breaks_at_random(defect: Defect, folder: Path, runs: int, seed: int) -> int:
    """Return how many of so many random runs break something."""
    hunt, chance = hunt_of(defect, folder, runs, seed), random.Random(seed)
    broken = 0
    for _ in range(runs):
        case = hunt.space.case(hunt.space.suggested(lambda _, n: chance.randrange(n) if n else chance.random()))
        broken += bool(hunt.verdict(case, done(hunt.job(case))).broken)
    return broken


def measured(defect: Defect, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of a defect: runs until found by hunts and at random, and whether it counts."""
    broken = breaks_at_random(defect, folder, options.random, options.seed)
    share = max(broken, 1) / options.random
    hunts, real = [], True
    for seed in range(1, 1 + options.hunts):
        after, case = runs_of_hunt(defect, folder, options.cap, seed)
        hunts.append(after)
        if case is not None:
            healthy = hunt_of(HEALTHY, folder, 1, seed)
            real = real and done(healthy.job(case)).status == PASSED
    median = statistics.median(CAP if after is None else after for after in hunts)
    at_random = min(CAP, math.log(2.0) / share)
    return {
        "defect": defect.name,
        "random_runs": options.random,
        "random_broken": broken,
        "random_median": at_random,
        "hunts": hunts,
        "hunt_median": median,
        "ratio": median / at_random,
        "passes_without": real,
        "counts": broken / options.random <= RARE and real,
    }


def main() -> int:
    """Measure, print, and return 1 where a hunt needs more than a fifth of the runs of random search."""
    parser = argparse.ArgumentParser(prog="tools.bench.hunt", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--defect", choices=[one.name for one in DEFECTS], action="append", help="only these")
    parser.add_argument("--random", type=int, default=2000, help="random runs a defect")
    parser.add_argument("--hunts", type=int, default=5, help="hunts a defect, each with another seed")
    parser.add_argument("--cap", type=int, default=CAP, help="runs of a hunt at most")
    parser.add_argument("--seed", type=int, default=7, help="of the random runs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for defect in DEFECTS:
            if options.defect is None or defect.name in options.defect:
                rows.append(measured(defect, Path(folder), options))
                print(json.dumps(rows[-1]), flush=True)
    counted = [row for row in rows if row["counts"]]
    result: dict[str, Any] = {"rows": rows, "counted": len(counted)}
    if counted:
        result |= {
            "ratio_median": statistics.median(row["ratio"] for row in counted),
            "hunt_median": statistics.median(row["hunt_median"] for row in counted),
            "random_median": statistics.median(row["random_median"] for row in counted),
        }
        print({name: value for name, value in result.items() if name != "rows"})
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return 0 if counted and result["ratio_median"] <= MOST else 1


if __name__ == "__main__":
    sys.exit(main())
