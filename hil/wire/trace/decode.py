"""Reads a trace and decodes its frames by the wheel-command protocol, whichever tool wrote the file."""

import logging
import math
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import NAMED_VALUES, NAMES, SENDERS, UNITS, Tick
from hil.core.errors import BadInputError, nearest
from hil.wire.trace import damage

READABLE = (".blf", ".asc", ".log", ".trc")
"""Extensions of the files that can be read: Vector's two, that of ``candump -L``, and PEAK's."""

FOREIGN, ERROR = "foreign", "error"
_KINDS = (*NAMES.values(), FOREIGN, ERROR)
_SIGNS = {"us": "µs", "N.m": "N·m", "m/s2": "m/s²", "degC": "°C"}
# What python-can's readers raise for a file that is cut, damaged, or of another format.
_BROKEN = (ValueError, LookupError, struct.error, zlib.error, EOFError, ArithmeticError, AssertionError)


class Selection(NamedTuple):
    """Which frames are wanted: by kind (empty: all), and by seconds after the first frame, both ends included.

    ``raw``: do not decode frames. Third-party motor controllers use the same identifiers as this project's messages,
    and an identifier does not tell whose frame it is.
    """

    kinds: frozenset[str]
    from_s: float
    to_s: float
    raw: bool = False

    @classmethod
    def of(cls, names: Collection[str], from_s: float, to_s: float, *, raw: bool = False) -> Self:
        """Return the selection. Raises BadInputError for a name that is no message, and for an empty time range."""
        if raw and names:
            raise BadInputError(f"--message {next(iter(names))!r} with --raw: raw frames have no names; leave one out")
        by_name = {kind.casefold(): kind for kind in _KINDS}
        for name in names:
            if name.casefold() not in by_name:
                raise BadInputError(f"--message {name!r}: there is no such message{nearest(name.upper(), _KINDS)}")
        if not from_s <= to_s:
            raise BadInputError(f"--from {from_s:g} --to {to_s:g}: expected the first not to be later than the second")
        return cls(frozenset(by_name[name.casefold()] for name in names), from_s, to_s, raw)


