"""A recording as an MCAP file, which Foxglove and PlotJuggler open; needs no rerun.

Each row is one message on ``/hil``, of a ROS 2 message definition that holds the signals by their names, as in
``/hil.wheel.fl.speed_rad_s``, encoded as CDR: floats of 64 bits one after the other. Events are
``rcl_interfaces/msg/Log`` on ``/events``. The robot is there as ROS has it, for Foxglove and RViz to draw: its URDF on
``/robot_description``, its frames on ``/tf``. As all messages are ROS 2's, so is the profile. The properties and the
summary are metadata records with the names of an .rrd file's properties. A chunk is closed whenever the recorder
flushes, so a file that was cut off keeps everything that was flushed.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.record.checks import NUMBERS, with_check
from hil.record.frames import RobotFrames
from hil.record.properties import (
    APPLICATION,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
    scenario_values,
)
from hil.record.ring import Rows
from hil.record.ros_messages import (
    CDR_HEADER,
    LOG,
    LOG_LEVELS,
    STRING,
    TF_MESSAGE,
    Definition,
    log_message,
    string_message,
)

SIGNALS_TOPIC = "/hil"
EVENTS_TOPIC = "/events"
ROBOT_TOPIC, FRAMES_TOPIC = "/robot_description", "/tf"
ZERO_KEY = "zero_unix_ns"


class McapFile:
    """An MCAP file that grows by chunks. Raises OSError when it cannot be opened or written.

    Args:
        zero_unix_ns: Unix time at the run's t = 0 [ns], for the time stamps.
        signals: names of the columns of every row.
        properties: facts about the run, as texts by name.
        part: which file of the run it is (see ``hil.record.properties``).
    """

    def __init__(
        self,
        path: Path,
        zero_unix_ns: int,
        *,
        signals: Sequence[str],
        properties: Mapping[str, str],
        part: Mapping[str, Any],
    ) -> None:
        self._file = path.open("wb")
        self._zero_unix_ns = zero_unix_ns
        self._t_column = signals.index("loop.t_s")
        self._next_row, self._next_event = (int(part.get(name, 0)) for name in ("first_row", "first_event"))
        self._holds: list[str] = []
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
        self._events = self._channel(EVENTS_TOPIC, LOG)
        self._robot = RobotFrames.of(signals, scenario_values(properties))
        if self._robot is not None:
            self._frames = self._channel(FRAMES_TOPIC, TF_MESSAGE)
            robot, message = self._channel(ROBOT_TOPIC, STRING), string_message(self._robot.urdf)
            self._writer.add_message(robot, zero_unix_ns, message, zero_unix_ns)
        self.flush()

    def rows(self, rows: Rows, first: int | None = None) -> None:
        """Write rows of shape (n, signals) as they are; ``first`` is the number of the first of them in the run.

        None if it follows the last one. The number of a row is its message's sequence number.
        """
        first = self._next_row if first is None else first
        self._next_row = first + len(rows)
        values = rows[:, self._order].astype("<f8")
        data, width = values.tobytes(), 8 * values.shape[1]
        for i, t_s in enumerate(rows[:, self._t_column].tolist()):
            stamp_ns = self._last_ns = self._stamp_ns(t_s)
            message = CDR_HEADER + data[i * width : (i + 1) * width]
            self._writer.add_message(self._rows, stamp_ns, message, stamp_ns, (first + i) % NUMBERS)
        if self._robot is not None:
            self._writer.flush()  # as before an event
            for stamp_ns, message in self._robot.messages(rows, self._zero_unix_ns):
                self._writer.add_message(self._frames, stamp_ns, message, stamp_ns)
            self._writer.flush()

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        # In a chunk of its own: chunks of rows alone are read back faster.
        self._writer.flush()
        stamp_ns = self._stamp_ns(t_s)
        log = log_message(stamp_ns, LOG_LEVELS.get(level, LOG_LEVELS["info"]), APPLICATION, text)
        self._writer.add_message(self._events, stamp_ns, log, stamp_ns, self._next_event % NUMBERS)
        self._next_event += 1
        self._writer.flush()

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the run's summary, when there is one, and last the recorder's counts: a file with these is complete."""
        self._writer.flush()
        if summary is not None:
            self._property(SUMMARY_PROPERTY, {"json": json.dumps(summary)})
        end = {"rows_until": self._next_row, "events_until": self._next_event, "holds": self._holds}
        self._property(RECORDER_PROPERTY, {"json": json.dumps({**end, **recorder})})

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._writer.flush()

    def close(self) -> None:
        """Write the index, and close the file."""
        self._writer.finish()
        self._file.close()

    def _property(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a property with its check value: MCAP has none for a metadata record."""
        self._writer.add_metadata(name, with_check(name, texts))
        self._holds.append(name)

    def _channel(self, topic: str, of: Definition) -> int:
        """Open a topic for messages of ROS 2 and return its channel."""
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
