"""Runs section IV: the jobs of the cases, the figures that follow from their signals, and the files of the results."""

import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.batch.job import ALWAYS, ENDED, LOST, NEVER, REFUSED, Job, Outcome
from hil.batch.keys import make_job
from hil.batch.output import deferred, prepare_folder, remove
from hil.batch.plan import OnProgress, run_jobs
from hil.batch.reproduction import pictures, published
from hil.batch.reproduction.analysis import oscillation
from hil.batch.reproduction.assumptions import assumptions
from hil.batch.reproduction.plan import Case, Result, cases
from hil.batch.reproduction.verdicts import Results, judge
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, claim, write_whole
from hil.core.scratch import scratch_folder
from hil.core.types import WHEEL_NAMES
from hil.judge.tracking import STEADY_WINDOW_S, TRACKED_RATIO
from hil.review.plots import FORMATS
from hil.scenario import from_plain, load

Signals = Mapping[str, npt.NDArray[np.float64]]

_SUMMARY = "summary.json"
_DELAY = "delay"
_PICTURES = {
    "figure_8": (pictures.circle, ("dsc", "afdsc")),
    "convergence": (pictures.convergence, ("dsc", "afdsc")),
    "figure_10": (pictures.path_in_plane, ("experiment",)),
    "figure_11": (pictures.control_signals, ("experiment",)),
}
"""By name: what draws a picture, and the runs (names in ``_SHOWN``) that it needs."""
_SHOWN = {
    "dsc": "dsc common together",
    "afdsc": "afdsc common together",
    "afdsc short": "afdsc short together",
    "constant": "constant common together",
    "experiment": "experiment",
}
"""The cases that are in the pictures, by their names there."""
_SIGNALS = (
    "loop.t_s",
    *(f"reference.{axis}_m" for axis in "xy"),
    *(f"truth.{axis}_m" for axis in "xy"),
    *(f"error.{name}" for name in ("x_m", "y_m", "heading_rad", "planar_m")),
    *(f"wheel.{wheel}.torque_command_n_m" for wheel in WHEEL_NAMES),
)
_OF_METRICS = ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m")
_OF_SIGNALS = ("heading_rad", "driven_s", "from_m", "transition_s", "amplitude_m", "frequency_hz")
_OF_DELAY = ("steady_rms_m", "steady_max_m", "amplitude_m", "frequency_hz")
_FIGURES = {
    "circle": (*_OF_METRICS, "heading_rad"),
    "experiment": ("driven_s", "from_m", "transition_s", *_OF_DELAY),
    "delay": ("transition_s", *_OF_DELAY),
    "transition": ("from_m", "transition_s"),
}
"""The figures in each group of the summary."""
FORMAT = 1
"""Version of the summary: raised for changes that a reader has to know of."""
PAPER = (
    "Nguyen Minh et al. 2023, An Adaptive Fuzzy Dynamic Surface Control Tracking Algorithm for Mecanum Wheeled "
    "Mobile Robot"
)


class NotWrittenError(BadInputError):
    """The runs are done but a file could not be written; ``summary`` has the results and names the written files."""

    def __init__(self, error: BadInputError, summary: dict[str, Any]) -> None:
        super().__init__(str(error))
        self.summary = summary


def reproduce(
    folder: Path,
    *,
    quick: bool = False,
    kind: str = "png",
    workers: int | None = None,
    limit_s: float = 120.0,
    on_progress: OnProgress | None = None,
    existing: Existing = "refuse",
) -> dict[str, Any]:
    """Run section IV and return the summary; it goes into ``folder`` as ``summary.json``, with pictures and recordings.

    In the summary each of ``circle``, ``experiment``, ``delay`` and ``transition`` is a list of rows: what the case is,
    its figures (None where one is not defined) and ``failure``. ``paper`` has the printed figures, ``verdicts`` the
    verdicts on them, ``pictures`` and ``recordings`` names of files in ``folder``.

    ``quick`` leaves out most variants and shortens the others. ``kind`` is the format of the pictures: png, svg or
    pdf. ``workers`` is the number of processes, by default one per processor; a run that takes more than ``limit_s``
    of wall-clock time is ended. ``on_progress`` is called as ``hil.batch.plan.run_jobs`` does. Results of an earlier
    reproduction in the folder are removed when the runs are done; with ``existing="refuse"`` they are an error and
    nothing begins.

    Raises BadInputError when ``folder`` cannot be made or written to or has results that must stay, and
    NotWrittenError, with the summary, when a file cannot be written after the runs.
    """
    began = time.monotonic()
    prepare_folder(folder, _older, "reproduction", existing)
    planned = cases(quick=quick)
    errors: list[BadInputError] = []
    drawn: list[str] = []
    recordings: list[str] = []
    with scratch_folder("reproduce") as scratch:
        jobs = [_job(case, scratch, limit_s) for case in planned]
        names = {job.key: case.name for job, case in zip(jobs, planned, strict=True)}

        def trouble(outcome: Outcome) -> str | None:
            failure = _failure(outcome)
            return None if failure is None else f"{names[outcome.key]}: {failure}"

        outcomes = run_jobs(jobs, workers, on_progress, trouble)
        found = [_result(*one) for one in zip(planned, jobs, outcomes, strict=True)]
        results = Results(found)
        with deferred(errors):
            remove(_older(folder) if existing == "replace" else [])
            signals = {case.name: _signals(job) for case, job in zip(planned, jobs, strict=True)}
            shown = {label: signals[name] for label, name in _SHOWN.items() if signals.get(name)}
            for picture, (draw, needed) in _PICTURES.items():
                if shown.keys() >= set(needed):
                    draw(folder / f"{picture}.{kind}", shown)
                    drawn.append(f"{picture}.{kind}")
            if any(results.rows("delay")):
                pictures.delay(folder / f"{_DELAY}.{kind}", results)
                drawn.append(f"{_DELAY}.{kind}")
        # Recordings are the largest, so pictures go first: a full disk then costs least.
        with deferred(errors):
            for outcome in outcomes:
                if outcome.recording is not None:
                    _move(Path(outcome.recording), folder)
                    recordings.append(Path(outcome.recording).name)
    summary = {
        "format": FORMAT,
        "source": PAPER,
        "quick": quick,
        "paper": [printed._asdict() for printed in published.FIGURES],
        "filters_s": {"common": published.COMMON_FILTER_S, "short": published.SHORT_FILTER_S},
        "assumptions": assumptions(),
        **{group: [_row(one) for one in found if one.case.group == group] for group in _FIGURES},
        "verdicts": [verdict._asdict() for verdict in judge(results)],
        "folder": str(folder),
        "pictures": drawn,
        "recordings": recordings,
        "wall_s": time.monotonic() - began,
    }
    with deferred(errors):
        text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False)
        write_whole(folder / _SUMMARY, text.encode("utf-8"))
    if errors:
        raise NotWrittenError(errors[0], summary)
    return summary


