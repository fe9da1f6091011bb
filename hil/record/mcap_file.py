"""A recording as an MCAP file, which Foxglove and PlotJuggler open; needs no rerun and no ROS.

Each row is one message on ``/hil``, of a ROS 2 message definition that holds the signals by their names, as in
``/hil.wheel.fl.speed_rad_s``, encoded as CDR: floats of 64 bits one after the other. Events are
``rcl_interfaces/msg/Log`` on ``/events``, which Foxglove lists as a log. All messages are of ROS 2, and so is the
profile. The properties and the summary are metadata records with the names of an .rrd file's properties. A chunk is
closed whenever the recorder flushes, so a file that was cut off keeps everything that was flushed.
"""

import json
import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.record.checks import NUMBERS, Contained
from hil.record.properties import (
    APPLICATION,
    EVENTS_PATH,
    JOURNAL,
    JOURNAL_PATH,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
    scenario_values,
)
from hil.record.ring import Rows
from hil.record.viewing import MakeFrames

SIGNALS_TOPIC = "/hil"
ZERO_KEY = "zero_unix_ns"
CDR_HEADER = b"\0\1\0\0"  # little-endian
LOG_LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40}
"""The numbers of the levels in ``rcl_interfaces/msg/Log``."""
LENGTH, STAMP = struct.Struct("<I"), struct.Struct("<iI")
_LEVEL_AT = 8


class Definition(NamedTuple):
    """A type of message, with the definitions of the types that it uses after its own."""

    name: str
    text: str


def definition(name: str, *others: tuple[str, str], fields: str) -> Definition:
    """Return a definition in the form that MCAP calls ``ros2msg``; ``others`` are the types used, with their fields."""
    parts = [f"{fields}\n", *(f"MSG: {other}\n{inner}\n" for other, inner in others)]
    return Definition(name, ("=" * 80 + "\n").join(parts))


TIME = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec")
LOG = definition(
    "rcl_interfaces/msg/Log",
    TIME,
    fields="builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
    "uint32 line",
)


class McapFile:
    """An MCAP file that grows by chunks. Raises OSError when it cannot be opened or written.

    Args:
        zero_unix_ns: Unix time at the run's t = 0 [ns], for the time stamps.
        signals: names of the columns of every row. properties: facts about the run, as texts by name.
        part: which file of the run it is (see ``hil.record.properties``).
        make_frames: makes the messages by which viewers draw the robot (see ``hil.record.viewing``), or None.
    """

    def __init__(
        self,
        path: Path,
        zero_unix_ns: int,
        *,
        signals: Sequence[str],
        properties: Mapping[str, str],
        part: Mapping[str, Any],
        make_frames: MakeFrames | None,
    ) -> None:
        self._file = path.open("wb")
        self._zero_unix_ns = zero_unix_ns
        self._t_column = signals.index("loop.t_s")
        self._contained = Contained(part)
        self._last_ns = zero_unix_ns
        tree = _tree(signals)
        self._order = _leaves(tree)
        self._writer: Any = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library=APPLICATION)
        self._property(RUN_PROPERTY, properties)
        held = {SIGNALS_TOPIC: [signals[i] for i in self._order]}
        self._property(SIGNALS_PROPERTY, {"json": json.dumps(held), ZERO_KEY: str(zero_unix_ns)})
        self._property(PART_PROPERTY, {"json": json.dumps(part)})
        self._rows = self._channel(SIGNALS_TOPIC, Definition("hil/msg/Row", _definition(tree)))
        self._events = self._channel(EVENTS_PATH, LOG)
        self._journal = self._channel(JOURNAL_PATH, LOG)
        self._frames = None if make_frames is None else make_frames(signals, scenario_values(properties))
        self._topics: dict[str, int] = {}
        if self._frames is not None:
            self._topics = {topic: self._channel(topic, of) for topic, of in self._frames.topics.items()}
            for topic, stamp_ns, message in self._frames.begin(zero_unix_ns):
                self._writer.add_message(self._topics[topic], stamp_ns, message, stamp_ns)
        self.flush()

    def rows(self, rows: Rows, first: int | None = None) -> None:
        """Write rows of shape (n, signals) as they are; ``first`` is the number of the first of them in the run.

        None if it follows the last one. The number of a row is its message's sequence number.
        """
        first = self._contained.add_rows(len(rows), first)
        values = rows[:, self._order].astype("<f8")
        data, width = values.tobytes(), 8 * values.shape[1]
        for i, t_s in enumerate(rows[:, self._t_column].tolist()):
            stamp_ns = self._last_ns = self._stamp_ns(t_s)
            message = CDR_HEADER + data[i * width : (i + 1) * width]
            self._writer.add_message(self._rows, stamp_ns, message, stamp_ns, (first + i) % NUMBERS)
        if self._frames is not None:
            self._writer.flush()  # as before an event
            for topic, stamp_ns, message in self._frames.messages(rows, self._zero_unix_ns):
                self._writer.add_message(self._topics[topic], stamp_ns, message, stamp_ns)
            self._writer.flush()

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        # In a chunk of its own: chunks of rows alone are read back faster.
        self._writer.flush()
        stamp_ns = self._stamp_ns(t_s)
        log = log_message(stamp_ns, LOG_LEVELS.get(level, LOG_LEVELS["info"]), APPLICATION, text)
        channel = self._journal if level == JOURNAL else self._events
        self._writer.add_message(channel, stamp_ns, log, stamp_ns, self._contained.add_event() % NUMBERS)
        self._writer.flush()

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the run's summary, when there is one, and last the recorder's counts: a file with these is complete."""
        self._writer.flush()
        if summary is not None:
            self._property(SUMMARY_PROPERTY, {"json": json.dumps(summary)})
        self._property(RECORDER_PROPERTY, {"json": json.dumps({**self._contained.end(), **recorder})})

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._writer.flush()

    def close(self) -> None:
        """Write the index, and close the file."""
        self._writer.finish()
        self._file.close()

    def _property(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a property with its check value: MCAP has none for a metadata record."""
        self._writer.add_metadata(name, self._contained.checked(name, texts))

    def _channel(self, topic: str, of: Definition) -> int:
        schema = self._writer.register_schema(of.name, "ros2msg", of.text.encode())
        channel: int = self._writer.register_channel(topic, "cdr", schema)
        return channel

    def _stamp_ns(self, t_s: float) -> int:
        """Return the Unix time [ns] of a time of the run; a row without a time gets that of the last one."""
        return self._zero_unix_ns + round(t_s * 1e9) if np.isfinite(t_s) else self._last_ns


