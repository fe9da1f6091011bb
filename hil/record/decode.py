"""Decodes a recording in a separate process: ``python -m hil.record.decode RUN.rrd SIGNALS JOURNAL``.

rerun's reader aborts its whole process on some damaged files, so ``hil.record.reader`` runs this module as a child. The
arguments after the file are JSON: a list of signals or null for all, and whether the journal is wanted. The
answer on standard output is one line of JSON, then the values as float64, signal by signal.
"""

import gc
import itertools
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import BadInputError
from hil.record.contents import (
    CUT_BEFORE_ROWS,
    NO_INDEX,
    Contents,
    DamagedError,
    Selection,
    Series,
    json_property,
)
from hil.record.decode_rrd import decode_rrd
from hil.record.files import check_is_recording, later_files
from hil.record.properties import (
    JOURNAL,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
)
from hil.record.started_process import refuse_pandas


def decode(
    path: Path, selection: Selection = None, *, with_journal: bool = False
) -> tuple[dict[str, Any], dict[str, Series]]:
    """Return the contents of a recording and its later files, and their signals by name. Raises DamagedError.

    The contents are the answer's first line: ``signals`` names the signals in the order of their values, each with
    ``rows`` values; the other keys are fields of ``RecordedRun``.
    """
    files, notes = _files(path, selection)
    parts = [contents for _, contents in files]
    first, last = parts[0], parts[-1]
    about = [contents.properties.part for contents in parts]
    lengths = [_length(contents) + contents.lost_rows for contents in parts]
    row_starts = [one.get("first_row") for one in about]
    spans, missing = _spans(row_starts, lengths)
    for i, start in enumerate(row_starts[1:]):
        if start is not None and (numbers := parts[i].numbers) is not None:
            spans[i] = int(np.searchsorted(numbers, start))
    starts = [one.get("first_event") for one in about]
    event_spans, events_missing = _spans(starts, [len(contents.events) + contents.lost_events for contents in parts])
    for count, what in ((missing, "rows"), (events_missing, "events")):
        if count:
            notes.append(f"{count} {what} between its parts were lost")
    notes.extend(f"{file.name} is damaged: {sentence}" for file, contents in files for sentence in contents.damage)
    signals = first.signals
    if len(files) > 1:
        spanned = list(zip(parts, spans, strict=True))
        signals = {name: np.concatenate([one.signals[name][:count] for one, count in spanned]) for name in signals}
    events = [event for one, count in zip(parts, event_spans, strict=True) for event in one.events[:count]]
    recorder = json_property(last.properties, RECORDER_PROPERTY)
    rows = len(next(iter(signals.values()), ()))
    if not rows:
        if any(contents.damage for contents in parts):
            raise DamagedError("damaged: none of its rows can be read")
        if recorder is None:
            raise DamagedError(CUT_BEFORE_ROWS)
    notes.extend(f"{file.name}: {sentence}" for file, contents in files for sentence in contents.remarks)
    notes.extend(note for part in files if (note := _cut(*part, is_last=part is files[-1])))
    next_number = (recorder or {}).get("next_part")
    if next_number is not None:
        notes.append(f"the run went on in part {next_number}, which is not read here")
    decoded: dict[str, Any] = dict(  # noqa: C408 -- keys as of RecordedRun
        signals=list(signals),
        held=[name for names in (json_property(first.properties, SIGNALS_PROPERTY) or {}).values() for name in names],
        rows=rows,
        events=[event for event in events if event[1] != JOURNAL],
        journal=[text for _, level, text in events if level == JOURNAL] if with_journal else [],
        properties=first.properties.get(RUN_PROPERTY, {}),
        summary=json_property(last.properties, SUMMARY_PROPERTY),
        rows_dropped=None if recorder is None else recorder.get("rows_dropped"),
        rows_missing=missing + sum(contents.lost_rows for contents in parts),
        is_damaged=any(set(contents.damage) - {NO_INDEX} for contents in parts),
        is_continued=next_number is not None,
        parts=[str(one) for one, _ in files],
        notes=notes,
    )
    return decoded, signals


