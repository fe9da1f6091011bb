"""Reads a user's DBC file with cantools, and keeps its messages as plain data."""

import logging
import math
import struct
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil.core.errors import nearest
from hil.core.extras import need
from hil.robot.driver import EXTENDED, clamp

_CLASSIC_BYTES = 8
_MOST_BYTES = 32_000_000
"""Of a file. cantools reads a megabyte a second; those of whole cars have up to eight."""
_REMEDIES = {
    "more than 11 bits": "; a DBC has 2147483648 added to an identifier of 29 bits",
    "unused ": "; remove these lines",
}
_LONGEST_MS = 86_400_000
_FLOATS = {16: "<e", 32: "<f", 64: "<d"}
_FLOAT_HIGHEST = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}


class Signal:
    """A signal of a DBC. Its value in its ``unit`` is ``factor`` × raw + ``offset``.

    ``low`` and ``high``: raw limits, from the DBC's minimum and maximum and from the number of bits. ``has_limits``:
    whether the DBC's are the narrower ones. ``texts``: the value table. ``initial``: the raw value sent by default: the
    DBC's start value, or zero in the signal's unit; None if it has neither.
    """

    def __init__(self, message: str, signal: Any) -> None:
        conversion = signal.conversion
        self.message = message
        self.name: str = signal.name
        self.unit: str = signal.unit or ""
        self.is_float: bool = conversion.is_float
        self.factor: float = conversion.scale
        self.offset: float = conversion.offset
        low, high = _limits_of_bits(signal)
        choices = (conversion.choices or {}).items()
        self.texts: dict[float, str] = {int(raw): str(text) for raw, text in choices if low <= raw <= high}
        self.low, self.high = self._limits(signal, low, high)
        self.has_limits = (self.low, self.high) != (low, high)
        self._float = struct.Struct(_FLOATS[signal.length]) if self.is_float else None
        self.initial: float | None = None
        if (given := signal.raw_initial) is not None and math.isfinite(given):
            initial = clamp(given, high, low)
            self.initial = initial if self.is_float else int(initial)
        else:
            with suppress(ValueError):
                self.initial = self.raw(0)

    def _limits(self, signal: Any, low: float, high: float) -> tuple[float, float]:
        """Return the raw limits: the DBC's minimum and maximum if it has both, within ``low`` and ``high``."""
        given = [one for one in (signal.minimum, signal.maximum) if one is not None and math.isfinite(one)]
        if len(given) == 2:
            least, most = sorted((limit - self.offset) / self.factor for limit in given)
            if not self.is_float:  # move a limit between two steps inwards, with a tolerance for rounding
                least, most = (clamp(raw, high + 1, low - 1) for raw in (least, most))  # no integer equals infinity
                least, most = math.ceil(least - 1e-6), math.floor(most + 1e-6)
            if max(low, least) <= min(high, most):  # ignore limits outside the range of the bits
                return max(low, least), min(high, most)
        return low, high

    def __str__(self) -> str:
        return f"{self.message}.{self.name}"

    def raws(self, value: object) -> list[float]:
        """Return the raw numbers of a value: of a number in the signal's unit, or of a text of its value table.

        Only a text may have several. Raises ValueError if the signal cannot carry it; the sentence continues after the
        signal's name.
        """
        if not isinstance(value, str):
            return [self.raw(value)]
        if not (found := [number for number, text in self.texts.items() if text == value]):
            known = nearest(value, self.texts.values()) or "; its DBC has no value table for it, give a number"
            raise ValueError(f"no value of this signal has this text{known}")
        return found

    def raw(self, value: object) -> float:
        """Return the one raw number of a value, to be sent. Raises ValueError as ``raws`` does, and for several."""
        if isinstance(value, str):
            number, *others = self.raws(value)
            if others:
                numbers = " and ".join(f"{self.physical(one):g}" for one in (number, *others))
                raise ValueError(f"this text stands for {numbers}; give one of these numbers")
            return number
        if not isinstance(value, bool | int | float) or not abs(value) <= _FLOAT_HIGHEST[64]:
            raise ValueError("expected a finite number or a text of the signal's value table")
        exact = (value - self.offset) / self.factor
        raw = exact if self.is_float or not math.isfinite(exact) else round(exact)
        if not math.isclose(raw, exact, rel_tol=1e-9, abs_tol=1e-6):
            raise ValueError(f"the signal has steps of {self.factor:g}; the nearest is {self.physical(raw):.9g}")
        if raw not in self.texts and not self.low <= raw <= self.high:
            raise ValueError(f"outside the signal's limits, {self.limits()}")
        # Rounded as the bits hold it, so that it equals the one that is received.
        return raw if self._float is None else float(self._float.unpack(self._float.pack(raw))[0])

    def physical(self, raw: float) -> float:
        """Return a raw number in the signal's unit."""
        return self.factor * raw + self.offset

    def limits(self) -> str:
        """Return the signal's limits in words, in its own unit."""
        lowest, highest = sorted((self.physical(self.low), self.physical(self.high)))
        return f"{lowest:g} to {highest:g} {self.unit}".rstrip()

    def word(self, raw: float) -> str:
        """Return the text of a raw number in the value table, or else its value in the signal's unit."""
        text = self.texts.get(raw)
        return f"{self.physical(raw):g}" if text is None else repr(text)


