"""The trace of a link: a thread writes the frames on the wire to a file for bus tools, with python-can's writers."""

import queue
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

import can

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, claim, release
from hil.core.ports import EXTENDED, REMOTE
from hil.record.files import check_output_path, why_not_written

_CAPACITY = 16384  # of the queue; an item is what crossed the wire together
_MOST_CLASSIC_BYTES, _MOST_BYTES = 8, 64


class Trace:
    """Writes the frames on the wire to a file for bus tools, in a thread of its own; a context manager.

    The extension of ``path`` sets the format. ``fd``: the link uses CAN FD frames; ``switched``: their data has its own
    bit rate. When the queue to the thread is full, ``blocking`` (as in lockstep) waits; otherwise frames are dropped
    and counted. ``existing`` says what to do when the file exists already. After the first failure to write, the rest
    is discarded and counted: the run goes on.

    Raises BadInputError when the file cannot be written.
    """

    def __init__(
        self, path: Path, *, blocking: bool, fd: bool = False, switched: bool = False, existing: Existing = "refuse"
    ) -> None:
        check_output_path("trace", path, existing)
        self._path = path = claim("trace", path, existing)
        self._zero_unix_us = 0
        self._blocking, self._is_fd, self._is_switched = blocking, fd, fd and switched
        self._is_open = True
        self._frames = self._dropped = self._lost = 0
        self._unsafe = 0  # frames given to python-can, but perhaps not yet in the file: lost if it fails before that
        self._error: str | None = None
        try:
            self._file: Any = can.Logger(path)
        except OSError as error:
            release(path, existing)
            raise BadInputError(f"trace {path}: {error.strerror}; choose a path that can be written") from error
        # Frames that crossed together, their Unix time [µs], and whether they were sent; or a foreign message.
        self._queue: queue.Queue[tuple[int, Sequence[Frame] | can.Message, bool] | None] = queue.Queue(_CAPACITY)
        self._thread = threading.Thread(target=self._run, name="trace", daemon=True)
        self._thread.start()

    def begin(self, zero_unix_ns: int) -> None:
        """Set the Unix time at which the run's clock was zero; time stamps are times of that clock."""
        self._zero_unix_us = zero_unix_ns // 1000

    def frames(self, stamp_ns: int, frames: Sequence[Frame], *, sent: bool) -> None:
        """Trace frames of this link, which crossed the wire together."""
        self._put(stamp_ns, frames, len(frames), sent=sent)

    def foreign(self, stamp_ns: int, message: can.Message) -> None:
        """Trace a message that is not of this link's protocol."""
        self._put(stamp_ns, message, 1, sent=False)

    def _put(self, stamp_ns: int, item: Sequence[Frame] | can.Message, frames: int, *, sent: bool) -> None:
        try:
            self._queue.put((self._zero_unix_us + stamp_ns // 1000, item, sent), block=self._blocking)
        except queue.Full:
            self._dropped += frames

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            unix_us, content, sent = item
            if isinstance(content, can.Message):
                content.timestamp = unix_us * 1e-6
                self._write(content)
            else:
                for frame in content:
                    for message in self._messages_of(frame, unix_us * 1e-6, sent=sent):
                        self._write(message)
            # Keeps the file valid up to here if the process dies; a BLF file is written in blocks.
            if self._queue.empty() and self._error is None and self._path.suffix != ".blf":
                self._settle(self._file.file.flush)

    def _messages_of(self, frame: Frame, unix_s: float, *, sent: bool) -> Iterator[can.Message]:
        """Yield the messages of a frame: several of CAN FD for a payload that only a serial line can carry."""
        number, payload = frame
        extended, remote = number >= EXTENDED, bool(number & REMOTE)
        for at in range(0, len(payload) or 1, _MOST_BYTES):
            data = payload[at : at + _MOST_BYTES]
            yield can.Message(
                timestamp=unix_s,
                arbitration_id=number & ~(EXTENDED | REMOTE),
                is_extended_id=extended,
                is_remote_frame=remote,
                # Without this flag Vector's formats keep only the first eight bytes.
                is_fd=self._is_fd or len(payload) > _MOST_CLASSIC_BYTES,
                bitrate_switch=self._is_switched,
                is_rx=not sent,
                data=None if remote else data,
                dlc=len(data),
            )

    def _write(self, message: can.Message) -> None:
        if self._error is None and self._attempt(self._file.on_message_received, message):
            self._unsafe += 1
        else:
            self._lost += 1

    def _settle(self, write: Any) -> None:
        """Flush or close the file by ``write``, and count the frames given to python-can so far as safe or lost."""
        if self._attempt(write) and self._error is None:
            self._frames += self._unsafe
        else:
            self._lost += self._unsafe
        self._unsafe = 0

    def _attempt(self, write: Any, *arguments: Any) -> bool:
        """Write to the file; keep the text of the first failure. Return whether it succeeded."""
        try:
            write(*arguments)
        except OSError as error:
            self._error = self._error or why_not_written(self._path, error)
        except Exception as error:  # noqa: BLE001 - as for a number that the format cannot hold; the run goes on
            self._error = self._error or f"python-can's writer refused a frame: {error}"
        else:
            return True
        return False

    def finish(self) -> dict[str, Any]:
        """Write the rest, close the file, and return the trace's figures for the run; may be called repeatedly.

        Numbers of frames: ``frames`` in the file, error frames included; ``dropped`` because the writer was too slow;
        ``lost`` because it failed. ``trouble`` is a sentence on what is missing, or None.
        """
        if self._is_open:
            self._is_open = False
            self._queue.put(None)
            self._thread.join()
            self._settle(self._file.stop)
        counts = {"frames": self._frames, "dropped": self._dropped, "lost": self._lost}
        trouble = None
        if self._error is not None or self._dropped:
            missing = f"{self._dropped} frames were dropped and {self._lost} lost, {self._frames} are safe in it"
            trouble = f"trace {self._path} is incomplete: {self._error or 'the writer was too slow'}; {missing}"
        return {"path": str(self._path), **counts, "trouble": trouble}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.finish()
