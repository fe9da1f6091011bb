"""Faults of the wire itself: those of a serial line act on its framed bytes, those of a CAN bus on its frames."""

from collections.abc import Sequence

from cobs import cobs

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link
from hil.faults.link_faults import DIRECTIONS, ByteFault, ErrorCounter
from hil.faults.rows import ScenarioTime
from hil.wire.streams import HostStream


class FaultLine:
    """The host's end of a line, with faults in both directions. The framing at the other end finds the errors.

    Nothing happens before the scenario's time has begun. Frames that carry lockstep are not changed; each gets a zero
    byte before it, because the frame before it may have been cut.
    """

    def __init__(
        self, stream: HostStream, time: ScenarioTime, faults: Sequence[ByteFault], protocol: LinkProtocol = WHEEL_DBC
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

    def describe(self) -> str:
        return self._stream.describe()

    def close(self) -> None:
        self._stream.close()

    def _spoil(self, data: bytes, direction: str, t_ns: int) -> bytes:
        senders = [fault for fault in self._faults if fault.is_sender and fault.acts_on(direction)]
        foreign = [piece for fault in senders for piece in fault.sent_on_line(t_ns)]
        frames = (self._spoil_frame(piece, direction, t_ns) for piece in self._protocol.pieces(data))
        return b"".join((*foreign, *frames))

    def _spoil_frame(self, frame: bytes, direction: str, t_ns: int) -> bytes:
        number = _id_of(frame) if self._protocol is WHEEL_DBC else None
        if number is not None and number >= self._protocol.exempt_from:
            return b"\0" + frame
        for fault in self._faults:
            if fault.row.is_in_force(t_ns) and fault.concerns(direction, number):
                frame = fault.on_line(frame)
        return frame


def _id_of(frame: bytes) -> int | None:
    try:
        body = cobs.decode(frame[:-1])
    except cobs.DecodeError:
        return None
    return int.from_bytes(body[:2], "little") if len(body) >= 2 else None


class BusFaults:
    """The faults of a CAN bus, as the bus's controllers would see them.

    A destroyed frame takes no time here; on a bus it and its error frame take some 0.15 ms at 1 Mbit/s. ``node`` is
    the end of the bus at which another sender is; None if no row needs one.
    """

    def __init__(self, faults: Sequence[ByteFault], node: Link | None) -> None:
        self._faults = faults
        self._node = node
        self._counters = {direction: ErrorCounter() for direction in DIRECTIONS}
        self._bus_off = self._cut = 0

    def rejected(self) -> dict[str, int]:
        """Return the number of destroyed or cut frames, by the causes of ``Link.rejected``."""
        destroyed = sum(counter.destroyed for counter in self._counters.values())
        return {"error_bit": destroyed, "error_bus_off": self._bus_off, "length": self._cut}

    def sent(self, frame: Frame, t_ns: int) -> Frame:
        """Return a command as it arrives at the robot. Raises LinkError if it put the host's controller bus-off."""
        passed = self._passed(frame, "command", t_ns)
        if passed is None:
            self._bus_off += 1
            raise LinkError("the CAN controller is bus-off: the fault bit_errors destroyed too many frames in a row")
        return passed

    def arrives(self, frame: Frame, t_ns: int) -> bool:
        """Whether a frame of the robot arrives undamaged."""
        passed = self._passed(frame, "feedback", t_ns)
        is_short = passed is not None and len(passed.payload) < len(frame.payload)
        self._cut += is_short
        return passed is not None and not is_short

    def send_foreign(self, t_ns: int | None) -> None:
        """Let the other senders send the frames that are due by now, in the scenario's time."""
        if t_ns is None or self._node is None:
            return
        for fault in self._faults:
            for frame in fault.sent_on_bus(t_ns):
                self._node.send(frame)
        while self._node.receive(0) is not None:
            pass  # it receives every frame, and ignores them

    def reopen(self) -> None:
        if self._node is not None:
            self._node.reopen()

    def close(self) -> None:
        if self._node is not None:
            self._node.close()

    def _passed(self, frame: Frame, direction: str, t_ns: int) -> Frame | None:
        """Return the frame as it arrives, or None when its sender went bus-off over it."""
        for fault in self._faults:
            if fault.row.is_in_force(t_ns) and fault.concerns(direction, frame.id):
                passed = fault.on_bus(frame, self._counters[direction])
                if passed is None:
                    return None
                frame = passed
        return frame
