"""Computes the figures of a finished run, and finishes its recording."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

from hil.core.errors import HilError, kind_of
from hil.core.percentiles import Percentiles
from hil.judge.baselines import against_baseline
from hil.judge.claims import Outcome
from hil.judge.expectations import Count, allow_figures, figure_outcome, outcome_figures, stop_outcome
from hil.judge.figures import cut_words
from hil.judge.results import MemorySink
from hil.judge.words import SCHEMA, applied_words, judged, set_lost_rows, why_not_passed, with_page
from hil.record import RunRecording
from hil.runtime.bench import Bench
from hil.runtime.loop import Loop, Report
from hil.scenario import Scenario
from hil.scenario.load import given
from hil.scenario.run import values
from hil.scenario.trial import AllowTable, ExpectTable

_NO_VALUE = {
    "load": "a link in memory has no bit rate",
    "foreign": "a line between two ends has no other nodes",
    "frames_to_host": "frames carry no running number on this link",
    "frames_to_robot": "frames carry no running number on this link",
    "feedback_age_ms": "the run has no ticks",
    "round_trip_ms": "no feedback said that a command of the run was in force",
    "clock": "the robot answered no TIME_SYNC_REQUEST",
}


def run_figures(
    scenario: Scenario,
    bench: Bench,
    memory: MemorySink,
    loop: Loop,
    report: Report,
    outcomes: Mapping[int, dict[str, Any]],
    rejections: Mapping[str, Count],
    *,
    lenient: bool = False,
) -> dict[str, Any]:
    """Return the figures of a run by name.

    ``outcomes`` are those of the expectations about signals, by their place in the scenario. ``lenient``: the run is
    judged by its expectations alone.
    """
    failure, duration_s = report.failure, scenario.loop.duration_s
    cut_s = loop.t_s if is_cut(scenario, loop, report) else None
    figures, reasons = memory.figures(None if cut_s is None else cut_words(cut_s, duration_s))
    applied: list[dict[str, Any]] = [
        {"kind": row.kind, "target": row.target, "text": row.words, "applied": count, "counts": row.counts}
        | {"start_s": row.start_s, "end_s": row.end_s if math.isfinite(row.end_s) else None, "value": row.value}
        for row, count in zip(scenario.fault, bench.faults.applied(), strict=True)
    ]
    refused = {"refused": Count(loop.commands_refused, loop.commands_refused)}
    counts = {**report.undriven, **rejections, **refused, "lost_rows": Count(0, 0)}
    if not report.ticks:
        reasons["realtime_factor"] = "the run has no ticks"
    pose_fixes = loop.pose_fixes()
    if pose_fixes is None:
        reasons["pose_fixes"] = f"{scenario.estimator.source!r} takes none"
    device = bench.device
    metrics: dict[str, Any] = {
        "schema": SCHEMA,
        "passed": None,
        "lenient": lenient,
        "scenario": scenario.name,
        "law": scenario.controller.law,
        "mode": scenario.loop.mode,
        "command": scenario.controller.command,
        "link": scenario.link.url,
        "seed": scenario.loop.seed,
        "given": given(dict(values(scenario)), scenario.provenance),
        **figures,
        "lateness_us": loop.lateness.figures(),
        "deadline_misses": report.deadline_misses,  # the rows miss those after the last row
        "realtime_factor": report.robot_s / report.wall_s if report.ticks else None,
        "frames": {"sent": device.sent, "received": device.received, "rejected": device.rejected()},
        "link_statistics": _link_statistics(bench, memory.feedback_age_ms()),
        "pose_fixes": pose_fixes,
        "wire_sha256": device.wire_sha256(),
        "stopped": report.stopped,
        "commands_refused": loop.commands_refused,
        **{name: count.all for name, count in counts.items() if name != "refused"},
        "allow": allow_figures(scenario.allow, counts, report.ticks),
        "recoveries": [recovered._asdict() for recovered in report.recoveries],
        "robot_slipped_ticks": bench.slipped_ticks,
        "expect": [],
        "fault": applied,
        "failure": str(failure) if failure is not None else None,
        "failure_kind": None if failure is None else kind_of(failure),
        "failure_s": None if failure is None else loop.t_s,
        "recording": None,
        "reasons": reasons | {"recording": "no recording was asked for"},
    }
    metrics["baseline"] = against_baseline(scenario, metrics, is_cut=cut_s is not None)

    def outcome(row: ExpectTable) -> Outcome:
        if row.stops is not None:
            return stop_outcome(row, report.stops, cut_s, scenario.fault)
        return figure_outcome(row, metrics, cut_s, scenario.baseline)

    metrics["expect"] = [
        outcomes[i] if i in outcomes else outcome_figures(row, outcome(row)) for i, row in enumerate(scenario.expect)
    ]
    return judged(metrics)


def is_cut(scenario: Scenario, loop: Loop, report: Report) -> bool:
    """Whether a run ended before its planned duration."""
    return report.failure is not None and loop.t_s < scenario.loop.duration_s - 2.0 / scenario.loop.rate_hz


def _link_statistics(bench: Bench, age_ms: Percentiles | None) -> dict[str, Any]:
    """Return the figures of the link (hil/wire/STATISTICS.md); ``reasons`` explains each that is None."""
    device, wire = bench.device, bench.wire
    rejected = device.rejected()
    counts_frames = wire.counts_frames
    lost = {
        "snapshots": device.snapshots_lost,
        "frames_to_host": rejected.pop("lost", 0) if counts_frames else None,
        "frames_to_robot": rejected.pop("robot_serial_lost", 0) if counts_frames else None,
    }
    figures = {
        **wire.figures(),
        "lost": lost,
        "rejected": rejected,
        "feedback_age_ms": None if age_ms is None else age_ms._asdict(),
        "round_trip_ms": device.round_trip.figures(),
        "clock": device.clock_sync.figures(),
    }
    missing = [name for name, value in (figures | lost).items() if value is None]
    return figures | {"reasons": {name: _NO_VALUE[name] for name in missing}}


def close_recording(
    recording: RunRecording, t_s: float, allow: AllowTable, metrics: dict[str, Any], *, keep_live: bool
) -> None:
    """Finish the recording at ``t_s`` with the figures in it, and add the recorder's report to the figures.

    The event log gets what is known only at the end; events of the run are in it already.
    """
    set_lost_rows(metrics, allow, recording.rows_dropped)
    for row in metrics["expect"]:
        if row["figure"] is not None or row["stops"] is not None:
            recording.event(t_s, "error" if row["passed"] is False else "info", row["text"])
    for kind, text in why_not_passed(metrics):
        if kind == "baseline":
            recording.event(t_s, "error", f"baseline: {text}")
    for row in metrics["fault"]:
        recording.event(t_s, "info" if row["applied"] else "error", f"fault: {applied_words(row)}")
    if (trace := metrics.get("trace")) is not None and trace["trouble"] is not None:
        recording.event(t_s, "warning", trace["trouble"])
    if metrics["failure"] is not None:
        recording.event(t_s, "error", metrics["failure"])
    if recording.path is not None:
        metrics["recording"] = str(recording.path)
        del metrics["reasons"]["recording"]
    report = recording.finish(with_page(metrics), keep_live=keep_live)
    set_lost_rows(metrics, allow, report.rows_dropped + report.rows_lost)
    metrics["recorded"] = {
        "rows": report.rows_written,
        "dropped": report.rows_dropped,
        "lost": report.rows_lost,
        "events_lost": report.events_lost,
        "error": report.error,
        "restarts": report.restarts,
        "troubles": list(report.troubles),
        "parts": [str(path) for path in report.parts],
    }


def close_unfinished(
    recording: RunRecording, t_s: float, failure: HilError, outcomes: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Finish the recording of a run that has no figures: it could not begin, or its law did not return.

    ``outcomes`` are those of its expectations. A recording that cannot be written is no error here: the failure counts.
    """
    recording.event(t_s, "error", str(failure))
    summary = {"passed": False, "failure": str(failure), "failure_kind": kind_of(failure), "failure_s": t_s}
    with contextlib.suppress(HilError):
        recording.finish(with_page({**summary, "expect": outcomes}))
