"""Reads a trace and decodes its frames by the wheel-command protocol, whichever tool wrote the file."""

import math
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import NAMES, SENDERS, Tick
from hil.addons.report.trace.trace_files import DamagedError, LeftOut, TracedFrame, read_blf, read_log
from hil.core.errors import BadInputError, nearest

_READERS = {".blf": read_blf, ".log": read_log}
"""The reader of each form by the extension of its files: Vector's binary one, and that of ``candump -L``."""

FOREIGN, ERROR, REQUEST = "foreign", "error", "request"
_KINDS = (*NAMES.values(), FOREIGN, ERROR, REQUEST)
_SIGNS = {"us": "µs", "N.m": "N·m", "m/s2": "m/s²", "degC": "°C"}
_CAUSES_TOLD = 8
_TEXTS = "log with candump -L, or export it as .asc for 'python -m can.logconvert'"
# How files of other forms begin.
_FORMS_OF_OTHERS = {
    b"\x1f\x8b": "it is compressed with gzip; unpack it first",
    b"PK\x03\x04": "it is a zip archive; unpack it first",
    b"\xff\xfe": "it is text in UTF-16; save it as UTF-8",
    b"\xfe\xff": "it is text in UTF-16; save it as UTF-8",
    b"MDF  ": f"it is an MDF (.mf4); {_TEXTS}",
    b"SQLite format 3": f"it is a database of SQLite; {_TEXTS}",
    b"\xd4\xc3\xb2\xa1": f"it is a capture of packets (pcap); {_TEXTS}",
    b"\xa1\xb2\xc3\xd4": f"it is a capture of packets (pcap); {_TEXTS}",
    b"\n\r\r\n": f"it is a capture of packets (pcapng); {_TEXTS}",
    b"***BUSMASTER": f"it is a log of BUSMASTER; {_TEXTS}",
    b"Chn Identifier": f"it is a log of Kvaser's CanKing; {_TEXTS}",
    b"Time Stamp,ID,Extended": f"it is a table of SavvyCAN; {_TEXTS}",
    b";$FILEVERSION": "it is a trace of PEAK; convert it with 'python -m can.logconvert'",
    b"LOGG": "it is a .blf by its content; name it so",
}


class Selection(NamedTuple):
    """Which frames are wanted: by kind and channel (empty: all), and by seconds after the first, both ends included.

    ``raw``: do not decode frames. Third-party motor controllers use the same identifiers as this project's messages,
    and an identifier does not tell whose frame it is.
    """

    kinds: frozenset[str]
    from_s: float
    to_s: float
    raw: bool = False
    channels: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, names: Collection[str], from_s: float, to_s: float, *, raw: bool = False, channels: Collection[str] = ()
    ) -> Self:
        """Return the selection. Raises BadInputError for a name that is no message, and for an empty time range."""
        if raw and names:
            raise BadInputError(f"--message {next(iter(names))!r} with --raw: raw frames have no names; leave one out")
        by_name = {kind.casefold(): kind for kind in _KINDS}
        for name in names:
            if name.casefold() not in by_name:
                raise BadInputError(f"--message {name!r}: there is no such message{nearest(name.upper(), _KINDS)}")
        if not from_s <= to_s:
            raise BadInputError(f"--from {from_s:g} --to {to_s:g}: expected the first not to be later than the second")
        kinds = frozenset(by_name[name.casefold()] for name in names)
        return cls(kinds, from_s, to_s, raw, frozenset(channels))


class Entry(NamedTuple):
    """One frame of a trace.

    Attributes:
        t_s: seconds after the first frame of the file, to the microsecond; negative for one that was stamped earlier.
        kind: the name of a message of this project, ``foreign``, ``error`` or ``request``: a frame
            that was to be sent, and follows if it was.
        frame: as the file has it.
        message: the decoded message, or None if the frame is foreign or not valid.
        refusal: why it is not valid, or None.
    """

    t_s: float
    kind: str
    frame: TracedFrame
    message: codec.Message | None = None
    refusal: str | None = None

    def text(self) -> str:
        """Return one line for a person."""
        channel, direction = self.frame.channel or "-", self.frame.direction
        return f"{self.t_s:11.6f}  {channel:<5}  {direction}  {self.kind:<18}  {self._content()}".rstrip()

    def _content(self) -> str:
        if self.message is not None:
            return "  ".join(_signals(self.message))
        number, payload = self.frame.number, self.frame.payload
        data = f"[{len(payload)}] {payload.hex(' ')}"
        if self.kind == ERROR:
            error_class = f" {number:03X}" if number else ""
            return "error frame, or bytes that are no frame" + (f"{error_class} {data}" if payload else "")
        identifier = f"{number:08X}" if self.frame.extended else f"{number:03X}"
        return " ".join(filter(None, (identifier, self.refusal, data)))

    def record(self) -> dict[str, Any]:
        """Return the entry as a dict, for ``--json``."""
        record: dict[str, Any] = {
            "t_s": self.t_s,
            "channel": self.frame.channel,
            "direction": self.frame.direction,
            "message": self.kind,
            "sender": SENDERS.get(self.frame.number) if self.kind in NAMES.values() else None,
            "id": self.frame.number,
            "extended": self.frame.extended,
            "payload": self.frame.payload.hex(),
        }
        if self.message is not None:
            fields = self.message.FIELDS
            signals = {name: getattr(self.message, name) for name in fields}
            names = {name: kind(signals[name]).name for name, field in fields.items() if (kind := field.values)}
            record |= {"signals": signals, "names": names}
        if self.refusal is not None:
            record["refusal"] = self.refusal
        return record


