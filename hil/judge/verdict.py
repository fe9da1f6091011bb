"""A run as the text of a terminal: its verdict, what went wrong in order of time, then its figures.

No side effects: the JSON of a run in, lines of at most 80 columns out. ``hil run``, ``hil review`` and the results of
Python print the same lines.
"""

import math
import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.core.printable import printable
from hil.core.signals import unit_of
from hil.judge.baselines import outside
from hil.judge.claims import against
from hil.judge.course import course_words
from hil.judge.shadows import difference_words
from hil.judge.state import STATE_BEGINS
from hil.judge.words import (
    LENIENT,
    Row,
    accept_words,
    applied_words,
    belief_rows,
    figure_rows,
    frame_rows,
    in_order,
    link_rows,
    recording_words,
    why_incomplete,
)

COLUMNS = 80
_LABEL = 22
_NO_BREAK = "\N{NO-BREAK SPACE}"
_NUMBER_WITH_UNIT = re.compile(r"(?<=\d) (?=(?:s|ms|µs|m|mm|rad|mrad|rad/s|m/s|N·m|A|V|%)\b|%)")
_VERDICTS = {True: "PASSED", False: "FAILED", None: "NO VERDICT"}
_MOVED, _WARNED, _GIVEN = 6, 6, 6  # how many are shown before the rest is counted
_MOVED_BESIDE = 3  # where other failures say more
_LEFT_OUT = ("granted", "times real time", "frames")  # of a run in real time


class Happening(NamedTuple):
    """Something that went wrong, or explains it: when [s] (infinite: judged at the end), of which kind, and words."""

    t_s: float
    kind: str
    text: str


def run_lines(metrics: Mapping[str, Any], *, everything: bool = False) -> Iterator[str]:
    """Return the lines about a run, from its JSON; ``events`` and ``notes`` of it may be missing.

    ``everything``: also what held, the figures of this machine, and those of a link that lost nothing.
    """
    return map(printable, _run_lines(metrics, everything=everything))


def _run_lines(metrics: Mapping[str, Any], *, everything: bool) -> Iterator[str]:
    yield from row_lines(head_rows(metrics))
    if happened := happenings(metrics):
        yield ""
        yield "On the way:" if metrics["passed"] else "What happened, in order of time:"
        yield from _timeline(happened)
    if metrics.get("error_course") is not None and (everything or not metrics["passed"]):
        yield from wrapped("  position error: ", course_words(metrics["error_course"]))
    yield ""
    yield from row_lines(_judged(metrics, everything=everything))
    figures = figure_rows(metrics, machine=everything or metrics.get("mode") == "realtime")
    yield from row_lines(_without_value(row for row in figures if everything or row[0] not in _LEFT_OUT))
    if _is_rejected(metrics) and not everything:
        yield from row_lines(frame_rows(metrics))
    yield from row_lines(belief_rows(metrics))
    if everything or metrics.get("link") != "memory:" or _is_rejected(metrics):
        yield from row_lines(link_rows(metrics))
    yield from row_lines(_shadows(metrics))
    yield from row_lines(_outputs(metrics))


def verdict_word(metrics: Mapping[str, Any]) -> str:
    """Return PASSED, FAILED, or NO VERDICT for a run that did not come to its end.

    A run that passed though its recording lacks something, as with ``--lenient``, is PASSED, INCOMPLETE.
    """
    word, recorded = _VERDICTS[metrics.get("passed")], metrics.get("recorded")
    lacks = metrics.get("lost_rows") or metrics.get("damaged")
    lacks = lacks or (recorded is not None and why_incomplete(recorded) is not None)
    return f"{word}, INCOMPLETE" if metrics.get("passed") and lacks else word


