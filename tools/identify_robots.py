"""How well hil identify finds robots that nobody knows: ``python -m tools.identify_robots --robots 20``.

Each robot is random and never a default one. It is driven over the wire as ``hil identify drive`` does, with noise of
the gyro, encoders of 4096 counts and late, noisy pose fixes; the recorded currents get noise, offsets and gains, which
the plant does not have. It is weighed, and fitted as ``hil identify fit`` does, without a model with slip where nothing
slips. Prints errors, how many true values are within their intervals, the prediction of a held-out drive, and the time
of the fit. A file of outcomes is continued where it ended. ``--page`` writes the table into
docs/results/identification.md. The exit code is 1 when a figure misses ``REACH``, ``PREDICTED_MM`` or ``COVERAGE``.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.stats import binom

from hil.addons.identify.drives import Drive, drive_of
from hil.addons.identify.estimates import Estimate, estimates
from hil.addons.identify.excitation import STEPS, Plan, plan_step
from hil.addons.identify.fit import fit
from hil.core.errors import HilError
from hil.core.outputs import write_whole
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import resolved
from tests.support.hidden_robots import Hidden, hidden_robot, write_scenario

PAGE = Path(__file__).parents[1] / "docs" / "results" / "identification.md"
BEGIN, END = "<!-- robots: begin -->", "<!-- robots: end -->"
CURRENT_NOISE_A, CURRENT_OFFSET_A, CURRENT_GAIN = 0.03, 0.003, 0.01
"""Standard deviations of the current sensors: of a reading, of an offset, and of the logarithm of a gain."""
PLANTS: dict[str, dict[str, object]] = {"rigid": {"contact": "rigid"}, "slip": {"contact": "slip"}, "mujoco": {}}
NAMES = {
    "torque_constant_n_m_a": ("torque constant", "%", 100.0),
    "inertia_kg_m2": ("inertia", "%", 100.0),
    "wheel_inertia_kg_m2": ("wheel inertia", "%", 100.0),
    "com_x_m": ("centre of mass, x", "mm", 1000.0),
    "com_y_m": ("centre of mass, y", "mm", 1000.0),
    "friction_coefficient": ("Coulomb friction", "%", 100.0),
    "viscous_n_m_s_rad": ("viscous friction", "%", 100.0),
    "wheel_radius_m": ("wheel radius", "%", 100.0),
    "lever_m": ("lever", "%", 100.0),
    "grip_coefficient": ("grip", "%", 100.0),
}
"""What is measured by name: its words, the unit of its error, and how many of it are one relative error, or a metre."""
REACH = {
    "torque_constant_n_m_a": 0.7,
    "inertia_kg_m2": 1.5,
    "wheel_inertia_kg_m2": 1.3,
    "com_x_m": 1.0,
    "com_y_m": 1.0,
    "friction_coefficient": 1.5,
    "viscous_n_m_s_rad": 2.0,
    "wheel_radius_m": 0.4,
    "lever_m": 0.4,
    "grip_coefficient": 12.0,
}
"""The largest 95th percentile of an error, in the unit of ``NAMES``; not of MuJoCo's robot, which has other parts."""
PREDICTED_MM = {"rigid": ("rigid_m", 1.5), "slip": ("slip_m", 1.5), "mujoco": ("slip_m", 5.0)}
"""The model that matches a plant, and the largest 95th percentile of its error on the held-out drive [mm]."""
COVERAGE = (0.90, 0.98)
"""The share of 95 % intervals that should hold the true value."""
_CHANCE = 0.01
_LENGTHS = ("com_x_m", "com_y_m")


