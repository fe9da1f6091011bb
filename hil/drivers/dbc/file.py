"""Reads a user's DBC file with cantools, and keeps its messages as plain data."""

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import nearest
from hil.drivers.port import EXTENDED, clamp

_CLASSIC_BYTES = 8
_FLOAT_HIGHEST = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}


class Signal(NamedTuple):
    """A signal of a DBC. Its value in its ``unit`` is ``factor`` × raw + ``offset``.

    ``low`` and ``high``: raw limits, from the DBC's minimum and maximum and from the number of bits. ``texts``: the
    value table. ``initial``: raw value where nothing else is given.
    """

    message: str
    name: str
    is_float: bool
    factor: float
    offset: float
    low: float
    high: float
    unit: str
    texts: Mapping[int, str]
    initial: float

    def __str__(self) -> str:
        return f"{self.message}.{self.name}"

    def raw(self, value: object) -> float:
        """Return the raw number of a value: a number in the signal's unit, or a text of its value table.

        Raises ValueError if the signal cannot carry it; the sentence continues after the signal's name.
        """
        if isinstance(value, str):
            for number, text in self.texts.items():
                if text == value:
                    return number
            known = nearest(value, self.texts.values()) or "; its DBC has no value table for it, give a number"
            raise ValueError(f"no value of this signal has this text{known}")
        if not isinstance(value, bool | int | float) or not abs(value) <= _FLOAT_HIGHEST[64]:
            raise ValueError("expected a finite number or a text of the signal's value table")
        exact = raw = (value - self.offset) / self.factor
        if not self.is_float:
            raw = round(exact)
            if not math.isclose(raw, exact, rel_tol=1e-9, abs_tol=1e-6):
                raise ValueError(f"the signal has steps of {self.factor:g}; the nearest is {self.physical(raw):.9g}")
        if raw not in self.texts and not self.low <= raw <= self.high:
            raise ValueError(f"outside the signal's limits, {self.limits()}")
        return raw

    def physical(self, raw: float) -> float:
        """Return a raw number in the signal's unit."""
        return self.factor * raw + self.offset

    def limits(self) -> str:
        """Return the signal's limits in words, in its own unit."""
        lowest, highest = sorted((self.physical(self.low), self.physical(self.high)))
        return f"{lowest:g} to {highest:g} {self.unit}".rstrip()

    def word(self, raw: float) -> str:
        """Return the text of a raw number in the value table, or else its value in the signal's unit."""
        text = self.texts.get(int(raw)) if math.isfinite(raw) else None
        return f"{self.physical(raw):g}" if text is None else repr(text)


class Message(NamedTuple):
    """A message of a DBC. ``id``: as in ``Frame.id``. ``period_s``: None if the DBC has no cycle time.

    ``codec``: the message of cantools, which packs and unpacks it.
    """

    name: str
    id: int
    length: int
    period_s: float | None
    signals: Mapping[str, Signal]
    codec: Any


class Dbc:
    """A DBC file with the name ``name``. Each message is checked when it is first used."""

    def __init__(self, name: str, database: Any) -> None:
        self.name = name
        self._there = {message.name: message for message in database.messages}
        self._messages: dict[str, Message] = {}

    def message(self, name: str) -> Message:
        """Return a message.

        Raises ValueError if there is none of this name, if classic CAN cannot carry it, or if it is multiplexed.
        """
        if name not in self._messages:
            if name not in self._there:
                raise ValueError(f"{self.name} has no message {name!r}{nearest(name, self._there)}")
            message = self._there[name]
            if (refusal := _refusal(message)) is not None:
                raise ValueError(f"the message {name} of {self.name} {refusal}")
            self._messages[name] = _message(message)
        return self._messages[name]

    def signal(self, spec: object) -> Signal:
        """Return the signal of ``MESSAGE.Signal``. Raises ValueError when there is none."""
        name, dot, signal = spec.partition(".") if isinstance(spec, str) else ("", "", "")
        if not (name and dot and signal):
            raise ValueError('expected a signal of the DBC as text, such as "DRIVE_FL.TargetSpeed"')
        return self.signal_of(name, signal)

    def signal_of(self, message: str, name: str) -> Signal:
        """Return a message's signal. Raises ValueError when there is none."""
        signals = self.message(message).signals
        if name not in signals:
            raise ValueError(f"the message {message} of {self.name} has no signal {name!r}{nearest(name, signals)}")
        return signals[name]