def _tree(signals: Sequence[str]) -> dict[str, Any]:
    """Return the signals' columns by the parts of their names, as nested fields that a message can have."""
    tree: dict[str, Any] = {}
    for column, signal in enumerate(signals):
        *groups, leaf = (re.sub(r"\W", "_", part) for part in signal.split("."))
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
            assert isinstance(branch, dict), f"{signal}: {group} is a signal and a group"
        assert leaf not in branch, f"{signal}: two signals of one name"
        branch[leaf] = column
    return tree


def _leaves(tree: Mapping[str, Any]) -> list[int]:
    columns: list[int] = []
    for branch in tree.values():
        columns += _leaves(branch) if isinstance(branch, dict) else [branch]
    return columns


def _definition(tree: Mapping[str, Any]) -> str:
    """Return the message definition in the form that MCAP calls ``ros2msg``, with the types that it uses after it."""
    texts: list[str] = []

    def define(branch: Mapping[str, Any], kind: str) -> None:
        groups = [name for name, inner in branch.items() if isinstance(inner, dict)]
        kinds = {name: kind + name.title().replace("_", "") for name in groups}
        lines = [f"hil/{kinds[name]} {name}" if name in kinds else f"float64 {name}" for name in branch]
        texts.append((f"MSG: hil/{kind}\n" if texts else "") + "\n".join(lines) + "\n")
        for name, inner_kind in kinds.items():
            define(branch[name], inner_kind)

    define(tree, "Row")
    return ("=" * 80 + "\n").join(texts)


def log_message(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """Return a ``rcl_interfaces/msg/Log`` at a Unix time, without a place in a source file."""
    body = bytearray(STAMP.pack(*divmod(stamp_ns, 1_000_000_000)) + bytes([level]))
    for one in (name, text, "", ""):  # the last two: file, function
        cdr_grown(body, 4, 0)
        body += cdr_string(one)
    cdr_grown(body, 4, 4)  # line
    return CDR_HEADER + bytes(body)


def log_fields(message: bytes) -> tuple[int, str]:
    """Return the level and the text of a ``rcl_interfaces/msg/Log``. Raises struct.error or ValueError for damage."""
    body = message[len(CDR_HEADER) :]
    at = _LEVEL_AT + 4
    (size,) = LENGTH.unpack_from(body, at)
    at += LENGTH.size + size
    at += -at % 4
    (size,) = LENGTH.unpack_from(body, at)
    at += LENGTH.size
    return body[_LEVEL_AT], body[at : at + size - 1].decode()


def cdr_string(text: str) -> bytes:
    data = text.encode(errors="backslashreplace") + b"\0"
    return LENGTH.pack(len(data)) + data


def cdr_grown(body: bytearray, alignment: int, size: int) -> int:
    """Align the end of a body (CDR aligns a number to its size), add ``size`` bytes and return where they begin."""
    body += bytes(-len(body) % alignment)
    at = len(body)
    body += bytes(size)
    return at
