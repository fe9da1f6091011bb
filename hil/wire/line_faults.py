"""Faults of a serial line: they corrupt the framed bytes, and the framing at the other end finds the errors."""

import math
from collections.abc import Sequence

from cobs import cobs

from firmware_protocol.framing import crc16
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.wire.faults import LinkFault, ScenarioTime, foreign_id
from hil.wire.streams import HostStream

_LONGEST_GARBAGE = 16


class FaultLine:
    """The host's end of a line, with faults in both directions.

    Nothing happens before the scenario's time has begun. Frames that carry lockstep are not changed; each gets a zero
    byte before it, because the frame before it may have been cut.
    """

    def __init__(
        self, stream: HostStream, time: ScenarioTime, faults: Sequence[LinkFault], protocol: LinkProtocol = WHEEL_DBC
    ) -> None:
        self._stream = stream
        self._time = time
        self._faults = faults
        self._protocol = protocol
        self._rest = b""  # the beginning of a frame that has not arrived completely

    def write(self, data: bytes) -> None:
        t_ns = self._time.now_ns()
        self._stream.write(data if t_ns is None else self._spoil(data, "command", t_ns))

    def read(self, timeout_ns: int) -> bytes:
        data = self._rest + self._stream.read(timeout_ns)
        t_ns = self._time.now_ns()
        if t_ns is None:
            self._rest = b""
            return data
        whole = self._protocol.whole(data)
        self._rest = data[whole:]
        return self._spoil(data[:whole], "feedback", t_ns)

    def reopen(self) -> None:
        self._rest = b""
        self._stream.reopen()

    def unread_bytes(self) -> int:
        return self._stream.unread_bytes()

    def describe(self) -> str:
        return self._stream.describe()

    def close(self) -> None:
        self._stream.close()

    def _spoil(self, data: bytes, direction: str, t_ns: int) -> bytes:
        """Return whole frames with the faults applied."""
        babbles = [fault for fault in self._faults if fault.kind == "babble" and fault.concerns(direction, None)]
        babbled = [_babble(fault, n, self._protocol) for fault in babbles for n in fault.due(t_ns)]
        frames = (self._spoil_frame(piece, direction, t_ns) for piece in self._protocol.pieces(data))
        return b"".join((*babbled, *frames))

    def _spoil_frame(self, frame: bytes, direction: str, t_ns: int) -> bytes:
        number = _id_of(frame) if self._protocol is WHEEL_DBC else None
        if number is not None and number >= self._protocol.exempt_from:
            return b"\0" + frame
        for fault in self._faults:
            if fault.kind == "babble" or not (fault.row.is_in_force(t_ns) and fault.concerns(direction, number)):
                continue
            frame = _flip(frame, fault) if fault.kind == "bit_errors" else _cut(frame, fault)
        return frame


def _id_of(frame: bytes) -> int | None:
    """Return the id of an encoded frame, or None when it cannot be decoded."""
    try:
        body = cobs.decode(frame[:-1])
    except cobs.DecodeError:
        return None
    return int.from_bytes(body[:2], "little") if len(body) >= 2 else None


def _flip(frame: bytes, fault: LinkFault) -> bytes:
    """Make each bit wrong independently of the others: the gaps between wrong bits have a geometric distribution."""
    spoilt = bytearray(frame)
    scale = 1.0 / math.log1p(-fault.row.value)
    place = -1
    while (place := place + 1 + int(math.log1p(-fault.chance.random()) * scale)) < 8 * len(frame):
        spoilt[place // 8] ^= 1 << place % 8
    fault.applied += spoilt != frame
    return bytes(spoilt)


def _cut(frame: bytes, fault: LinkFault) -> bytes:
    return frame[: fault.chance.randrange(1, len(frame))] if len(frame) > 1 and fault.strikes() else frame


def _babble(fault: LinkFault, number: int, protocol: LinkProtocol) -> bytes:
    """Return bytes of a babbling node: random ones, or every other time a foreign frame of this project's protocol."""
    if number % 2 or protocol is not WHEEL_DBC:
        return fault.chance.randbytes(fault.chance.randint(1, _LONGEST_GARBAGE))
    body = foreign_id(fault, protocol).to_bytes(2, "little") + fault.chance.randbytes(fault.chance.randint(1, 9))
    encoded: bytes = cobs.encode(body + crc16(body).to_bytes(2, "little"))
    return encoded + b"\0"
