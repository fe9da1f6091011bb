"""The run's side of a trace: gives what is on the wire to a process that writes it, and takes its report."""

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from firmware_protocol.framing import Frame
from hil.core.outputs import Existing, claim, release
from hil.core.ports import EXTENDED, REMOTE
from hil.core.subprocesses import child_environment
from hil.record.files import check_output_path
from hil.record.ring_process import RingProcess
from hil.record.ring_start import Started
from hil.wire.trace import rows

_CAPACITY = 16384


@dataclass(frozen=True, slots=True)
class TraceReport:
    """What became of a trace.

    Attributes:
        path: the file.
        frames: frames that are in it, error frames among them.
        dropped: frames that the writer was too slow to take.
        lost: frames that were taken, but are not known to be in the file.
        error: what went wrong with the writer, or None.
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

    def trouble(self) -> str | None:
        """Return in one sentence what is missing, or None."""
        if self.complete:
            return None
        why = self.error or "the writer was too slow"
        counts = f"{self.dropped} frames were dropped and {self.lost} lost, {self.frames} are safe in it"
        return f"trace {self.path} is incomplete: {why}; {counts}"


class Trace:
    """Writes what is on the wire to a file for bus tools, in a process of its own; a context manager.

    The ending of ``path`` tells the format. ``fd`` says that our frames go in CAN FD frames, ``switched`` that these
    have a bit rate of their own for the data. With ``blocking``, as in lockstep, frames wait for room; else they are
    dropped, and counted. When the run dies, the file is finished with what it gave. ``existing`` says what is done
    where the file is there already.

    Raises BadInputError when the file cannot be written, DeviceError when the process does not start.
    """

    def __init__(
        self,
        path: Path,
        *,
        blocking: bool,
        fd: bool = False,
        switched: bool = False,
        existing: Existing = "refuse",
    ) -> None:
        check_output_path("trace", path, existing)
        self._path = path = claim("trace", path, existing)
        self._zero_unix_us = 0
        self._flags = rows.FD * fd + rows.SWITCHED * (fd and switched)
        self._report: TraceReport | None = None
        try:
            self._process = RingProcess(
                Started("hil.wire.trace.writer", child_environment()),
                {"path": str(path.absolute())},
                width=rows.WIDTH,
                capacity=_CAPACITY,
                blocking=blocking,
                name="the writer of the trace",
                remedy="run without --trace to go on",
            )
        except BaseException:
            release(path, existing)
            raise

    @property
    def pid(self) -> int:
        """Process id of the writer."""
        return self._process.pid

    def begin(self, zero_unix_ns: int) -> None:
        """Say at what Unix time the clock of the stamps was zero."""
        self._zero_unix_us = zero_unix_ns // 1000

    def frame(self, stamp_ns: int, frame: Frame, *, sent: bool) -> None:
        """Take one of our frames. What only a serial line carries is in the trace as CAN FD, in pieces of 64 bytes."""
        number, payload = frame
        if len(payload) > rows.MOST_BYTES:
            for at in range(0, len(payload), rows.MOST_BYTES):
                self.frame(stamp_ns, Frame(number, payload[at : at + rows.MOST_BYTES]), sent=sent)
            return
        flags = self._flags + rows.SENT * sent
        if len(payload) > rows.MOST_CLASSIC_BYTES:
            flags |= rows.FD  # of a frame without it Vector's formats keep the first eight bytes
        if number >= REMOTE:
            flags += rows.EXTENDED * (number >= EXTENDED) + rows.REMOTE * bool(number & REMOTE)
            number &= ~(EXTENDED | REMOTE)
        self._process.put(rows.pack(self._zero_unix_us + stamp_ns // 1000, flags, number, len(payload), payload))

    def foreign(self, stamp_ns: int, message: Any) -> None:
        """Take a ``can.Message`` that is none of ours."""
        self._process.put(rows.pack_message(self._zero_unix_us + stamp_ns // 1000, message))

    def rejected(self, stamp_ns: int, count: int) -> None:
        """Take note of so many frames that the framing could not read: each becomes an error frame."""
        row = rows.pack(self._zero_unix_us + stamp_ns // 1000, rows.ERROR, 0, 0, b"")
        for _ in range(count):
            self._process.put(row)

    def finish(self) -> TraceReport:
        """Have the rest written, end the process and return the report; never raises for a writer that died."""
        if self._report is None:
            process = self._process
            reply = process.finish({"finish": {}, "keep_live": False})
            written = int(reply["rows_written"]) if "rows_written" in reply else process.rows_saved
            self._report = TraceReport(
                self._path, written, process.rows_dropped, process.rows_taken - written, reply.get("error")
            )
            process.close()
        return self._report

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        if self._report is None:
            self.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
