"""The robot's end of a link: bytes or CAN frames to and from its firmware."""

from typing import Protocol

from firmware_protocol.framing import Frame
from hil.links.streams import ByteStream
from hil.ports import Link


class Node(Protocol):
    """A firmware's end of the wire, wherever it runs: bytes of a serial line, or CAN frames."""

    def feed(self, data: bytes) -> None:
        """Take bytes of a serial line."""

    def receive(self, frame: Frame) -> None:
        """Take one CAN frame."""

    def take_bytes(self) -> bytes:
        """Return what there is to send, as bytes of a serial line."""

    def take_frames(self) -> list[Frame]:
        """Return what there is to send, as frames."""

    def count_unsent(self, frames: int) -> None:
        """Take note that so many frames that were to be sent could not be."""


class Wire(Protocol):
    """Connects a firmware to a transport."""

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        """Hand over what has arrived, waiting at most ``timeout_ns``; return whether there was anything."""

    def send_from(self, node: Node) -> None:
        """Send what the robot has to send."""

    def close(self) -> None:
        """Release the transport."""


class SerialWire:
    """A byte stream; framing and its counters are the firmware's own."""

    def __init__(self, stream: ByteStream) -> None:
        self._stream = stream

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        data = self._stream.read(timeout_ns)
        if data:
            node.feed(data)
        return bool(data)

    def send_from(self, node: Node) -> None:
        while data := node.take_bytes():
            self._stream.write(data)

    def close(self) -> None:
        self._stream.close()


class LossyStream(ByteStream, Protocol):
    """A line that loses frames which nobody reads, and counts them."""

    lost_frames: int


class LossySerialWire(SerialWire):
    """A byte stream that may lose what is sent; the firmware learns how many frames that were."""

    def __init__(self, stream: LossyStream) -> None:
        super().__init__(stream)
        self._lossy = stream
        self._told = 0

    def send_from(self, node: Node) -> None:
        super().send_from(node)
        if (lost := self._lossy.lost_frames) > self._told:
            node.count_unsent(lost - self._told)
            self._told = lost


class CanWire:
    """A CAN bus."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        received = self._link.receive(timeout_ns)
        if received is None:
            return False
        while received is not None:
            node.receive(received.frame)
            received = self._link.receive(0)
        return True

    def send_from(self, node: Node) -> None:
        for frame in node.take_frames():
            self._link.send(frame)

    def close(self) -> None:
        self._link.close()
