"""Faults of a CAN bus: frames that are destroyed and sent again, frames with a wrong DLC, and a node that babbles."""

import time
from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link, Received
from hil.wire.fault_rows import LinkFault, ScenarioTime
from hil.wire.line_faults import foreign_id

# ISO 11898-1: of a classic frame with 11-bit id, less stuff bits, and the transmit error counter.
_BITS_OF_FRAME = 47
_ERROR_COUNTS = 8
_BUS_OFF = 256
_MOST_DATA = 8


class FaultBus:
    """Applies bit errors, truncation and babble to a CAN link, as controllers on the bus would see them.

    A destroyed frame costs the time on the wire of itself and of the error frame, some 0.15 ms at 1 Mbit/s each time;
    that time is not modelled. ``babbler`` is the node of its own that babbles, None where no fault wants one.
    """

    def __init__(
        self,
        link: Link,
        time: ScenarioTime,
        faults: Sequence[LinkFault],
        babbler: Link | None,
        protocol: LinkProtocol = WHEEL_DBC,
    ) -> None:
        self._link = link
        self._time = time
        self._protocol = protocol
        self._faults = [fault for fault in faults if fault.kind != "babble"]
        self._babbles = [fault for fault in faults if fault.kind == "babble"]
        self._babbler = babbler
        self._errors = {"command": 0, "feedback": 0}  # the transmit error counter of each end
        self._rejected = {"error_bit": 0, "error_bus_off": 0, "length": 0}

    def send(self, frame: Frame) -> None:
        t_ns = self._time.now_ns()
        self._babble(t_ns)
        if t_ns is None or frame.id >= self._protocol.exempt_from:
            self._link.send(frame)
            return
        sent = self._passed(frame, "command", t_ns)
        if sent is None:
            self._rejected["error_bus_off"] += 1
            raise LinkError("the CAN controller is bus-off: the fault bit_errors destroyed too many frames in a row")
        self._link.send(sent)

    def receive(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while (received := self._link.receive(timeout_ns)) is not None:
            t_ns = self._time.now_ns()
            self._babble(t_ns)
            frames = [frame for frame in received.frames if self._arrives(frame, t_ns)]
            if frames:
                return Received(frames, received.stamp_ns)
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())
        return None

    def _arrives(self, frame: Frame, t_ns: int | None) -> bool:
        """Tell whether a frame of the robot's comes through whole."""
        if t_ns is None or frame.id >= self._protocol.exempt_from:
            return True
        passed = self._passed(frame, "feedback", t_ns)
        is_short = passed is not None and len(passed.payload) < len(frame.payload)
        self._rejected["length"] += is_short
        return passed is not None and not is_short

    def rejected(self) -> dict[str, int]:
        causes = self._link.rejected()
        return causes | {cause: causes.get(cause, 0) + count for cause, count in self._rejected.items()}

    def reopen(self) -> None:
        self._link.reopen()
        if self._babbler is not None:
            self._babbler.reopen()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        if self._babbler is not None:
            self._babbler.close()
        self._link.close()

    def _passed(self, frame: Frame, direction: str, t_ns: int) -> Frame | None:
        """Return the frame as it comes through, or None when its sender went bus-off over it."""
        for fault in self._faults:
            if not (fault.row.is_in_force(t_ns) and fault.concerns(direction, frame.id)):
                continue
            if fault.kind == "truncation":
                if frame.payload and fault.strikes():
                    frame = Frame(frame.id, frame.payload[: fault.chance.randrange(len(frame.payload))])
            elif not self._comes_through(fault, direction, len(frame.payload)):
                return None
        return frame

    def _comes_through(self, fault: LinkFault, direction: str, length: int) -> bool:
        """Send a frame until it is whole, with an error frame for each time that it is not."""
        whole = (1.0 - fault.row.value) ** (_BITS_OF_FRAME + 8 * length)
        while fault.chance.random() >= whole:
            fault.applied += 1
            self._rejected["error_bit"] += 1
            self._errors[direction] += _ERROR_COUNTS
            if self._errors[direction] >= _BUS_OFF:
                self._errors[direction] = 0  # it recovers, without the frame
                return False
        self._errors[direction] = max(0, self._errors[direction] - 1)
        return True

    def _babble(self, t_ns: int | None) -> None:
        if t_ns is None or self._babbler is None:
            return
        for fault in self._babbles:
            for _ in range(fault.due(t_ns)):
                data = fault.chance.randbytes(fault.chance.randint(0, _MOST_DATA))
                self._babbler.send(Frame(foreign_id(fault, self._protocol), data))
        while self._babbler.receive(0) is not None:
            pass  # it hears everybody, and has no ear for them
