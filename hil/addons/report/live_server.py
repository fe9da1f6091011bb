"""The server of live views: a run's rows on a port of this machine, thinned and in batches.

A viewer that connects late gets the messages kept by the server. So the size of a message decides how far back it sees.
"""

import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import rerun as rr

from hil.addons.report.decimate import Decimator
from hil.addons.report.run_drawing import RunDrawing
from hil.addons.report.viewer import HOST
from hil.record.ring import Rows
from hil.record.stream import Stream

LIVE_PERIOD_S = 0.02
BATCH_S = 0.5
"""How long rows are collected: a message costs about 1.7 kB and a viewer's time, whatever is in it."""
_QUEUE_LENGTH = 500
MEMORY_LIMIT = "512MiB"
"""Half an hour of a run with 33 entities needs 0.4 GB."""
_CLOSE_TIMEOUT_S = 2.0


class LiveServer:
    """A gRPC server on 127.0.0.1 with the run's rows at 50 Hz, in a thread of its own; registered as ``live``.

    Viewers pull the data. The server's memory and the queue to the thread are bounded and drop the oldest data first,
    so the recorder never waits for a viewer. Raises OSError for a port that is in use.
    """

    def __init__(self, port: int, *, recording_id: str, signals: Sequence[str], properties: Mapping[str, str]) -> None:
        rr.set_strict_mode(True)
        _check_port(port)
        sink = rr.GrpcServerSink(HOST, port, server_memory_limit=MEMORY_LIMIT)
        self._stream = Stream(
            sink,
            recording_id=recording_id,
            signals=signals,
            properties=properties,
            make_drawing=RunDrawing,
            live=True,
        )
        self._t_column = list(signals).index("loop.t_s")
        self._decimator = Decimator(LIVE_PERIOD_S)
        self._queue: deque[Rows | Callable[[], None]] = deque(maxlen=_QUEUE_LENGTH)
        self._closing = threading.Event()
        self.error: str | None = None
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)
        self._thread.start()

    def rows(self, rows: Rows) -> None:
        """Queue rows of shape (n, signals); one per 20 ms of scenario time is served."""
        kept = rows[self._decimator.keep(rows[:, self._t_column])]
        if len(kept):
            self._queue.append(kept)

    def event(self, t_s: float, level: str, text: str) -> None:
        """Queue a line of the event log."""
        self._queue.append(lambda: self._stream.event(t_s, level, text))

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Queue the run's summary; all is served until ``close``."""
        self._queue.append(lambda: self._stream.finish(summary, recorder))

    def close(self) -> None:
        """Stop serving; gives up on what could not be handed over within two seconds."""
        self._closing.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        try:
            while not self._closing.wait(BATCH_S):
                self._serve()
            self._serve()
            self._stream.close()
        except RuntimeError as error:
            self.error = str(error)

    def _serve(self) -> None:
        """Serve the queue: consecutive rows as one batch."""
        batch: list[Rows] = []
        while self._queue:
            item = self._queue.popleft()
            if callable(item):
                self._draw(batch)
                item()
            else:
                batch.append(item)
        self._draw(batch)

    def _draw(self, batch: list[Rows]) -> None:
        if batch:
            self._stream.draw(np.concatenate(batch))
            batch.clear()


def _check_port(port: int) -> None:
    """Raise OSError for a port in use: rerun binds it later, in a thread, and reports that only in its log."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