class Entry(NamedTuple):
    """One frame of a trace.

    Attributes:
        t_s: seconds after the first frame of the file.
        unix_s: the file's own time stamp.
        direction: ``Tx`` or ``Rx``, as seen by the writer of the trace; ``Rx`` if the file does not say.
        kind: the name of a message of this project, ``foreign`` or ``error``.
        number: the identifier.
        extended: whether the identifier has 29 bits.
        payload: the data.
        message: the decoded message, or None if the frame is foreign or not valid.
        refusal: why it is not valid, or None.
    """

    t_s: float
    unix_s: float
    direction: str
    kind: str
    number: int
    extended: bool
    payload: bytes
    message: codec.Message | None
    refusal: str | None

    def text(self) -> str:
        """Return one line for a person."""
        return f"{self.t_s:11.6f}  {self.direction}  {self.kind:<18}  {self._content()}".rstrip()

    def _content(self) -> str:
        if self.message is not None:
            return "  ".join(_signals(self.message))
        if self.kind == ERROR:
            return "error frame, or bytes that are no frame"
        identifier = f"{self.number:08X}" if self.extended else f"{self.number:03X}"
        text = f"{identifier} {self.refusal or ''}"
        return f"{text.strip()} [{len(self.payload)}] {self.payload.hex(' ')}"

    def record(self) -> dict[str, Any]:
        """Return the entry as a dict, for ``--json``."""
        record: dict[str, Any] = {
            "t_s": round(self.t_s, 9),
            "unix_s": self.unix_s,
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

    If reading stopped early, ``trouble`` then says where and why. ``is_ours`` is false when the frames are taken for
    those of another maker's motors: then none is decoded.
    """

    def __init__(self, path: Path, selection: Selection) -> None:
        self._path = path
        self._selection = selection
        self._first_s: float | None = None
        self._kinds: Counter[str] = Counter()
        self._last_s = 0.0
        self.frames = self.selected = 0
        self.trouble: str | None = None
        self.is_ours = True

    def __iter__(self) -> Iterator[Entry]:
        kinds, from_s, to_s, _ = self._selection
        for message in self._messages():
            entry = self._entry(message)
            self._kinds[entry.kind] += 1
            self._last_s = entry.t_s
            if from_s <= entry.t_s <= to_s and (not kinds or entry.kind in kinds):
                self.selected += 1
                yield entry

    def contents(self) -> str:
        """Return in words what was read: how many frames, of what time, and their kinds, the most frequent first."""
        kinds = ", ".join(kind for kind, _ in self._kinds.most_common())
        return f"{self._path} has {self.frames} frames of {self._last_s:.3f} s: {kinds}"

    def _messages(self) -> Iterator[Any]:
        from can.io.blf import BLFParseError

        # python-can's log about a bad file is not shown; ``trouble`` says it.
        logging.getLogger("can").addHandler(logging.NullHandler())
        try:
            yield from self._binary() if self._path.suffix.lower() == ".blf" else self._text()
        except damage.DamagedError as broken:
            self._break_off(str(broken))
        except (*_BROKEN, BLFParseError):
            self._break_off("the rest cannot be read, it is cut or damaged")
        else:
            if not self.frames:
                self._break_off(f"it is not a {self._path.suffix} file, or it is empty")

    def _text(self) -> Iterator[Any]:
        import can

        ending = self._path.suffix.lower()
        # Vector's text format has seconds since its start, whose time is in its header.
        readers: dict[str, Any] = {
            ".asc": partial(can.ASCReader, relative_timestamp=False),
            ".log": can.CanutilsLogReader,
            ".trc": can.TRCReader,
        }
        with self._path.open("rb") as file:
            for message in readers[ending](damage.sound_lines(file, ending)):
                damage.check_length(message)
                self.frames += 1
                yield message

    def _binary(self) -> Iterator[Any]:
        import can
        from can.io.blf import BLFParseError

        with can.BLFReader(self._path) as reader:
            try:
                for message in reader:
                    self.frames += 1
                    yield message
            except (*_BROKEN, BLFParseError):
                damage.check_blocks(self._path)
                raise
            damage.check_blocks(self._path)
            if reader.file_size != self._path.stat().st_size:  # its size when it was finished
                raise damage.DamagedError("it was not finished, or is cut")

    def _break_off(self, why: str) -> None:
        self.trouble = f"{self._path}: {self.frames or 'no'} frames could be read; {why}"

    def _entry(self, message: Any) -> Entry:
        if self._first_s is None:
            self._first_s = message.timestamp
        frame = Frame(message.arbitration_id, bytes(message.data))
        kind, decoded, refusal = FOREIGN, None, None
        if message.is_error_frame:
            kind = ERROR
        elif message.is_remote_frame:
            refusal = "remote"
        elif not self._selection.raw and not message.is_extended_id and frame.id in NAMES:
            kind = NAMES[frame.id]
            decoded = codec.decode(frame)
            refusal = None if decoded is not None else f"not valid: {codec.refusal(frame)}"
        return Entry(
            message.timestamp - self._first_s,
            message.timestamp,
            "Rx" if message.is_rx else "Tx",
            kind,
            frame.id,
            message.is_extended_id,
            frame.payload,
            decoded,
            refusal,
        )


def read(path: Path, selection: Selection) -> Reading:
    """Return an iterator over the frames of a trace file that ``selection`` asks for.

    No frame is decoded if the file has no valid TICK and fewer valid messages of ours than other frames: other makers
    use the same identifiers. Raises BadInputError when the file cannot be opened or its extension is not one of
    ``READABLE``.
    """
    if path.suffix.lower() not in READABLE:
        raise BadInputError(f"{path}: unknown file extension{nearest(path.suffix.lower(), READABLE)}")
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}; expected a trace, one of {', '.join(READABLE)}") from error
    is_ours = selection.raw or _is_ours(Reading(path, Selection(frozenset(), 0.0, math.inf)))
    reading = Reading(path, selection if is_ours else selection._replace(raw=True))
    reading.is_ours = is_ours
    return reading


def _is_ours(frames: Reading) -> bool:
    """Return whether frames are ours: at the first TICK that is valid, and without one by what most of them are."""
    ours = others = 0
    for entry in frames:
        if isinstance(entry.message, Tick):
            return True
        ours += entry.message is not None
        others += entry.message is None and entry.kind != ERROR
    return ours >= others or ours == 0


class Tally(NamedTuple):
    """Number of frames of a kind; ``per_s`` is their rate from the trace's first to its last frame, None for one."""

    message: str
    id: int | None
    frames: int
    per_s: float | None

    def texts(self) -> tuple[str, str, str, str]:
        """Return the row of a table."""
        identifier = "" if self.id is None else f"{self.id:03X}"
        return self.message, identifier, str(self.frames), "" if self.per_s is None else f"{self.per_s:.4g}"


def count(entries: Iterable[Entry]) -> list[Tally]:
    """Return how often each kind occurs: our messages by id, then foreign frames and errors."""
    found: Counter[str] = Counter()
    first_s, last_s = math.inf, -math.inf
    for entry in entries:
        found[entry.kind] += 1
        first_s, last_s = min(first_s, entry.t_s), max(last_s, entry.t_s)
    lasted_s = last_s - first_s
    ids = {name: number for number, name in NAMES.items()}
    return [
        Tally(kind, ids.get(kind), found[kind], found[kind] / lasted_s if lasted_s > 0 else None)
        for kind in _KINDS
        if found[kind]
    ]
