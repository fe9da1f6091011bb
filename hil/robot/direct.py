"""A virtual robot in lockstep with its host in the same thread: its true pose, and the host's end of the link."""

import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol, cast

from firmware_protocol.client import MOST_TICKS, Client
from firmware_protocol.extension import library, wheel
from firmware_protocol.framing import PACKED_HEADERS, Frame, unsendable
from firmware_protocol.host import HostNode
from firmware_protocol.host_line import HostLine, PackedFrames
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
        # Only a plant in a process of its own may hang.
        return DirectLink(cast(LibraryRobot, robot), direct, may_hang=robot.output is not None)
    return StreamLink(stream)


class LibraryRobot(Protocol):
    """A robot whose firmware runs in the host library, also after a power cycle."""

    node: HostNode


class DirectLink:
    """A ``StreamLink`` whose bytes stay in the host library. ``step`` makes a whole exchange in one call.

    While a plant steps that ``may_hang`` other threads run, which can end it.

    Attributes:
        now_ns: the clock that stamps received frames.
        answer: the packed frames of the newest exchange.
        crossed: returns the packed frames that the newest exchange sent of the client's, and their number; and those of
            the answer.
        byte_counts: returns the bytes sent and received since ``begin_byte_counts``.
    """

    def __init__(self, robot: LibraryRobot, stream: DirectStream, *, may_hang: bool = True) -> None:
        ffi, _ = library()
        self._robot = robot
        self._stream = stream
        self._line = wheel.Direct(HostLine(), may_hang)
        self._direct = ffi.cast("wheel_direct *", self._line.address)
        self.crossed, self.byte_counts = self._line.crossed, self._line.line_bytes
        self.answer = ffi.buffer(self._direct.answer)
        self._earlier: Counter[str] = Counter()  # rejected before the link was reopened
        self._begin_line()
        self._view = ffi.new("wheel_view *")  # of no client: nothing waits
        self._is_open = True
        self.now_ns: Callable[[], int] = time.monotonic_ns

    def _begin_line(self) -> None:
        self._here = HostLine()
        self._line.listen(self._here)

    def send(self, frame: Frame) -> None:
        number, payload = frame
        header = PACKED_HEADERS.get((number, len(payload)))
        if header is None:
            raise unsendable(frame)
        self.send_packed(PackedFrames(header + payload, 1))

    def send_packed(self, frames: PackedFrames) -> None:
        if not self._is_open:
            raise closed()
        self._line.hold(self._robot.node, frames.packed)

    def receive(self, _timeout_ns: int) -> Received | None:
        if not self._is_open or not self._direct.held_bytes:
            return None
        answer = self._line.exchange(self._robot.node, None)
        return Received(PackedFrames(answer), self.now_ns()) if answer else None

    def serve(self, client: Client) -> None:
        """Set the client whose frames ``step`` and ``exchange`` send."""
        self._line.serve(client)
        self._view = client.view

    def exchange(self, ticks: int) -> PackedFrames:
        """Send what waits in the client, and a STEP; return all that the robot then sends.

        Raises ValueError for more than 1000 ticks; nothing is sent then.
        """
        if not self._is_open:
            raise closed()
        answer = self._line.exchange(self._robot.node, ticks)
        if answer is None:
            raise _unsendable_step(ticks)
        return PackedFrames(answer)

    def step(self, ticks: int) -> Received | None:
        """Send what waits in the client, and a STEP; the client takes the answer.

        Return None, or where the client has stopped early the rest of the answer, which it must be given; its view says
        why it has stopped. Raises ValueError for more than 1000 ticks; nothing is sent then.
        """
        if not self._is_open:
            raise closed()
        now_ns = self.now_ns()
        if self._line.step(self._robot.node, ticks, now_ns):
            return None
        direct = self._direct
        if not direct.stepped_bytes:  # the client refused it: a step that was made is never empty
            raise _unsendable_step(ticks)
        return Received(PackedFrames(self.answer[direct.answer_at : direct.answer_bytes], 0), now_ns)

    # The counters; what waits in the client counts as sent.

    @property
    def sent_frames(self) -> int:
        return self._direct.sent_frames + self._direct.held_frames + self._view.out_frames  # type: ignore[no-any-return]

    @property
    def received_frames(self) -> int:
        return self._direct.received_frames  # type: ignore[no-any-return]

    def begin_byte_counts(self) -> None:
        direct = self._direct
        sent, received = map(int, self.byte_counts())
        direct.sent_bytes_before += sent
        direct.received_bytes_before += received

    def rejected(self) -> dict[str, int]:
        return {cause: count + self._earlier[cause] for cause, count in self._here.rejected.items()}

    def reopen(self) -> None:
        self._stream.reopen()
        # A partial frame and the gap in the running number belong to the line that was lost.
        self._earlier = Counter(self.rejected())
        self._begin_line()

    def describe(self) -> str:
        return self._stream.describe()

    def close(self) -> None:
        self._is_open = False
        self._stream.close()


def _unsendable_step(ticks: int) -> ValueError:
    return ValueError(f"a step of {ticks} ticks; expected at most {MOST_TICKS}, and room in the client")
