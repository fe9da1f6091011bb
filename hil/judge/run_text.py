"""A judged run as text: its verdict, what went wrong in order of time, then its figures.

No side effects: a ``JudgedRun`` in; pairs of a label and a text, or lines of at most 80 columns, out. ``hil run``,
``hil review`` and the results of Python print the same lines.
"""

import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from hil.core.printable import printable
from hil.core.signals import unit_of
from hil.judge.baselines import outside
from hil.judge.claims import against
from hil.judge.figure_text import Row, belief_rows, figure_rows, frame_rows, is_rejected_or_lost, link_rows
from hil.judge.judged_run import (
    STATE_BEGINS,
    BaselineResult,
    ExpectationResult,
    FaultResult,
    JudgedRun,
    MovedFigure,
    Recorded,
    Verdict,
    decide,
    in_order,
)
from hil.judge.run_json import to_json

LENIENT = "judged by [[expect]] alone: not by [allow], the baseline, or whether every fault was applied"
COLUMNS = 80
_LABEL = 22
_NO_BREAK = "\N{NO-BREAK SPACE}"
_NUMBER_WITH_UNIT = re.compile(r"(?<=\d) (?=(?:s|ms|µs|m|mm|rad|mrad|rad/s|m/s|N·m|A|V|%)\b|%)")
_VERDICTS = {Verdict.PASSED: "PASSED", Verdict.FAILED: "FAILED", Verdict.NONE: "NO VERDICT"}
_MOVED, _WARNED, _GIVEN = 6, 6, 6  # how many are shown before the rest is counted
_MOVED_BESIDE = 3  # where other failures say more
_LEFT_OUT = ("granted", "times real time", "frames")  # of a run in real time


class TimelineEntry(NamedTuple):
    """Something that went wrong, or explains it: time [s] (infinite: judged at the end), kind, and text."""

    t_s: float
    kind: str
    text: str


def run_lines(run: JudgedRun, *, everything: bool = False) -> Iterator[str]:
    """Return the lines about a run.

    ``everything``: also what held, the figures of this machine, and those of a link that lost nothing.
    """
    return map(printable, _run_lines(run, everything=everything))


def _run_lines(run: JudgedRun, *, everything: bool) -> Iterator[str]:
    yield from row_lines(head_rows(run))
    if entries := timeline(run):
        yield ""
        yield "On the way:" if run.passed else "What happened, in order of time:"
        for t_s, kind, text in entries:
            at = f"{t_s:.3f} s" if math.isfinite(t_s) else "at the end"
            yield from wrapped(f"  {at:>10}  {kind:<8}  ", text)
    yield ""
    yield from row_lines(_outcome_summary(run, everything=everything))
    rows = figure_rows(run, machine=everything or run.identity.mode == "realtime")
    yield from row_lines(_without_value(row for row in rows if everything or row[0] not in _LEFT_OUT))
    is_rejected = is_rejected_or_lost(run)
    if is_rejected and not everything:
        yield from row_lines(frame_rows(run))
    yield from row_lines(belief_rows(run))
    if everything or run.identity.link != "memory:" or is_rejected:
        yield from row_lines(link_rows(run))
    yield from row_lines(_outputs(run))


def verdict_word(run: JudgedRun) -> str:
    """Return PASSED, FAILED, or NO VERDICT for a run that did not come to its end.

    A run that passed though its recording lacks something, as with ``--lenient``, is PASSED, INCOMPLETE.
    """
    word = _VERDICTS[run.verdict]
    lacks = run.counts.lost_rows or run.damaged or (run.recorded is not None and run.recorded.why_incomplete)
    return f"{word}, INCOMPLETE" if run.passed and lacks else word


