"""Review of a recording: the figures of a run, from its recording alone."""

from pathlib import Path
from typing import Any

from hil.metrics import percentiles, tracking_metrics
from hil.review.reader import Event, RecordedRun, read, to_frame

__all__ = ["Event", "RecordedRun", "figures", "read", "review", "to_frame"]

_NO_SUMMARY = "the recording has no summary: the run did not come to its end"
_UNSAID = "the run's summary does not say"
_FROM_SUMMARY = ("passed", "realtime_factor", "frames", "wire_sha256")
_ORDER = (
    "passed",
    "tracked_s",
    "t10_s",
    "steady_rms_m",
    "steady_max_m",
    "ticks",
    "realtime_factor",
    "tick_us",
    "deadline_misses",
    "frames",
    "wire_sha256",
    "recording",
)


def review(path: Path) -> dict[str, Any]:
    """Return the figures that ``hil run --json`` gives, with ``reasons`` for those that are None.

    What the signals tell is computed from them again; the rest comes from the summary that the run left.
    Raises BadInputError when the file is no recording (see ``hil.review.reader.read``).
    """
    return figures(read(path))


def figures(run: RecordedRun) -> dict[str, Any]:
    """Return the figures of a recording that was read; see ``review``."""
    tracking = tracking_metrics(run.signals["loop.t_s"], run.signals["error.planar_m"])
    reasons = dict(tracking.reasons)
    found: dict[str, Any] = {**tracking.figures(), "recording": str(run.path)}

    found["ticks"] = len(run.signals["loop.tick"]) + (run.rows_dropped or 0)
    tick_us = percentiles(run.signals["loop.tick_us"])
    found["tick_us"] = None if tick_us is None else tick_us._asdict()
    if tick_us is None:
        reasons["tick_us"] = "no tick has a time"
    misses = run.signals["loop.deadline_misses"]
    found["deadline_misses"] = int(misses[-1]) if len(misses) else None
    if not len(misses):
        reasons["deadline_misses"] = "the recording has no samples"

    summary = run.summary or {}
    for name in _FROM_SUMMARY:
        found[name] = summary.get(name)
        if found[name] is None:
            reasons[name] = (
                _NO_SUMMARY if run.summary is None else summary.get("reasons", {}).get(name, _UNSAID)
            )
    return {**{name: found[name] for name in _ORDER}, "reasons": reasons}
