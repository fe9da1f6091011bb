"""Reading a recording back: every signal bit for bit, the events, what the run was, and its summary.

Works for a file without an end too: one whose recorder was killed.
"""

import json
import subprocess
from collections.abc import Collection
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from hil.child import module_command
from hil.errors import BadInputError
from hil.telemetry.environment import rerun_environment
from hil.telemetry.files import EXPECTED_FILE, check_is_recording

if TYPE_CHECKING:
    import pandas as pd

Series = npt.NDArray[np.float64]

_SENSELESS = "damaged: its content makes no sense"
_REPAIR = "'rerun rrd optimize --continue-on-error' may recover what is whole"


class Event(NamedTuple):
    """A line of the event log; level as rerun names it: DEBUG, INFO, WARN or ERROR."""

    t_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """What a recording holds.

    Attributes:
        path: the file.
        signals: float64 arrays of one length by the signal's name, in the order in which the rows were recorded.
        events: the event log.
        properties: what the run was, as texts by name.
        summary: what the run said at its end; None when it never came to that.
        rows_dropped: rows that the run had to drop; None when the recorder never came to say.
        repairs: a sentence for each thing that was wrong with the file, and what was lost by it.
        held: the names of all signals of the file, read or not.
    """

    path: Path
    signals: dict[str, Series]
    events: tuple[Event, ...]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None
    repairs: tuple[str, ...]
    held: tuple[str, ...]


def read(path: Path, signals: Collection[str] | None = None) -> RecordedRun:
    """Read a recording made by ``hil run``: all of its signals, or of those named the ones that it has.

    A long run has a gigabyte of them; only what is asked for is read.

    Raises BadInputError when the file is missing, empty, no recording, damaged, or one of another program.
    """
    check_is_recording(path)
    # A process of its own: the library aborts on some damaged files.
    with subprocess.Popen(
        module_command("hil.review.decode", str(path), *(signals or ())),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=rerun_environment(),
    ) as decoder:
        answer = cast(BufferedReader, decoder.stdout)
        line = answer.readline()
        head: dict[str, Any] = json.loads(line) if line else {"damage": _SENSELESS}
        found: dict[str, Series] = {}
        for name in head.get("signals", ()):
            found[name] = np.empty(head["rows"])
            if answer.readinto(found[name].data.cast("B")) != found[name].nbytes:
                head = {"damage": _SENSELESS}
                break
    if "damage" in head:
        raise BadInputError(f"{path}: {head['damage']}; expected {EXPECTED_FILE}; {_REPAIR}")
    return RecordedRun(
        path=path,
        signals=found,
        events=tuple(Event(*event) for event in head["events"]),
        properties=head["properties"],
        summary=head["summary"],
        rows_dropped=head["rows_dropped"],
        repairs=tuple(head["repairs"]),
        held=tuple(head["held"]),
    )


def to_frame(run: RecordedRun) -> "pd.DataFrame":
    """Return the signals as a frame: one column each, indexed by the scenario time ``loop.t_s``."""
    import pandas as pd

    return pd.DataFrame(run.signals).set_index("loop.t_s", drop=False)
