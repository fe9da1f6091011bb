"""Serving a run to live viewers, on this machine only, in a thread of its own.

Viewers pull; with none, or a frozen one, the server's memory is bounded and the oldest data go first. The
queue to the thread is bounded in the same way: whatever a viewer does, the file's recorder never waits for
it.
"""

import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import rerun as rr

from hil.record.decimate import Decimator
from hil.record.ring import Rows
from hil.record.stream import Stream

LIVE_PERIOD_S = 0.01
HOST = "127.0.0.1"
_QUEUE_LENGTH = 500
_MEMORY_LIMIT = "256MiB"
_CLOSE_TIMEOUT_S = 2.0


class LiveServer:
    """A gRPC server on 127.0.0.1 with the run's rows at 100 Hz. Raises OSError for a port that is in use."""

    def __init__(self, port: int, *, recording_id: str, signals: Sequence[str], properties: Mapping[str, str]) -> None:
        rr.set_strict_mode(True)
        _check_port(port)
        self._stream = Stream(
            rr.GrpcServerSink(HOST, port, server_memory_limit=_MEMORY_LIMIT),
            recording_id=recording_id,
            signals=signals,
            properties=properties,
            live=True,
        )
        self._t_column = list(signals).index("loop.t_s")
        self._decimator = Decimator(LIVE_PERIOD_S)
        self._queue: deque[Callable[[], None]] = deque(maxlen=_QUEUE_LENGTH)
        self._wake = threading.Event()
        self._closing = False
        self.error: str | None = None
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)
        self._thread.start()

    def rows(self, rows: Rows) -> None:
        """Queue rows of shape (n, signals); one each 10 ms of scenario time is served."""
        kept = rows[self._decimator.keep(rows[:, self._t_column])]
        if len(kept):
            self._put(lambda: self._stream.draw(kept))

    def event(self, t_s: float, level: str, text: str) -> None:
        """Queue a line of the event log."""
        self._put(lambda: self._stream.event(t_s, level, text))

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Queue the run's summary; what was queued stays served until ``close``."""
        self._put(lambda: self._stream.finish(summary, recorder))

    def close(self) -> None:
        """Stop serving; gives up on what could not be handed over within two seconds."""
        self._closing = True
        self._wake.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _put(self, write: Callable[[], None]) -> None:
        self._queue.append(write)
        self._wake.set()

    def _run(self) -> None:
        try:
            while not self._closing or self._queue:
                self._wake.wait()
                self._wake.clear()
                while self._queue:
                    self._queue.popleft()()
            self._stream.close()
        except RuntimeError as error:
            self.error = str(error)


def _check_port(port: int) -> None:
    """rerun binds later, in a thread, and says so only in its log."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