def _row(result: Result) -> dict[str, Any]:
    case, figures, failure = result
    return {
        "name": case.name,
        **case.row,
        **{name: figures.get(name) for name in _FIGURES[case.group]},
        "failure": failure,
    }


def failures(summary: Mapping[str, Any]) -> list[str]:
    """Return the runs of a summary that did not come to their end, each with what ended it."""
    rows = (row for group in _FIGURES for row in summary[group])
    return [f"{row['name']}: {row['failure']}" for row in rows if row["failure"] is not None]


def _job(case: Case, scratch: Path, limit_s: float) -> Job:
    scenario = replace(load(case.scenario, set=case.sets), baseline=None)
    job = make_job(scenario, options={"signals": _SIGNALS}, limit_s=limit_s)
    return job._replace(
        signals_file=str(scratch / f"{job.key}.npz"),
        record=ALWAYS if case.records else NEVER,
        recording=str(scratch / _recording(case)),
    )


def _recording(case: Case) -> str:
    return f"{case.name.replace(' ', '_')}.rrd"


def _failure(outcome: Outcome) -> str | None:
    """Return what ended a run early, or a sentence if no fault explains that the robot was not driven.

    Such runs say nothing about the law. The scenario's own expectations do not matter here.
    """
    return outcome.reason if outcome.status in (ENDED, LOST, REFUSED) else outcome.details["undriven"]


def _result(case: Case, job: Job, outcome: Outcome) -> Result:
    """Return the result of a case, with the figures of ``signal_figures`` beside those of the run itself."""
    if not outcome.figures:
        return Result(case, {}, _failure(outcome))
    figures = {name: outcome.figures[name] for name in _OF_METRICS}
    signals = _signals(job)
    if outcome.status == ENDED or not len(signals["loop.t_s"]):
        return Result(case, figures | dict.fromkeys(_OF_SIGNALS), _failure(outcome))
    period_s = from_plain(job.scenario).reference.options["period_s"]
    assert isinstance(period_s, float)
    return Result(case, figures | signal_figures(signals, period_s), _failure(outcome))


def signal_figures(signals: Signals, period_s: float) -> dict[str, float | None]:
    """Return the figures that follow from the signals of a run on a circle of this period; None where not defined.

    ``heading_rad`` is the largest heading error of the last 5 s, ``driven_s`` the first time from which the robot is
    commanded to the end, ``from_m`` how far it then is from the path, ``transition_s`` how long it takes until it stays
    within 2 % of that; ``amplitude_m`` and ``frequency_hz`` are those of ``oscillation`` over the last lap.
    """
    found: dict[str, float | None] = dict.fromkeys(_OF_SIGNALS)
    t_s, planar_m = signals["loop.t_s"], signals["error.planar_m"]
    found["heading_rad"] = float(np.max(np.abs(signals["error.heading_rad"][t_s > t_s[-1] - STEADY_WINDOW_S])))
    silent = np.flatnonzero(np.isnan(signals["wheel.fl.torque_command_n_m"]))
    first = int(silent[-1]) + 1 if len(silent) else 0
    if first < len(t_s):
        found |= {"driven_s": float(t_s[first]), "from_m": float(planar_m[first])}
        outside = np.flatnonzero(planar_m[first:] >= TRACKED_RATIO * planar_m[first])
        last = first + int(outside[-1]) + 1 if len(outside) else first
        if last < len(t_s):
            found["transition_s"] = float(t_s[last] - t_s[first])
    swing = oscillation(t_s, signals["error.x_m"], signals["error.y_m"], period_s)
    return found | ({} if swing is None else swing._asdict())


def _signals(job: Job) -> Signals:
    """Return the signals that a job left; none where it did not get as far."""
    if not Path(job.signals_file).exists():
        return {}
    with np.load(job.signals_file) as held:
        return dict(held)


def _older(folder: Path) -> list[Path]:
    """Return the files that an earlier reproduction, quick or not, wrote into a folder."""
    recordings = [_recording(case) for case in cases(quick=False) + cases(quick=True) if case.records]
    drawings = (f"{picture}.{kind}" for picture in (*_PICTURES, _DELAY) for kind in FORMATS)
    names = dict.fromkeys([_SUMMARY, *drawings, *recordings])
    return [folder / name for name in names if (folder / name).exists()]


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
