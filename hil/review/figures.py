"""The figures of a recorded run: computed again from its signals or, where these do not suffice, from its summary."""

import contextlib
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.options import OptionsError, build, options_of
from hil.core.signals import SIGNAL_NAMES
from hil.judge.claims import check_expectation, signals_of
from hil.judge.course import ErrorCourse
from hil.judge.expectations import (
    figure_outcome,
    figures_by_key,
    outcome_figures,
    rejected_and_unmatched,
)
from hil.judge.figures import BLOCK_ROWS, cut_words, figure_signals, signal_figures
from hil.judge.measure import CommandLimits, RunSetup
from hil.judge.shadows import ShadowDifferences, shadow_differences, with_differences
from hil.judge.words import SCHEMA, set_lost_rows
from hil.record.properties import table_rows
from hil.review.reader import RecordedRun, read
from hil.scenario.load import given
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable

T = TypeVar("T")

_NO_SUMMARY = "the recording has no summary: the run did not come to its end"
_NO_END = "the recording has no summary and no end: how the run ended is not known"
_IN_LATER_PART = "the recording has no summary: it is in a later part, which was not read"
_NOT_IN_SUMMARY = "the run's summary does not have it"
_IDENTITY = {name: name for name in ("law", "command", "mode", "link", "seed")} | {"scenario": "scenario_name"}
_FROM_SUMMARY = ("passed", "realtime_factor", "lateness_us", "frames", "link_statistics", "pose_fixes", "wire_sha256")
# No reason is given where one of these is None.
_OUTCOME = (
    *("failure", "failure_kind", "failure_s", "stopped", "expect", "fault", "recoveries", "commands_refused"),
    *("lenient", "baseline", "stale_ticks", "held_ticks", "rejected", "unmatched", "allow", "realtime"),
    *("robot_slipped_ticks", "reference"),
)
_MADE = ("command", "started", "mecanum_hil", "commit", "python", "machine")
_MUTANT = ("mutant", "mutant_sha256")
_NAMED = 4
_LATE_S = 1.0  # a run in real time may have missed its first ticks


def review(path: Path) -> dict[str, Any]:
    """Return the figures of a recording, as ``hil run --json`` has them, with ``reasons`` for those that are None.

    Only the signals that they need are read. Raises BadInputError when the file is not a recording of a run (see
    ``hil.review.reader.read``).
    """
    return figures(read_for_figures(path))


def read_for_figures(path: Path, more: Collection[str] = ()) -> RecordedRun:
    """Read a recording: the signals for its figures and expectations, and those of ``more``. Raises BadInputError."""
    needed = figure_signals().union(more)
    run = read(path, needed)
    further = set(ShadowDifferences(run.held).signals)
    if run.summary is None:
        further |= {name for row in expected(run) for name in signals_of(row)}
    return run if further <= needed else read(path, needed | further)


