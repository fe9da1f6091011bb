"""A judged run as JSON, as ``hil run --json`` and ``hil review --json`` print it and recordings hold it."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from hil.core.ports import Event
from hil.judge.judged_run import (
    BaselineResult,
    Counts,
    ExpectationResult,
    Failure,
    FaultResult,
    FramesResult,
    Identity,
    JudgedRun,
    LimitResult,
    MovedFigure,
    Recorded,
    Recovered,
    Verdict,
)

SCHEMA = "hil.run/1"
"""Name and version of a run's JSON; ``run.schema.json`` beside this file describes it."""
R = TypeVar("R", bound=tuple[Any, ...])
_FAILURE = ("failure", "failure_kind", "failure_s")
_MAY_BE_UNKNOWN = ("expect", "fault", "recoveries", "allow", "lenient")
_AS_THEY_ARE = (
    *("lenient", "reasons", "wire_sha256", "stopped", "robot_slipped_ticks", "realtime", "reference"),
    *("trace", "recording", "made", "damaged", "notes"),
)


def to_json(run: JudgedRun) -> dict[str, Any]:
    """Return the JSON of a run as ``hil run --json`` has it, and of one that was read back as ``hil review --json``."""
    failure = run.failure or (None, None, None)
    found = {
        "schema": SCHEMA,
        "passed": run.verdict.value,
        "lenient": run.lenient,
        **run.identity._asdict(),
        **run.figures,
        "wire_sha256": run.wire_sha256,
        "stopped": run.stopped,
        **run.counts._asdict(),
        "allow": _plain(run.allow),
        "recoveries": _plain(run.recoveries),
        "robot_slipped_ticks": run.robot_slipped_ticks,
        "expect": _plain(run.expect),
        "fault": _plain(run.faults),
        **dict(zip(_FAILURE, failure, strict=True)),
        "recording": run.recording,
        "reasons": dict(run.reasons),
        "baseline": _plain(run.baseline),
        "realtime": run.realtime,
        "reference": run.reference,
    }
    outputs = {"trace": run.trace, "recorded": _plain(run.recorded)}
    found |= {name: value for name, value in outputs.items() if value is not None}
    if run.made is not None:
        read = {"damaged": run.damaged, "notes": list(run.notes), "made": dict(run.made), "events": _plain(run.events)}
        found |= read | dict.fromkeys(run.unknown)
    return found


def from_json(found: Mapping[str, Any]) -> JudgedRun:
    """Return the run of a JSON. Keys that it lacks, as of an older version, are ``unknown`` or None."""
    known = {name: value for name, value in found.items() if value is not None}
    failure = None
    if "failure" in known:
        failure = Failure(*(found.get(name) for name in _FAILURE))  # type: ignore[arg-type]
    baseline, recorded = known.get("baseline"), known.get("recorded")
    if baseline is not None:
        figures = _rows(MovedFigure, baseline["figures"])
        frames = None if baseline["frames"] is None else _row(FramesResult, baseline["frames"])
        baseline = _row(BaselineResult, baseline)._replace(figures=figures, frames=frames)
    return JudgedRun(
        identity=_row(Identity, known),
        verdict=Verdict(found.get("passed")),
        figures={name: value for name, value in found.items() if name not in _NOT_FIGURES},
        counts=_row(Counts, known),
        allow=_rows(LimitResult, known.get("allow", ())),
        recoveries=_rows(Recovered, known.get("recoveries", ())),
        expect=_rows(ExpectationResult, known.get("expect", ())),
        faults=_rows(FaultResult, known.get("fault", ())),
        failure=failure,
        baseline=baseline,
        recorded=None if recorded is None else _row(Recorded, recorded),
        events=_rows(Event, known.get("events", ())),
        unknown=frozenset(name for name in _MAY_BE_UNKNOWN if name not in known),
        **{name: known[name] for name in _AS_THEY_ARE if name in known},
    )


def _plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _row(kind: type[R], found: Mapping[str, Any]) -> R:
    defaults = dict.fromkeys(kind._fields) | kind._field_defaults  # type: ignore[attr-defined]
    return kind(**{name: found.get(name, default) for name, default in defaults.items()})


def _rows(kind: type[R], found: Iterable[Mapping[str, Any]]) -> list[R]:
    return [_row(kind, row) for row in found]


_OF_OLDER_VERSIONS = ("error_course", "shadows", "streamed")
_NOT_FIGURES = {*to_json(JudgedRun(made={})), *_AS_THEY_ARE, "recorded", "page", "why", *_OF_OLDER_VERSIONS}
"""Keys of a run's JSON that are no figures: its other fields, what its recording adds for display, and what older
versions wrote."""
