"""Reads a trace and decodes its frames by the wheel-command protocol, whichever tool wrote the file."""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import NAMED_VALUES, NAMES, SENDERS, UNITS, Tick
from hil.core.errors import BadInputError, nearest
from hil.wire.trace.text_forms import FORMS, read_text
from hil.wire.trace.traced import DamagedError, LeftOut, TracedFrame

READABLE = (".blf", *FORMS)
"""Extensions of the files that can be read: Vector's two, that of ``candump -L``, and PEAK's."""

FOREIGN, ERROR, REQUEST = "foreign", "error", "request"
_KINDS = (*NAMES.values(), FOREIGN, ERROR, REQUEST)
_SIGNS = {"us": "µs", "N.m": "N·m", "m/s2": "m/s²", "degC": "°C"}
_CAUSES_TOLD = 8
_TEXTS = "log with candump -L, or export it as .asc"
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
}
# How files begin that can be read under another extension.
_FORMS_OF_OURS = {b"LOGG": ".blf", b";$FILEVERSION": ".trc"}


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
        t_s: seconds after the first frame of the file; negative for one that was stamped earlier.
        unix_s: the file's own time stamp.
        channel: the bus as the file names it, such as ``can0`` or ``2``; None if it names none.
        direction: ``Tx`` or ``Rx``, as seen by the writer of the trace; ``Rx`` if the file does not say.
        kind: the name of a message of this project, ``foreign``, ``error`` or ``request``: a frame
            that was to be sent, and follows if it was.
        number: the identifier.
        extended: whether the identifier has 29 bits.
        payload: the data.
        message: the decoded message, or None if the frame is foreign or not valid.
        refusal: why it is not valid, or None.
    """

    t_s: float
    unix_s: float
    channel: str | None
    direction: str
    kind: str
    number: int
    extended: bool
    payload: bytes
    message: codec.Message | None
    refusal: str | None

    def text(self) -> str:
        """Return one line for a person."""
        return (
            f"{self.t_s:11.6f}  {self.channel or '-':<5}  {self.direction}  {self.kind:<18}  {self._content()}".rstrip()
        )

    def _content(self) -> str:
        if self.message is not None:
            return "  ".join(_signals(self.message))
        if self.kind == ERROR:
            error_class = f" {self.number:03X}" if self.number else ""
            details = f"{error_class} [{len(self.payload)}] {self.payload.hex(' ')}" if self.payload else ""
            return "error frame, or bytes that are no frame" + details
        identifier = f"{self.number:08X}" if self.extended else f"{self.number:03X}"
        text = f"{identifier} {self.refusal or ''}"
        return f"{text.strip()} [{len(self.payload)}] {self.payload.hex(' ')}"

    def record(self) -> dict[str, Any]:
        """Return the entry as a dict, for ``--json``."""
        record: dict[str, Any] = {
            "t_s": round(self.t_s, 9),
            "unix_s": self.unix_s,
            "channel": self.channel,
            "direction": self.direction,
            "message": self.kind,
            "sender": SENDERS.get(self.number) if self.kind in NAMES.values() else None,
            "id": self.number,
            "extended": self.extended,
            "payload": self.payload.hex(),
        }
        if self.message is not None:
            signals = self.message._asdict()
            names = {field: kind(signals[field]).name for field, kind in NAMED_VALUES.get(self.number, {}).items()}
            record |= {"signals": signals, "names": names}
        if self.refusal is not None:
            record["refusal"] = self.refusal
        return record


def _signals(message: codec.Message) -> Iterator[str]:
    units, names = UNITS.get(message.ID, {}), NAMED_VALUES.get(message.ID, {})
    for field, value in message._asdict().items():
        unit = units.get(field)
        if field in names:
            yield f"{field} {names[field](value).name}"
        else:
            yield f"{field} {value}" if unit is None else f"{field} {value} {_SIGNS.get(unit, unit)}"


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
        self._from_s, self._to_s = math.inf, -math.inf
        self._kinds: Counter[str] = Counter()
        self._channels: dict[str, None] = {}
        self.left_out: Counter[str] = Counter()
        self.frames = self.selected = 0
        self.trouble: str | None = None

    def __iter__(self) -> Iterator[Entry]:
        kinds, from_s, to_s, _, channels = self._selection
        for frame in self._frames():
            entry = self._entry(frame)
            self._kinds[entry.kind] += 1
            self._from_s, self._to_s = min(self._from_s, entry.t_s), max(self._to_s, entry.t_s)
            if entry.channel is not None:
                self._channels[entry.channel] = None
            is_there = not channels or entry.channel in channels
            if is_there and from_s <= entry.t_s <= to_s and (not kinds or entry.kind in kinds):
                self.selected += 1
                yield entry

    def contents(self) -> str:
        """Return in words what was read: how many frames, their channels and time, and kinds by frequency."""
        kinds = ", ".join(kind for kind, _ in self._kinds.most_common())
        where = f" on {', '.join(self._channels)}" if self._channels else ""
        return f"{self._path} has {self.frames} frames of {self._to_s - self._from_s:.3f} s{where}: {kinds}"

    def rest(self) -> str | None:
        """Return in words what is left out, the most frequent first; None if nothing is."""
        if not self.left_out:
            return None
        told = self.left_out.most_common(_CAUSES_TOLD)
        words = [f"{cause}: {count}" for cause, count in told]
        if more := self.left_out.total() - sum(count for _, count in told):
            words.append(f"{len(self.left_out) - len(told)} other kinds: {more}")
        return f"{self._path}: left out, not readable as CAN frames: {', '.join(words)}"

    def _frames(self) -> Iterator[TracedFrame]:
        try:
            for content in self._contents():
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

    def _contents(self) -> Iterator[TracedFrame | LeftOut]:
        if self._path.suffix.lower() in FORMS:
            return read_text(self._path)
        from hil.wire.trace.blf import read_blf

        return read_blf(self._path)

    def _other_form(self) -> str | None:
        with self._path.open("rb") as file:
            begin = file.read(32)
        for magic, suffix in _FORMS_OF_OURS.items():
            if begin.startswith(magic) and suffix != self._path.suffix.lower():
                return f"it is a {suffix} by its content; name it so"
        return next((why for magic, why in _FORMS_OF_OTHERS.items() if begin.startswith(magic)), None)

    def _break_off(self, why: str) -> None:
        self.trouble = f"{self._path}: {self.frames or 'no'} frames could be read; {why}"

    def _entry(self, traced: TracedFrame) -> Entry:
        if self._first_s is None:
            self._first_s = traced.unix_s
        frame = Frame(traced.number, traced.payload)
        kind, decoded, refusal = FOREIGN, None, None
        is_foreign = self._selection.raw or traced.channel in self.foreign
        if traced.is_error:
            kind = ERROR
        elif traced.is_request:
            kind = REQUEST
        elif traced.is_remote:
            refusal = "remote"
        elif not is_foreign and not traced.extended and frame.id in NAMES:
            kind = NAMES[frame.id]
            decoded = codec.decode(frame)
            refusal = None if decoded is not None else f"not valid: {codec.refusal(frame)}"
        return Entry(
            traced.unix_s - self._first_s,
            traced.unix_s,
            traced.channel,
            "Rx" if traced.is_rx else "Tx",
            kind,
            frame.id,
            traced.extended,
            frame.payload,
            decoded,
            refusal,
        )


def read(path: Path, selection: Selection) -> Reading:
    """Return an iterator over the frames of a trace file that ``selection`` asks for.

    No frame of a channel is decoded if it has no valid TICK and fewer valid messages of ours than other frames: other
    makers use the same identifiers. Raises BadInputError when the file cannot be opened or its extension is not one of
    ``READABLE``.
    """
    if path.suffix.lower() not in READABLE:
        raise BadInputError(f"{path}: unknown file extension{nearest(path.suffix.lower(), READABLE)}")
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}; expected a trace, one of {', '.join(READABLE)}") from error
    everything = Selection(frozenset(), -math.inf, math.inf)
    return Reading(path, selection, () if selection.raw else _foreign_channels(Reading(path, everything)))


def _foreign_channels(frames: Reading) -> frozenset[str | None]:
    """Return the channels whose frames are not ours: without a valid TICK, and most of them other frames."""
    ticking: set[str | None] = set()
    ours: Counter[str | None] = Counter()
    others: Counter[str | None] = Counter()
    for entry in frames:
        if entry.message is not None:
            ours[entry.channel] += 1
            if isinstance(entry.message, Tick):
                ticking.add(entry.channel)
        elif entry.kind not in (ERROR, REQUEST):
            others[entry.channel] += 1
    return frozenset(one for one in others if one not in ticking and 0 < ours[one] < others[one])


class Tally(NamedTuple):
    """Number of frames of a kind on a channel; ``per_s`` is their rate over the time of all, None if that is 0."""

    message: str
    id: int | None
    channel: str | None
    frames: int
    per_s: float | None

    def texts(self) -> tuple[str, str, str, str, str]:
        """Return the row of a table."""
        identifier = "" if self.id is None else f"{self.id:03X}"
        rate = "" if self.per_s is None else f"{self.per_s:.4g}"
        return self.message, identifier, str(self.frames), rate, self.channel or "-"


def count(entries: Iterable[Entry]) -> list[Tally]:
    """Return how often each kind occurs on each channel: ours by id, then foreign ones, errors and requests."""
    found: Counter[tuple[str, str | None]] = Counter()
    first_s, last_s = math.inf, -math.inf
    for entry in entries:
        found[entry.kind, entry.channel] += 1
        first_s, last_s = min(first_s, entry.t_s), max(last_s, entry.t_s)
    lasted_s = last_s - first_s
    ids = {name: number for number, name in NAMES.items()}
    in_order = sorted(found.items(), key=lambda one: (_KINDS.index(one[0][0]), one[0][1] or ""))
    return [
        Tally(kind, ids.get(kind), channel, frames, frames / lasted_s if lasted_s > 0 else None)
        for (kind, channel), frames in in_order
    ]
