"""A run as a row of the results: its figures by column, and what became of it."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.judge.words import in_order, why_not_passed

MACHINE = "machine."
"""What begins the names of columns that depend on the machine, and not on the run."""
FOREIGN = "foreign"
"""Of a run that was not done, because the worker would have done another: it is no row."""
PASSED, FAILED, ENDED, REFUSED, LOST = "passed", "failed", "ended", "refused", "lost"
"""Outcomes: as expected; it ran to its end and was not; a law, the link or the robot ended it; it could not begin; its
process crashed or hung."""
OUTCOMES = (PASSED, FAILED, ENDED, REFUSED, LOST)

_FIGURES = (
    "t10_s",
    "tracked_s",
    "steady_rms_m",
    "steady_max_m",
    "overshoot_m",
    "effort_n_m_s",
    "torque_variation_n_m_per_s",
    "saturation_s",
)
_COUNTS = ("ticks", "commands_refused", "stale_ticks", "held_ticks", "deadline_misses")
_NESTED: Mapping[str, tuple[str, ...]] = {
    "estimation_rms_m": ("estimation_error", "rms_m"),
    "estimation_max_m": ("estimation_error", "max_m"),
    "estimation_heading_rms_rad": ("estimation_error", "heading_rms_rad"),
    "feedback_age_p99_ms": ("link_statistics", "feedback_age_ms", "p99"),
    "round_trip_p99_ms": ("link_statistics", "round_trip_ms", "p99"),
}
FIGURES = (*_FIGURES, *_NESTED)
"""Columns of numbers that a report can show; of each less is better."""
_TEXTS = ("key", "law", "fault", "outcome", "reason", "failed_expectation", "wire_sha256")
_WHOLE = ("seed", "sample", "faults_applied", "recoveries", *_COUNTS)
_OF_MACHINE = {"wall_s": float, "worker": str, "commit": str, "tick_p50_us": float}
COLUMNS: Mapping[str, type] = {
    **dict.fromkeys(_TEXTS, str),
    **dict.fromkeys(_WHOLE, int),
    **dict.fromkeys(FIGURES, float),
    **{MACHINE + name: kind for name, kind in _OF_MACHINE.items()},
}
"""The columns of a row beside those of its campaign's axes, and what is in them."""


class Said(NamedTuple):
    """What a run's process says of it, as plain values.

    Attributes:
        figures: columns and their values; empty where there are none.
        outcome: one of the outcomes, or ``FOREIGN``. reason: why it is not "passed".
        wall_s: how long it took. recording: the file that it was recorded into.
    """

    figures: Mapping[str, Any]
    outcome: str
    reason: str | None
    wall_s: float
    recording: str | None = None


def figures_of(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns that follow from the figures of ``hil run --json``."""
    row: dict[str, Any] = {name: metrics[name] for name in (*_FIGURES, *_COUNTS, "wire_sha256")}
    row |= {name: _at(metrics, path) for name, path in _NESTED.items()}
    row["faults_applied"] = sum(fault["applied"] or 0 for fault in metrics["fault"])
    row["recoveries"] = len(metrics["recoveries"])
    row["failed_expectation"] = next(_failed(metrics), None)
    row[MACHINE + "tick_p50_us"] = _at(metrics, ("tick_us", "p50"))
    return row


def as_judged(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row as it is judged: without figures when its run did not come to its end, for to stop early is no merit
    and makes effort and overshoot less."""
    missing: dict[str, Any] = dict.fromkeys(FIGURES)
    return {**missing, **row} if row["outcome"] in (PASSED, FAILED) else {**row, **missing}


def why_failed(metrics: Mapping[str, Any]) -> str:
    """Return one sentence on why a run that came to its end did not pass."""
    return next(why_not_passed(metrics))


def _failed(metrics: Mapping[str, Any]) -> Iterator[str]:
    return (one["text"] for one in in_order(metrics["expect"]) if one["passed"] is False)


def check_figure(name: str, where: str) -> None:
    """Raise BadInputError for what is no figure of a run."""
    if name not in FIGURES:
        raise BadInputError(f"{where}: unknown figure {name!r}{nearest(name, FIGURES)}")


def _at(metrics: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        if metrics is None:
            return None
        metrics = metrics.get(name)
    return metrics
