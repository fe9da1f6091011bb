"""Section IV of Nguyen Minh et al. 2023 through the wire and the FMU, beside what the paper prints."""

import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.batch.old_pool import counted, perform_all
from hil.batch.reproduction import pictures
from hil.batch.reproduction.plan import FILTERS, LAWS, Case, cases
from hil.batch.reproduction.runs import WORK, Job, Outcome
from hil.batch.reproduction.summary import summarise
from hil.batch.reproduction.verdicts import Results, judge
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, claim, write_whole

__all__ = ["NotWrittenError", "reproduce"]

_SUMMARY = "summary.json"
_PICTURES = ("figure_8.png", "convergence.png", "figure_10.png", "figure_11.png", "delay.png")

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


class NotWrittenError(BadInputError):
    """The runs are done and a file could not be written; ``summary`` is what was found, of the files that are there."""

    def __init__(self, error: BadInputError, summary: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.summary = summary


def reproduce(
    folder: Path,
    *,
    quick: bool = False,
    jobs: int | None = None,
    limit_s: float = 120.0,
    tell: Tell | None = None,
    existing: Existing = "refuse",
) -> dict[str, Any]:
    """Run section IV and return the summary; it goes into ``folder`` as ``summary.json``, with pictures and recordings.

    ``quick`` leaves out most variants and shortens the others. ``jobs`` is the number of processes, by default one a
    processor; a run that takes more than ``limit_s`` of wall-clock time is ended. ``tell`` gets how many runs are done,
    of how many, and the newest outcome. ``existing`` says what is done where the folder has results of an earlier one:
    they are removed when the runs are done, or nothing begins.

    Raises BadInputError when ``folder`` cannot be made or written to or has results that must stay, and
    NotWrittenError, which has the summary, when it could be at first and a file then could not be written.
    """
    began = time.monotonic()
    _make(folder)
    planned = cases(quick=quick)
    if existing == "refuse" and (older := _older(folder)):
        raise BadInputError(
            f"--out {folder}: it has {older[0].name} of an earlier reproduction; name another folder, or replace its "
            "results with --force"
        )
    with tempfile.TemporaryDirectory(prefix="hil-reproduce-") as scratch:
        asked = [_job(case, Path(scratch)) for case in planned]
        outcomes = perform_all(WORK, asked, jobs or os.cpu_count() or 1, limit_s, counted(tell, len(planned)))
        signals = {label: _signals(Path(scratch) / f"{name}.npz") for label, name in _SHOWN.items()}
        results = Results(planned, outcomes)
        drawn: list[str] = []
        trouble: BadInputError | None = None
        try:
            _remove(_older(folder) if existing == "replace" else [])
            _draw(folder, results, {label: found for label, found in signals.items() if found is not None}, drawn)
        except BadInputError as error:
            trouble = error
        # Recordings are the largest, so that pictures go first, and a disk that is full ends no run.
        recordings: list[str] = []
        try:
            for job, outcome in zip(asked, outcomes, strict=True):
                if job.recording is not None and outcome.figures:  # what was lost has left half a recording at most
                    _move(Path(job.recording), folder)
                    recordings.append(Path(job.recording).name)
        except BadInputError as error:
            trouble = trouble or error
    found = summarise(
        planned,
        outcomes,
        judge(results),
        quick=quick,
        folder=folder,
        pictures=drawn,
        recordings=recordings,
        wall_s=time.monotonic() - began,
    )
    text = json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)
    try:
        write_whole(folder / _SUMMARY, text.encode("utf-8"))
    except BadInputError as error:
        trouble = trouble or error
    if trouble is not None:
        raise NotWrittenError(trouble, found)
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


def _older(folder: Path) -> list[Path]:
    """Return the files that an earlier reproduction, quick or not, wrote into a folder."""
    recordings = [f"{_file_name(case)}.rrd" for case in cases(quick=False) + cases(quick=True) if case.records]
    names = dict.fromkeys([_SUMMARY, *_PICTURES, *recordings])
    return [folder / name for name in names if (folder / name).exists()]


def _remove(files: Sequence[Path]) -> None:
    for file in files:
        try:
            file.unlink()
        except OSError as error:
            raise BadInputError(
                f"file {file}: this older result cannot be removed ({error.strerror}); name another folder"
            ) from error


def _move(recording: Path, folder: Path) -> None:
    place = claim("recording", folder / recording.name)
    try:
        shutil.move(recording, place)
    except OSError as error:
        if place.is_file():
            place.unlink()
        raise BadInputError(
            f"recording {place}: it cannot be written ({error.strerror}); name a folder with more room"
        ) from error


def _job(case: Case, scratch: Path) -> Job:
    series = str(scratch / f"{case.name}.npz") if case.name in _SHOWN.values() else None
    recording = str(scratch / f"{_file_name(case)}.rrd") if case.records else None
    return Job(case.name, case.scenario, dict(case.sets), series, recording)


def _file_name(case: Case) -> str:
    return case.name.replace(" ", "_")


def _signals(path: Path) -> Signals | None:
    """Return the signals that a run left; None where it did not come to its end."""
    if not path.exists():
        return None
    with np.load(path) as held:
        return dict(held)


def _draw(folder: Path, results: Results, shown: Mapping[str, Signals], drawn: list[str]) -> None:
    """Draw what there are runs for, and add the name of each picture to ``drawn``."""
    wanted: dict[str, Callable[[Path], None]] = {}
    if "dsc" in shown and "afdsc" in shown:
        wanted["figure_8.png"] = lambda path: pictures.circle(path, shown["dsc"], shown["afdsc"])
        wanted["convergence.png"] = lambda path: pictures.convergence(path, list(_labelled(shown)))
    if "experiment" in shown:
        wanted["figure_10.png"] = lambda path: pictures.path_in_plane(path, shown["experiment"])
        wanted["figure_11.png"] = lambda path: pictures.control_signals(path, shown["experiment"])
    if any(results.rows("delay")):
        wanted["delay.png"] = lambda path: pictures.delay(path, results)
    for name, draw in wanted.items():
        draw(folder / name)
        drawn.append(name)


def _labelled(shown: Mapping[str, Signals]) -> Sequence[tuple[str, Signals]]:
    """Return the runs on the circle with their words."""
    words = {
        "dsc": LAWS["dsc"][1].words,
        "afdsc": LAWS["afdsc"][1].words,
        "afdsc short": f"AFDSC, filter {FILTERS['short'].words}",
        "constant": LAWS["constant"][1].words,
    }
    return [(words[label], signals) for label, signals in shown.items() if label in words]
