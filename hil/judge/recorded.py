"""A recorded run read back: its result, and its figures, computed again from its signals or taken from its summary."""

import contextlib
import json
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from hil.core.errors import BadInputError, error_of
from hil.core.model import RobotModel
from hil.core.options import OptionsError, build, options_of
from hil.core.signals import SIGNAL_NAMES, Signals
from hil.faults.kinds import is_instant
from hil.judge.claims import check_expectation, signals_of
from hil.judge.expectations import figure_result, figures_by_key, rejected_and_unmatched, with_lost_rows
from hil.judge.figures import cut_words, figure_signals, signal_figures
from hil.judge.judged_run import ExpectationResult, Failure, FaultResult, Identity, JudgedRun
from hil.judge.measure import CommandLimits, RunSetup
from hil.judge.result import RunResult
from hil.judge.run_json import from_json, to_json
from hil.record.properties import table_rows
from hil.record.reader import RecordedRun, read
from hil.scenario import Scenario, from_values
from hil.scenario.load import given
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable

T = TypeVar("T")

_NO_SUMMARY = "the recording has no summary: the run did not come to its end"
_NO_END = "the recording has no summary and no end: how the run ended is not known"
_IN_LATER_PART = "the recording has no summary: it is in a later part, which was not read"
_NOT_IN_SUMMARY = "the run's summary does not have it"
_IDENTITY = {name: name for name in ("law", "command", "mode", "link", "seed")} | {"scenario": "scenario_name"}
_FIGURES_FROM_SUMMARY = ("realtime_factor", "lateness_us", "frames", "link_statistics", "pose_fixes")
_FROM_SUMMARY = ("passed", *_FIGURES_FROM_SUMMARY, "wire_sha256")
_MADE = ("command", "started", "mecanum_hil", "commit", "python", "machine")
_NAMED = 4


def load(path: str | Path) -> RunResult:
    """Return the result of a recorded run from its ``.rrd`` or ``.mcap`` file, as ``hil.run`` returned it.

    Signals, figures, events and scenario are those of the run. The figures also have what ``hil review --json`` adds:
    ``made``, ``notes`` and ``events``. Of a run that was killed, ``failure`` and ``notes`` say so, and ``signals`` and
    ``figures`` are those of the rows until then. ``scenario`` is None where the recording does not hold it, or holds
    one of another version that this version does not understand; ``notes`` say so. Its ``path`` is None.

    Raises BadInputError when the file is missing, damaged, or not a recording of a run.
    """
    run = read(Path(path))
    found = judged_run(run)
    scenario, notes = recorded_scenario(run)
    failure = None if found.failure is None else error_of(found.failure.kind, found.failure.text)
    names = [name for name in dict.fromkeys([*SIGNAL_NAMES, *run.held, *run.signals]) if name in run.signals]
    signals = Signals({name: run.signals[name] for name in names})
    return RunResult(scenario, replace(found, notes=[*found.notes, *notes]), signals, failure)


def review(path: Path) -> dict[str, Any]:
    """Return the figures of a recording, as ``hil run --json`` has them, with ``reasons`` for those that are None.

    Only the signals that they need are read. Raises BadInputError when the file is not a recording of a run (see
    ``hil.record.reader.read``).
    """
    return to_json(judged_run(read_for_figures(path)))


def read_for_figures(path: Path, more: Collection[str] = ()) -> RecordedRun:
    """Read a recording: the signals for its figures and expectations, and those of ``more``. Raises BadInputError."""
    needed = figure_signals().union(more)
    run = read(path, needed)
    further = set() if run.summary is not None else {name for row in expected(run) for name in signals_of(row)}
    return run if further <= needed else read(path, needed | further)