def _signals(message: codec.Message) -> Iterator[str]:
    for name, field in message.FIELDS.items():
        value = getattr(message, name)
        if field.values is not None:
            yield f"{name} {field.values(value).name}"
        else:
            yield f"{name} {value} {_SIGNS.get(field.unit, field.unit)}" if field.unit else f"{name} {value}"


class Reading:
    """Iterates over the selected frames of a file, and counts all frames and the ``selected`` ones.

    ``left_out`` counts by kind what is not a CAN frame. If reading stopped early, ``trouble`` then says where and why.
    ``foreign`` are the channels whose frames are taken for those of another maker's motors: none of them is decoded.
    """

    def __init__(self, path: Path, selection: Selection, foreign: Collection[str | None] = ()) -> None:
        self._path = path
        self._selection = selection
        self.foreign = foreign
        self._first_s: float | None = None
        self.left_out: Counter[str] = Counter()
        self.frames = self.selected = 0
        self.trouble: str | None = None

    def __iter__(self) -> Iterator[Entry]:
        kinds, from_s, to_s, _, channels = self._selection
        for frame in self._frames():
            entry = self._entry(frame)
            is_there = not channels or entry.frame.channel in channels
            if is_there and from_s <= entry.t_s <= to_s and (not kinds or entry.kind in kinds):
                self.selected += 1
                yield entry

    def rest(self) -> str | None:
        """Return a text on the lines left out, the most frequent first; None without any."""
        if not self.left_out:
            return None
        told = self.left_out.most_common(_CAUSES_TOLD)
        words = [f"{cause}: {count}" for cause, count in told]
        if more := self.left_out.total() - sum(count for _, count in told):
            words.append(f"{len(self.left_out) - len(told)} other kinds: {more}")
        return f"{self._path}: left out, not readable as CAN frames: {', '.join(words)}"

    def _frames(self) -> Iterator[TracedFrame]:
        try:
            for content in _READERS[self._path.suffix.lower()](self._path):
                if isinstance(content, LeftOut):
                    self.left_out[content.cause] += 1
                else:
                    self.frames += 1
                    yield content
        except DamagedError as damage:
            self._break_off(str(damage) if self.frames else self._other_form() or str(damage))
        else:
            if not self.frames:
                suffix = self._path.suffix
                self._break_off("it has none" if self.left_out else f"it is not a {suffix} file, or it is empty")

    def _other_form(self) -> str | None:
        with self._path.open("rb") as file:
            begin = file.read(32)
        is_blf = self._path.suffix.lower() == ".blf"
        others = (why for magic, why in _FORMS_OF_OTHERS.items() if begin.startswith(magic))
        return None if is_blf and begin.startswith(b"LOGG") else next(others, None)

    def _break_off(self, why: str) -> None:
        self.trouble = f"{self._path}: {self.frames or 'no'} frames could be read; {why}"

    def _entry(self, traced: TracedFrame) -> Entry:
        if self._first_s is None:
            self._first_s = traced.stamp_s
        # Stamps are Unix seconds in a float, of which 0.2 µs are lost: `--from 1` would miss a frame shown at 1.000000.
        t_s = round(traced.stamp_s - self._first_s, 6)
        is_foreign = self._selection.raw or traced.channel in self.foreign
        if traced.is_error or traced.is_request:
            return Entry(t_s, ERROR if traced.is_error else REQUEST, traced)
        if traced.is_remote:
            return Entry(t_s, FOREIGN, traced, refusal="remote")
        if is_foreign or traced.extended or traced.number not in NAMES:
            return Entry(t_s, FOREIGN, traced)
        frame = Frame(traced.number, traced.payload)
        message = codec.decode(frame)
        refusal = None if message is not None else f"not valid: {codec.refusal(frame)}"
        return Entry(t_s, NAMES[frame.id], traced, message, refusal)


def read(path: Path, selection: Selection) -> Reading:
    """Return an iterator over the frames of a trace file that ``selection`` asks for.

    No frame of a channel is decoded if it has no valid TICK and fewer valid messages of ours than other frames: other
    makers use the same identifiers. Raises BadInputError when the file cannot be opened or its extension is not
    ``.blf`` or ``.log``.
    """
    if path.suffix.lower() not in _READERS:
        told = "expected .blf or .log, into which 'python -m can.logconvert' converts others"
        raise BadInputError(f"{path}: unknown file extension; {told}")
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}; expected a trace, .blf or .log") from error
    everything = Selection(frozenset(), -math.inf, math.inf)
    return Reading(path, selection, () if selection.raw else _foreign_channels(Reading(path, everything)))


def _foreign_channels(frames: Reading) -> frozenset[str | None]:
    """Return the channels whose frames are not ours: without a valid TICK, and most of them other frames."""
    ticking: set[str | None] = set()
    ours: Counter[str | None] = Counter()
    others: Counter[str | None] = Counter()
    for entry in frames:
        if entry.message is not None:
            ours[entry.frame.channel] += 1
            if isinstance(entry.message, Tick):
                ticking.add(entry.frame.channel)
        elif entry.kind not in (ERROR, REQUEST):
            others[entry.frame.channel] += 1
    return frozenset(one for one in others if one not in ticking and 0 < ours[one] < others[one])
