"""Read a recording (.rrd or .mcap) of `hil run` into NumPy and pandas."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from hil.review import read, review


def main(file: str) -> None:
    """Print what the recording holds."""
    recorded = read(Path(file))
    print(f"{file}: {len(recorded.signals)} signals, {len(recorded.events)} events, {recorded.properties['law']}")

    # NumPy: one array a signal, one value a tick.
    t_s = recorded.signals["loop.t_s"]
    error_m = recorded.signals["error.planar_m"]
    print(f"rms error {np.sqrt(np.mean(error_m**2)):.4f} m over {t_s[-1]:.2f} s")

    # pandas: all of them, by time.
    frame = pd.DataFrame(recorded.signals).set_index("loop.t_s")
    print(frame[["wheel.fl.speed_rad_s", "wheel.fr.speed_rad_s"]].describe().loc[["mean", "max"]])

    # What happened, and the figures that the run had at its end, worked out of the recording alone.
    for event in recorded.events:
        print(f"{event.t_s:8.3f} s  {event.level:7}  {event.text}")
    print("passed:", review(Path(file))["passed"])


if __name__ == "__main__":
    main(*sys.argv[1:])
