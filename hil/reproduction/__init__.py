"""Section IV of Nguyen Minh et al. 2023 through the wire and the FMU, beside what the paper prints."""

import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.errors import BadInputError
from hil.pool import counted, perform_all
from hil.reproduction import pictures
from hil.reproduction.plan import FILTERS, LAWS, Case, cases
from hil.reproduction.runs import WORK, Job, Outcome
from hil.reproduction.summary import summarise
from hil.reproduction.verdicts import Results, judge

__all__ = ["reproduce"]

_SUMMARY = "summary.json"

Tell = Callable[[int, int, Outcome], None]
Signals = Mapping[str, npt.NDArray[np.float64]]

_SHOWN = {
    "dsc": "dsc common together",
    "afdsc": "afdsc common together",
    "afdsc short": "afdsc short together",
    "constant": "constant common together",
    "experiment": "experiment",
}
"""Runs that are in the pictures."""


def reproduce(
    folder: Path, *, quick: bool = False, jobs: int | None = None, limit_s: float = 120.0, tell: Tell | None = None
) -> dict[str, Any]:
    """Run section IV and return the summary; it goes into ``folder`` as ``summary.json``, with pictures and recordings.

    ``quick`` leaves out most variants and shortens the circle. ``jobs`` is the number of processes, by default one a
    processor; a run that takes more than ``limit_s`` of wall-clock time is ended. ``tell`` gets how many runs are done,
    of how many, and the newest outcome.

    Raises BadInputError when ``folder`` cannot be made or written to.
    """
    began = time.monotonic()
    _make(folder)
    planned = cases(quick=quick)
    with tempfile.TemporaryDirectory(prefix="hil-reproduce-") as scratch:
        asked = [_job(case, folder, Path(scratch)) for case in planned]
        outcomes = perform_all(WORK, asked, jobs or os.cpu_count() or 1, limit_s, counted(tell, len(planned)))
        signals = {label: _signals(Path(scratch) / f"{name}.npz") for label, name in _SHOWN.items()}
        results = Results(planned, outcomes)
        drawn = _draw(folder, results, {label: found for label, found in signals.items() if found is not None})
    recordings = [Path(job.recording) for job in asked if job.recording is not None]
    found = summarise(
        planned,
        outcomes,
        judge(results),
        quick=quick,
        folder=folder,
        pictures=drawn,
        recordings=[path.name for path in recordings if path.exists()],
        wall_s=time.monotonic() - began,
    )
    (folder / _SUMMARY).write_text(json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False), encoding="utf-8")
    return found


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInputError(
            f"--out {folder}: it cannot be written to ({error.strerror}); name a folder that you may write to"
        ) from error


def _job(case: Case, folder: Path, scratch: Path) -> Job:
    series = str(scratch / f"{case.name}.npz") if case.name in _SHOWN.values() else None
    recording = str(folder / f"{case.name.replace(' ', '_')}.rrd") if case.records else None
    return Job(case.name, case.scenario, dict(case.sets), series, recording)


def _signals(path: Path) -> Signals | None:
    """Return the signals that a run left; None where it did not come to its end."""
    if not path.exists():
        return None
    with np.load(path) as held:
        return dict(held)


def _draw(folder: Path, results: Results, shown: Mapping[str, Signals]) -> list[str]:
    """Draw what there are runs for; return the names of the pictures."""
    drawn: list[str] = []

    def place(name: str) -> Path:
        drawn.append(name)
        return folder / name

    if "dsc" in shown and "afdsc" in shown:
        pictures.circle(place("figure_8.png"), shown["dsc"], shown["afdsc"])
        pictures.convergence(place("convergence.png"), list(_labelled(shown)))
    if "experiment" in shown:
        pictures.path_in_plane(place("figure_10.png"), shown["experiment"])
        pictures.control_signals(place("figure_11.png"), shown["experiment"])
    if any(results.rows("delay")):
        pictures.delay(place("delay.png"), results)
    return drawn


def _labelled(shown: Mapping[str, Signals]) -> Sequence[tuple[str, Signals]]:
    """Return the runs on the circle with their words."""
    words = {
        "dsc": LAWS["dsc"][1].words,
        "afdsc": LAWS["afdsc"][1].words,
        "afdsc short": f"AFDSC, filter {FILTERS['short'].words}",
        "constant": LAWS["constant"][1].words,
    }
    return [(words[label], signals) for label, signals in shown.items() if label in words]
