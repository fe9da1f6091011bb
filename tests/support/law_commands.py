"""Golden commands of the laws: ``python -m tests.support.law_commands`` writes tests/vectors/law_commands.csv anew.

Each law, in each mode that it has, drives a robot that is heavier and turns more easily than it believes from some
situations: near, far, turned round, faster than the reference, with little torque. Kept are the commands of some ticks,
for which no wire and no plant is needed. MPC is left out: its solver rounds in another way elsewhere, and SciPy judges
it.
"""

import csv
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.types import WHEEL_NAMES, ZERO_WHEELS, Applied, CommandMode, Pose, State, Twist, WheelCommand
from hil.laws.law_registry import shipped_laws
from hil.references.shapes import FigureEight, Hold
from tests.support.closed_loop import PAPER_ROBOT, after

VECTORS = Path(__file__).parents[1] / "vectors" / "law_commands.csv"
WHEELS = [f"{quantity}_{wheel}" for quantity in ("speed", "torque") for wheel in WHEEL_NAMES]
HEAD = ["law", "command", "situation", "tick", *WHEELS]
DT_S = 0.005
LAWS = {name: law for name, law in shipped_laws().items() if name != "mpc"}
EIGHT = FigureEight(1.0, 8.0, heading="path", centre_x_m=0.2, centre_y_m=-0.1)
FIXED = FigureEight(1.0, 8.0, heading_rad=0.6)


class Situation(NamedTuple):
    """How far a robot is from the reference at the start, and what it can."""

    pose: tuple[float, float, float]
    twist: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_n_m: float = 5.0
    speed_rad_s: float = 20.0
    latency_s: float = 0.004
    reference: Any = EIGHT
    ticks: tuple[int, ...] = (0, 1, 5, 20)


SITUATIONS = {
    "near": Situation((0.004, -0.002, 0.01), latency_s=0.02),
    "beside": Situation((0.08, 0.05, -0.3), torque_n_m=1.8),
    "far": Situation((-0.6, 0.35, 0.9), ticks=(0, 1, 5, 20, 60, 110)),
    "turned": Situation((1.4, -1.1, -2.5), torque_n_m=1.8, ticks=(0, 1, 5, 20, 60, 150)),
    "fast": Situation((0.3, 0.2, 0.1), (0.9, -0.7, 2.5), latency_s=0.02),
    "rush": Situation((-1.9, 1.6, -0.4), (0.5, 0.2, -0.6), 1.8, 60.0, reference=FIXED, ticks=(0, 1, 5, 20, 60, 110)),
    "hold": Situation((0.25, -0.45, 0.2), reference=Hold(0.5, 0.3, -1.0), ticks=(0, 1, 5, 20, 60)),
}


def commands(law: str, mode: CommandMode, name: str) -> Iterator[tuple[int, tuple[float, ...]]]:
    """Yield tick, and speeds and torques of the wheels. Raises BadInputError for a mode that the law refuses."""
    situation = SITUATIONS[name]
    robot = dataclasses.replace(
        PAPER_ROBOT,
        friction_coefficient=0.03,
        speed_limit_rad_s=situation.speed_rad_s,
        torque_limit_n_m=situation.torque_n_m,
    )
    true = dataclasses.replace(PAPER_ROBOT, mass_kg=25.0, inertia_kg_m2=0.35)
    controller = LAWS[law](robot, mode, LAWS[law].Options())
    guard = Guard(robot.speed_limit_rad_s, robot.torque_limit_n_m)
    first = situation.reference.at(1.0)
    motion = tuple(map(sum, zip((*first.pose, *first.twist), (*situation.pose, *situation.twist), strict=True)))
    applied = Applied(WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), False, situation.latency_s)
    for tick in range(situation.ticks[-1] + 1):
        state = State(Pose(*motion[:3]), Twist(*motion[3:]))
        reference = situation.reference.at(1.0 + tick * DT_S)
        if tick == 0:
            controller.reset(state, reference)
        wanted = controller.update(reference, state, applied, DT_S)
        if tick in situation.ticks:
            yield tick, (*wanted.speed_rad_s, *wanted.torque_n_m)
        command, saturated = guard.apply(wanted)
        applied = Applied(command, saturated, situation.latency_s)
        if mode is CommandMode.TORQUE:
            motion = after(true, motion, command.torque_n_m, DT_S)
        else:  # wheels that follow at once
            twist = robot.twist(command.speed_rad_s, state.pose.heading_rad)
            motion = (*(at + DT_S * rate for at, rate in zip(state.pose, twist, strict=True)), *twist)


def main() -> None:
    """Write the vectors of all laws and modes."""
    with VECTORS.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEAD)
        for law in sorted(LAWS):
            for mode in CommandMode:
                for name in SITUATIONS:
                    try:
                        for tick, values in commands(law, mode, name):
                            rows.writerow([law, mode.name.lower(), name, tick, *(f"{value:.9g}" for value in values)])
                    except BadInputError:
                        break  # it makes no sense in this mode, and says so


if __name__ == "__main__":
    main()
