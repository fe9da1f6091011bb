"""A trace at the robot's end: a wire that shows what crosses it, for ``hil device --trace``."""

from collections.abc import Callable, Sequence

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import HostLine
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Framing
from hil.wire.robot_end import Node, Wire
from hil.wire.trace.session import Trace


class TracedWire:
    """Shows a trace every frame between a transport and a firmware. ``now_ns`` is the robot's clock."""

    def __init__(self, wire: Wire, trace: Trace, now_ns: Callable[[], int], protocol: LinkProtocol = WHEEL_DBC) -> None:
        self._wire = wire
        self._ear = _Ear(trace, now_ns, protocol)

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        return self._wire.receive_into(_Tapped(node, self._ear), timeout_ns)

    def send_from(self, node: Node) -> None:
        self._wire.send_from(_Tapped(node, self._ear))

    def drop_from(self, node: Node) -> None:
        self._wire.drop_from(node)

    def close(self) -> None:
        self._wire.close()


class _Ear:
    """Listens in: bytes of a serial line are read with a framing of its own, one for each direction."""

    def __init__(self, trace: Trace, now_ns: Callable[[], int], protocol: LinkProtocol) -> None:
        self._trace = trace
        self._now_ns = now_ns
        make_framing = protocol.make_framing or HostLine
        self._received = make_framing()
        self._sent = make_framing()

    def hear_bytes(self, data: bytes, *, sent: bool) -> None:
        framing = self._sent if sent else self._received
        before = _noise(framing)
        self.hear(framing.feed(data), sent=sent)
        if noise := _noise(framing) - before:
            self._trace.rejected(self._now_ns(), noise)

    def hear(self, frames: Sequence[Frame], *, sent: bool) -> None:
        now_ns = self._now_ns()
        for frame in frames:
            self._trace.frame(now_ns, frame, sent=sent)


def _noise(framing: Framing) -> int:
    return sum(count for cause, count in framing.rejected.items() if cause != "lost")


class _Tapped:
    """A firmware with an ear at its end of the wire. What comes is heard before the firmware acts on it."""

    def __init__(self, node: Node, ear: _Ear) -> None:
        self._node = node
        self._ear = ear

    def feed(self, data: bytes) -> None:
        self._ear.hear_bytes(data, sent=False)
        self._node.feed(data)

    def receive(self, frame: Frame) -> None:
        self._ear.hear([frame], sent=False)
        self._node.receive(frame)

    def take_bytes(self) -> bytes:
        data = self._node.take_bytes()
        if data:
            self._ear.hear_bytes(data, sent=True)
        return data

    def take_frames(self) -> list[Frame]:
        frames = self._node.take_frames()
        self._ear.hear(frames, sent=True)
        return frames

    def count_unsent(self, frames: int) -> None:
        self._node.count_unsent(frames)
