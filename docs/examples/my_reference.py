"""A motion of one's own: computed in Python, written as a trajectory, checked, and followed by the robot."""

import math
import sys
from pathlib import Path

import numpy as np

import hil


def write_flower(path: Path, petals: int = 3, period_s: float = 20.0) -> None:
    """Write a flower as a trajectory: its columns are t_s, x_m, y_m and heading_rad."""
    t_s = np.arange(0.0, period_s + 0.01, 0.02)
    angle_rad = math.tau * t_s / period_s
    radius_m = 0.8 + 0.2 * np.cos(petals * angle_rad)
    rows = np.column_stack([t_s, radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), 0.0 * t_s])
    np.savetxt(path, rows, delimiter=",", header="t_s,x_m,y_m,heading_rad", comments="")


def main(folder: str = ".", duration_s: str = "20") -> None:
    """Write the flower, and drive it from a start that lies beside it."""
    path = Path(folder) / "flower.csv"
    write_flower(path)
    result = hil.run(
        "circle_speed",
        set={
            # This table replaces that of the scenario. ramp_s: from rest, and to rest at the end.
            "reference": {"kind": "trajectory", "file": str(path.resolve()), "ramp_s": 2.0},
            "plant.start.start_x_m": 0.9,
            "loop.duration_s": float(duration_s),
            "expect": [],
        },
    )
    print(result)
    print("the robot can follow it" if not result.metrics["reference"]["warnings"] else "it is too fast for the wheels")


if __name__ == "__main__":
    main(*sys.argv[1:])
