"""``hil reproduce``: section IV of the paper, as named cases with their figures, a summary and a page."""

import json
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Option

from hil.addons.batch.job import ALWAYS, ENDED, LOST, NEVER, REFUSED, Job, Outcome, Signals, saved_signals
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import OnProgress, run_jobs
from hil.addons.batch.reproduction import published
from hil.addons.batch.reproduction.paper_claims import CaseResults, judge
from hil.addons.batch.reproduction.section_iv import PaperRun, Result, assumptions, cases
from hil.addons.batch.reproduction.section_iv_page import PLOTS, plots, tables
from hil.addons.batch.results_page import Page, Results, finish
from hil.cli.options import Force, Jobs, Json, PictureFormat
from hil.cli.output import batch
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import check_free, existing_files
from hil.core.scratch import scratch_folder
from hil.core.types import WHEEL_NAMES
from hil.judge.tracking import STEADY_WINDOW_S, TRACKED_RATIO
from hil.pages.plots import check_format
from hil.scenario import load

SUMMARY = "summary.json"
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
HARMONICS = 8
"""Multiples of the path's frequency that are no oscillation: lag, and friction that turns with the wheels."""


def reproduce(
    page: Page,
    *,
    quick: bool = False,
    workers: int | None = None,
    limit_s: float = 120.0,
    on_progress: OnProgress | None = None,
) -> Results:
    """Run section IV, record some of its runs into the folder of the page, and return the results.

    ``plain`` is the summary: each of ``circle``, ``experiment``, ``delay`` and ``transition`` is a list of rows: the
    case, its figures (None if undefined) and ``failure``. ``quick`` leaves out most variants and shortens the others.
    Raises BadInputError when the folder cannot be made or written to, or has results that must stay.
    """
    began = time.monotonic()
    folder, planned = _prepared(page), cases(quick=quick)
    recordings = [folder / _recording(case) for case in cases(quick=False) if case.records]
    for file in [folder / SUMMARY, *(folder / f"{name}.{page.kind}" for name in PLOTS), *recordings]:
        check_free("file", file, page.existing)
    for file in recordings:
        file.unlink(missing_ok=True)
    with scratch_folder("reproduce") as scratch:
        jobs = [_job(case, folder, scratch, limit_s) for case in planned]
        names = {job.key: case.name for job, case in zip(jobs, planned, strict=True)}

        def trouble(outcome: Outcome) -> str | None:
            failure = _failure(outcome)
            return None if failure is None else f"{names[outcome.key]}: {failure}"

        outcomes = run_jobs(jobs, workers, on_progress, trouble)
        signals = {case.name: saved_signals(job) for case, job in zip(planned, jobs, strict=True)}
    found = [_result(case, one, signals[case.name]) for case, one in zip(planned, outcomes, strict=True)]
    cases_done = CaseResults(found)
    drawn = list(plots(cases_done, signals))
    pictures = [page.picture(plot).name for plot in drawn]
    recorded = [file.name for file in recordings if file.exists()]
    verdicts = judge(cases_done)
    summary = {
        "format": FORMAT,
        "source": PAPER,
        "quick": quick,
        "paper": [printed._asdict() for printed in published.FIGURES],
        "filters_s": {"common": published.COMMON_FILTER_S, "short": published.SHORT_FILTER_S},
        "assumptions": assumptions(),
        **{group: [_row(one) for one in found if one.case.group == group] for group in _FIGURES},
        "verdicts": [verdict._asdict() for verdict in verdicts],
        "folder": str(folder),
        "pictures": pictures,
        "recordings": recorded,
        "wall_s": time.monotonic() - began,
    }
    failures = [f"{one.case.name}: {one.failure}" for one in found if one.failure is not None]
    counts = Counter(verdict.verdict for verdict in verdicts)
    files = ", ".join([str(page.file), SUMMARY, *pictures, *recorded])
    return Results(
        "Section IV of the paper, reproduced",
        not failures,
        ", ".join(f"{count} {words}" for words, count in counts.items()),
        [*failures, f"{summary['wall_s']:.0f} s; {files}"],
        tables(summary),
        drawn,
        summary,
    )


def _prepared(page: Page) -> Path:
    """Make the folder of a page. Raises BadInputError when it cannot be made or written to."""
    assert page.file is not None
    folder = page.file.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise BadInputError(
            f"--out {folder}: it cannot be written to ({error.strerror}); name a folder that you may write to"
        ) from error


