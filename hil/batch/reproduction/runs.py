"""One run of the reproduction: a case, what it came to, and the signals that the pictures need."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.batch.old_pool import Work
from hil.batch.recording import RecordingHere
from hil.batch.reproduction.oscillation import oscillation
from hil.core.errors import HilError
from hil.core.types import WHEEL_NAMES
from hil.judge.measure import Series
from hil.judge.tracking import STEADY_WINDOW_S, TRACKED_RATIO
from hil.record import Recording
from hil.runtime.assembly import RunOptions, RunResult, run_scenario
from hil.scenario import load

_SERIES = (
    "loop.t_s",
    *(f"reference.{axis}_m" for axis in "xy"),
    *(f"truth.{axis}_m" for axis in "xy"),
    "error.x_m",
    "error.y_m",
    "error.heading_rad",
    "error.planar_m",
    *(f"wheel.{wheel}.torque_command_n_m" for wheel in WHEEL_NAMES),
)


class Job(NamedTuple):
    """A case to run, and where to leave its signals (``.npz``) and its recording; None for nowhere.

    Plain values, for it goes to a worker as JSON.
    """

    name: str
    scenario: str
    sets: Mapping[str, object]
    series: str | None
    recording: str | None


class Outcome(NamedTuple):
    """What became of a case; ``failure`` tells what ended the run early or kept it from beginning."""

    name: str
    figures: Mapping[str, float | None]
    failure: str | None
    wall_s: float


def lost(job: Job, failure: str, wall_s: float) -> Outcome:
    """Return what becomes of a case that told nothing."""
    return Outcome(job.name, {}, failure, wall_s)


WORK = Work("hil.batch.reproduction.worker", Outcome, lost)
"""What the pool is told of a run of the reproduction."""


def perform(job: Job) -> Outcome:
    """Do a run. Whatever is no HilError is raised: it is a defect of ours."""
    began = time.monotonic()
    try:
        result = run_scenario(
            load(job.scenario, set=job.sets),
            RunOptions(
                record=Path(job.recording) if job.recording is not None else None,
                make_recording=RecordingHere if job.recording is not None else Recording,
            ),
        )
    except HilError as error:
        return lost(job, str(error), time.monotonic() - began)
    if job.series is not None:
        held: dict[str, Any] = {name: result.signals[name] for name in _SERIES}
        np.savez(job.series, **held)
    # A robot that was not driven, and for no fault of the scenario, shows nothing of the law either.
    beyond = next((str(row["text"]) for row in result.metrics["allow"] if not row["passed"]), None)
    failure = str(result.failure) if result.failure is not None else beyond
    return Outcome(job.name, figures(result), failure, time.monotonic() - began)


def figures(result: RunResult) -> dict[str, float | None]:
    """Return the figures of a run by name, with the unit in the name; None where one has no meaning.

    Beside those of ``hil.judge.figures``: ``heading_rad`` is the largest heading error of the last 5 s, ``driven_s``
    the first time from which the robot is commanded to the end, ``from_m`` how far it then is, ``transition_s`` how
    long it takes until it stays within 2 % of that; ``amplitude_m`` and ``frequency_hz`` are those of ``oscillation``
    over the last lap.
    """
    signals: Mapping[str, Series] = result.signals
    metrics: Mapping[str, Any] = result.metrics
    found = {name: metrics[name] for name in ("tracked_s", "t10_s", "steady_rms_m", "steady_max_m")}
    t_s, planar_m = signals["loop.t_s"], signals["error.planar_m"]
    nothing = dict.fromkeys(("heading_rad", "driven_s", "from_m", "transition_s", "amplitude_m", "frequency_hz"))
    if result.failure is not None or not len(t_s):
        return found | nothing
    heading = np.abs(signals["error.heading_rad"][t_s > t_s[-1] - STEADY_WINDOW_S])
    silent = np.flatnonzero(np.isnan(signals["wheel.fl.torque_command_n_m"]))
    first = int(silent[-1]) + 1 if len(silent) else 0
    found |= nothing | {"heading_rad": float(np.max(heading))}
    if first < len(t_s):
        found |= {"driven_s": float(t_s[first]), "from_m": float(planar_m[first])}
        outside = np.flatnonzero(planar_m[first:] >= TRACKED_RATIO * planar_m[first])
        last = first + int(outside[-1]) + 1 if len(outside) else first
        if last < len(t_s):
            found["transition_s"] = float(t_s[last] - t_s[first])
    swing = oscillation(t_s, signals["error.x_m"], signals["error.y_m"], _period_s(result))
    return found | ({} if swing is None else swing._asdict())


def _period_s(result: RunResult) -> float:
    period_s = result.scenario.reference.options["period_s"]
    assert isinstance(period_s, float)
    return period_s
