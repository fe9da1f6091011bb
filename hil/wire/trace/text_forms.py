"""Reads traces of text, a line at a time: Vector's .asc, the .log of ``candump -L``, and PEAK's .trc.

Each line is a frame, a part of the header or footer, something that is left out and counted, or damage. python-can's
readers skip lines that they do not know, without a word.
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import ClassVar, Protocol

from hil.wire.trace.traced import (
    MOST_BYTES,
    MOST_CLASSIC_BYTES,
    MOST_EXTENDED,
    MOST_STANDARD,
    DamagedError,
    LeftOut,
    TracedFrame,
    length_of,
)


class _CutError(Exception):
    """The line may go on after its last character."""


class _ShortError(Exception):
    """The line has less data than it says."""


class _Form(Protocol):
    name: str
    """Of the form, in words."""

    def read(self, line: str, *, ended: bool) -> TracedFrame | LeftOut | None:
        """Return what is in a line; None for a part of the header or footer.

        A line that has not ``ended`` has no line feed. Raises ValueError or LookupError for what is not a line of this
        form, _ShortError for too few data, _CutError if a part of its frame may be missing, and DamagedError with a
        reason of its own.
        """
        ...

    def finish(self) -> None:
        """Raise DamagedError if the end of the file is missing."""
        ...


def read_text(path: Path) -> Iterator[TracedFrame | LeftOut]:
    """Yield the contents of a text trace. Raises DamagedError where it is cut or damaged."""
    form = FORMS[path.suffix.lower()]()
    with path.open("rb") as file:
        for number, raw in enumerate(file, 1):
            line, ended = raw.decode("utf-8", "replace").lstrip("\ufeff").strip(), raw.endswith(b"\n")
            if not line:
                continue
            try:
                content = form.read(line, ended=ended)
            except (_CutError, _ShortError, ValueError, LookupError) as error:
                why = f"line {number} is not a line of {form.name}; the file is damaged there, or has another form"
                if not ended and number > 1:
                    why = f"it is cut within line {number}, which is not read"
                elif isinstance(error, _ShortError):
                    why = f"line {number} says {error}, it is cut or damaged"
                raise DamagedError(why) from None
            if content is not None:
                yield content
    form.finish()


def _bytes(text: str, length: int, base: int = 16) -> bytes:
    """Return the first so many bytes of a text with a blank between them. Raises _ShortError if it has fewer."""
    found = text.split()[: max(0, length)]
    if length not in range(MOST_BYTES + 1) or any(len(one) > 3 or (base == 16 and len(one) != 2) for one in found):
        raise ValueError
    try:
        data = bytes(int(one, base) for one in found)
    except ValueError:
        data = b""
    if len(data) < length:
        raise _ShortError(f"{length} bytes and has {len(data)}")
    return data


_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_GERMAN = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}


class _Asc:
    """Vector's text: times count from a date in the header, or, with ``timestamps relative``, from the line before."""

    name = "Vector's .asc"
    _STAMP = r"(?P<t>-?\d{1,15}\.\d{1,15})\s+"
    _CLASSIC = re.compile(
        _STAMP + r"(?P<channel>\d+)\s+(?P<id>\S+)\s+(?P<dir>[TR]x\w*)\s+(?P<kind>[dr])(?:\s+(?P<code>[\da-f]+))?"
        r"(?P<data>(?:\s.*)?)",
        re.IGNORECASE | re.ASCII,
    )
    _FD = re.compile(
        _STAMP + r"CANFD\s+(?P<channel>\d+)\s+(?P<dir>[TR]x\w*)\s+(?P<id>\S+)(?:\s+[a-z_]\w*)?\s+[01]\s+[01]\s+"
        r"(?P<code>[\da-f]+)\s+(?P<length>\d+)(?P<data>(?:\s.*)?)",
        re.IGNORECASE | re.ASCII,
    )
    _ERROR = re.compile(
        _STAMP + r"(?:CANFD\s+)?(?P<channel>\d+)\s+(?:(?P<dir>[TR]x)\s+)?ErrorFrame\b.*", re.IGNORECASE | re.ASCII
    )
    # Something that happened on a bus (by its number) or elsewhere; a word that is an identifier is of a frame.
    _EVENT = re.compile(
        _STAMP + r"(?:(?:CAN|CANFD)\s+)?(?:\d+\s+(?![\da-f]+x?\s))?(?P<word>(?!(?:[TR]x|CANFD)\b)[a-z]\w*)(?P<rest>.*)",
        re.IGNORECASE | re.ASCII,
    )
    _MARKER = re.compile(_STAMP + r"(?:\d+\s+)+GMGroup:.*", re.ASCII)
    _HEAD = re.compile(r"//|(?:date|base|version|previous log|(?:no\s+)?internal\s+events)\b", re.IGNORECASE)
    _BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
    _DATE = re.compile(
        r"(?:date|begin\s+triggerblock)\s+\w+\s+(\w+)\s+(\d+)\s+(\d+):(\d+):(\d+)(\.\d+)?\s*([ap]m)?\s+(\d+)",
        re.IGNORECASE,
    )
    _FLAGS = re.compile(r"[\da-f]{1,8}", re.IGNORECASE | re.ASCII)
    _BEGIN, _END = (re.compile(rf"{word}\s+triggerblock\b", re.IGNORECASE) for word in ("begin", "end"))

    def __init__(self) -> None:
        self._base = 16
        self._is_relative = self._is_open = False
        self._start_s = self._last_s = 0.0

    def read(self, line: str, *, ended: bool) -> TracedFrame | LeftOut | None:
        if (found := self._CLASSIC.fullmatch(line) or self._FD.fullmatch(line)) is not None:
            return self._frame(found, ended=ended)
        if (found := self._ERROR.fullmatch(line)) is not None:
            is_rx = (found["dir"] or "rx").lower() == "rx"
            return TracedFrame(self._unix_s(found), found["channel"], is_rx, 0, False, b"", is_error=True)
        if (found := self._EVENT.fullmatch(line)) is not None:
            self._unix_s(found)
            is_start = found["word"].lower() == "start" and found["rest"].strip().lower() == "of measurement"
            return None if is_start else LeftOut(f"{found['word']} lines")
        if (found := self._MARKER.fullmatch(line)) is not None:
            self._unix_s(found)
            return LeftOut("markers")
        if self._END.match(line):
            self._is_open = False
            return None
        if not ended:
            raise _CutError
        self._header(line)
        return None

    def finish(self) -> None:
        if self._is_open:
            raise DamagedError("it is cut, or was not finished: its last line is not End TriggerBlock")

    def _unix_s(self, found: re.Match[str]) -> float:
        self._last_s = float(found["t"]) + (self._last_s if self._is_relative else 0.0)
        return self._start_s + self._last_s

    def _frame(self, found: re.Match[str], *, ended: bool) -> TracedFrame | LeftOut:
        parts = found.groupdict()
        unix_s = self._unix_s(found)
        name = parts["id"].lower()
        if name != "0x":  # the extended identifier 0
            name = name.removeprefix("0x")
        if re.fullmatch(r"[\da-f]+x?" if self._base == 16 else r"\d+x?", name) is None:
            if re.fullmatch(r"[a-z_]\w*", name, re.ASCII) is None:
                raise ValueError
            return LeftOut("frames with a name in place of their identifier (log numbers)")
        number = int(name.removesuffix("x"), self._base)
        direction = parts["dir"].lower()
        if number > MOST_EXTENDED or direction not in ("rx", "tx", "txrq"):
            raise ValueError
        if "length" in parts:
            length = int(parts["length"])
            flags = parts["data"].split()[length + 2 : length + 3]
            is_request = flags and self._FLAGS.fullmatch(flags[0]) is not None and int(flags[0], 16) & 0x10
            is_remote = bool(is_request) or (length == 0 < int(parts["code"], 16))
        else:
            if parts["code"] is None and parts["kind"].lower() == "d":
                raise ValueError
            length = length_of(int(parts["code"] or "0", self._base), fd=False)
            is_remote = parts["kind"].lower() == "r"
        data = b"" if is_remote else _bytes(parts["data"], length, self._base)
        last = parts["data"].split()[length - 1 :] if data else []
        if not ended and self._base == 10 and len(last) == 1 and len(last[0]) < 3:
            raise _CutError
        extended = name.endswith("x") or number > MOST_STANDARD
        is_rx, is_request = direction == "rx", direction == "txrq"
        return TracedFrame(
            unix_s, parts["channel"], is_rx, number, extended, data, is_remote=is_remote, is_request=is_request
        )

    def _header(self, line: str) -> None:
        begins = self._BEGIN.match(line) is not None
        self._is_open = self._is_open or begins
        if (found := self._BASE.match(line)) is not None:
            self._base = 10 if found[1].lower() == "dec" else 16
            self._is_relative = (found[2] or "").lower() == "relative"
        elif (found := self._DATE.match(line)) is not None:
            month, day, hour, minute, second, fraction, half, year = found.groups()
            month = month[:3].lower()
            hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
            with contextlib.suppress(ValueError, OverflowError):  # in a language that is not known
                number = _MONTHS.index(_GERMAN.get(month, month)) + 1
                start = datetime(int(year), number, int(day), hours, int(minute), int(second))  # noqa: DTZ001 -- local
                self._start_s = start.timestamp() + float(fraction or 0)
        elif not begins and self._HEAD.match(line) is None:
            raise ValueError


