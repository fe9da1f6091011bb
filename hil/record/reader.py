"""Reading a recording back: every signal bit for bit, the events, the properties, and the summary.

A file without an end, whose recorder was killed, is read too.
"""

import json
import subprocess
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError
from hil.core.ports import Event
from hil.core.scratch import scratch_folder
from hil.core.subprocesses import module_command
from hil.record.contents import Series
from hil.record.files import EXPECTED_FILE, check_is_recording
from hil.record.started_process import rerun_environment

_INSTALL = "install rerun-sdk==0.41.*, or read it on a machine that has it"
_REPAIR = "'rerun rrd optimize --continue-on-error' may recover what is whole"


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """The contents of a recording.

    Attributes:
        path: the file; the first of its ``parts``, which are in order.
        signals: float64 arrays of one length by the signal's name, in the order in which the rows were recorded.
        properties: facts about the run, as texts by name.
        summary: the run's JSON; None when the run did not come to its end.
        rows_dropped: rows that the run dropped because the recorder was too slow; None when the recorder did not
            finish.
        rows_missing: rows that are in none of its files.
        is_damaged: whether something of it could not be read; ``notes`` tell what.
        is_continued: whether the run continued in a file that was not read.
        held: the names of all signals of the recording, read or not.
        journal: the pieces of its controller's journal (``hil.record.journal``), if they were asked for.
        notes: sentences on what is missing in the files, or could not be read.
    """

    path: Path
    signals: dict[str, Series]
    events: tuple[Event, ...]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None
    rows_missing: int = 0
    is_damaged: bool = False
    is_continued: bool = False
    parts: tuple[Path, ...] = ()
    held: tuple[str, ...] = ()
    journal: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read(path: Path, signals: Collection[str] | None = None, *, with_journal: bool = False) -> RecordedRun:
    """Read a recording made by ``hil run``, with its later files when it is the first of several.

    ``signals`` names the signals to read, for a long run that would not fit memory; None reads all. ``with_journal``
    reads the journal of its controller too.

    Raises BadInputError when the file is missing, empty, damaged, or not a recording by this program.
    """
    check_is_recording(path)
    selection = json.dumps(None if signals is None else sorted(signals)), json.dumps(with_journal)
    # In a separate process: rerun aborts its process on some damaged files, and leaves its temporary files behind.
    with (
        scratch_folder("read") as scratch,
        subprocess.Popen(
            module_command("hil.record.decode", str(path), *selection),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=rerun_environment() | {"TMPDIR": str(scratch)},
        ) as decoder,
    ):
        assert decoder.stdout is not None
        line = decoder.stdout.readline()
        head: dict[str, Any] = (
            json.loads(line) if line.endswith(b"\n") else {"damage": "damaged: its content makes no sense"}
        )
        if "missing" in head:
            raise BadInputError(f"{path}: no library to read it ({head['missing']}); {_INSTALL}")
        if "damage" in head:
            repair = f"; {_REPAIR}" if path.suffix == ".rrd" and head["damage"].startswith("damaged:") else ""
            raise BadInputError(f"{path}: {head['damage']}; expected {EXPECTED_FILE}{repair}")
        table = np.empty((len(head["signals"]), head["rows"]))
        _read_into(decoder.stdout, table)
    head["held"], head["notes"] = tuple(head["held"]), tuple(head["notes"])
    del head["rows"]
    head["signals"] = dict(zip(head["signals"], table, strict=True))
    head["events"] = tuple(Event(*event) for event in head["events"])
    head["journal"] = tuple(head["journal"])
    head["parts"] = tuple(map(Path, head["parts"]))
    return RecordedRun(path=path, **head)


def _read_into(stream: IO[bytes], table: npt.NDArray[np.float64]) -> None:
    """Fill a table without a second copy of it in memory."""
    left = memoryview(table.reshape(-1).view(np.uint8).data)
    while len(left):
        piece = stream.read(min(len(left), 1 << 20))
        if not piece:
            raise BadInputError("decoding the recording ended too early; there may be too little memory")
        left[: len(piece)] = piece
        left = left[len(piece) :]