def figures(run: RecordedRun) -> dict[str, Any]:
    """Return the figures of a recording that was read; see ``review``.

    ``made`` has the time and the versions of the run, ``notes`` sentences on what is missing in the file, ``events``
    the event log. Without a summary the expectations are checked over the recorded rows.
    """
    if "loop.t_s" not in run.signals:
        raise BadInputError(f"{run.path}: it has no signal 'loop.t_s', so it is not a recording of a run")
    cut_s = _cut_s(run)
    found, reasons = signal_figures(
        run.signals,
        RunSetup(scenario_number(run, "firmware.torque_constant_n_m_a"), _limits(run)),
        None if cut_s is None else cut_words(cut_s, scenario_number(run, "loop.duration_s")),
        lacks=lambda name: f"the recording has no signal {name}: another version of the program made it",
    )
    found["ticks"] += (run.rows_dropped or 0) + run.rows_missing
    summary = run.summary or {}
    no_summary = _IN_LATER_PART if run.is_continued else _NO_END if run.rows_dropped is None else _NO_SUMMARY
    for name in _FROM_SUMMARY:
        found[name] = summary.get(name)
        if found[name] is None:
            reasons[name] = no_summary if run.summary is None else summary.get("reasons", {}).get(name, _NOT_IN_SUMMARY)
    identity = {name: summary.get(name, run.properties.get(stored)) for name, stored in _IDENTITY.items()}
    outcome = {name: summary.get(name) for name in _OUTCOME}
    if run.summary is None:
        outcome |= {"failure": no_summary, "failure_kind": "RunInterruptedError", "failure_s": _last_s(run)}
    result = {
        "schema": SCHEMA,
        "passed": found.pop("passed"),
        **identity,
        "given": given(scenario_of(run), json_object(run, "scenario_sources")),
        **outcome,
        **found,
        **{name: run.properties[name] for name in _MUTANT if name in run.properties},
        "recording": str(run.path),
        "damaged": run.is_damaged,
        "notes": [*run.notes, *_other_version(run), *_judged_before(run), *_late_begin(run)],
        "made": {name: text for name, text in run.properties.items() if name in _MADE},
        "events": [event._asdict() for event in run.events],
        "reasons": reasons,
        "shadows": _shadows(run),
        "error_course": _course(run),
    }
    if result["rejected"] is None and result["frames"] is not None:  # before version 0.3
        result["rejected"], result["unmatched"] = rejected_and_unmatched(result["frames"]["rejected"])
    if run.summary is None:
        result["expect"] = _outcomes(run, result, cut_s)
        if left_out := len(table_rows(scenario_of(run), "expect")) - len(result["expect"]):
            result["notes"].append(
                f"{left_out} of its expectations cannot be judged: the recording lacks their figures, signals or "
                "baseline, or another version made it"
            )
    result["lost_rows"] = lost = (run.rows_dropped or 0) + run.rows_missing
    if run.summary is not None and summary.get("lost_rows", 0) != lost:
        set_lost_rows(result, _tables(run, AllowTable, "allow")[0], lost)
    return result


def _shadows(run: RecordedRun) -> list[dict[str, Any]]:
    """Return the shadows of a run, as its summary has them, with their differences to the command."""
    differences = shadow_differences(run.signals)
    unknown = [{"name": name, "dropped_s": None, "dropped": None} for name in differences]
    return with_differences((run.summary or {}).get("shadows", unknown), differences)


def _course(run: RecordedRun) -> dict[str, Any] | None:
    """Return the course of the position error; None where the recording has none."""
    course = ErrorCourse()
    if all(name in run.signals for name in course.signals):
        for start in range(0, len(run.signals["loop.t_s"]), BLOCK_ROWS):
            course.add({name: run.signals[name][start : start + BLOCK_ROWS] for name in course.signals})
    return course.figures()


def _outcomes(run: RecordedRun, found: Mapping[str, Any], cut_s: float | None) -> list[dict[str, Any]]:
    """Return the outcomes of the expectations of a run without a summary, as far as its rows show them."""
    faults, models = _tables(run, FaultTable, "fault"), _tables(run, RobotModel, "robot")
    known, robot = figures_by_key(), models[0] if models else None
    outcomes = []
    for row in expected(run):
        if row.is_of_signals and all(name in run.signals for name in signals_of(row)):
            with contextlib.suppress(ValueError):  # after a fault that this version does not understand
                outcomes.append((row, check_expectation(row, run.signals, cut_s, faults, robot)))
        elif row.figure in known and row.baseline is None:  # a recording does not hold the baseline
            outcomes.append((row, figure_outcome(row, found, cut_s)))
    return [outcome_figures(*one) for one in outcomes]


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
    """Return the limits of a wheel's command in the run's scenario; None where it has none."""
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
    """Return a note on the signals of this version that the recording lacks."""
    missing = [name for name in SIGNAL_NAMES if name not in run.held]
    if not missing:
        return []
    more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
    commit = run.properties.get("commit")
    made = f"another version (commit {commit})" if commit else "another version"
    return [f"{made} made it: it lacks {', '.join(missing[:_NAMED])}{more}, which this one records"]


def _late_begin(run: RecordedRun) -> list[str]:
    """Return a note when the recording begins later than its run or service, from whose start its times count."""
    t_s = run.signals["loop.t_s"]
    if not len(t_s) or t_s[0] < _LATE_S:
        return []
    return [f"it begins at t = {t_s[0]:.6g} s; how long it took to track the reference is counted from there"]