def head_rows(run: JudgedRun) -> Iterator[Row]:
    """Yield the verdict with the run's identity, then the user's values and notes on the recording."""
    ran = run.identity
    if ran.scenario is None:
        yield verdict_word(run), ""
    else:
        by = f" by {ran.command}" if ran.command else ""
        yield verdict_word(run), f"{ran.scenario}: {ran.law}{by}, {ran.mode} over {ran.link}, seed {ran.seed}"
    # On the command line, and, if the run did not pass, in files of the user's own.
    given = [f"{key} = {one['value']}" for key, one in ran.given.items() if one["from"].startswith("--")]
    if not run.passed:
        given += [f"{key} = {one['value']}" for key, one in ran.given.items() if not one["from"].startswith("--")]
    more = [f"{len(given) - _GIVEN} more"] if len(given) > _GIVEN else []
    if given:
        yield "given", "; ".join([*given[:_GIVEN], *more])
    yield from (("note", sentence) for sentence in run.notes)


def timeline(run: JudgedRun) -> list[TimelineEntry]:
    """Return what went wrong in a run, and the faults that may explain it, in order of time."""
    found = [
        TimelineEntry(row.start_s, "fault" if row.applied else "no fault", applied_text(row))
        for row in run.faults
        if row.start_s is not None
    ]
    failed = [row for row in in_order(run.expect) if row.passed is False]
    found += [TimelineEntry(_end(row.violation_s), "failed", failed_text(row)) for row in failed]
    found += [
        TimelineEntry(row.lost_s, "lost", f"{row.why}; ACTIVE again at {row.armed_s:.3f} s") for row in run.recoveries
    ]
    if run.failure is not None:
        # A fault that begins between two ticks has ended the run after the one before.
        began = [row.start_s for row in run.faults if row.applied and row.start_s is not None]
        found.append(TimelineEntry(max(_end(run.failure.t_s), *began, -math.inf), "ended", run.failure.text))
    found += [TimelineEntry(math.inf, "allow", row.text) for row in run.allow if not row.passed]
    found += [TimelineEntry(0.0, "warning", sentence) for sentence in (run.reference or {}).get("warnings", ())]
    if run.baseline is not None:
        most = _MOVED_BESIDE if any(one.kind in ("failed", "ended") for one in found) else _MOVED
        found += [TimelineEntry(math.inf, "moved", text) for text in _moved(run.baseline, most)]
    found += _logged(run, found)
    return sorted(found, key=lambda one: one.t_s)


def outcome_rows(run: JudgedRun) -> Iterator[Row]:
    """Yield faults, recoveries, expectations (see ``in_order``), broken limits, and what the recording lacks."""
    yield from (("fault", applied_text(row)) for row in run.faults)
    for row in run.recoveries:
        yield "recovery", f"lost at {row.lost_s:.3f} s, ACTIVE again at {row.armed_s:.3f} s: {row.why}"
    yield from (("expect", row.text) for row in in_order(run.expect))
    yield from (("allow", row.text) for row in run.allow if not row.passed)
    if (baseline := run.baseline) is not None:
        if baseline.why is None:
            yield from (("baseline", row.text) for row in baseline.figures)
            if baseline.frames is not None and not baseline.frames.passed:
                yield "baseline", baseline.frames.text
        yield from _baseline_rows(run, baseline, "baseline", "not judged against the baseline")
    if run.lenient:
        yield "lenient", LENIENT
    yield from _recording(run)


def why_not_passed(run: JudgedRun) -> Iterator[Row]:
    """Yield kind and sentence of each cause for which a run did not pass."""
    for kind, of in decide(run).causes:
        yield kind.value, applied_text(of) if isinstance(of, FaultResult) else of.text


def page_json(run: JudgedRun) -> dict[str, Any]:
    """Return rows as ``page``, and ``why`` the run did not pass, for what a recording shows."""
    page = [] if run.verdict is Verdict.NONE else [("passed", "yes" if run.passed else "no")]
    if run.failure is not None:
        page.append(("failure", run.failure.text))
    for rows in (outcome_rows, figure_rows, belief_rows, link_rows):
        page += rows(run)
    return {"page": page, "why": list(why_not_passed(run))}


