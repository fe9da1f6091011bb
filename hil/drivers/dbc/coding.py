"""Packs and unpacks a DBC's messages in every tick. cantools codes raw numbers; everything else is prepared before.

cantools' own checks and value-table texts would double the time. So limits are applied here, and conditions compare raw
numbers. Four frames take 15 µs to pack and 11 µs to unpack on a machine where those of a C620 take 9 µs and 5 µs.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.drivers.dbc.file import Message, Signal
from hil.drivers.port import clamp


class Moving(NamedTuple):
    """A signal that carries the value with the index ``place``: raw = ``gain`` × value + ``bias``."""

    signal: Signal
    place: int
    gain: float
    bias: float


class RollingCounter:
    """A signal that counts the frames of its message cyclically, from its lowest to its highest number."""

    def __init__(self, signal: Signal) -> None:
        self.signal = signal
        self._first = int(signal.low)
        self._span = int(signal.high) - self._first + 1
        self._count = 0

    def next(self) -> int:
        """Return the raw number for the next frame."""
        raw = self._first + self._count
        self._count = (self._count + 1) % self._span
        return raw


class Packer:
    """Makes the frames of one message from fixed raw numbers, counters, and signals that carry values."""

    def __init__(
        self,
        message: Message,
        fixed: Mapping[str, float],
        moving: Sequence[Moving] = (),
        counters: Sequence[RollingCounter] = (),
    ) -> None:
        self._id = message.id
        self._encode = message.codec.encode
        self._raws = {name: fixed.get(name, signal.initial) for name, signal in message.signals.items()}
        self._moving = [
            (signal.name, place, gain, bias, signal.low, signal.high, signal.is_float)
            for signal, place, gain, bias in moving
        ]
        self._counters = [(counter.signal.name, counter) for counter in counters]

    def frame(self, values: Sequence[float] = ()) -> Frame:
        """Return a frame with these values; each is limited to the range of its signal."""
        raws = self._raws
        for name, place, gain, bias, low, high, is_float in self._moving:
            raw = clamp(values[place] * gain + bias, high, low)
            raws[name] = raw if is_float else round(raw)
        for name, counter in self._counters:
            raws[name] = counter.next()
        return Frame(self._id, self._encode(raws, scaling=False, strict=False))


class Reading(NamedTuple):
    """A signal to be read: value = ``gain`` × raw + ``bias``."""

    signal: Signal
    gain: float = 1
    bias: float = 0


class Unpacker:
    """Reads some signals of one message."""

    def __init__(self, message: Message, readings: Sequence[Reading]) -> None:
        self._length = message.length
        self._decode = message.codec.decode_simple
        self._readings = [(one.signal.name, one.gain, one.bias) for one in readings]
        self._has_floats = any(one.signal.is_float for one in readings)

    def values(self, payload: bytes) -> list[float] | None:
        """Return the values in the order of the readings; None if the frame is short or a value is not finite."""
        if len(payload) < self._length:
            return None
        raws = self._decode(payload[: self._length], decode_choices=False, scaling=False)
        values = [raws[name] * gain + bias for name, gain, bias in self._readings]
        return None if self._has_floats and not all(map(isfinite, values)) else values
