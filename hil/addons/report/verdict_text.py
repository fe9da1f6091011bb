"""The texts that a viewer shows of a run: the verdict first, and the page of its figures and properties."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

RUNNING, PASSED, FAILED, NOT_JUDGED = "RUNNING", "PASSED", "FAILED", "NOT JUDGED"

PROPERTY_WORDS = {
    "scenario_name": "scenario",
    "law": "law",
    "command": "commands by",
    "mode": "time",
    "link": "link",
    "seed": "seed",
    "started": "started",
    "mecanum_hil": "version",
    "rerun_sdk": "version of rerun",
    "python": "version of Python",
    "gains": "options of the law",
    "law_sha256": "code of the law",
    "fmu_sha256": "FMU",
    "map_sha256": "map of the FMU",
    "reference_file_sha256": "file of the reference",
    "motors_file_sha256": "file of the motors",
    "wheel_host_sources_sha256": "sources of the firmware (wheel_host)",
    "cosim_sources_sha256": "sources of the FMU's shim (cosim)",
    "wheel_host_sha256": "native library wheel_host",
    "cosim_sha256": "native library cosim",
    "scenario_sha256": "scenario with all values",
}
"""Labels of a recording's properties (see ``hil.runtime.provenance``)."""
HASHES = tuple(name for name in PROPERTY_WORDS if name.endswith("_sha256") and name != "scenario_sha256")
"""Hashes of a run's inputs (law, FMU, libraries, files), in the order in which they are shown."""
_HASH_LETTERS = 12  # enough to tell one hash from another
_MOST_REASONS = 4
_NO_VERDICT = "NO VERDICT"


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
    """Yield the results of a passed run."""
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


def hash_text(text: str) -> str:
    """Return a recorded hash, or a JSON object of hashes by name, shortened for a reader.

    A null, the hash of a law whose source was not found, becomes "not known".
    """
    if not text.startswith("{"):
        return text[:_HASH_LETTERS]
    hashes = {name: (digest or "not known")[:_HASH_LETTERS] for name, digest in json.loads(text).items()}
    return ", ".join(f"{name} {digest}" for name, digest in hashes.items())


def page(properties: Mapping[str, str], summary: Mapping[str, Any] | None) -> str:
    """Return the run's page as Markdown: a table of figures (``page`` of the summary) and one of properties."""
    text = _table("run", _properties(properties))
    return text if not summary else _table("figure", summary.get("page", ())) + "\n" + text


def _properties(properties: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for name, text in properties.items():
        if name in ("scenario", "scenario_sources"):  # hundreds of values: ``hil review --html`` lists them
            continue
        label = PROPERTY_WORDS.get(name, name.replace("_", " "))
        if name == "gains":
            yield label, ", ".join(f"{key} = {value}" for key, value in json.loads(text).items()) or "none"
        else:
            yield label, hash_text(text) if name.endswith("_sha256") else text


def _table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    lines = [f"| {_cell(label)} | {_cell(text)} |" for label, text in rows]
    return "\n".join([f"| {title} | |", "|---|---|", *lines, ""])


def _cell(text: str) -> str:
    """Escape a text so that it stays within one cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