def load(file: str) -> Dbc:
    """Return a DBC file, parsed. Raises ValueError if it is missing, unreadable or no DBC, or without cantools."""
    path = Path(file)
    try:
        status = path.stat()
    except FileNotFoundError:
        raise ValueError(f"file = {file!r}: there is no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        raise ValueError(f"file = {file!r} cannot be read: {error}") from error
    return _load(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)  # a scenario is checked, then run: a maker's DBC may take a second to parse
def _load(path: Path, _changed_ns: int, _size: int) -> Dbc:
    return Dbc(path.name, parse(path))


def parse(path: Path) -> Any:
    """Return cantools' database of a DBC file. Raises ValueError if it is unreadable or no DBC, or without cantools."""
    try:
        import cantools  # not at the top: it is an optional package, and its import takes 0.2 s
    except ImportError as error:
        raise ValueError(
            f"cantools, which reads DBC files, is not installed ({error}); pip install 'mecanum-hil[dbc]'"
        ) from error
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"file = {str(path)!r} cannot be read: {error.strerror}") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")  # what the format's own tools write
    try:
        # Not strict: an error in a message that is not used does not matter.
        return cantools.database.load_string(text, database_format="dbc", strict=False)
    except cantools.Error as error:
        raise ValueError(f"file = {str(path)!r} is no DBC that can be read: {_one_line(error)}") from error


def _refusal(message: Any) -> str | None:
    """Return why this driver does not support a message, None if it does."""
    if message.is_fd or message.length > _CLASSIC_BYTES:
        return f"has {message.length} bytes and is for CAN FD; this driver speaks classic CAN, of up to 8 bytes"
    if message.is_multiplexed():
        return "is multiplexed; this driver takes messages whose signals are the same in every frame"
    if unusable := [one.name for one in message.signals if not _is_usable(one)]:
        return f"has in {unusable[0]} a factor or an offset that is no number, or a factor of 0; correct the DBC"
    import cantools

    try:
        message.refresh(strict=True)
    except cantools.Error as error:
        return f"cannot be coded: {_one_line(error)}"
    return None


def _message(message: Any) -> Message:
    identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    signals = {signal.name: _signal(message, signal) for signal in message.signals}
    period_s = message.cycle_time / 1000.0 if message.cycle_time else None
    return Message(message.name, identifier, message.length, period_s, signals, message)


def _is_usable(signal: Any) -> bool:
    conversion = signal.conversion
    return conversion.scale != 0 and math.isfinite(conversion.scale) and math.isfinite(conversion.offset)


def _signal(message: Any, signal: Any) -> Signal:
    conversion = signal.conversion
    length_low, length_high = _limits_of_length(signal)
    low, high = _limits(signal)
    initial = clamp(signal.raw_initial or 0, length_high, length_low)
    if signal.raw_initial is None:
        initial = clamp(0, high, low)
    return Signal(
        message.name,
        signal.name,
        conversion.is_float,
        conversion.scale,
        conversion.offset,
        low,
        high,
        signal.unit or "",
        {
            int(raw): str(text)
            for raw, text in (conversion.choices or {}).items()
            if length_low <= int(raw) <= length_high
        },
        initial if conversion.is_float else int(initial),
    )


def _limits_of_length(signal: Any) -> tuple[float, float]:
    """Return the lowest and the highest raw number that the bits can hold."""
    if signal.conversion.is_float:
        return -_FLOAT_HIGHEST[signal.length], _FLOAT_HIGHEST[signal.length]
    high = (1 << signal.length - signal.is_signed) - 1
    return (-high - 1 if signal.is_signed else 0), high


def _limits(signal: Any) -> tuple[float, float]:
    """Return the raw limits: the DBC's minimum and maximum if it has both, within those of the signal's length."""
    conversion = signal.conversion
    low, high = _limits_of_length(signal)
    given = [
        (limit - conversion.offset) / conversion.scale
        for limit in (signal.minimum, signal.maximum)
        if limit is not None and math.isfinite(limit)
    ]
    if len(given) == 2:
        least, most = sorted(given)
        if not conversion.is_float:  # move a limit between two steps inwards, with a tolerance for rounding
            least, most = math.ceil(least - 1e-6), math.floor(most + 1e-6)
        if max(low, least) <= min(high, most):  # ignore limits outside the range of the bits
            low, high = max(low, least), min(high, most)
    return low, high


def _one_line(error: Exception) -> str:
    words = "".join(one if one.isprintable() else "?" for one in " ".join(str(error).split()))
    return (words or type(error).__name__)[:200]