def outcome(seed: int, plant: str) -> dict[str, Any]:
    """Drive and fit one robot; return its errors, intervals and which of them hold, predictions [m] and times [s]."""
    robot = hidden_robot(seed)
    with tempfile.TemporaryDirectory() as folder:
        drives = dict(_drives(Path(folder), robot, seed, plant))
    begin = time.process_time()
    contacts, squeeze = (("rigid",), None) if plant == "rigid" else (("rigid", "slip"), drives["squeeze"])
    result = fit(drives["floor"], drives["held_out"], blocks=drives["blocks"], contacts=contacts, squeeze=squeeze)
    fit_s = time.process_time() - begin
    true = robot.true | {
        "lever_m": robot.true["half_length_m"] + robot.true["half_width_m"],
        "torque_constant_n_m_a": robot.true["motor_constant_n_m_a"],
    }
    found = {one.name: one for one in estimates(result, robot.true["mass_kg"]) if one.name in NAMES}
    if plant == "rigid":
        found.pop("grip_coefficient", None)  # there is none
    return {
        "seed": seed,
        "plant": plant,
        "chosen": result.chosen.contact,
        "error": {name: _error(one, true[name]) for name, one in found.items()},
        "width": {name: _width(one, true[name]) for name, one in found.items()},
        "held": {name: one.low <= true[name] <= one.high for name, one in found.items()},
        "before_m": result.before.rms_m,
        **{f"{model.contact}_m": model.held_out.rms_m for model in result.models},
        "fit_s": fit_s,
    }


def _width(one: Estimate, true: float) -> float:
    return (one.high - one.low) / 2.0 / (1.0 if one.name in _LENGTHS else true)


def _error(one: Estimate, true: float) -> float:
    return one.value - true if one.name in _LENGTHS else one.value / true - 1.0


def _drives(folder: Path, robot: Hidden, seed: int, plant: str) -> Iterator[tuple[str, Drive]]:
    scenario = write_scenario(folder, robot, PLANTS[plant], seed)
    if plant == "mujoco":
        scenario.write_text(mujoco_text(scenario.read_text("utf-8")), encoding="utf-8")
    noise = np.random.default_rng(seed)
    gains, offsets_a = noise.normal(0.0, CURRENT_GAIN, 4), noise.normal(0.0, CURRENT_OFFSET_A, 4)
    gains = np.exp(gains - gains.mean())  # what they share is in the torque constant
    for name in STEPS:
        step = plan_step(name, scenario, Plan(seed=seed))
        result = run_scenario(step.scenario, RunOptions(lenient=True))
        if result.failure is not None:
            raise result.failure
        values = {key: value for key, value, _ in resolved(step.scenario)}
        drive = drive_of(Path(f"{name} of robot {seed}"), values, dict(result.signals))
        read_a = noise.normal(0.0, CURRENT_NOISE_A, drive.current_a.shape)
        yield name, replace(drive, current_a=gains * drive.current_a + offsets_a + read_a)


def mujoco_text(text: str) -> str:
    """Return a scenario with MuJoCo's robot in place of ours, without the variables that it does not have."""
    from plant_fmu.shipped import variable_names

    known = variable_names("mecanum_mujoco")
    lines, table = [], ""
    for line in text.splitlines():
        table = line if line.startswith("[") else table
        name = line.partition(" = ")[0]
        if table != "[plant.start]" or line.startswith("[") or not line or name in known:
            lines.append(line)
    return "\n".join([*lines, "", "[plant]", 'fmu = "mecanum_mujoco"', ""])


def figures(rows: Sequence[Mapping[str, Any]], name: str) -> tuple[float, float, float, int]:
    """Return median and 95th percentile of the error's size, the share of intervals that hold, and how many robots."""
    errors = [abs(row["error"][name]) for row in rows if name in row["error"]]
    if not errors:
        return np.nan, np.nan, np.nan, 0
    held = [row["held"][name] for row in rows if name in row["held"]]
    scale = NAMES[name][2]
    return (
        scale * float(np.median(errors)),
        scale * float(np.percentile(errors, 95)),
        float(np.mean(held)),
        len(errors),
    )


