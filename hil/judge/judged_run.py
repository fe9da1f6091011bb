"""A judged run: its identity and figures, the outcome of each expectation and limit, and why it did not pass.

``decide`` decides whether a run passed. No side effects; ``run_json.py`` makes JSON of a run, ``run_text.py`` text.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from typing import Any, NamedTuple

from hil.core.ports import Event

STATE_BEGINS = "the robot then: "
"""The first words of the event with the robot's state at the first failure of a run."""


class Verdict(Enum):
    """How a run was judged; the value is ``passed`` in its JSON."""

    PASSED = True
    FAILED = False
    NONE = None
    """It was not judged, for example because its recording has no end."""


class Identity(NamedTuple):
    """The scenario and its main values; ``given``: the user's own by dotted key, each with ``value`` and ``from``."""

    scenario: str | None = None
    law: str | None = None
    mode: str | None = None
    command: str | None = None
    link: str | None = None
    seed: int | None = None
    given: Mapping[str, Mapping[str, str]] = {}


class Failure(NamedTuple):
    """What ended a run early: a sentence, the class of the error in ``hil.core.errors``, and when [s]."""

    text: str
    kind: str | None = None
    t_s: float | None = None


class ExpectationResult(NamedTuple):
    """The outcome of an expectation: of a signal, a figure or a stop, whichever is named; else that the robot rests.

    Attributes:
        passed: whether it held. False also without any sample; None when it is not judged: the run ended early, without
            a violation until then.
        violation_s: time of the first violation, or None. For a ``settles_to`` that did not settle, the last sample's.
        violation_value: the signal's value there (NaN for a gap), or None.
        worst_s: time of the worst violation, the value farthest from the claim, or None. None also for a ``settles_to``
            that did not settle: being outside at first is not a violation.
        worst_value: the signal's value there.
        violated_s: total time of violation [s]: each violation lasts from its first sample to the next good one, or to
            the last sample. None where ``worst_s`` is None.
        settled_s: of ``settles_to``: the first time from which the signal stayed within the tolerance.
        margin: how far inside the claim the run was, as ``hil.judge.claims.margin`` defines it; negative where it is
            broken, None when it is not judged.
        text: a sentence for the user with all of this.
    """

    signal: str | None = None
    figure: str | None = None
    stops: str | None = None
    passed: bool | None = None
    violation_s: float | None = None
    violation_value: float | None = None
    worst_s: float | None = None
    worst_value: float | None = None
    violated_s: float | None = None
    settled_s: float | None = None
    margin: float | None = None
    text: str = ""

    @property
    def claim(self) -> str:
        """The claim itself: ``text`` up to the outcome."""
        return self.text.partition(": ")[0]


class LimitResult(NamedTuple):
    """The outcome of a limit of ``[allow]``: how many events there were, how many no fault explains, and the limit."""

    name: str
    passed: bool
    all: int
    unexplained: int
    limit: int | str
    margin: float
    text: str


class FaultResult(NamedTuple):
    """A fault of a run: how often it was ``applied`` (None: unknown, the robot that counted is gone).

    ``counts`` is the unit of ``applied``, such as "frames lost".
    ``end_s`` is None for a fault without an end; ``start_s`` where an older version recorded the run.
    """

    kind: str
    target: str
    text: str
    applied: int | None
    counts: str
    start_s: float | None = None
    end_s: float | None = None
    value: float | None = None


class Recovered(NamedTuple):
    """A successful recovery: scenario time of the loss and of the return to ACTIVE [s], and the cause."""

    lost_s: float
    armed_s: float
    why: str


class MovedFigure(NamedTuple):
    """A figure of a run that is outside its baseline's band; a missing value is None."""

    key: str
    baseline: float | None
    value: float | None
    band: float
    text: str


class FramesResult(NamedTuple):
    """Whether the frames on the wire were those of the baseline; None: not judged."""

    passed: bool | None
    text: str


class BaselineResult(NamedTuple):
    """A run against its scenario's baseline: ``why`` it is not judged by it, or how many figures were ``judged``.

    ``figures`` are those that moved.
    """

    file: str
    why: str | None = None
    judged: int = 0
    figures: Sequence[MovedFigure] = ()
    frames: FramesResult | None = None

    @property
    def has_failed(self) -> bool:
        """Whether a figure moved, or the frames differ."""
        return bool(self.figures) or (self.frames is not None and self.frames.passed is False)


class Recorded(NamedTuple):
    """How complete a recording is: rows written, rows and events missing, the recorder's error, and its files."""

    rows: int
    dropped: int
    lost: int
    events_lost: int
    error: str | None
    restarts: int = 0
    troubles: Sequence[str] = ()
    parts: Sequence[str] = ()

    @property
    def why_incomplete(self) -> str | None:
        """Why it is incomplete; None where it is complete."""
        lacks = self.error or self.dropped or self.lost or self.events_lost
        return (self.error or "the recorder was too slow") if lacks else None

    def first_file(self, path: str | None) -> str | None:
        """Return the first file that is still there; ``path`` is the file that was asked for."""
        return path if path in self.parts else next(iter(self.parts), None)


