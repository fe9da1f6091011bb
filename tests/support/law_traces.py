"""Golden traces of the laws: ``python -m tests.support.law_traces`` writes tests/vectors/laws.csv anew.

Each law, in each mode that it has, drives the shipped FMU through the wire in lockstep, with its defaults and from half
a metre and 0.2 rad beside the circle. Kept is the true pose at some times. It is compared with a tolerance, because
another libm rounds another way.
"""

import csv
from pathlib import Path

import hil
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.laws.law_registry import shipped_laws

SHIPPED = shipped_laws()

VECTORS = Path(__file__).parents[1] / "vectors" / "laws.csv"
HEAD = ["law", "command", "t_s", "x_m", "y_m", "heading_rad"]
TIMES_S = (0.1, 0.3, 0.6, 0.995)
TICKS = tuple(round(t_s * 200) for t_s in TIMES_S)


def trace(law: str, mode: CommandMode) -> list[tuple[float, float, float]]:
    """Return the pose at the times. Raises BadInputError for a mode that the law refuses."""
    controller = {"law": law, "command": mode.name.lower()}
    signals = hil.run("circle_speed", set={"controller": controller, "loop.duration_s": 1.0, "expect": []}).signals
    axes = [signals[f"truth.{axis}"] for axis in ("x_m", "y_m", "heading_rad")]
    return [tuple(float(axis[tick]) for axis in axes) for tick in TICKS]


def main() -> None:
    """Write the vectors of all laws and modes."""
    with VECTORS.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEAD)
        for law in sorted(SHIPPED):
            for mode in CommandMode:
                try:
                    poses = trace(law, mode)
                except BadInputError:
                    continue  # it makes no sense in this mode, and says so
                for t_s, pose in zip(TIMES_S, poses, strict=True):
                    rows.writerow([law, mode.name.lower(), t_s, *(f"{value:.7f}" for value in pose)])


if __name__ == "__main__":
    main()
