"""One run of a comparison: through the wire in memory, in lockstep, judged by its figures alone."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.batch.old_pool import Work
from hil.core.errors import BadInputError, HilError
from hil.core.types import WHEEL_NAMES
from hil.runtime.assembly import RunResult, run_scenario
from hil.scenario import Scenario, load

FIGURES = (
    "t10_s",
    "tracked_s",
    "steady_rms_m",
    "steady_max_m",
    "overshoot_m",
    "effort_n_m_s",
    "torque_variation_n_m_per_s",
    "saturation_s",
)
"""What is compared, of ``hil.judge.figures``; of each less is better."""

MODE = "lockstep"
LINK = "memory:"
_CURVES = ("loop.t_s", "error.planar_m", "truth.x_m", "truth.y_m", "reference.x_m", "reference.y_m")
_MOST_POINTS = 3000


class Job(NamedTuple):
    """A run to do; plain values, for it goes to a worker as JSON. ``curves`` asks for what pictures need."""

    scenario: str
    sets: Sequence[str]
    seed: int | None
    law: str
    gains: Mapping[str, Any]
    curves: bool


class Outcome(NamedTuple):
    """What became of a job.

    Attributes:
        figures: those of ``FIGURES`` by name; None where there are none, and ``refused`` or ``failed`` says why.
        reasons: for each figure that is None, one sentence.
        refused: why the run could not begin: the law does not do this mode, for one.
        failed: what ended the run, or why its figures say nothing.
        curves: signals of the run by name, and ``torque.fl`` to ``torque.rl`` [N·m]; None unless asked for.
    """

    figures: Mapping[str, float | None] | None
    reasons: Mapping[str, str]
    refused: str | None
    failed: str | None
    curves: Mapping[str, Sequence[float]] | None


def lost(_job: Job, words: str, _wall_s: float) -> Outcome:
    """Return the outcome of a run that told nothing."""
    return Outcome(None, {}, None, words, None)


WORK = Work("hil.batch.comparison.worker", Outcome, lost)
"""What the pool is told of a run of a comparison."""


def perform(job: Job) -> Outcome:
    """Do a run. Whatever is no HilError is raised: it is a defect of ours, or of a law that ends its process."""
    try:
        result = run_scenario(scenario(job))
    except BadInputError as error:
        return Outcome(None, {}, str(error), None, None)
    except HilError as error:
        return Outcome(None, {}, None, str(error), None)
    if (failed := _failure(result)) is not None:
        return Outcome(None, {}, None, failed, None)
    figures = {name: result.metrics[name] for name in FIGURES}
    reasons = {name: result.metrics["reasons"][name] for name, value in figures.items() if value is None}
    return Outcome(figures, reasons, None, None, _curves(result) if job.curves else None)


def scenario(job: Job) -> Scenario:
    """Return the job's scenario. Raises BadInputError."""
    base = load(job.scenario, set=job.sets, mode=MODE, link=LINK, seed=job.seed)
    controller = base.controller.model_copy(update={"law": job.law, "gains": dict(job.gains)})
    return base.model_copy(update={"controller": controller})


def _failure(result: RunResult) -> str | None:
    """Say why the figures of a run are none of the law's."""
    if result.failure is not None:
        return str(result.failure)
    if refused := result.metrics["commands_refused"]:
        return f"the law gave no number {refused} times, and the robot was held still"
    if beyond := [row["text"] for row in result.metrics["allow"] if not row["passed"]]:
        return str(beyond[0])
    if idle := [row["text"] for row in result.metrics["fault"] if not row["applied"]]:
        return f"{idle[0]} was never applied"
    return None


def _curves(result: RunResult) -> dict[str, list[float]]:
    """Return what pictures need, so many samples as a picture can show."""
    constant_n_m_a = result.scenario.firmware.torque_constant_n_m_a
    series = {name: result.signals[name] for name in _CURVES}
    series |= {f"torque.{wheel}": constant_n_m_a * result.signals[f"wheel.{wheel}.current_a"] for wheel in WHEEL_NAMES}
    every = -(-len(series["loop.t_s"]) // _MOST_POINTS) or 1
    return {name: np.asarray(values[::every]).tolist() for name, values in series.items()}
