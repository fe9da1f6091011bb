"""Review of a recording: the figures of a run, from its recording alone."""

import json
from pathlib import Path
from typing import Any

from hil.errors import BadInputError
from hil.metrics import CommandLimits, signal_figures
from hil.review.reader import Event, RecordedRun, read, to_frame
from hil.review.trajectory import write_trajectory
from hil.types import WHEEL_NAMES

__all__ = ["FIGURE_SIGNALS", "Event", "RecordedRun", "figures", "read", "review", "to_frame", "write_trajectory"]

FIGURE_SIGNALS = (
    *("loop.t_s", "loop.tick_us", "loop.deadline_misses", "error.planar_m", "error.x_m", "error.y_m"),
    *(
        f"wheel.{wheel}.{name}"
        for wheel in WHEEL_NAMES
        for name in ("current_a", "speed_command_rad_s", "torque_command_n_m")
    ),
    *(f"{pose}.{name}" for pose in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")),
    "guard.saturated",
)
"""The signals that ``figures`` needs: those of a long run fit memory, all of them may not."""

_NO_SUMMARY = "the recording has no summary: the run did not come to its end"
_UNSAID = "the run's summary does not say"
_FROM_SUMMARY = ("passed", "realtime_factor", "frames", "link_statistics", "pose_fixes", "wire_sha256")
_ORDER = (
    "passed",
    "tracked_s",
    "t10_s",
    "steady_rms_m",
    "steady_max_m",
    "overshoot_m",
    "effort_n_m_s",
    "torque_variation_n_m_per_s",
    "saturation_s",
    "estimation_error",
    "ticks",
    "realtime_factor",
    "tick_us",
    "deadline_misses",
    "frames",
    "link_statistics",
    "pose_fixes",
    "wire_sha256",
    "recording",
)


def review(path: Path) -> dict[str, Any]:
    """Return the figures that ``hil run --json`` gives, with ``reasons`` for those that are None.

    What the signals tell is computed from them again; the rest comes from the summary that the run left.
    Raises BadInputError when the file is no recording (see ``hil.review.reader.read``).
    """
    return figures(read(path, FIGURE_SIGNALS))


def figures(run: RecordedRun) -> dict[str, Any]:
    """Return the figures of a recording that was read; see ``review``."""
    try:
        found, reasons = signal_figures(run.signals, _torque_constant_n_m_a(run), _limits(run))
    except KeyError as missing:
        raise BadInputError(f"{run.path}: it has no signal {missing}; no recording of a run") from missing
    found["ticks"] += (run.rows_dropped or 0) + run.rows_missing
    found["recording"] = str(run.path)
    summary = run.summary or {}
    for name in _FROM_SUMMARY:
        found[name] = summary.get(name)
        if found[name] is None:
            reasons[name] = _NO_SUMMARY if run.summary is None else summary.get("reasons", {}).get(name, _UNSAID)
    return {**{name: found[name] for name in _ORDER}, "reasons": reasons}


def _torque_constant_n_m_a(run: RecordedRun) -> float | None:
    """Return what the run's scenario says of the motors; None for a recording that does not hold its scenario."""
    found = _of_scenario(run, "firmware.torque_constant_n_m_a")
    return None if found is None else found[0]


def _limits(run: RecordedRun) -> CommandLimits | None:
    """Return what the run's scenario allows a wheel to be told; None for a recording that does not hold it."""
    found = _of_scenario(run, "robot.speed_limit_rad_s", "robot.torque_limit_n_m")
    return None if found is None else CommandLimits(*found)


def _of_scenario(run: RecordedRun, *keys: str) -> list[float] | None:
    """Return numbers of the run's scenario; None for a recording that does not hold them."""
    try:
        scenario = json.loads(run.properties["scenario"])
        return [float(scenario[key]) for key in keys]
    except (KeyError, TypeError, ValueError):
        return None