class Counts(NamedTuple):
    """How many events of each kind a run had; None where a recording does not have it."""

    commands_refused: int | None = None
    stale_ticks: int | None = None
    held_ticks: int | None = None
    rejected: int | None = None
    unmatched: int | None = None
    fix_restarts: int | None = None
    lost_rows: int | None = None


@dataclass(frozen=True, kw_only=True)
class JudgedRun:
    """All that a run's JSON tells.

    Attributes:
        figures: figures and tables of figures by name; None where one is not defined, with a sentence in ``reasons``.
        lenient: whether the run is judged by its expectations alone.
        unknown: keys of the JSON that a recording lacks. Their fields here are empty or None, but not because the run
            had none.
        recording: the file of its recording. ``recorded``: its contents and gaps, None for a run that is read back.
        made: when, and by which versions, the recording was made; None for a run that is not read back. ``damaged``:
            whether some of it could not be read. ``notes``: sentences on what is missing.
        events: the event log.
        realtime, reference, trace: tables of the parts that made them, as the JSON has them.
    """

    identity: Identity = Identity()  # noqa: RUF009 -- immutable
    verdict: Verdict = Verdict.NONE
    lenient: bool = False
    figures: Mapping[str, Any] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    wire_sha256: str | None = None
    stopped: bool | None = None
    counts: Counts = Counts()  # noqa: RUF009 -- immutable
    robot_slipped_ticks: int | None = None
    allow: Sequence[LimitResult] = ()
    recoveries: Sequence[Recovered] = ()
    expect: Sequence[ExpectationResult] = ()
    faults: Sequence[FaultResult] = ()
    failure: Failure | None = None
    baseline: BaselineResult | None = None
    realtime: Mapping[str, Any] | None = None
    reference: Mapping[str, Any] | None = None
    trace: Mapping[str, Any] | None = None
    recording: str | None = None
    recorded: Recorded | None = None
    made: Mapping[str, str] | None = None
    damaged: bool = False
    notes: Sequence[str] = ()
    events: Sequence[Event] = ()
    unknown: frozenset[str] = frozenset()

    @property
    def passed(self) -> bool:
        return self.verdict is Verdict.PASSED

    def number(self, name: str) -> float | None:
        """Return a figure by its name, ``table.key`` for one of a table; None where the run has none.

        A table of counts gives their sum, expectations how many failed, recoveries how many there are.
        """
        if name in self.unknown:
            return None
        if name == "expect":
            return sum(row.passed is False for row in self.expect)
        if name == "recoveries":
            return len(self.recoveries)
        value: Any = self.counts._asdict() if name in Counts._fields else self.figures
        for part in name.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if isinstance(value, Mapping):
            return sum(value.values())
        return value if isinstance(value, int | float) and math.isfinite(value) else None

    def why_none(self, figure: str) -> str | None:
        """Return the reason why a figure has no value, or None where none is known."""
        return self.reasons.get(figure.partition(".")[0])


class CauseKind(StrEnum):
    """Why a run did not pass."""

    FAILURE = "failure"
    EXPECTATION = "expectation"
    LIMIT = "allow"
    FAULT = "fault"
    BASELINE = "baseline"


class Cause(NamedTuple):
    """A reason why a run did not pass."""

    kind: CauseKind
    of: Failure | ExpectationResult | LimitResult | FaultResult | MovedFigure | FramesResult


class Decision(NamedTuple):
    """A verdict with its causes; a run without any has passed."""

    verdict: Verdict
    causes: Sequence[Cause]


def decide(run: JudgedRun) -> Decision:
    """Decide whether a run passed. Causes come before their consequences, failed expectations in order of time.

    A lenient run is judged by its expectations alone. Of a recording without a summary only its failure and
    expectations are known.
    """
    causes = [] if run.failure is None else [Cause(CauseKind.FAILURE, run.failure)]
    causes += [Cause(CauseKind.EXPECTATION, row) for row in in_order(run.expect) if row.passed is False]
    if not run.lenient:
        causes += [Cause(CauseKind.LIMIT, row) for row in run.allow if not row.passed]
        # A fault that was never applied proves nothing.
        causes += [Cause(CauseKind.FAULT, row) for row in run.faults if not row.applied]
        if run.baseline is not None:
            causes += [Cause(CauseKind.BASELINE, row) for row in run.baseline.figures]
            if (frames := run.baseline.frames) is not None and frames.passed is False:
                causes.append(Cause(CauseKind.BASELINE, frames))
    return Decision(Verdict.FAILED if causes else Verdict.PASSED, causes)


def decided(run: JudgedRun) -> JudgedRun:
    """Return a run with the verdict that ``decide`` gives."""
    return replace(run, verdict=decide(run).verdict)


def in_order(expect: Iterable[ExpectationResult]) -> list[ExpectationResult]:
    """Return expectations: the failed ones by time, then those not judged, then those that held."""
    return sorted(expect, key=urgency)


def urgency(row: ExpectationResult) -> tuple[int, float]:
    """Return a key to sort expectations by, as ``in_order`` does."""
    return 1 if row.passed is None else 2 * row.passed, math.inf if row.violation_s is None else row.violation_s
