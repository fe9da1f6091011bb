"""The verdict of a run in words, as the first thing that a viewer shows, and the moments that are worth a look."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.record.lanes import FAILED, NOT_JUDGED, PASSED, RUNNING

_MOST_REASONS = 4
_NO_VERDICT = "NO VERDICT"


class Moment(NamedTuple):
    """Something that happened: its time [s], a word for it, and how long it lasted [s]."""

    t_s: float
    words: str
    lasts_s: float = 0.0


def running(properties: Mapping[str, str], troubles: Sequence[str]) -> str:
    """Return the verdict as Markdown while the run lasts; ``troubles`` are its errors so far."""
    so_far = _listed(troubles) if troubles else ["No expectation is violated so far."]
    return "\n\n".join([f"# {RUNNING}{_about(properties)}", *so_far])


def verdict(
    properties: Mapping[str, str],
    summary: Mapping[str, Any] | None,
    *,
    end_s: float,
    failed_s: float | None,
    next_part: int | None,
    troubles: Sequence[str],
) -> str:
    """Return the verdict as Markdown when a file ends at ``end_s``.

    ``failed_s`` is the time of the first violation, or None; ``summary`` is the run's JSON, None if the run was killed
    or goes on in file ``next_part``; ``troubles`` are the errors in its event log.
    """
    about = _about(properties)
    if next_part is not None:
        return f"# {RUNNING}{about}\n\nThis file ends at t = {end_s:.6g} s; the run goes on in file {next_part}."
    if summary is None:
        why = f"The run was killed or interrupted: its recording ends at t = {end_s:.6g} s, before the run was judged."
        return "\n\n".join([f"# {_NO_VERDICT}{about}", why, *_listed(troubles)])
    if summary.get("passed") is None:
        why = f"The recording ends at t = {end_s:.6g} s; it has nothing to be judged by."
        return "\n\n".join([f"# {NOT_JUDGED}{about}", why, *_listed(troubles)])
    if summary["passed"]:
        return "\n\n".join([f"# {PASSED}{about}", *_listed(_held(summary))])
    if failed_s is None and summary.get("failure") is not None:
        failed_s = end_s
    when = "" if failed_s is None else f" at t = {failed_s:.6g} s"
    return "\n\n".join([f"# {FAILED}{when}{about}", *_listed(_why(summary, end_s))])


def _why(summary: Mapping[str, Any], end_s: float) -> Iterable[str]:
    """Yield why a run failed: after its failure the faults that were in force then."""
    for kind, text in summary.get("why", ()):
        yield text
        if kind != "failure":
            continue
        for row in summary.get("fault") or ():
            ended_s = row["end_s"]
            if row["applied"] and (ended_s is None or ended_s >= end_s):
                yield f"In force then: the fault {row['text']}."


def _held(summary: Mapping[str, Any]) -> Iterable[str]:
    """Yield what a run that passed has shown."""
    expect = summary.get("expect") or ()
    if not expect:
        yield "Nothing broke, but the scenario expects nothing: it has no [[expect]]."
    elif len(expect) == 1:
        yield expect[0]["text"]
    else:
        yield f"All {len(expect)} expectations held; their lanes show when."
    if faults := summary.get("fault"):
        yield "Faults: " + "; ".join(f"{row['text']}, applied {row['applied']} times" for row in faults)


def _about(properties: Mapping[str, str]) -> str:
    """Return the names of the scenario and the law for the headline."""
    named = [properties[name] for name in ("scenario_name", "law") if name in properties]
    return f" ({', law '.join(named)})" if named else ""


def _listed(sentences: Iterable[str]) -> list[str]:
    """Return the sentences as one list in Markdown; what is too long for it is counted."""
    said = list(dict.fromkeys(sentences))
    if not said:
        return []
    shown = [f"- {sentence.replace('*', chr(92) + '*')}" for sentence in said[:_MOST_REASONS]]
    if len(said) > _MOST_REASONS:
        shown.append(f"- and {len(said) - _MOST_REASONS} more: see the tab Run")
    return ["\n".join(shown)]