class _Candump:
    """A line of ``candump -L``, also with its options -8, -e and -x."""

    name = "a log of candump -L"
    _LINE = re.compile(
        r"\((?P<t>\d{1,15}\.\d{1,15})\)\s+(?P<channel>\S+)\s+(?P<id>[\da-f]{3}|[0-3][\da-f]{7})"
        r"#(?:(?P<remote>r[\da-f]?)|(?P<fd>\#[\da-f])?(?P<data>(?:[\da-f]{2}){,64}))(?P<code>_[\da-f])?(?:\s+(?P<dir>[rt]))?",
        re.IGNORECASE | re.ASCII,
    )
    _XL = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[\da-f]+#[\da-f]+:[\da-f:]+#[\da-f]*(?:\s+[rt])?", re.IGNORECASE | re.ASCII)
    _SCREEN = re.compile(
        r"(?:\([^)]*\)\s+)?\S+\s+(?:[TR]X(?:\s+\S){2}\s+)?[\da-f]{3,8}\s+\[\d+\]", re.IGNORECASE | re.ASCII
    )
    _ERROR_FLAG = 0x20000000

    def read(self, line: str, *, ended: bool) -> TracedFrame | LeftOut | None:
        found = self._LINE.fullmatch(line)
        if found is None:
            if self._SCREEN.match(line):
                raise DamagedError("it is of the form that candump prints on the screen; log with candump -L")
            if self._XL.fullmatch(line):
                return LeftOut("CAN XL frames")
            raise ValueError
        stamp, channel, name, remote, fd, digits, code, direction = found.groups()
        number, data = int(name, 16), bytes.fromhex(digits or "")
        most = MOST_BYTES if fd else MOST_CLASSIC_BYTES
        if len(data) > most:
            raise ValueError
        if not (ended or direction or code or remote) and len(data) < most:
            raise _CutError
        is_rx, is_error = (direction or "r").lower() == "r", len(name) == 8 and bool(number & self._ERROR_FLAG)
        number &= MOST_EXTENDED
        extended = len(name) == 8 and not is_error
        return TracedFrame(float(stamp), channel, is_rx, number, extended, data, remote is not None, is_error)

    def finish(self) -> None:
        pass