def judged_run(run: RecordedRun) -> JudgedRun:
    """Return a recording that was read, with its figures and its verdict; see ``review``.

    ``made`` has the time and the versions of the run, ``notes`` sentences on what is missing in the file, ``events``
    the event log. Without a summary the expectations are checked over the recorded rows.
    """
    if "loop.t_s" not in run.signals:
        raise BadInputError(f"{run.path}: it has no signal 'loop.t_s', so it is not a recording of a run")
    cut_s = _cut_s(run)
    figures, reasons = signal_figures(
        run.signals,
        RunSetup(scenario_number(run, "firmware.torque_constant_n_m_a"), _limits(run)),
        None if cut_s is None else cut_words(cut_s, scenario_number(run, "loop.duration_s")),
        lacks=lambda name: f"the recording has no signal {name}: another version of the program made it",
    )
    lost = (run.rows_dropped or 0) + run.rows_missing
    figures["ticks"] += lost
    summary = run.summary or {}
    no_summary = _IN_LATER_PART if run.is_continued else _NO_END if run.rows_dropped is None else _NO_SUMMARY
    for name in _FROM_SUMMARY:
        if summary.get(name) is None:
            reasons[name] = no_summary if run.summary is None else summary.get("reasons", {}).get(name, _NOT_IN_SUMMARY)
    figures |= {name: summary.get(name) for name in _FIGURES_FROM_SUMMARY}
    found = from_json(summary)
    identity = {name: summary.get(name, run.properties.get(stored)) for name, stored in _IDENTITY.items()}
    found = replace(
        found,
        identity=Identity(**identity, given=given(scenario_of(run), json_object(run, "scenario_sources"))),
        figures=figures,
        reasons=reasons,
        counts=found.counts._replace(lost_rows=lost),
        trace=None,
        recording=str(run.path),
        recorded=None,
        damaged=run.is_damaged,
        notes=[*run.notes, *_other_version(run), *_judged_before(run)],
        made={name: text for name, text in run.properties.items() if name in _MADE},
        events=run.events,
    )
    if found.counts.rejected is None and figures["frames"] is not None:  # before version 0.3
        rejected, unmatched = rejected_and_unmatched(figures["frames"]["rejected"])
        found = replace(found, counts=found.counts._replace(rejected=rejected, unmatched=unmatched))
    if run.summary is None:
        failure = Failure(no_summary, "RunInterruptedError", _last_s(run))
        return _judged_by_rows(run, replace(found, failure=failure), cut_s)
    if summary.get("lost_rows", 0) != lost:
        return with_lost_rows(found, _tables(run, AllowTable, "allow")[0], lost)
    return found


def _judged_by_rows(run: RecordedRun, found: JudgedRun, cut_s: float | None) -> JudgedRun:
    expect = _results(run, found, cut_s)
    notes = [*found.notes]
    if left_out := len(table_rows(scenario_of(run), "expect")) - len(expect):
        notes.append(
            f"{left_out} of its expectations cannot be judged: the recording lacks their figures, signals or "
            "baseline, or another version made it"
        )
    return replace(found, expect=expect, notes=notes, unknown=found.unknown - {"expect"})


def _results(run: RecordedRun, found: JudgedRun, cut_s: float | None) -> list[ExpectationResult]:
    faults, models = _tables(run, FaultTable, "fault"), _tables(run, RobotModel, "robot")
    known, robot = figures_by_key(), models[0] if models else None
    results = []
    for row in expected(run):
        if row.is_of_signals and all(name in run.signals for name in signals_of(row)):
            with contextlib.suppress(ValueError):  # after a fault that this version does not understand
                results.append(check_expectation(row, run.signals, cut_s, faults, robot))
        elif row.figure in known and row.baseline is None:  # a recording does not hold the baseline
            results.append(figure_result(row, found, cut_s))
    return results


def fault_span_s(fault: FaultResult, end_s: float) -> tuple[float, float]:
    """Return from when to when a fault of a run was in force, until ``end_s`` at most.

    A fault that only happens does not last.
    """
    start_s = fault.start_s or 0.0
    if is_instant(fault.kind, fault.target):
        return start_s, start_s
    return start_s, max(end_s if fault.end_s is None else min(fault.end_s, end_s), start_s)


