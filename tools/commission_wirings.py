"""Commissions robots of random hidden wirings, and prints how many came out right: the table of COMMISSIONING.md.

``python -m tools.commission_wirings`` takes hours on two busy processors; ``--wirings 5`` is a first look. A robot
has its motors on random outputs in random directions, its encoders on random inputs and against their motors at times,
rollers X or O, and an IMU that lies level in one of eight ways. The bridge is told nothing of that. The exit code is 1
when a wiring came out wrong.
"""

import argparse
import itertools
import json
import random
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.identify.commission.commissioning import commission
from hil.addons.init.init_command import ROBOT_FILE, begin
from hil.addons.init.new_robot import PROJECT_QUESTIONS, Value
from hil.core.errors import HilError
from hil.core.options import format_value
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import IMU_AXES, ImuMount

DRIVERS = ("stm32", "odrive", "c620")
PLANTS: dict[str, dict[str, object]] = {
    "rigid": {"plant.start.contact": "rigid"},
    "slip": {"plant.start.contact": "slip"},
    "MuJoCo": {"plant.fmu": "mecanum_mujoco"},
}
GEOMETRY: dict[str, Value] = {"robot.half_length_m": 0.3, "robot.half_width_m": 0.22}


class Hidden(NamedTuple):
    """A wiring that nobody tells the bridge."""

    wheels: tuple[str, ...]
    reversed: tuple[str, ...]
    encoders: tuple[str, ...]
    encoders_reversed: tuple[str, ...]
    imu: tuple[str, ...]
    rollers: str

    def keys(self) -> dict[str, object]:
        """Return the keys of a scenario whose virtual robot is wired so."""
        wiring = {f"plant.wiring.{name}": value for name, value in self._asdict().items() if name != "rollers"}
        return {**wiring, "plant.start.rollers": "xo".index(self.rollers) + 1}


class Outcome(NamedTuple):
    """The result for one robot: ``problem`` is None if everything was found correctly."""

    problem: str | None
    furthest_m: float
    fastest_rad_s: float


def level_mounts() -> list[tuple[str, ...]]:
    """Return the ways in which an IMU lies level, its third axis up or down."""
    found = []
    for axes in itertools.permutations(IMU_AXES):
        for signs in itertools.product(("", "-"), repeat=3):
            mount = tuple(sign + axis for sign, axis in zip(signs, axes, strict=True))
            try:
                ImuMount(mount)
            except ValueError:
                continue
            if mount[2] in ("z", "-z"):
                found.append(mount)
    return found


def hidden(seed: int) -> Hidden:
    """Return a random wiring."""
    source = random.Random(seed)
    wheels = tuple(source.sample(WHEEL_NAMES, 4))
    some = [tuple(wheel for wheel in WHEEL_NAMES if source.random() < share) for share in (0.5, 0.3)]
    encoders = wheels if source.random() < 0.7 else tuple(source.sample(WHEEL_NAMES, 4))
    return Hidden(wheels, some[0], encoders, some[1], source.choice(level_mounts()), source.choice("xo"))


def robot_file(folder: Path) -> Path:
    """Write the robot of ``hil init`` with these half lengths, and return its file."""
    answers: dict[str, Value] = {}
    for question in PROJECT_QUESTIONS:
        answers[question.key] = GEOMETRY.get(question.key, question.proposed(answers))
    return begin(folder, answers)[ROBOT_FILE]


def found_right(wired: Hidden, values: dict[str, object], table: Any) -> str | None:
    """Return the differences between a wiring and the found one; None without any."""
    inputs = tuple(wired.encoders.index(wheel) + 1 for wheel in wired.wheels)
    signs = tuple(-1 if wheel in wired.encoders_reversed else 1 for wheel in wired.wheels)
    pairs: list[tuple[str, object, object]] = [
        ("wheels", wired.wheels, values.get("device.wheels")),
        ("reversed", set(wired.reversed), set(values.get("device.reversed", ()))),  # type: ignore[call-overload]
        ("imu", wired.imu, values.get("device.imu", wired.imu)),  # motor controllers have none
        ("rollers", wired.rollers, table.rollers),
        ("encoders", inputs, table.encoders),
        ("encoder signs", signs, table.encoder_signs),
    ]
    wrong = [f"{name}: {found} for {true}" for name, true, found in pairs if true != found]
    return "; ".join(wrong) or None


def tried(driver: str, plant: str, seed: int, further: Sequence[str] = ()) -> Outcome:
    """Commission one robot of a random wiring through the bridge."""
    wired = hidden(seed)
    keys = {**PLANTS[plant], **wired.keys(), "device.driver": driver, "loop.seed": seed}
    sets = [*(f"{key}={format_value(value)}" for key, value in keys.items()), *further]
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = commission(robot_file(Path(folder)), sets=sets)
        except HilError as error:
            return Outcome(f"seed {seed}: {error}", 0.0, 0.0)
    problem = found_right(wired, done.values, done.table)
    named = None if problem is None else f"seed {seed}: {problem}"
    return Outcome(named, done.furthest_m, done.fastest_rad_s)


def row(driver: str, plant: str, outcomes: Sequence[Outcome]) -> str:
    """Return the row of the page's table for one driver and plant."""
    right = sum(outcome.problem is None for outcome in outcomes)
    way_cm = 100 * max(outcome.furthest_m for outcome in outcomes)
    speed = max(outcome.fastest_rad_s for outcome in outcomes)
    return f"| {driver} | {plant} | {right} of {len(outcomes)} | {way_cm:.1f} | {speed:.1f} |"


def main() -> None:
    """Commission the robots, and print a row for each driver and plant."""
    parser = argparse.ArgumentParser(prog="tools.commission_wirings", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--wirings", type=int, default=100, metavar="N", help="of each driver and plant")
    parser.add_argument("--driver", choices=DRIVERS, action="append", help="by default all")
    parser.add_argument("--plant", choices=PLANTS, action="append", help="by default all")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes")
    parser.add_argument("--json", action="store_true", help="print every outcome as a line of JSON too")
    options = parser.parse_args()
    problems = []
    print("| driver | plant | right | furthest way of a rim in a pulse, cm | fastest wheel, rad/s |")
    print("|---|---|---|---|---|")
    with ProcessPoolExecutor(options.jobs) as pool:
        for driver, plant in itertools.product(options.driver or DRIVERS, options.plant or PLANTS):
            outcomes = list(pool.map(partial(tried, driver, plant), range(1, options.wirings + 1)))
            print(row(driver, plant, outcomes), flush=True)
            here = [f"{driver}, {plant}, {one.problem}" for one in outcomes if one.problem is not None]
            problems += here
            print("\n".join(here), end="\n" if here else "", file=sys.stderr, flush=True)
            if options.json:
                print(json.dumps([outcome._asdict() for outcome in outcomes]), flush=True)
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main()