def head_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the verdict with what was run, then what was given for it and notes on the recording."""
    if metrics.get("scenario") is None:
        yield verdict_word(metrics), ""
    else:
        by = f" by {metrics['command']}" if metrics.get("command") else ""
        about = f"{metrics['scenario']}: {metrics['law']}{by}, {metrics['mode']} over {metrics['link']}"
        yield verdict_word(metrics), f"{about}, seed {metrics['seed']}"
    if (mutant := metrics.get("mutant")) is not None:
        yield "mutant", f"{mutant}, a known defect that hil verify has put in"
    if given := _given(metrics):
        yield "given", given
    yield from (("note", sentence) for sentence in metrics.get("notes") or ())


def happenings(metrics: Mapping[str, Any]) -> list[Happening]:
    """Return what went wrong in a run, and the faults that may explain it, in order of time."""
    found = [
        Happening(row["start_s"], "fault" if row["applied"] else "no fault", applied_words(row))
        for row in metrics.get("fault") or ()
        if row.get("start_s") is not None
    ]
    found += [
        Happening(_end(row["violation_s"]), "failed", failed_words(row))
        for row in in_order(metrics.get("expect") or ())
        if row["passed"] is False
    ]
    found += [
        Happening(row["lost_s"], "lost", f"{row['why']}; ACTIVE again at {row['armed_s']:.3f} s")
        for row in metrics.get("recoveries") or ()
    ]
    if metrics.get("failure") is not None:
        found.append(Happening(_ended_s(metrics), "ended", metrics["failure"]))
    found += [Happening(math.inf, "allow", row["text"]) for row in metrics.get("allow") or () if not row["passed"]]
    found += [
        Happening(_end(row["dropped_s"]), "shadow", row["dropped"])
        for row in metrics.get("shadows") or ()
        if row["dropped"] is not None
    ]
    warned = (metrics.get("reference") or {}).get("warnings", ())
    found += [Happening(0.0, "warning", sentence) for sentence in warned]
    found += _moved(metrics, _MOVED_BESIDE if any(one.kind in ("failed", "ended") for one in found) else _MOVED)
    found += _logged(metrics, found)
    return sorted(found, key=lambda one: one.t_s)


def _ended_s(metrics: Mapping[str, Any]) -> float:
    """Return when a run ended early. A fault that begins between two ticks has ended it after the one before."""
    began = [row["start_s"] for row in metrics.get("fault") or () if row["applied"] and row.get("start_s") is not None]
    return float(max([_end(metrics.get("failure_s")), *began]))


def failed_words(row: Mapping[str, Any]) -> str:
    """Return a failed expectation, from its entry in a run's JSON: the claim, first and worst value, and how long."""
    claim, _, rest = str(row["text"]).partition(": failed")
    if row.get("violated_s") is None or row.get("worst_s") is None:
        return f"{claim}: {rest.lstrip(', ')}"
    unit = "" if row.get("signal") is None else unit_of(row["signal"])
    first = f"first {_value(row['violation_value'], unit, claim)} at {row['violation_s']:.6g} s"
    if row["worst_s"] == row["violation_s"] and not row["violated_s"]:
        return f"{claim}: {first}, once"
    if row["violation_s"] > 0.0 and f" from {row['violation_s']:g} s" in claim:
        first += ", already when its time began"
    worst = f"worst {_value(row['worst_value'], unit, claim)} at {row['worst_s']:.6g} s"
    return f"{claim}: {first}, {worst}, {row['violated_s']:.4g} s in all"


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


def _timeline(happened: Sequence[Happening]) -> Iterator[str]:
    for t_s, kind, text in happened:
        at = f"{t_s:.3f} s" if math.isfinite(t_s) else "at the end"
        yield from wrapped(f"  {at:>10}  {kind:<8}  ", text)


def _end(t_s: float | None) -> float:
    return math.inf if t_s is None else t_s


def _value(value: float | None, unit: str, claim: str) -> str:
    return "no value" if value is None or math.isnan(value) else f"{against(value, claim, 4)} {unit}".rstrip()


def _given(metrics: Mapping[str, Any]) -> str:
    """Return what the user gave for the run: on the command line, and, if it did not pass, in files of his own."""
    given: Mapping[str, Mapping[str, str]] = metrics.get("given") or {}
    rows = [f"{key} = {one['value']}" for key, one in given.items() if one["from"].startswith("--")]
    if not metrics.get("passed"):
        rows += [f"{key} = {one['value']}" for key, one in given.items() if not one["from"].startswith("--")]
    more = [f"{len(rows) - _GIVEN} more"] if len(rows) > _GIVEN else []
    return "; ".join([*rows[:_GIVEN], *more])


def _moved(metrics: Mapping[str, Any], most: int) -> Iterator[Happening]:
    """Yield how a run is away from its baseline, the figure that is farthest from its band first."""
    if (baseline := metrics.get("baseline")) is None or baseline["why"] is not None:
        return

    def away(row: Mapping[str, Any]) -> float:
        value, accepted = row.get("value"), row.get("baseline")
        if value is None or accepted is None:
            return -math.inf
        return -float(abs(value - accepted) / (row["band"] or 1e-12))

    rows = sorted(baseline["figures"], key=away)
    yield from (Happening(math.inf, "moved", _moved_words(row)) for row in rows[:most])
    if len(rows) > most:
        others = ", ".join(row["key"] for row in rows[most:])
        yield Happening(math.inf, "moved", f"also {others}")
    frames = baseline["frames"]
    if frames is not None and frames["passed"] is False and not rows:  # with other figures they must be others
        yield Happening(math.inf, "moved", frames["text"])


def _moved_words(row: Mapping[str, Any]) -> str:
    """Return a figure that is not where the baseline has it, in a line."""
    value, baseline = row["value"], row["baseline"]
    found, accepted = outside(value, baseline, row["band"], 4)
    share = "" if value is None or not baseline else f" ({100.0 * (value / baseline - 1.0):+.3g} %)"
    return f"{row['key']}: {found}, accepted {accepted}{share}"


