"""The journal of a run: all that its controller was told from outside and what it sent, kept in the recording.

With it the run can be repeated by a controller that may have changed (``hil replay``). It has, in order, the frames of
the link as the controller's session saw them, behind latency and faults; when it found nothing to read; until when it
waited; the true poses and the pose fixes. Times are of the run's clock, in ns.

A recording holds it as lines of its event log of the level ``JOURNAL``, which readers keep apart: each has its number
and the next piece of the journal in base 64. So it is checked, resent and counted as all events are.
"""

import base64
import struct
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.core.ports import Clock, FixSource, Note, PoseSource
from hil.core.types import MeasuredPose, Pose, PoseCovariance, PoseFix, Twist
from hil.record.properties import JOURNAL

_PIECE_BYTES = 1 << 13
_HEAD = struct.Struct("<BIqq")  # kind, bytes of the body, two times
_FRAME = struct.Struct("<IH")  # identifier with its flags, bytes of the payload
_LOGS = struct.Struct("<II")
_POSE = struct.Struct("<q6d")
_TRUTH = struct.Struct("<BIqqq6d")  # with its head
_FIX = struct.Struct("<q9d")


class Kind(IntEnum):
    """What an entry is.

    The first time of an entry is when it happened. ``SENT``, ``RECEIVED``: frames; the second time of the latter is
    their time of arrival. ``ARRIVED``: as received, in a call that waited for them. ``EMPTY``: nothing was left to
    read. ``WAITED``: until the second time; its body is the time after it. ``LOST``: the link was, with the reason.
    ``LOGS``: what our protocol's client in C has sent and received in lockstep since the last one. ``TRUTH``,
    ``FIXES``: what one call of a source returned. ``READ``: the clock was, in real time.
    """

    SENT = 1
    RECEIVED = 2
    ARRIVED = 3
    EMPTY = 4
    WAITED = 5
    LOST = 6
    LOGS = 7
    TRUTH = 8
    FIXES = 9
    READ = 10


class Entry(NamedTuple):
    """An entry of a journal: its kind, its two times [ns], and its body."""

    kind: Kind
    time_ns: int
    other_ns: int
    body: bytes


class Journal:
    """Collects entries, and gives them piece by piece to the event log of a recording, once it is there.

    Attributes:
        waiting: the entries that are not written yet.
    """

    def __init__(self) -> None:
        self.waiting = bytearray()
        self._number = 0
        self._note: Note | None = None
        self._time_ns = 0

    def begin(self, note: Note) -> None:
        """Write to this event log from now on."""
        self._note = note

    def add(self, kind: Kind, time_ns: int, other_ns: int = 0, body: bytes = b"") -> None:
        """Add an entry."""
        self._time_ns = time_ns
        self.waiting += _HEAD.pack(kind, len(body), time_ns, other_ns) + body

    def frames(self, kind: Kind, time_ns: int, other_ns: int, frames: Sequence[Frame]) -> None:
        """Add frames."""
        body = b"".join([_FRAME.pack(number, len(payload)) + payload for number, payload in frames])
        self.add(kind, time_ns, other_ns, body)

    def logs(self, sent: bytes, received: bytes) -> None:
        """Add what the client in C has logged, as packed frames."""
        if sent or received:
            self.add(Kind.LOGS, self._time_ns, 0, _LOGS.pack(len(sent), len(received)) + sent + received)

    def put(self, row: bytes) -> None:
        """Write the next piece if it is long enough: once a tick, as a sink, for the event log may wait for room."""
        if len(self.waiting) >= _PIECE_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write what waits, if the event log is there."""
        if self._note is not None and self.waiting:
            text = f"{self._number} {base64.b64encode(self.waiting).decode('ascii')}"
            self._note(self._time_ns * 1e-9, JOURNAL, text)
            self._number += 1
            self.waiting.clear()


class JournalDamagedError(Exception):
    """A piece of a journal is missing or makes no sense; the text says which."""


def entries(pieces: Iterable[str]) -> Iterator[Entry]:
    """Yield the entries of a journal. Raises JournalDamagedError where a piece is missing or makes no sense."""
    rest = b""
    for expected, text in enumerate(pieces):
        number, _, content = text.partition(" ")
        if number != str(expected):
            raise JournalDamagedError(f"piece {expected} of its journal is missing")
        try:
            rest += base64.b64decode(content, validate=True)
        except ValueError:
            raise JournalDamagedError(f"piece {expected} of its journal is damaged") from None
        at = 0
        while len(rest) - at >= _HEAD.size:
            kind, size, time_ns, other_ns = _HEAD.unpack_from(rest, at)
            if len(rest) - at < _HEAD.size + size:
                break
            begin = at + _HEAD.size
            try:
                yield Entry(Kind(kind), time_ns, other_ns, rest[begin : begin + size])
            except ValueError:
                raise JournalDamagedError(f"piece {expected} of its journal has an entry of kind {kind}") from None
            at = begin + size
        rest = rest[at:]
    if rest:
        raise JournalDamagedError("the last entry of its journal is cut")


def frames_of(body: bytes) -> list[Frame]:
    """Return the frames of an entry's body."""
    found, at = [], 0
    while at < len(body):
        number, size = _FRAME.unpack_from(body, at)
        at += _FRAME.size
        found.append(Frame(number, body[at : at + size]))
        at += size
    return found


def logs_of(body: bytes) -> tuple[bytes, bytes]:
    """Return what was sent and received, as packed frames."""
    sent, received = _LOGS.unpack_from(body)
    return body[_LOGS.size : _LOGS.size + sent], body[_LOGS.size + sent : _LOGS.size + sent + received]


_OF_TRUTH = int(Kind.TRUTH)


class KeptTruth:
    """A source of true poses whose answers the journal keeps."""

    def __init__(self, source: PoseSource, journal: Journal, clock: Clock) -> None:
        self._source = source
        self._journal = journal
        self._clock = clock
        self._waiting = journal.waiting
        self.close = source.close

    def poll(self) -> PoseFix | None:
        fix = self._source.poll()
        now_ns = self._clock.now_ns()
        if fix is None:
            self._journal.add(Kind.TRUTH, now_ns)
            return None
        time_ns, (x, y, heading), (vx, vy, yaw_rate) = fix
        # In each tick: head and body in one call.
        self._waiting += _TRUTH.pack(_OF_TRUTH, _POSE.size, now_ns, 0, time_ns, x, y, heading, vx, vy, yaw_rate)
        return fix


def truth_of(body: bytes) -> PoseFix | None:
    """Return the true pose of an entry's body; None for a source that had none."""
    if not body:
        return None
    time_ns, *values = _POSE.unpack(body)
    return PoseFix(time_ns, Pose(*values[:3]), Twist(*values[3:]))


class KeptFixes:
    """A source of pose fixes whose answers the journal keeps."""

    def __init__(self, source: FixSource, journal: Journal, clock: Clock) -> None:
        self._source = source
        self._journal = journal
        self._clock = clock
        self.skip, self.restart, self.figures, self.close = source.skip, source.restart, source.figures, source.close

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        fixes = self._source.poll(now_ns, truth)
        body = b"".join([_FIX.pack(fix.time_ns, *fix.pose, *fix.covariance) for fix in fixes])
        self._journal.add(Kind.FIXES, self._clock.now_ns(), 0, body)
        return fixes


def fixes_of(body: bytes) -> list[MeasuredPose]:
    """Return the pose fixes of an entry's body."""
    found = []
    for time_ns, *values in _FIX.iter_unpack(body):
        found.append(MeasuredPose(time_ns, Pose(*values[:3]), PoseCovariance(*values[3:])))
    return found
