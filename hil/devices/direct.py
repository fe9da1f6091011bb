"""A virtual robot in lockstep whose host is in the same thread: its truth, and the host's end of the line to it."""

import time
from collections.abc import Callable
from typing import Protocol, cast

from firmware_protocol.framing import FRAME_OVERHEAD, Frame
from firmware_protocol.host import HostNode
from hil.devices.virtual import VirtualStm32
from hil.errors import LinkError
from hil.links.framed import StreamLink
from hil.links.language import wheel_framing
from hil.links.opening import Line
from hil.links.streams import DirectStream
from hil.ports import Link, Received, make_received


class DirectTruth:
    """Where the robot really is. Between two answers to its host no time passes."""

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
    # Faults of the line want the bytes, and so does a firmware that is watched. One that is reset is silent then.
    if stream is direct and type(robot.node) is HostNode and not robot.faults.can_reset:
        return DirectLink(cast(LibraryRobot, robot))
    return StreamLink(stream)


class LibraryRobot(Protocol):
    """A robot whose firmware is the host library's, also after a power cycle."""

    node: HostNode


class DirectLink:
    """Does what a ``StreamLink`` over a ``DirectStream`` does, but that the line's bytes stay within the library.

    What is sent waits until something is to be received: ``receive`` raises ValueError for a frame that is no message.

    Attributes:
        now_ns: the clock that stamps what is received.
        sent_frames, sent_bytes, received_frames, received_bytes: so far.
    """

    counts_frames = True

    def __init__(self, robot: LibraryRobot) -> None:
        self._robot = robot
        self._line = wheel_framing()
        self._unsent: list[Frame] = []
        self._told_frames = self._told_bytes = 0
        self._is_open = True
        self.send: Callable[[Frame], None] = self._unsent.append
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.received_bytes = 0

    @property
    def sent_frames(self) -> int:
        return self._told_frames + len(self._unsent)

    @property
    def sent_bytes(self) -> int:
        size = self._told_bytes
        for _, payload in self._unsent:
            size += len(payload) + FRAME_OVERHEAD
        return size

    @property
    def received_frames(self) -> int:
        return self._line.frames

    def receive(self, _timeout_ns: int) -> Received | None:
        unsent = self._unsent
        if not unsent:
            return None
        if not self._is_open:
            raise LinkError("the memory link was closed; open a new one")
        try:
            frames, sent, received = self._line.converse(self._robot.node, unsent)
            self._told_frames += len(unsent)
            self._told_bytes += sent
        finally:
            unsent.clear()
        if not received:
            return None
        self.received_bytes += received
        return make_received((frames, self.now_ns()))

    def rejected(self) -> dict[str, int]:
        return self._line.rejected | {"unread_bytes": 0}

    def reopen(self) -> None:
        """Nothing to do: what the robot said was read, and it hears what was sent before."""

    def describe(self) -> str:
        return "memory, both sides in one process"

    def close(self) -> None:
        self._is_open = False
