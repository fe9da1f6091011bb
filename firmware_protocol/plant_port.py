"""The other end of a robot's plant port, which takes the place of motors in a hardware-in-the-loop build.

The firmware sends its drives' set points over a second serial line, once a tick, and waits for the robot's sensor
values; ``port/stm32f4/plant_codec.h`` defines the frames. This module does no I/O: bytes in, bytes out.

    port = PlantPort(body)  # body(drive) lets a millisecond pass and returns a Sense; body(None) only returns one
    line.write(port.feed(line.read()))
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

from cobs import cobs

from firmware_protocol.framing import crc16

Four = tuple[float, float, float, float]
Three = tuple[float, float, float]

_HEADER = struct.Struct("<HB")  # id16, sequence8
_SAMPLE = struct.Struct("<I")
_DRIVE = struct.Struct("<II4f4f")
_SENSE = struct.Struct("<I4H4f3f3fff4f")
_CRC = 2


class PlantId(IntEnum):
    """Identifiers of the plant port. They exceed the 11 bits of wheel.dbc, so that neither line accepts the other's
    frames.
    """

    SAMPLE = 0x801
    DRIVE = 0x802
    SENSE = 0x803


_LENGTHS = {PlantId.SAMPLE: _SAMPLE.size, PlantId.DRIVE: _DRIVE.size, PlantId.SENSE: _SENSE.size}
BAUD = 2_000_000
"""Of the line, as the boards have it (``port/stm32f4``): at 921,600 the bytes of a tick would take longer than it."""
MAX_ENCODED = _HEADER.size + _SENSE.size + _CRC + 1
"""Bytes of the longest frame on the wire without its zero."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Requests the sensor values at the beginning of ``tick``; no time passes."""

    tick: int


@dataclass(frozen=True, slots=True)
class Drive:
    """``wheel_drive`` of ``firmware/plant_port.h``: the drives' set points during ``tick``; FL, FR, RR, RL.

    ``torque_n_m`` [N m] at the wheel axles; ``duty`` [-1 to 1] of the battery's voltage. If not ``enabled`` the wheels
    coast.
    """

    tick: int
    enabled: bool
    torque_n_m: Four
    duty: Four


@dataclass(frozen=True, slots=True)
class Sense:
    """``wheel_sense`` of ``firmware/plant_port.h``: sensor values at the beginning of ``tick``; SI units, degC.

    ``count`` are encoder counts modulo 65536. ``gyro_rad_s`` and ``acceleration_m_s2`` are in the body frame (x
    forward, y left, z up); the acceleration is the specific force, so that z is 9.81 at rest.
    """

    tick: int
    count: tuple[int, int, int, int]
    current_a: Four
    gyro_rad_s: Three
    acceleration_m_s2: Three
    battery_v: float
    battery_a: float
    temperature_degc: Four


Message = Sample | Drive | Sense


def _payload(message: Message) -> tuple[PlantId, bytes]:
    match message:
        case Sample(tick):
            return PlantId.SAMPLE, _SAMPLE.pack(tick)
        case Drive(tick, enabled, torque, duty):
            return PlantId.DRIVE, _DRIVE.pack(tick, enabled, *torque, *duty)
        case Sense(tick, count, current, gyro, acceleration, volt, ampere, degc):
            numbers = (*current, *gyro, *acceleration, volt, ampere, *degc)
            return PlantId.SENSE, _SENSE.pack(tick, *count, *numbers)


def _message(number: PlantId, payload: bytes) -> Message:
    match number:
        case PlantId.SAMPLE:
            return Sample(*_SAMPLE.unpack(payload))
        case PlantId.DRIVE:
            tick, enabled, *d = _DRIVE.unpack(payload)
            return Drive(tick, enabled != 0, (d[0], d[1], d[2], d[3]), (d[4], d[5], d[6], d[7]))
        case PlantId.SENSE:
            tick, *s = _SENSE.unpack(payload)
            return Sense(
                tick,
                (s[0], s[1], s[2], s[3]),
                (s[4], s[5], s[6], s[7]),
                (s[8], s[9], s[10]),
                (s[11], s[12], s[13]),
                s[14],
                s[15],
                (s[16], s[17], s[18], s[19]),
            )


class PlantFramer:
    """The sending side of a plant port: counts the frames that it sends, modulo 256."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, message: Message) -> bytes:
        """Return the bytes for the wire, with the final zero.

        Raises struct.error when a tick or a count is out of range, OverflowError when a number does not fit binary32.
        """
        number, payload = _payload(message)
        body = _HEADER.pack(number, self._sequence) + payload
        self._sequence = (self._sequence + 1) & 0xFF
        encoded: bytes = cobs.encode(body + crc16(body).to_bytes(_CRC, "little"))
        return encoded + b"\0"


class PlantDeframer:
    """The receiving side of a plant port. Raises no error: what is not a valid frame is dropped and counted in
    ``rejected``.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self._open = b""

    def feed(self, data: bytes) -> list[Message]:
        """Take the bytes that arrived, in pieces of any size, and return the messages that they complete."""
        *ended, rest = data.split(b"\0")
        messages = []
        for piece in ended:
            self._append(piece)
            if self._open:
                message = self._parse(self._open)
                if message is None:
                    self.rejected += 1
                else:
                    messages.append(message)
            self._open = b""
        self._append(rest)
        return messages

    def _append(self, piece: bytes) -> None:
        self._open = (self._open + piece)[: MAX_ENCODED + 1]  # with one byte too many it stays too long

    def _parse(self, encoded: bytes) -> Message | None:
        if len(encoded) > MAX_ENCODED:
            return None
        try:
            body: bytes = cobs.decode(encoded)
        except cobs.DecodeError:
            return None
        if len(body) < _HEADER.size + _CRC or crc16(body[:-_CRC]) != int.from_bytes(body[-_CRC:], "little"):
            return None
        number, payload = int.from_bytes(body[:2], "little"), body[_HEADER.size : -_CRC]
        if number not in _LENGTHS or _LENGTHS[PlantId(number)] != len(payload):
            return None
        return _message(PlantId(number), payload)


class PlantPort:
    """The plant's end of the line.

    ``body`` is called with each new drive: it lets one millisecond pass with it and returns the sensor values after it.
    Called with None it only returns the present sensor values. The tick of the result is set here. A firmware that
    missed an answer repeats its drive: it gets the same answer, and no time passes.
    """

    def __init__(self, body: Callable[[Drive | None], Sense]) -> None:
        self._body = body
        self._framer = PlantFramer()
        self._deframer = PlantDeframer()
        self._last: Sense | None = None  # the answer to the newest drive

    @property
    def rejected(self) -> int:
        """How many received frames were dropped."""
        return self._deframer.rejected

    def feed(self, data: bytes) -> bytes:
        """Take received bytes, valid or not, and return the bytes that answer them.

        Raises what ``body`` raises.
        """
        answers = [self._answer(message) for message in self._deframer.feed(data)]
        return b"".join(self._framer.encode(answer) for answer in answers if answer is not None)

    def _answer(self, message: Message) -> Sense | None:
        if isinstance(message, Sense):
            return None  # a robot never sends this
        if isinstance(message, Sample):
            self._last = None
            return replace(self._body(None), tick=message.tick)
        tick = (message.tick + 1) & 0xFFFF_FFFF
        if self._last is None or self._last.tick != tick:
            self._last = replace(self._body(message), tick=tick)
        return self._last