def _cut(path: Path, contents: Contents, *, is_last: bool) -> str | None:
    """Return a sentence on what a file without its end has lost; None if nothing, or if the next file has it."""
    why = "the recorder was killed or could not write it, or the file was cut"
    if json_property(contents.properties, RECORDER_PROPERTY) is None:
        cut = f", with its last {contents.cut_bytes} bytes, which were cut short," if contents.cut_bytes else ""
        return f"{path.name} has no end: {why}, and what came after{cut} is lost" if is_last else None
    if contents.cut_bytes is None:
        return None
    cut = f", and its last {contents.cut_bytes} bytes, which were cut short, are left out" if contents.cut_bytes else ""
    return f"{path.name} has no index at its end: {why}{cut}; all that the run recorded is before that"


def _files(path: Path, selection: Selection) -> tuple[list[tuple[Path, Contents]], list[str]]:
    """Return the file and the later files of its run, and notes on files that were left out."""
    first = _read(path, selection)
    files, notes = [(path, first)], []
    part = json_property(first.properties, PART_PROPERTY)
    if part is not None and _is_later_file(part, first):
        notes.append(_alone(path, part))
    for other in later_files(path) if part is not None and part["number"] == 1 else ():
        try:
            check_is_recording(other)
            contents = _read(other, selection)
        except (DamagedError, BadInputError) as error:
            notes.append(f"{other.name}, by its name a part of it, is left out: {error}")
            continue
        later = json_property(contents.properties, PART_PROPERTY)
        if later is None or part is None or later["recording_id"] != part["recording_id"]:
            continue
        if later["number"] != int(other.stem.rpartition("-")[2]):
            notes.append(f"{other.name} is left out: it is part {later['number']} of the run by its content")
            continue
        files.append((other, contents))
    return files, notes


def _is_later_file(part: dict[str, Any], contents: Contents) -> bool:
    """Whether the file is a single later file of its run. A file merged by rerun has the properties of the last."""
    in_part = contents.properties.end.get("rows_in_part")
    return bool(part["number"] > 1 and (in_part is None or not contents.signals or _length(contents) <= in_part))


def _alone(path: Path, part: dict[str, Any]) -> str:
    number = part["number"]
    first = path.with_name(path.stem.removesuffix(f"-{number}") + path.suffix)
    whole = f"review {first.name} for the whole run" if first.exists() else f"{first.name} is not beside it"
    return f"{path.name} is part {number} of its run, from row {part['first_row']} on, and read alone; {whole}"


def _length(contents: Contents) -> int:
    return len(next(iter(contents.signals.values()), ()))


def _spans(starts: list[int | None], lengths: list[int]) -> tuple[list[int], int]:
    """Return how many rows (or events) to use of each file, and how many are missing between the files.

    ``starts`` has the number of each file's first row; older recordings have none for events. Rows that a recorder
    wrote, but could not count before it was killed, are in the next file too.
    """
    used = list(lengths)
    missing = 0
    for i, (start, after) in enumerate(itertools.pairwise(starts)):
        if start is not None and after is not None:
            missing += max(0, after - start - lengths[i])
            used[i] = min(lengths[i], after - start)
    return used, missing


def _read(path: Path, selection: Selection) -> Contents:
    clocked = None if selection is None else {"loop.t_s", *selection}  # sentences on what is missing tell times
    if check_is_recording(path) == ".mcap":
        from hil.record.decode_mcap import decode_mcap

        contents = decode_mcap(path, clocked)
    else:
        contents = decode_rrd(path, clocked)
    kept = contents.signals.keys() if selection is None else selection
    return contents._replace(signals={name: series for name, series in contents.signals.items() if name in kept})


def main() -> int:
    """Write the answer and return 0; if the file cannot be read, write only the reason and return 1."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of a library must not get into the answer
    refuse_pandas()
    with output:
        try:
            decoded, signals = decode(Path(sys.argv[1]), json.loads(sys.argv[2]), with_journal=json.loads(sys.argv[3]))
        except (DamagedError, ImportError) as error:
            why = "damage" if isinstance(error, DamagedError) else "missing"
            output.write(json.dumps({why: str(error)}).encode() + b"\n")
            return 1
        output.write(json.dumps(decoded).encode() + b"\n")
        for name in decoded["signals"]:
            output.write(np.ascontiguousarray(signals[name]).data)
    gc.freeze()  # saves a last collection over all modules, 0.08 s
    return 0


if __name__ == "__main__":
    sys.exit(main())