class _Trc:
    """PEAK's rows, whose columns follow from the file's version, or are named in its header from version 2 on."""

    name = "PEAK's .trc"
    _COLUMNS: ClassVar = {"1.0": "NOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD"}
    _ROW = re.compile(r"\d+\)?\s+-?\d{1,15}(?:\.\d{1,15})?\s+\S.*", re.ASCII)
    _TYPE = re.compile(r"[a-z][a-z0-9]{1,7}", re.IGNORECASE | re.ASCII)
    _LAST_BYTES = re.compile(r"(?:\s[\da-f]{2})+$", re.IGNORECASE | re.ASCII)
    _WARNING = "FFFFFFFF"

    def __init__(self) -> None:
        self._columns = list(self._COLUMNS["1.0"])
        self._start_s = 0.0

    def read(self, line: str, *, ended: bool) -> TracedFrame | LeftOut | None:
        if line.startswith(";"):
            self._comment(line)
            return None
        if self._ROW.fullmatch(line) is None:
            raise ValueError
        row = dict(zip(self._columns, line.split(maxsplit=len(self._columns) - 1), strict=False))
        kind, data = row.get("T", "Rx"), row.get("D", "")
        unix_s = self._start_s + float(row["O"]) / 1000
        if kind in ("Error", "ER") or data.startswith("ERROR"):
            details = self._LAST_BYTES.search(line)
            return TracedFrame(
                unix_s, row.get("B"), True, 0, False, bytes.fromhex(details[0] if details else ""), is_error=True
            )
        if kind not in ("Rx", "Tx", "DT", "RR", "FD", "FB", "FE", "BI"):
            if self._TYPE.fullmatch(kind) is None:
                raise ValueError
            return LeftOut(f"{kind} rows")
        if row["I"] == self._WARNING:
            return LeftOut("warnings")
        number, extended = int(row["I"], 16), len(row["I"]) > 4
        if number > (MOST_EXTENDED if extended else MOST_STANDARD):
            raise ValueError
        is_rx = row.get("d", kind) != "Tx"
        length = int(row["l"]) if "l" in row else length_of(int(row["L"]), fd=kind in ("FD", "FB", "FE", "BI"))
        is_remote = kind == "RR" or data.startswith("RTR")
        payload = b"" if is_remote else _bytes(data, length)
        return TracedFrame(unix_s, row.get("B"), is_rx, number, extended, payload, is_remote)

    def finish(self) -> None:
        pass

    def _comment(self, line: str) -> None:
        name, _, value = line.partition("=")
        if name == ";$FILEVERSION":
            version = value.strip()
            if version not in self._COLUMNS and not version.startswith("2."):
                raise DamagedError(f"version {version} of .trc is not known; save it as 2.1 or older")
            self._columns = list(self._COLUMNS.get(version, self._columns))
        elif name == ";$STARTTIME":
            with contextlib.suppress(ValueError, OverflowError):  # other tools write a date
                days = timedelta(days=float(value.rstrip("; ")))
                self._start_s = (datetime(1899, 12, 30, tzinfo=UTC) + days).timestamp()
        elif name == ";$COLUMNS":
            self._columns = [column.strip() for column in value.split(",")]


FORMS: dict[str, Callable[[], _Form]] = {".asc": _Asc, ".log": _Candump, ".trc": _Trc}
"""The reader of each form by the extension of its files."""