class Message:
    """A message of a DBC. ``id``: as in ``Frame.id``. ``period_s``: None if the DBC has no cycle time.

    ``codec``: the message of cantools, which packs and unpacks it.
    """

    def __init__(self, codec: Any) -> None:
        self.codec = codec
        self.name: str = codec.name
        self.id: int = codec.frame_id | (EXTENDED if codec.is_extended_frame else 0)
        self.length: int = codec.length
        self.period_s: float | None = codec.cycle_time / 1000.0 if codec.cycle_time else None
        self.signals = {signal.name: Signal(codec.name, signal) for signal in codec.signals}

    def __str__(self) -> str:
        return f"{self.name} ({self.id & ~EXTENDED:#x})"


class Dbc:
    """A DBC file with the name ``name``. Each message is checked when it is first used."""

    def __init__(self, name: str, database: Any) -> None:
        self.name = name
        self._found = {message.name: message for message in database.messages}
        self._numbers = [(message.name, message.frame_id) for message in database.messages]
        self._messages: dict[str, Message] = {}

    def message(self, name: str) -> Message:
        """Return a message.

        Raises ValueError if there is none of this name or more than one, or if this driver does not support it.
        """
        if name not in self._messages:
            if name not in self._found:
                raise ValueError(f"{self.name} has no message {name!r}{nearest(name, self._found)}")
            message = self._found[name]
            if len(numbers := [f"{number:#x}" for one, number in self._numbers if one == name]) > 1:
                raise ValueError(f"{self.name} has {name!r} {len(numbers)} times, {' and '.join(numbers)}; rename one")
            if (refusal := _refusal(message)) is not None:
                raise ValueError(f"the message {name} of {self.name} {refusal}")
            self._messages[name] = Message(message)
        return self._messages[name]

    def messages(self, names: Iterable[str]) -> dict[str, Message]:
        """Return messages by name, each once."""
        return {name: self.message(name) for name in names}

    def signal(self, spec: object) -> Signal:
        """Return the signal of ``MESSAGE.Signal``. Raises ValueError when there is none."""
        message, _, name = spec.partition(".") if isinstance(spec, str) else ("", "", "")
        if not (message and name):
            raise ValueError('expected a signal of the DBC as text, such as "DRIVE_FL.TargetSpeed"')
        signals = self.message(message).signals
        if name not in signals:
            raise ValueError(f"the message {message} of {self.name} has no signal {name!r}{nearest(name, signals)}")
        return signals[name]


def load(file: str) -> Dbc:
    """Return a DBC file, parsed. Raises ValueError if it is missing, unreadable or no DBC, or without cantools."""
    try:
        with Path(file).open("rb") as opened:
            data = opened.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        raise ValueError(f"file = {file!r}: there is no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        raise ValueError(f"file = {file!r} cannot be read: {error}") from error
    if len(data) > _MOST_BYTES:
        raise ValueError(
            f"file = {file!r} has more than {_MOST_BYTES / 1e6:.0f} MB, which takes long to read; give one that has "
            "only the messages named here"
        )
    return _parse(file, data)


@lru_cache(maxsize=8)  # a scenario is checked, then run: a maker's DBC may take a second to parse
def _parse(file: str, data: bytes) -> Dbc:
    need("dbc", "a DBC file")
    import cantools  # not at the top: its import takes 0.2 s

    # It warns of names and identifiers that are there twice. Those that a mapping uses are refused.
    logging.getLogger("cantools").setLevel(logging.ERROR)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")  # what the format's own tools write
    try:
        # Not strict: an error in a message that is not used does not matter.
        return Dbc(Path(file).name, cantools.database.load_string(text, database_format="dbc", strict=False))
    except cantools.Error as error:
        remedy = next((words for part, words in _REMEDIES.items() if part in str(error)), "")
        raise ValueError(f"file = {file!r} is no DBC that can be read: {_one_line(error)}{remedy}") from error


def _refusal(message: Any) -> str | None:
    import cantools

    if message.is_fd or message.length > _CLASSIC_BYTES:
        return f"has {message.length} bytes and is for CAN FD; this driver speaks classic CAN, of up to 8 bytes"
    if message.is_multiplexed():
        return "is multiplexed; this driver takes messages whose signals are the same in every frame"
    cycle_time = message.cycle_time
    if cycle_time and not (isinstance(cycle_time, int | float) and 0 < cycle_time <= _LONGEST_MS):
        return f"has a cycle time (GenMsgCycleTime) of {cycle_time!r}; expected milliseconds, correct the DBC"
    for signal in message.signals:
        scale, offset = signal.conversion.scale, signal.conversion.offset
        if scale == 0 or not math.isfinite(scale) or not math.isfinite(offset):
            return f"has in {signal.name} a factor or an offset that is no number, or a factor of 0; correct the DBC"
        if signal.conversion.is_float and signal.length not in _FLOATS:
            return f"has in {signal.name} a float of {signal.length} bits; expected 16, 32 or 64, correct the DBC"
    try:
        message.refresh(strict=True)
    except cantools.Error as error:
        return f"cannot be coded: {_one_line(error)}"
    return None


def _limits_of_bits(signal: Any) -> tuple[float, float]:
    if signal.conversion.is_float:
        return -_FLOAT_HIGHEST[signal.length], _FLOAT_HIGHEST[signal.length]
    high = (1 << signal.length - signal.is_signed) - 1
    return (-high - 1 if signal.is_signed else 0), high


def _one_line(error: Exception) -> str:
    words = "".join(one if one.isprintable() else "?" for one in " ".join(str(error).split()))
    return (words or type(error).__name__)[:200]