def table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the table of the page as Markdown."""
    kinds = [plant for plant in PLANTS if any(row["plant"] == plant for row in rows)]
    by_plant = {plant: [row for row in rows if row["plant"] == plant] for plant in kinds}
    yield f"| | {' | '.join(f'{plant}, {len(by_plant[plant])} robots' for plant in kinds)} |"
    yield "|---|" + "---|" * len(kinds)
    for name, (words, unit, _) in NAMES.items():
        cells = []
        for plant in kinds:
            median, worst, held, count = figures(by_plant[plant], name)
            cells.append(f"{median:.2g} \\| {worst:.2g}, {held:.0%}" if count else "")
        yield f"| {words}, {unit} | {' | '.join(cells)} |"
    for key, words, many in (
        ("before_m", "held-out drive, before the fit, mm", 1e3),
        ("rigid_m", "held-out drive, fitted, rigid, mm", 1e3),
        ("slip_m", "held-out drive, fitted, slip, mm", 1e3),
        ("fit_s", "time of the fit, s", 1.0),
    ):
        cells = [_spread([many * row[key] for row in by_plant[plant] if key in row]) for plant in kinds]
        yield f"| {words} | {' | '.join(cells)} |"


def shortfalls(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a sentence on each figure that misses its target.

    So few robots tell a coverage roughly: it falls short where chance alone would hardly have brought it there.
    """
    for plant, (model, most_mm) in PREDICTED_MM.items():
        here = [row for row in rows if row["plant"] == plant]
        if not here:
            continue
        off_mm = 1e3 * float(np.percentile([row[model] for row in here], 95))
        if off_mm > most_mm:
            yield f"{plant}: the held-out drive is predicted to {off_mm:.2g} mm; expected at most {most_mm:g} mm"
        for name, most in REACH.items() if plant != "mujoco" else ():
            words, unit, _ = NAMES[name]
            _, worst, share, count = figures(here, name)
            if worst > most:
                yield f"{plant}, {words}: the 95th percentile is {worst:.2g} {unit}; expected at most {most:g} {unit}"
            if count and not _is_covered(round(share * count), count):
                yield (
                    f"{plant}, {words}: {share:.0%} of {count} intervals hold the true value; expected "
                    f"{COVERAGE[0]:.0%} to {COVERAGE[1]:.0%}"
                )


def _is_covered(held: int, count: int) -> bool:
    least, most = COVERAGE
    return bool(binom.cdf(held, count, least) >= _CHANCE and binom.sf(held - 1, count, most) >= _CHANCE)


def _spread(values: Sequence[float]) -> str:
    if not values:
        return ""
    return f"{np.median(values):.2g} \\| {np.percentile(values, 95):.2g}"


def main() -> None:
    """Fit the robots, print the table, and write what was asked for."""
    parser = argparse.ArgumentParser(prog="tools.identify_robots", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robots", type=int, default=10, help="of each plant")
    parser.add_argument("--plants", nargs="+", choices=list(PLANTS), default=["rigid", "slip"])
    parser.add_argument("--seed", type=int, default=1001, help="of the first robot")
    parser.add_argument("--outcomes", type=Path, default=Path("build/identify_robots.jsonl"), help="continued if begun")
    parser.add_argument("--page", action="store_true", help="write the table into docs/results/identification.md")
    options = parser.parse_args()
    options.outcomes.parent.mkdir(parents=True, exist_ok=True)
    lines = options.outcomes.read_text().splitlines() if options.outcomes.exists() else []
    rows = list({(row["seed"], row["plant"]): row for row in map(json.loads, lines)}.values())
    done = {(row["seed"], row["plant"]) for row in rows}
    wanted = [(options.seed + place, plant) for place in range(options.robots) for plant in options.plants]
    for seed, plant in track([one for one in wanted if one not in done], console=Console(stderr=True)):
        try:
            row = outcome(seed, plant)
        except HilError as error:
            raise SystemExit(f"tools.identify_robots: robot {seed}, {plant}: {error}") from error
        rows.append(row)
        with options.outcomes.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    text = "\n".join(table(rows))
    print(text)
    if options.page:
        before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
        after = rest.partition(END)[2]
        write_whole(PAGE, f"{before}{BEGIN}\n{text}\n{END}{after}".encode(), "page", "replace")
    short = list(shortfalls(rows))
    print("\n".join(short), end="\n" if short else "", file=sys.stderr)
    sys.exit(1 if short else 0)


if __name__ == "__main__":
    main()