def scenario_of(run: RecordedRun) -> dict[str, Any]:
    """Return every value of the run's scenario by its dotted key; empty where the recording does not hold it."""
    return json_object(run, "scenario")


def json_object(run: RecordedRun, name: str) -> dict[str, Any]:
    """Return a property of the run that is a JSON object; empty where the recording does not hold it."""
    try:
        value = json.loads(run.properties[name])
    except (KeyError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def scenario_number(run: RecordedRun, key: str) -> float | None:
    """Return a number of the run's scenario, by its dotted key; None if the scenario has none."""
    value = scenario_of(run).get(key)
    return float(value) if isinstance(value, int | float) else None


def _cut_s(run: RecordedRun) -> float | None:
    """Return the time of the last row of a run that was cut short; None for one that came to its end.

    With a summary a run is complete unless that has a failure; without one, if its last row is at its planned end.
    """
    if run.summary is not None and run.summary.get("failure") is None:
        return None
    last_s = _last_s(run)
    duration_s, rate_hz = scenario_number(run, "loop.duration_s"), scenario_number(run, "loop.rate_hz")
    if run.is_continued or duration_s is None or not rate_hz:
        return last_s
    return last_s if last_s < duration_s - 2.0 / rate_hz else None


def _last_s(run: RecordedRun) -> float:
    t_s = run.signals["loop.t_s"]
    return float(t_s[-1]) if len(t_s) else 0.0


def _limits(run: RecordedRun) -> CommandLimits | None:
    speed_rad_s = scenario_number(run, "robot.speed_limit_rad_s")
    torque_n_m = scenario_number(run, "robot.torque_limit_n_m")
    return None if speed_rad_s is None or torque_n_m is None else CommandLimits(speed_rad_s, torque_n_m)


def expected(run: RecordedRun) -> list[ExpectTable]:
    """Return the rows of ``[[expect]]`` of the run's scenario, those that this version understands."""
    return _tables(run, ExpectTable, "expect")


def _tables(run: RecordedRun, kind: type[T], table: str) -> list[T]:
    """Return a table of the run's scenario, or the rows of an array; none of what this version does not understand."""
    values = scenario_of(run)
    one = {key.removeprefix(f"{table}."): value for key, value in values.items() if key.startswith(f"{table}.")}
    made = []
    for row in table_rows(values, table) or ([] if kind in (ExpectTable, FaultTable) else [one]):
        with contextlib.suppress(OptionsError):  # of a version that has other keys
            made.append(build(kind, row))
    return made


def _judged_before(run: RecordedRun) -> list[str]:
    """Return a note on the limits of ``[allow]`` by which an older version did not judge the run."""
    if run.summary is None or run.summary.get("passed") is None or "frames" not in run.summary:  # it has no figures
        return []
    judged = {row["name"] for row in run.summary.get("allow") or ()}
    missing = [name for name in options_of(AllowTable) if name not in judged]
    return [f"it was not judged by allow.{', '.join(missing)}: an older version made it"] if missing else []


def _other_version(run: RecordedRun) -> list[str]:
    missing = [name for name in SIGNAL_NAMES if name not in run.held]
    if not missing:
        return []
    more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
    commit = run.properties.get("commit")
    made = f"another version (commit {commit})" if commit else "another version"
    return [f"{made} made it: it lacks {', '.join(missing[:_NAMED])}{more}, which this one records"]


def recorded_scenario(run: RecordedRun) -> tuple[Scenario | None, list[str]]:
    """Return the scenario of a run, None where the recording does not hold it or this version cannot read it; why."""
    values, name = scenario_of(run), run.properties.get("scenario_name", "")
    if not values:
        return None, ["the recording does not hold the scenario of its run"]
    try:
        return from_values(name, values, json_object(run, "scenario_sources")), []
    except OptionsError as error:
        problems = "; ".join(problem.sentence for problem in error.problems[:2])
        return None, [f"its scenario is that of another version, and this one does not understand it: {problems}"]