def with_page(run: JudgedRun) -> dict[str, Any]:
    """Return the JSON of a run with ``page_json``, as its recording holds it."""
    return to_json(run) | page_json(run)


def failed_text(row: ExpectationResult) -> str:
    """Return a failed expectation: the claim, first and worst value, and how long it was violated."""
    claim, _, rest = row.text.partition(": failed")
    if row.violated_s is None or row.worst_s is None:
        return f"{claim}: {rest.lstrip(', ')}"
    unit = "" if row.signal is None else unit_of(row.signal)
    first = f"first {_value(row.violation_value, unit, claim)} at {row.violation_s:.6g} s"
    if row.worst_s == row.violation_s and not row.violated_s:
        return f"{claim}: {first}, once"
    if (row.violation_s or 0.0) > 0.0 and f" from {row.violation_s:g} s" in claim:
        first += ", already when its time began"
    worst = f"worst {_value(row.worst_value, unit, claim)} at {row.worst_s:.6g} s"
    return f"{claim}: {first}, {worst}, {row.violated_s:.4g} s in all"


def applied_text(fault: FaultResult) -> str:
    """Return a sentence on how often a fault of a run was applied."""
    if fault.applied is None:
        return f"{fault.text}: not known how often it was applied, because the robot has gone"
    if not fault.applied:
        return f"{fault.text}: never applied, so the run shows nothing about it"
    times = "once" if fault.applied == 1 else f"{fault.applied} times"
    return f"{fault.text}: applied {times} ({fault.counts})"


def row_lines(rows: Iterator[Row]) -> Iterator[str]:
    """Yield a line for each label and text, with further lines where a text does not fit."""
    for label, text in rows:
        yield from wrapped(f"  {label:<{_LABEL}} " if label not in _VERDICTS.values() else f"{label}  ", text)


def wrapped(begin: str, text: str) -> list[str]:
    """Return ``begin`` and a text in lines of at most 80 columns; paths, and numbers with their units, stay whole."""
    kept = _NUMBER_WITH_UNIT.sub(_NO_BREAK, text)
    lines = textwrap.wrap(
        kept,
        COLUMNS,
        initial_indent=begin,
        subsequent_indent=" " * len(begin),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_NO_BREAK, " ") for line in lines] or [begin.rstrip()]


def _end(t_s: float | None) -> float:
    return math.inf if t_s is None else t_s


def _value(value: float | None, unit: str, claim: str) -> str:
    return "no value" if value is None or math.isnan(value) else f"{against(value, claim, 4)} {unit}".rstrip()


def _moved(baseline: BaselineResult, most: int) -> Iterator[str]:
    """Yield how a run is away from its baseline, the figure that is farthest from its band first."""

    def away(row: MovedFigure) -> float:
        if row.value is None or row.baseline is None:
            return -math.inf
        return -abs(row.value - row.baseline) / (row.band or 1e-12)

    rows = sorted(baseline.figures, key=away)
    for row in rows[:most]:
        found, accepted = outside(row.value, row.baseline or 0.0, row.band, 4)
        share = "" if row.value is None or not row.baseline else f" ({100.0 * (row.value / row.baseline - 1.0):+.3g} %)"
        yield f"{row.key}: {found}, accepted {accepted}{share}"
    if len(rows) > most:
        yield f"also {', '.join(row.key for row in rows[most:])}"
    if baseline.frames is not None and baseline.frames.passed is False and not rows:  # with other figures they must be
        yield baseline.frames.text