def _logged(metrics: Mapping[str, Any], found: Sequence[Happening]) -> Iterator[Happening]:
    """Yield the warnings and errors of the event log that are not told already, and how it looked at a failure."""
    # The first violation of an expectation is logged at once; its final text begins with the same claim.
    told = [claim for row in metrics.get("expect") or () if len(claim := row["text"].partition(": failed")[0])]
    told += [one.text for one in found] + [f"{one.kind}: {one.text}" for one in found]
    told += ["baseline: "] if metrics.get("baseline") is not None else []
    warned = []
    for event in metrics.get("events") or ():
        if event["text"].startswith(STATE_BEGINS) and not metrics.get("passed"):
            yield Happening(event["t_s"], "state", event["text"].removeprefix(STATE_BEGINS))
        elif event["level"] in ("WARN", "ERROR") and not any(event["text"].startswith(one) for one in told):
            warned.append(Happening(event["t_s"], "error" if event["level"] == "ERROR" else "warning", event["text"]))
    yield from warned[:_WARNED]
    if len(warned) > _WARNED:
        last = warned[-1].t_s
        yield Happening(last, "warning", f"{len(warned) - _WARNED} more until then; hil review --json has them all")


def _judged(metrics: Mapping[str, Any], *, everything: bool) -> Iterator[Row]:
    """Yield how many expectations held, the tightest of them, and how the run compares with its baseline."""
    rows = [row for row in metrics.get("expect") or () if row["passed"] is not False]
    held = [row for row in rows if row["passed"]]
    if everything:
        yield from (("expectation", row["text"]) for row in rows)
    elif held:
        tightest = min(held, key=lambda row: _end(row.get("margin")))
        claim = tightest["text"].partition(": ")[0]
        room = tightest.get("margin")
        left = "" if room is None or room >= 1.0 else f", with {100 * room:.3g} % to spare"
        count = "1 held: " if len(held) == 1 else f"{len(held)} held; the tightest: "
        yield "expectations", f"{count}{claim}{left}"
    if not everything and len(rows) > len(held):
        yield from (("not judged", row["text"].replace(": not judged", "")) for row in rows if row["passed"] is None)
    if (baseline := metrics.get("baseline")) is not None:
        if baseline["why"] is not None:
            yield "baseline", f"not judged against it: {baseline['why']}"
        else:
            frames = baseline["frames"]
            same = ", and the same frames" if frames is not None and frames["passed"] else ""
            count = baseline["judged"] - len(baseline["figures"])
            yield "baseline", f"{count} of {baseline['judged']} figures as accepted{same}"
        if baseline["figures"] or (baseline["frames"] is not None and baseline["frames"]["passed"] is False):
            yield "", accept_words(metrics)
    if metrics.get("lenient"):
        yield "lenient", LENIENT


def _without_value(rows: Iterator[Row]) -> Iterator[Row]:
    """Yield figures; those without a value together, by their reason."""
    none: dict[str, list[str]] = {}
    for label, text in rows:
        if text.startswith("-  "):
            none.setdefault(text.removeprefix("-").strip(), []).append(label)
        else:
            yield label, text
    yield from (("no value", f"{', '.join(labels)}: {why}") for why, labels in none.items())


def _is_rejected(metrics: Mapping[str, Any]) -> bool:
    """Whether frames were rejected, or feedback was lost."""
    rejected = Counter((metrics.get("frames") or {}).get("rejected") or {})
    lost = ((metrics.get("link_statistics") or {}).get("lost") or {}).values()
    return rejected.total() > 0 or any(lost)


def _shadows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    for row in metrics.get("shadows") or ():
        if row.get("difference"):
            yield f"shadow {row['name']}", difference_words(row["difference"])


def _outputs(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield what a recording lacks, a trace and a stream."""
    recorded = metrics.get("recorded")
    if recorded is not None and (text := recording_words(recorded, metrics["recording"])):
        yield "recording", text
    if (trace := metrics.get("trace")) is not None:
        yield "trace", trace["trouble"] or f"{trace['frames']} frames in {trace['path']}"
    if (stream := metrics.get("streamed")) is not None:
        yield "stream", _streamed(stream)


def _streamed(stream: Mapping[str, Any]) -> str:
    if stream["sent"] is None:
        return f"to {stream['url']} incomplete: {stream['error']}"
    text = f"{stream['sent']} datagrams to {stream['url']}"
    if stream["lost"]:
        text += f", {stream['lost']} lost: {stream['error']}"
    if stream["rows_dropped"]:
        text += f", {stream['rows_dropped']} rows dropped: the sender was too slow"
    return text
