"""Judges a finished run, and finishes its recording."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hil.core.errors import HilError, kind_of
from hil.core.percentiles import Percentiles
from hil.judge.baselines import against_baseline
from hil.judge.expectations import Count, figure_result, limit_results, stop_result, with_lost_rows
from hil.judge.figures import cut_words
from hil.judge.judged_run import (
    CauseKind,
    Counts,
    ExpectationResult,
    Failure,
    FaultResult,
    Identity,
    JudgedRun,
    Recorded,
    decided,
)
from hil.judge.memory_sink import MemorySink
from hil.runtime.bench import Bench
from hil.runtime.loop import Loop, Report
from hil.runtime.robots import link_of
from hil.scenario import Scenario
from hil.scenario.load import given
from hil.scenario.scenario import values
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable

if TYPE_CHECKING:
    from hil.record.recording import RunRecording

_NO_VALUE = {
    "load": "a link in memory has no bit rate",
    "foreign": "a line between two ends has no other nodes",
    "frames_to_host": "frames carry no running number on this link",
    "frames_to_robot": "frames carry no running number on this link",
    "feedback_age_ms": "the run has no ticks",
    "round_trip_ms": "no feedback said that a command of the run was in force",
    "clock": "the robot answered no TIME_SYNC_REQUEST",
}


def judge(
    scenario: Scenario,
    bench: Bench,
    memory: MemorySink,
    loop: Loop,
    report: Report,
    results: Mapping[int, ExpectationResult],
    rejections: Mapping[str, Count],
    *,
    lenient: bool = False,
) -> JudgedRun:
    """Return a run with its figures and its verdict.

    ``results`` are those of the expectations about signals, by their place in the scenario. ``lenient``: the run is
    judged by its expectations alone.
    """
    failure, duration_s = report.failure, scenario.loop.duration_s
    cut_s = loop.t_s if is_cut(scenario, loop, report) else None
    figures, reasons = memory.figures(None if cut_s is None else cut_words(cut_s, duration_s))
    refused = {"refused": Count(loop.commands_refused, loop.commands_refused)}
    pose_fixes = loop.pose_fixes()
    restarts = 0 if pose_fixes is None else pose_fixes["restarts"]
    counts = {
        **report.not_driven,
        **rejections,
        **refused,
        "fix_restarts": Count(restarts, restarts),
        "lost_rows": Count(0, 0),
    }
    if not report.ticks:
        reasons["realtime_factor"] = "the run has no ticks"
    if pose_fixes is None:
        reasons["pose_fixes"] = f"{scenario.estimator.source!r} takes none"
    device = bench.device
    run = JudgedRun(
        identity=Identity(
            scenario.name,
            scenario.controller.law,
            scenario.loop.mode,
            scenario.controller.command,
            scenario.link.url,
            scenario.loop.seed,
            given(dict(values(scenario)), scenario.provenance),
        ),
        lenient=lenient,
        figures={
            **figures,
            "lateness_us": loop.lateness.figures(),
            "deadline_misses": report.deadline_misses,  # the rows miss those after the last row
            "realtime_factor": report.robot_s / report.wall_s if report.ticks else None,
            "frames": {"sent": device.sent, "received": device.received, "rejected": device.rejected()},
            "link_statistics": _link_statistics(scenario, bench, memory.feedback_age_ms()),
            "pose_fixes": pose_fixes,
        },
        reasons=reasons | {"recording": "no recording was asked for"},
        wire_sha256=device.wire_sha256(),
        stopped=report.stopped,
        counts=Counts(loop.commands_refused, **{name: one.all for name, one in counts.items() if name != "refused"}),
        robot_slipped_ticks=bench.slipped_ticks,
        allow=limit_results(scenario.allow, counts, report.ticks),
        recoveries=report.recoveries,
        faults=[
            FaultResult(row.kind, row.target, row.words, applied, row.counts, row.start_s, _end_s(row), row.value)
            for row, applied in zip(scenario.fault, bench.faults.applied(), strict=True)
        ],
        failure=None if failure is None else Failure(str(failure), kind_of(failure), loop.t_s),
    )
    run = replace(run, baseline=against_baseline(scenario, run, is_cut=cut_s is not None))

    def result(row: ExpectTable) -> ExpectationResult:
        if row.stops is not None:
            return stop_result(row, report.stops, cut_s, scenario.fault)
        return figure_result(row, run, cut_s, scenario.baseline)

    expect = [results[i] if i in results else result(row) for i, row in enumerate(scenario.expect)]
    return decided(replace(run, expect=expect))


def _end_s(row: FaultTable) -> float | None:
    return row.end_s if math.isfinite(row.end_s) else None


def is_cut(scenario: Scenario, loop: Loop, report: Report) -> bool:
    """Whether a run ended before its planned duration."""
    return report.failure is not None and loop.t_s < scenario.loop.duration_s - 2.0 / scenario.loop.rate_hz


def _link_statistics(scenario: Scenario, bench: Bench, age_ms: Percentiles | None) -> dict[str, Any]:
    """Return the figures of the link (hil/wire/STATISTICS.md); ``reasons`` explains each that is None."""
    device, wire = bench.device, bench.wire
    rejected = device.rejected()
    counts_frames = not (scenario.device.is_makers or link_of(scenario).is_bus)  # ours, on a line, are numbered
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
    recording: "RunRecording", t_s: float, allow: AllowTable, run: JudgedRun, *, keep_live: bool
) -> JudgedRun:
    """Finish the recording at ``t_s`` with the run in it, and return the run with what the recorder reports.

    The event log gets what is known only at the end; events of the run are in it already.
    """
    from hil.judge.run_text import applied_text, why_not_passed, with_page  # only for a run that is recorded

    run = with_lost_rows(run, allow, recording.rows_dropped)
    for row in run.expect:
        if row.figure is not None or row.stops is not None:
            recording.event(t_s, "error" if row.passed is False else "info", row.text)
    for kind, text in why_not_passed(run):
        if kind == CauseKind.BASELINE:
            recording.event(t_s, "error", f"baseline: {text}")
    for fault in run.faults:
        recording.event(t_s, "info" if fault.applied else "error", f"fault: {applied_text(fault)}")
    if run.trace is not None and run.trace["trouble"] is not None:
        recording.event(t_s, "warning", run.trace["trouble"])
    if run.failure is not None:
        recording.event(t_s, "error", run.failure.text)
    if recording.path is not None:
        reasons = {name: reason for name, reason in run.reasons.items() if name != "recording"}
        run = replace(run, recording=str(recording.path), reasons=reasons)
    report = recording.finish(with_page(run), keep_live=keep_live)
    recorded = Recorded(
        report.rows_written,
        report.rows_dropped,
        report.rows_lost,
        report.events_lost,
        report.error,
        report.restarts,
        report.troubles,
        [str(path) for path in report.parts],
    )
    return replace(with_lost_rows(run, allow, report.rows_dropped + report.rows_lost), recorded=recorded)


def close_unfinished(
    recording: "RunRecording", t_s: float, failure: HilError, results: Sequence[ExpectationResult] = ()
) -> None:
    """Finish the recording of a run that has no figures: it could not begin, or its law did not return.

    ``results`` are those of its expectations. A recording that cannot be written is no error here: the failure counts.
    """
    from hil.judge.run_text import with_page

    recording.event(t_s, "error", str(failure))
    run = decided(JudgedRun(failure=Failure(str(failure), kind_of(failure), t_s), expect=results))
    found = with_page(run)
    known = ("passed", "failure", "failure_kind", "failure_s", "expect", "page")
    why = [(CauseKind.FAILURE.value, str(failure))]  # an expectation that failed before is not what ended it
    with contextlib.suppress(HilError):
        recording.finish({name: found[name] for name in known} | {"why": why})
