"""A job (one run to do) and its outcome, as plain values that can be passed between processes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Signals = Mapping[str, npt.NDArray[np.float64]]
"""Signals of a run by name, each of shape (n,)."""

NEVER, IF_FAILED, ALWAYS = "never", "if failed", "always"
"""When a job is recorded."""

PASSED, FAILED, ENDED, REFUSED, LOST = "passed", "failed", "ended", "refused", "lost"
"""The status of an outcome.

Passed: as expected. Failed: it ran to its end, but not as expected. Ended: a law, the link or the robot ended it early.
Refused: it could not begin. Lost: its process crashed or hung.
"""
STATUSES = (PASSED, FAILED, ENDED, REFUSED, LOST)
FOREIGN = "foreign"
"""The worker has other files or another version than the plan, so it did not do the job."""


class Job(NamedTuple):
    """One run to do, as plain values (JSON). ``hil.addons.batch.keys.make_job`` makes it.

    Attributes:
        key: SHA-256 of what decides the outcome; a job is looked up by it, and done once.
        kind: the function that does it, as ``module:function``; it takes the job and its scenario, and returns an
            Outcome.
        scenario: the resolved scenario, as ``hil.scenario.to_plain`` gives it.
        options: further inputs of the kind; part of the key.
        limit_s: wall-clock time [s] after which it is ended as hung.
        record: one of ``NEVER``, ``IF_FAILED``, ``ALWAYS``. recording: the file for it.
        signals_file: file (.npz) on this machine for the signals that ``options["signals"]`` names, or "".
        allow_motion: whether real motors may move.
    """

    key: str
    kind: str
    scenario: Mapping[str, Any]
    options: Mapping[str, Any]
    limit_s: float = 120.0
    record: str = NEVER
    recording: str = ""
    signals_file: str = ""
    allow_motion: bool = False


class Outcome(NamedTuple):
    """The outcome of a job, as plain values (JSON).

    Attributes:
        key: that of the job.
        status: one of ``STATUSES``, or ``FOREIGN``.
        reason: one sentence on why it is not ``PASSED``.
        figures: the measured values, by name; empty for a run without figures.
        details: further results of the kind of job.
        wall_s: wall-clock time that it took [s].
        recording: the file it was recorded to, if it was.
    """

    key: str
    status: str
    reason: str | None = None
    figures: Mapping[str, Any] = {}
    details: Mapping[str, Any] = {}
    wall_s: float = 0.0
    recording: str | None = None


def plain(value: Job | Outcome) -> dict[str, Any]:
    """Return a job or an outcome for JSON."""
    return {name: dict(one) if isinstance(one, Mapping) else one for name, one in value._asdict().items()}


def saved_signals(job: Job) -> Signals:
    """Return the signals that a job left in its ``signals_file``; none where it did not get as far."""
    if not job.signals_file or not Path(job.signals_file).exists():
        return {}
    with np.load(job.signals_file) as held:
        return dict(held)