def _logged(run: JudgedRun, found: Sequence[TimelineEntry]) -> Iterator[TimelineEntry]:
    """Yield the warnings and errors of the event log that are not shown already, and the state at a failure."""
    # The first violation of an expectation is logged at once; its final text begins with the same claim.
    told = [claim for row in run.expect if len(claim := row.text.partition(": failed")[0])]
    told += [one.text for one in found] + [f"{one.kind}: {one.text}" for one in found]
    told += ["baseline: "] if run.baseline is not None else []
    warned = []
    for t_s, level, text in run.events:
        if text.startswith(STATE_BEGINS) and not run.passed:
            yield TimelineEntry(t_s, "state", text.removeprefix(STATE_BEGINS))
        elif level in ("WARN", "ERROR") and not text.startswith(tuple(told)):
            warned.append(TimelineEntry(t_s, "error" if level == "ERROR" else "warning", text))
    yield from warned[:_WARNED]
    if len(warned) > _WARNED:
        last = warned[-1].t_s
        yield TimelineEntry(last, "warning", f"{len(warned) - _WARNED} more until then; hil review --json has them all")


def _outcome_summary(run: JudgedRun, *, everything: bool) -> Iterator[Row]:
    """Yield how many expectations held, the tightest of them, and how the run compares with its baseline."""
    rows = [row for row in run.expect if row.passed is not False]
    held = [row for row in rows if row.passed]
    if everything:
        yield from (("expectation", row.text) for row in rows)
    elif held:
        tightest = min(held, key=lambda row: _end(row.margin))
        room = tightest.margin
        left = "" if room is None or room >= 1.0 else f", with {100 * room:.3g} % to spare"
        count = "1 held: " if len(held) == 1 else f"{len(held)} held; the tightest: "
        yield "expectations", f"{count}{tightest.claim}{left}"
    if not everything and len(rows) > len(held):
        yield from (("not judged", row.text.replace(": not judged", "")) for row in rows if row.passed is None)
    if run.baseline is not None:
        yield from _baseline_rows(run, run.baseline, "", "not judged against it")
    if run.lenient:
        yield "lenient", LENIENT


def _baseline_rows(run: JudgedRun, baseline: BaselineResult, label: str, not_judged: str) -> Iterator[Row]:
    """Yield how many figures are as accepted, or why that is not judged, and with ``label`` what to do about others."""
    if baseline.why is not None:
        yield "baseline", f"{not_judged}: {baseline.why}"
        return
    same = ", and the same frames" if baseline.frames is not None and baseline.frames.passed else ""
    held = baseline.judged - len(baseline.figures)
    yield "baseline", f"{held} of {baseline.judged} figures as accepted{same}"
    if baseline.has_failed:
        explore = "" if run.lenient else ", or explore with --lenient"
        yield label, f"find what changed; accept it with `hil baseline --accept`{explore}"


def _without_value(rows: Iterator[Row]) -> Iterator[Row]:
    """Yield figures; those without a value together, by their reason."""
    none: dict[str, list[str]] = {}
    for label, text in rows:
        if text.startswith("-  "):
            none.setdefault(text.removeprefix("-").strip(), []).append(label)
        else:
            yield label, text
    yield from (("no value", f"{', '.join(labels)}: {why}") for why, labels in none.items())


def _outputs(run: JudgedRun) -> Iterator[Row]:
    yield from _recording(run)
    if (trace := run.trace) is not None:
        yield "trace", trace["trouble"] or f"{trace['frames']} frames in {trace['path']}"


def _recording(run: JudgedRun) -> Iterator[Row]:
    if run.recorded is not None and (text := _recording_text(run.recorded, run.recording)):
        yield "recording", text


def _recording_text(recorded: Recorded, path: str | None) -> str:
    parts = f" in {len(recorded.parts)} parts" if len(recorded.parts) > 1 else ""
    if (why := recorded.why_incomplete) is not None:
        file = recorded.first_file(path)
        events = f", {recorded.events_lost} events lost" if recorded.events_lost else ""
        rest = "" if file is None else f", {recorded.rows} are safe in {file}{parts}"
        return f"incomplete: {why}; {recorded.dropped} rows were dropped and {recorded.lost} lost{events}{rest}"
    if recorded.troubles:
        return f"complete{parts}, though {'; '.join(recorded.troubles)}"
    return f"complete{parts}" if parts else ""
