"""The trace of a link, at the host's end or the robot's: a process writes the frames on the wire to a file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import HostLine, PackedFrames
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.outputs import Existing, claim, release
from hil.core.ports import EXTENDED, REMOTE, Framing
from hil.core.subprocesses import child_environment
from hil.record.files import check_output_path
from hil.record.ring_process import RingProcess
from hil.record.started_process import StartedProcess
from hil.wire.framed import noise_of
from hil.wire.robot_end import Node, Wire
from hil.wire.trace import packing

_CAPACITY = 16384


@dataclass(frozen=True, slots=True)
class TraceReport:
    """The result of a trace.

    Attributes:
        path: the file.
        frames: frames in the file, including error frames.
        dropped: frames that were dropped because the writer was too slow.
        lost: frames that were passed to the writer, but may not be in the file.
        error: the writer's error, or None.
    """

    path: Path
    frames: int
    dropped: int
    lost: int
    error: str | None

    @property
    def complete(self) -> bool:
        """Whether everything that was on the wire is in the file."""
        return self.error is None and not (self.dropped or self.lost)

    def figures(self) -> dict[str, Any]:
        """Return the report as figures of a run."""
        counts = {"frames": self.frames, "dropped": self.dropped, "lost": self.lost}
        return {"path": str(self.path), **counts, "trouble": self.trouble()}

    def trouble(self) -> str | None:
        """Return a sentence on what is missing, or None."""
        if self.complete:
            return None
        why = self.error or "the writer was too slow"
        counts = f"{self.dropped} frames were dropped and {self.lost} lost, {self.frames} are safe in it"
        return f"trace {self.path} is incomplete: {why}; {counts}"


class Trace:
    """Writes the frames on the wire to a file for bus tools, in its own process; a context manager.

    The extension of ``path`` sets the format. ``fd``: the link uses CAN FD frames; ``switched``: their data has its own
    bit rate. With ``blocking``, as in lockstep, frames wait for room; otherwise they are dropped and counted. When the
    run dies, the process still finishes the file. ``existing`` says what to do when the file exists already.

    Raises BadInputError when the file cannot be written, DeviceError when the process does not start.
    """

    def __init__(
        self, path: Path, *, blocking: bool, fd: bool = False, switched: bool = False, existing: Existing = "refuse"
    ) -> None:
        check_output_path("trace", path, existing)
        self._path = path = claim("trace", path, existing)
        self._zero_unix_us = 0
        self._flags = packing.FD * fd + packing.SWITCHED * (fd and switched)
        self._packed_flags = self._flags + packing.PACKED, self._flags + packing.PACKED + packing.SENT
        self._report: TraceReport | None = None
        self._passed = self._dropped = 0  # frames
        try:
            self._process = RingProcess(
                StartedProcess("hil.wire.trace.writer", child_environment()),
                {"path": str(path.absolute())},
                width=packing.WIDTH,
                capacity=_CAPACITY,
                blocking=blocking,
                name="the writer of the trace",
                remedy="run without --trace to go on",
            )
        except BaseException:
            release(path, existing)
            raise
        self._try_put = self._process.ring.try_put

    @property
    def pid(self) -> int:
        """Process id of the writer."""
        return self._process.pid

    def begin(self, zero_unix_ns: int) -> None:
        """Set the Unix time at which the clock of the time stamps was zero."""
        self._zero_unix_us = zero_unix_ns // 1000

    def frames(self, stamp_ns: int, frames: Sequence[Frame], *, sent: bool) -> None:
        """Trace frames of this link, which crossed the wire together."""
        if type(frames) is PackedFrames and (length := len(frames.packed)) <= packing.MOST_PACKED:
            stamp_us, flags = self._zero_unix_us + stamp_ns // 1000, self._packed_flags[sent]
            self._put(packing.pack(stamp_us, flags, 0, length, frames.packed), len(frames))
            return
        for frame in frames:
            self.frame(stamp_ns, frame, sent=sent)

    def _put(self, row: bytes, frames: int = 1) -> None:
        """Give the writer a row with so many frames, or count them as dropped."""
        if self._try_put(row):
            self._passed += frames
        else:
            self._dropped += frames

    def frame(self, stamp_ns: int, frame: Frame, *, sent: bool) -> None:
        """Trace a frame of this link. A payload that only a serial line can carry becomes several CAN FD frames."""
        number, payload = frame
        if len(payload) > packing.MOST_BYTES:
            for at in range(0, len(payload), packing.MOST_BYTES):
                self.frame(stamp_ns, Frame(number, payload[at : at + packing.MOST_BYTES]), sent=sent)
            return
        flags = self._flags + packing.SENT * sent
        if len(payload) > packing.MOST_CLASSIC_BYTES:
            flags |= packing.FD  # without this flag Vector's formats keep only the first eight bytes
        if number >= REMOTE:
            flags += packing.EXTENDED * (number >= EXTENDED) + packing.REMOTE * bool(number & REMOTE)
            number &= ~(EXTENDED | REMOTE)
        self._put(packing.pack(self._zero_unix_us + stamp_ns // 1000, flags, number, len(payload), payload))

    def foreign(self, stamp_ns: int, message: Any) -> None:
        """Trace a ``can.Message`` that is not of this link's protocol."""
        self._put(packing.pack_message(self._zero_unix_us + stamp_ns // 1000, message))

    def rejected(self, stamp_ns: int, count: int) -> None:
        """Trace ``count`` frames that the framing could not decode, each as an error frame."""
        row = packing.pack(self._zero_unix_us + stamp_ns // 1000, packing.ERROR, 0, 0, b"")
        for _ in range(count):
            self._put(row)

    def finish(self) -> TraceReport:
        """Write the rest, end the process and return the report; raises no error for a writer that died."""
        if self._report is None:
            process = self._process
            reply = process.end({})
            written = int(reply.get("frames_written", process.ring.lines_saved))
            error = reply.get("error")
            self._report = TraceReport(self._path, written, self._dropped, self._passed - written, error)
            process.close()
        return self._report

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        if self._report is None:
            self.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class TracedWire:
    """Traces every frame between a transport and a firmware. ``now_ns`` is the robot's clock."""

    def __init__(self, wire: Wire, trace: Trace, now_ns: Callable[[], int], protocol: LinkProtocol = WHEEL_DBC) -> None:
        self._wire = wire
        self._traced = _TracedNode(trace, now_ns, protocol.make_framing or HostLine)

    def receive_into(self, node: Node, timeout_ns: int) -> bool:
        self._traced.node = node
        return self._wire.receive_into(self._traced, timeout_ns)

    def send_from(self, node: Node) -> None:
        self._traced.node = node
        self._wire.send_from(self._traced)

    def close(self) -> None:
        self._wire.close()


class _TracedNode:
    """Wraps a firmware, ``node``, and traces its end of the wire. Input is traced before the firmware acts on it.

    Bytes of a serial line are decoded here once more, each direction with its own framing.
    """

    node: Node

    def __init__(self, trace: Trace, now_ns: Callable[[], int], make_framing: Callable[[], Framing]) -> None:
        self._trace = trace
        self._now_ns = now_ns
        self._received, self._sent = make_framing(), make_framing()

    def feed(self, data: bytes) -> None:
        self._trace_bytes(self._received, data)
        self.node.feed(data)

    def receive(self, frame: Frame) -> None:
        self._trace_frames([frame], sent=False)
        self.node.receive(frame)

    def take_bytes(self) -> bytes:
        data = self.node.take_bytes()
        if data:
            self._trace_bytes(self._sent, data)
        return data

    def take_frames(self) -> list[Frame]:
        frames = self.node.take_frames()
        self._trace_frames(frames, sent=True)
        return frames

    def count_unsent(self, frames: int) -> None:
        self.node.count_unsent(frames)

    def _trace_bytes(self, framing: Framing, data: bytes) -> None:
        before = noise_of(framing)
        self._trace_frames(framing.feed(data), sent=framing is self._sent)
        if noise := noise_of(framing) - before:
            self._trace.rejected(self._now_ns(), noise)

    def _trace_frames(self, frames: Sequence[Frame], *, sent: bool) -> None:
        self._trace.frames(self._now_ns(), frames, sent=sent)
