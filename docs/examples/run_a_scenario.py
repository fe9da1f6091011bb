"""Run a scenario from Python, with some keys changed, and read its figures and signals."""

import sys

import numpy as np

import hil


def main(duration_s: float = 6.0) -> None:
    """Drive the paper's circle with a robot that is heavier than its controller believes."""
    result = hil.run(
        "paper_circle",
        set={"plant.start.mass_kg": 24.0, "loop.duration_s": duration_s, "expect": []},
        seed=1,
    )
    print(result)  # how it went, in a few lines

    # Figures are plain numbers; None where the run has no such figure, and `reasons` says why.
    print("on the path after", result.metrics["tracked_s"], "s")

    # Signals are NumPy arrays, one value a tick. `hil list signals` prints their names and units.
    t_s = result.signals["loop.t_s"]
    error_m = result.signals["error.planar_m"]
    print(f"{len(t_s)} ticks; the largest error of the last second is {np.max(error_m[t_s > t_s[-1] - 1.0]):.4f} m")

    # All of them as a pandas table, indexed by time.
    print(result.frame()[["pose.x_m", "pose.y_m", "error.planar_m"]].tail(3))


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
