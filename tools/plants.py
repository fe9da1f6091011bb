"""Writes the tables of docs/results/plants.md: what the three plants make of the same torques, speeds and controllers.

``python -m tools.plants`` runs the experiments, which takes about a minute, and writes the tables between the marks;
with ``--check`` it writes nothing and exits 1 when the page says something else.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hil
import plant_fmu
from hil.plant.fmu import FmuPlant
from tools.plant_experiments import (
    DIRECTIONS,
    Geometry,
    Start,
    acceleration,
    coasting_ratio,
    rolling_ratio,
    slip_onset_n_m,
)

PAGE = Path(plant_fmu.__file__).parents[1] / "docs" / "results" / "plants.md"
BEGIN, END = "<!-- plants: begin -->", "<!-- plants: end -->"
GEOMETRY = Geometry(wheel_radius_m=0.075, lever_m=0.6)
# What a scenario sets to have each plant, and the same as start values of the FMU.
PLANTS: dict[str, tuple[str, dict[str, float | str]]] = {
    "rigid": ("mecanum", {"contact": "rigid"}),
    "slip": ("mecanum", {"contact": "slip", "roller_friction_coefficient": 0.0}),  # MuJoCo's rollers run freely too
    "MuJoCo": ("mecanum_mujoco", {}),
}
HIGHEST_N_M = 12.0
LIMITED = {"robot.torque_limit_n_m": 1.8, "firmware.torque_limit_n_m": 1.8}


def start(plant: str) -> Start:
    """Return what starts a plant of ``PLANTS`` for an experiment."""
    fmu, values = PLANTS[plant]
    return lambda parameters: FmuPlant(plant_fmu.SHIPPED[fmu], {**values, **parameters})


def circle(plant: str, scenario: str) -> dict[str, object]:
    """Run a scenario with 1.8 N·m a wheel on a plant of ``PLANTS``, and return its metrics."""
    fmu, values = PLANTS[plant]
    chosen = {"plant.fmu": fmu} | {f"plant.start.{name}": value for name, value in values.items()}
    return dict(hil.run(scenario, set={**LIMITED, **chosen, "expect": []}).metrics)


def _row(name: str, of: Callable[[str], str]) -> str:
    return f"| {name} | " + " | ".join(of(plant) for plant in PLANTS) + " |"


def _number(value: object, digits: int, scale: float = 1.0) -> str:
    return "none" if value is None else f"{float(str(value)) * scale:.{digits}f}"


def tables() -> Iterator[str]:
    """Yield the lines of the tables."""
    head = ["| | " + " | ".join(PLANTS) + " |", "|---" * (1 + len(PLANTS)) + "|"]
    yield from ["Open loop:", "", *head]
    for direction in DIRECTIONS:
        yield _row(
            f"speed {direction} over that of ideal rollers, wheels at 5 rad/s",
            lambda p, d=direction: _number(rolling_ratio(start(p), GEOMETRY, d, 5.0), 4),  # type: ignore[misc]
        )
    for direction, unit in zip(DIRECTIONS, ("m/s²", "m/s²", "rad/s²"), strict=True):
        yield _row(
            f"acceleration {direction} at 1 N·m a wheel [{unit}]",
            lambda p, d=direction: _number(acceleration(start(p), d, 1.0), 3),  # type: ignore[misc]
        )
    for direction in DIRECTIONS:
        yield _row(
            f"3 % of the acceleration {direction} missing from [N·m]",
            lambda p, d=direction: _number(slip_onset_n_m(start(p), d, highest_n_m=HIGHEST_N_M), 2),  # type: ignore[misc]
        )
    yield _row(
        "turning of a coasting robot's velocity over its yaw rate",
        lambda p: _number(coasting_ratio(start(p), 1.0, 2.0), 3),
    )
    yield from ["", "The paper's circle in closed loop, at most 1.8 N·m a wheel:", "", *head]
    for scenario in ("paper_circle", "paper_circle_dsc", "circle_speed"):
        metrics = {plant: circle(plant, scenario) for plant in PLANTS}
        yield _row(f"`{scenario}`: tracked after [s]", lambda p, m=metrics: _number(m[p]["tracked_s"], 2))  # type: ignore[misc]
        yield _row(f"`{scenario}`: steady error rms [mm]", lambda p, m=metrics: _number(m[p]["steady_rms_m"], 2, 1e3))  # type: ignore[misc]


def page() -> str:
    """Return the page with new tables. Raises ValueError when it has lost its marks."""
    text = PAGE.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{PAGE.name}: expected {BEGIN} and {END} around the tables")
    return f"{before}{BEGIN}\n" + "\n".join(tables()) + f"\n{END}{after}"


def main() -> None:
    """Write the page, or with ``--check`` exit 1 when it says something else."""
    parser = argparse.ArgumentParser(prog="tools.plants", description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when the page is stale")
    check = parser.parse_args().check
    made = page()
    if check:
        sys.exit(f"{PAGE.name} is stale; run python -m tools.plants" if made != PAGE.read_text("utf-8") else 0)
    PAGE.write_text(made, encoding="utf-8", newline="\n")
    print(PAGE)


if __name__ == "__main__":
    main()