def _row(result: Result) -> dict[str, Any]:
    case, figures, failure = result
    own = {name: figures.get(name) for name in _FIGURES[case.group]}
    return {"name": case.name, **case.row, **own, "failure": failure}


def _job(case: PaperRun, folder: Path, scratch: Path, limit_s: float) -> Job:
    scenario = replace(load(case.scenario, set=case.sets), baseline=None)
    record = ALWAYS if case.records else NEVER
    how: dict[str, Any] = {"limit_s": limit_s, "record": record, "recording": str(folder / _recording(case))}
    return make_job(scenario, signals=_SIGNALS, scratch=scratch, **how)


def _recording(case: PaperRun) -> str:
    return f"{case.name.replace(' ', '_')}.rrd"


def _failure(outcome: Outcome) -> str | None:
    """Return what ended a run early, or a sentence if no fault explains that the robot was not driven.

    Such runs say nothing about the law. The scenario's own expectations do not matter here.
    """
    return outcome.reason if outcome.status in (ENDED, LOST, REFUSED) else outcome.details["undriven"]


def _result(case: PaperRun, outcome: Outcome, signals: Signals) -> Result:
    """Return the result of a case, with the figures of ``signal_figures`` beside those of the run itself."""
    if not outcome.figures:
        return Result(case, {}, _failure(outcome))
    figures = {name: outcome.figures[name] for name in _OF_METRICS}
    if outcome.status == ENDED or not len(signals["loop.t_s"]):
        return Result(case, figures | dict.fromkeys(_OF_SIGNALS), _failure(outcome))
    return Result(case, figures | signal_figures(signals, published.PERIOD_S), _failure(outcome))


def signal_figures(signals: Signals, period_s: float) -> dict[str, float | None]:
    """Return the figures that follow from the signals of a run on a circle of this period; None where not defined.

    ``heading_rad`` is the largest heading error of the last 5 s. From ``driven_s`` on the robot is commanded until the
    end; ``from_m`` is its distance from the path then, and ``transition_s`` the time until it stays within 2 % of that.
    ``amplitude_m`` and ``frequency_hz`` are those of ``oscillation`` over the last lap.
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
    swing = oscillation(signals, period_s)
    return found if swing is None else found | {"amplitude_m": swing[0], "frequency_hz": swing[1]}


def oscillation(signals: Signals, period_s: float) -> tuple[float, float] | None:
    """Return the oscillation over the last lap of a path of this period; None where there is no whole lap.

    The amplitude [m] is the largest distance from the mean path, the frequency [Hz] where the power is greatest. A mean
    and ``HARMONICS`` harmonics of the path's frequency are fitted to each error and subtracted. The signals are evenly
    spaced, without gaps.
    """
    t_s = signals["loop.t_s"]
    lap = t_s > t_s[-1] - period_s if len(t_s) else np.zeros(0, dtype=bool)
    if np.count_nonzero(lap) < 4 * HARMONICS or t_s[-1] - t_s[0] < period_s * 0.999:
        return None
    t_s = t_s[lap]
    phases = np.outer(t_s, np.arange(1, HARMONICS + 1)) * (2.0 * np.pi / period_s)
    basis = np.column_stack([np.ones(len(t_s)), np.cos(phases), np.sin(phases)])
    left = np.column_stack([signals["error.x_m"][lap], signals["error.y_m"][lap]])
    left = left - basis @ np.linalg.lstsq(basis, left, rcond=None)[0]
    power = np.sum(np.abs(np.fft.rfft(left * np.hanning(len(t_s))[:, None], axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0]))
    return float(np.max(np.hypot(left[:, 0], left[:, 1]))), float(frequencies[np.argmax(power)])


def command(
    out: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="folder for page, pictures, recordings and summary.json; by default runs/reproduction, "
            "with --quick runs/reproduction-quick",
        ),
    ] = None,
    quick: Annotated[bool, Option("--quick", help="a few short runs instead of all")] = False,
    pictures: PictureFormat = "png",
    jobs: Jobs = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run section IV of the paper and say which of its figures come out, which do not, and why."""
    folder = out or Path("runs/reproduction-quick" if quick else "runs/reproduction")
    page = Page(folder / "report.html", check_format("--pictures", pictures), existing_files(force=force))
    need("plots", "hil reproduce")
    with batch(as_json=as_json) as progress:
        results = reproduce(page, quick=quick, workers=jobs, on_progress=progress)
    summary = json.dumps(results.plain, indent=1, ensure_ascii=False, allow_nan=False)
    finish(results, page, as_json=as_json, files={folder / SUMMARY: summary})
    raise typer.Exit(0 if results.passed else 1)
