"""The poses of a recorded run as a CSV file, which ``reference.kind = "trajectory"`` follows."""

import csv
from pathlib import Path

import numpy as np

from hil.core.errors import BadInputError
from hil.core.outputs import Existing, whole_file
from hil.record.files import check_output_path
from hil.review.reader import RecordedRun

_POSE = ("x_m", "y_m", "heading_rad")


def write_trajectory(run: RecordedRun, path: Path, existing: Existing = "refuse") -> None:
    """Write time and pose of each tick that has one: the true pose where the run knew it, else the estimate.

    ``existing`` says what is done where the file is there already. Raises BadInputError where the recording has no
    pose, and where the file cannot be written.
    """
    check_output_path("trajectory", path, existing)
    signals = run.signals
    for source in ("truth", "pose"):
        names = [f"{source}.{name}" for name in _POSE]
        if all(name in signals for name in names):
            rows = np.stack([signals["loop.t_s"], *(signals[name] for name in names)], axis=1)
            rows = rows[np.isfinite(rows).all(axis=1)]
            if len(rows):
                break
    else:
        raise BadInputError(f"{run.path}: no tick of it has a pose; a trajectory needs some")
    try:
        with (
            whole_file(path, "trajectory", existing) as unfinished,
            unfinished.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(("t_s", *_POSE))
            writer.writerows(rows.tolist())
    except OSError as error:
        raise BadInputError(f"--trajectory {path}: it cannot be written: {error.strerror}") from error
