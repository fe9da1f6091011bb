"""A virtual robot in lockstep with its host in the same thread: its true pose, and the host's end of the link."""

from typing import Protocol, cast

from firmware_protocol.framing import FRAME_OVERHEAD, PACKED_HEADERS, Frame, unsendable
from firmware_protocol.generated.messages import Estop
from firmware_protocol.host import HostNode
from firmware_protocol.host_line import HostLine
from hil.core.ports import Link, Received
from hil.robot.virtual import VirtualStm32
from hil.wire.framed import StreamLink
from hil.wire.link import Line
from hil.wire.streams import DirectStream, closed


class DirectTruth:
    """The robot's true pose. In lockstep it does not change between two exchanges with the host."""

    def __init__(self, robot: VirtualStm32) -> None:
        self.poll = robot.plant.truth

    def close(self) -> None:
        """Nothing to release."""


def open_direct(robot: VirtualStm32, line: Line) -> Link:
    """Open the host's end of ``memory:`` to this robot, for our own protocol in lockstep."""

    def answer(data: bytes) -> bytes:
        robot.node.feed(data)
        return robot.awake().take_bytes()

    direct = DirectStream(answer)
    stream = line(direct)
    # DirectLink bypasses the bytes, so it cannot be used with faults on the line, with a watched firmware, or with a
    # reset fault, after which the robot is silent.
    if stream is direct and type(robot.node) is HostNode and not robot.faults.can_reset:
        return DirectLink(cast(LibraryRobot, robot), direct)
    return StreamLink(stream)


class LibraryRobot(Protocol):
    """A robot whose firmware runs in the host library, also after a power cycle."""

    node: HostNode


class DirectLink(StreamLink):
    """A faster ``StreamLink``: the bytes stay in the host library, and one call exchanges all frames of a tick."""

    _framing: HostLine

    def __init__(self, robot: LibraryRobot, stream: DirectStream) -> None:
        super().__init__(stream)
        self._robot = robot
        self._there = HostLine()
        self._unsent = b""  # packed
        self._is_open = True

    def send(self, frame: Frame) -> None:
        number, payload = frame
        header = PACKED_HEADERS.get((number, len(payload)))
        if header is None:
            raise unsendable(frame)
        if not self._is_open:
            raise closed()
        self._unsent += header + payload
        self.sent_frames += 1
        self.sent_bytes += FRAME_OVERHEAD + len(payload) + (number == Estop.ID)

    def receive(self, _timeout_ns: int) -> Received | None:
        unsent = self._unsent
        if not unsent:
            return None
        self._unsent = b""
        frames, size = self._framing.converse(self._robot.node, unsent, self._there)
        if not size:
            return None
        self.received_frames += len(frames)
        self.received_bytes += size
        return Received(frames, self.now_ns())

    def close(self) -> None:
        self._is_open = False
        self._unsent = b""
        super().close()
