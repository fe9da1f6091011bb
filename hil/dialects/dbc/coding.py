"""Frames of a DBC's messages at the rate of the loop: what does not change is worked out before.

cantools takes 40 times as long for a frame, as it checks and names every value; it is the oracle of the tests.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from struct import Struct
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.dialects.dbc.file import Message, Signal

_FLOATS = {16: Struct("<e"), 32: Struct("<f"), 64: Struct("<d")}


class Moving(NamedTuple):
    """A signal that follows the value number ``place`` of those given: raw = ``gain`` × value + ``bias``."""

    signal: Signal
    place: int
    gain: float
    bias: float


class RollingCounter:
    """A signal that counts the frames of its message, from its lowest value to its highest and over again."""

    def __init__(self, signal: Signal) -> None:
        self.signal = signal
        self._first = int(signal.low)
        self._span = int(signal.high) - self._first + 1
        self._count = 0

    def next(self) -> int:
        """Return the bits for the next frame, in place."""
        raw = self._first + self._count % self._span
        self._count += 1
        return _bits(self.signal, raw)


class Packer:
    """Makes the frames of one message: fixed raw values, counters, and signals that move."""

    def __init__(
        self,
        message: Message,
        fixed: Mapping[str, float],
        moving: Sequence[Moving] = (),
        counters: Sequence[RollingCounter] = (),
    ) -> None:
        self._id, self._length = message.id, message.length
        self._words = [0, 0]  # of the little-endian signals, and of the big-endian ones
        changing = {one.signal.name for one in moving} | {one.signal.name for one in counters}
        for name, signal in message.signals.items():
            if name not in changing:
                self._words[signal.is_big_endian] |= _bits(signal, fixed.get(name, signal.initial))
        whole = [one for one in moving if not one.signal.is_float]
        self._whole = [
            (place, gain, bias, signal.low, signal.high, (1 << signal.length) - 1, signal.shift, signal.is_big_endian)
            for signal, place, gain, bias in whole
        ]
        self._floats = [one for one in moving if one.signal.is_float]
        self._counters = counters

    def frame(self, values: Sequence[float] = ()) -> Frame:
        """Return a frame; a value beyond the limits of its signal is sent as the limit."""
        words = self._words.copy()
        for place, gain, bias, low, high, mask, shift, big in self._whole:
            words[big] |= (round(min(max(values[place] * gain + bias, low), high)) & mask) << shift
        for signal, place, gain, bias in self._floats:
            raw = min(max(values[place] * gain + bias, signal.low), signal.high)
            words[signal.is_big_endian] |= _bits(signal, raw)
        for counter in self._counters:
            words[counter.signal.is_big_endian] |= counter.next()
        little, big_word = words
        payload = little.to_bytes(self._length, "little")
        if big_word:
            payload = (int.from_bytes(payload, "big") | big_word).to_bytes(self._length, "big")
        return Frame(self._id, payload)


class Reading(NamedTuple):
    """A signal to be read: value = ``gain`` × raw + ``bias``."""

    signal: Signal
    gain: float = 1
    bias: float = 0


class Unpacker:
    """Reads some signals of one message."""

    def __init__(self, message: Message, readings: Sequence[Reading]) -> None:
        self._length = message.length
        self._has_little = any(not one.signal.is_big_endian for one in readings)
        self._has_big = any(one.signal.is_big_endian for one in readings)
        self._fields = [
            (
                signal.is_big_endian,
                signal.shift,
                (1 << signal.length) - 1,
                1 << signal.length - 1 if signal.is_signed else 0,
                _FLOATS[signal.length] if signal.is_float else None,
                gain,
                bias,
            )
            for signal, gain, bias in readings
        ]

    def values(self, payload: bytes) -> list[float] | None:
        """Return the values in the order of the readings; None for a frame that is short, or has no number in it."""
        length = self._length
        if len(payload) < length:
            return None
        data = payload[:length]
        words = (
            int.from_bytes(data, "little") if self._has_little else 0,
            int.from_bytes(data, "big") if self._has_big else 0,
        )
        values: list[float] = []
        for big, shift, mask, sign, form, gain, bias in self._fields:
            bits = words[big] >> shift & mask
            if form is None:
                values.append(((bits ^ sign) - sign) * gain + bias)
                continue
            (raw,) = form.unpack(bits.to_bytes(form.size, "little"))
            if not isfinite(raw):
                return None
            values.append(raw * gain + bias)
        return values


def _bits(signal: Signal, raw: float) -> int:
    """Return the bits of a raw value, in place in the word of its byte order."""
    if signal.is_float:
        bits = int.from_bytes(_FLOATS[signal.length].pack(raw), "little")
    else:
        bits = int(raw) & (1 << signal.length) - 1
    return bits << signal.shift
