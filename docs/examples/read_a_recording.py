"""Read a recording (.rrd or .mcap) of `hil run` back: how it went, its signals in NumPy and pandas, its events."""

import sys

import numpy as np

import hil


def main(file: str) -> None:
    """Print what the recording holds."""
    result = hil.load(file)  # what hil.run returned; also of a run that was killed, which result.notes then say
    print(result)
    for sentence in result.notes:
        print("note:", sentence)

    # NumPy: one array a signal, one value a tick.
    t_s, error_m = result.signals["loop.t_s"], result.signals["error.planar_m"]
    print(f"rms error {np.sqrt(np.nanmean(error_m**2)):.4f} m over {t_s[-1]:.2f} s")

    # pandas: all of them, by time.
    print(result.frame()[["wheel.fl.speed_rad_s", "wheel.fr.speed_rad_s"]].describe().loc[["mean", "max"]])

    # The figures, by the names in `hil run --json`, and what happened.
    print(f"law {result.metrics['law']}, effort {result.metrics['effort_n_m_s']:.3g} N·m·s")
    for event in result.events:
        print(f"{event.t_s:8.3f} s  {event.level:7}  {event.text}")
    print("passed:", result.passed)


if __name__ == "__main__":
    main(*sys.argv[1:])
