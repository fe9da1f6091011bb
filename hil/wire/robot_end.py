"""The robot's end of a link: bytes or CAN frames to and from its firmware."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from hil.core.errors import LinkError
from hil.core.ports import Link, Node
from hil.wire.reopening import BackOff
from hil.wire.streams import ByteStream


class Wire(Protocol):
    """Connects a firmware to a transport."""

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        """Pass on what has arrived, waiting at most ``timeout_ns``; return whether anything arrived."""

    def send_from(self, node: Node) -> None:
        """Send the robot's waiting output."""

    def close(self) -> None:
        """Release the transport."""


class SerialWire:
    """A byte stream; the firmware does the framing and counts errors. It gets the number of frames nobody read."""

    def __init__(self, stream: ByteStream) -> None:
        self._stream = stream
        self._lost = 0  # lost frames that were reported to the firmware

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        data = self._stream.read(timeout_ns)
        if data:
            node.feed(data)
        return bool(data)

    def send_from(self, node: Node) -> None:
        if data := node.take_bytes():
            self._stream.write(data)
        if (lost := self._stream.lost_frames) > self._lost:
            node.count_unsent(lost - self._lost)
            self._lost = lost

    def drop_from(self, node: Node) -> None:
        """Discard the robot's waiting output, because the transport is lost."""
        node.take_bytes()

    def close(self) -> None:
        self._stream.close()


class CanWire:
    """A CAN bus."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        received = self._link.receive(timeout_ns)
        if received is None:
            return False
        while received is not None:
            for frame in received.frames:
                node.receive(frame)
            received = self._link.receive(0)
        return True

    def send_from(self, node: Node) -> None:
        for frame in node.take_frames():
            self._link.send(frame)

    def drop_from(self, node: Node) -> None:
        node.take_frames()

    def close(self) -> None:
        self._link.close()


class ReopeningWire:
    """A wire that is reopened after it was lost. Meanwhile the firmware runs, as on a board, and stops the wheels.

    ``reopen`` is called after 0.1 s, then after twice as long each time, up to 2 s, in its own thread, because it may
    take seconds (an slcan adapter alone takes 2 s). ``say`` gets a sentence when the link is lost and when it is
    back.
    """

    def __init__(self, wire: SerialWire | CanWire, reopen: Callable[[], None], say: Callable[[str], None]) -> None:
        self._wire = wire
        self._reopen = reopen
        self._say = say
        self._lost = False
        self._waits = BackOff()
        self._due_ns = 0
        self._opener = ThreadPoolExecutor(1, "reopening")
        self._attempt: Future[None] | None = None  # while it runs, nothing else may use the wire

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        if not self._is_there():
            # The server waits here, so that it does not spin while there is nothing to receive.
            time.sleep(max(0, timeout_ns) * 1e-9)
            return False
        try:
            return self._wire.receive_into(node, timeout_ns)
        except LinkError as error:
            self._lose(error)
            return False

    def send_from(self, node: Node) -> None:
        if self._lost:
            self._wire.drop_from(node)
            return
        try:
            self._wire.send_from(node)
        except LinkError as error:
            self._lose(error)

    def _lose(self, error: LinkError) -> None:
        self._lost = True
        self._waits = BackOff()
        self._due_ns = time.monotonic_ns() + self._waits.next_ns()
        self._say(f"link lost, reopening: {error}")

    def _is_there(self) -> bool:
        if not self._lost:
            return True
        if self._attempt is None:
            if time.monotonic_ns() >= self._due_ns:
                self._attempt = self._opener.submit(self._reopen)
            return False
        if not self._attempt.done():
            return False
        attempt, self._attempt = self._attempt, None
        try:
            attempt.result()
        except LinkError:
            self._due_ns = time.monotonic_ns() + self._waits.next_ns()
            return False
        self._lost = False
        self._say("link reopened")
        return True

    def close(self) -> None:
        self._opener.shutdown()  # waits for a running attempt, so that its link is closed too
        self._wire.close()
