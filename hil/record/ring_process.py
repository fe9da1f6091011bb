"""The recorder process as the run sees it: rows go to it through a ring, lines through a pipe.

If the run dies, the recorder finishes its file on its own. If it dies, the run goes on and another one is started, at
most six times in a row, after a pause of 0.1 s that doubles each time: unsaved rows are still in the ring, and unsaved
lines are sent again. ``hil.record.recorder`` is the other side.
"""

import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Self, cast

from hil.core.errors import BadInputError, DeviceError
from hil.core.subprocesses import start_children_as_ordinary
from hil.record.ring import RingWriter, Row, ring_bytes
from hil.record.started_process import StallTimeout, StartedProcess

_STALL_WAITS = 60_000  # of 0.5 ms, without any progress of the other process: about 30 s
_WAITS_A_TURN = 11  # as many waits take as long as 5 ms for a reply and one wait
_FLUSH_PERIOD_S = 0.005
_EXIT_TIMEOUT_S = 10.0
_STARTS_IN_A_ROW = 6
_FIRST_BACK_OFF_S = 0.1
_LONG_LIFE_S = 60.0  # after a longer life the starts are counted from one again


class RingProcess:
    """Sends rows and lines to a ``StartedProcess``, receives its report; a context manager. Raises as ``wait_ready``.

    Args:
        config: settings of the process, as JSON values.
        blocking: ``put`` waits while the ring is full (for lockstep); otherwise it drops the row and counts it.
        wait: return when the process is ready. Otherwise return at once: rows wait in the ring, and ``put`` calls
            ``wait_ready`` when the ring is full, ``end`` in any case.

    Attributes:
        put: takes one row; raises ValueError when its width is wrong.
        ring: the ring; it counts the rows that were put, saved and dropped.
        restarts: how often the process was started again.
        troubles: for each process that died, how it ended, as text.
    """

    def __init__(
        self,
        started: StartedProcess,
        config: Mapping[str, object],
        *,
        width: int,
        capacity: int,
        blocking: bool,
        wait: bool,
    ) -> None:
        self._waits = blocking
        self._restart = True
        self._child = started
        size = ring_bytes(capacity, width)
        self.ring = RingWriter(started.block.allocate(size), capacity, width, self._put_later)
        self.put = cast(Callable[[Row], None], self.ring.try_put)
        self._config = {**config, "block": started.block.token, "block_bytes": size, "parent_pid": os.getpid()}
        self._swap = threading.Lock()  # held while lines are sent, and while the process is replaced
        self._unsent: deque[Mapping[str, object]] = deque()
        self._unsaved: deque[Mapping[str, object]] = deque()
        self._failing: str | None = None
        self._lines_dropped = 0
        self._lines_seen_saved = 0
        self._reports: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._gone = threading.Event()
        self.restarts = 0
        self.troubles: list[str] = []
        self._last_line: Mapping[str, object] | None = None
        self._first_reply: Mapping[str, Any] = {}
        self._takes_lines = True  # False while the process is replaced
        self._send_config()
        self._keeper = threading.Thread(target=self._keep, name="keeper", daemon=True)
        self._keeper.start()
        if wait:
            try:
                self.wait_ready()
            except BaseException:  # also for KeyboardInterrupt: the shared memory must be freed
                self.close()
                raise

    @property
    def pid(self) -> int:
        """Process id; after a restart, that of the newest."""
        return self._child.process.pid

    @property
    def lines_lost(self) -> int:
        """Lines that are not known to be safe, including those that are still being sent."""
        with self._swap:
            self._send_unsent()
            return self._lines_dropped + len(self._unsaved) + self.ring.lines_lost

    @property
    def failing(self) -> str | None:
        """Why the process cannot write at present, as it reports, or why it has ended; else None."""
        if self._gone.is_set() and not self._closing.is_set() and self.troubles:
            return f"the recorder ended: {self.troubles[-1]}"
        return self._failing

    def wait_ready(self) -> None:
        """Wait until the process is ready. Raises BadInputError if it refuses the config, DeviceError if it never is.

        Every later call does the same.
        """
        if not self._first_reply:
            self._first_reply = self._report()
        if "refused" in self._first_reply:
            raise BadInputError(str(self._first_reply["refused"]))
        if not self._first_reply:
            raise DeviceError(f"the recorder did not start: {self.troubles[-1]}; run without a recording to go on")

    def send(self, record: Mapping[str, object]) -> None:
        """Send a line. Waits for room in the pipe where ``put`` waits for room in the ring, and never for a restart."""
        stall = StallTimeout(_STALL_WAITS)
        while self._waits and not self._gone.is_set() and not self._has_room():
            if not stall.wait((self._child.lines.kept_back, self.restarts)):
                break
        self._unsent.append(record)
        self._send_waiting()

    def _has_room(self) -> bool:
        with self._swap:
            return not self._takes_lines or self._child.lines.flush()

    def end(self, summary: Mapping[str, object], *, keep_live: bool = False) -> dict[str, Any]:
        """Send the last line, with the run's summary, and return the process's report.

        With ``keep_live`` the process serves live viewers until ``close``. If the process died, the report has
        ``error`` alone; no exception is raised, except as by ``wait_ready``.
        """
        self.wait_ready()
        with self._swap:
            self._send_unsent()
            self._last_line = {"finish": dict(summary), "keep_live": keep_live}
            if self._takes_lines:
                self._child.lines.send(self._last_line, always=True)
        return self._report() or {"error": f"the recorder ended before the run: {self.troubles[-1]}"}

    def close(self) -> None:
        """End the process, with or without a report, and free everything. Closing twice is allowed."""
        self._closing.set()
        with self._swap:
            self._child.end_lines()
        self._keeper.join(_EXIT_TIMEOUT_S)  # it waits for the end of the process without polling, unlike Popen
        if self._keeper.is_alive():
            self._child.process.kill()
            self._keeper.join()
        self._child.close()
        self.ring.close()
        self._child.block.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send_config(self) -> None:
        self._child.lines.send({**self._config, "restarts": self.restarts}, always=True)

    def _report(self) -> dict[str, Any]:
        """Return the next reply; empty when the process has ended for good, or was killed for lack of progress."""
        stall = StallTimeout(_STALL_WAITS // _WAITS_A_TURN)
        while True:
            ended = self._gone.is_set()
            try:
                return self._reports.get(timeout=0.005)
            except queue.Empty:
                if ended:
                    return {}
            with self._swap:
                flushed = self._child.lines.flush()
            if not stall.wait((flushed, self.ring.tail, self.restarts)):
                self._restart = False
                self._child.process.kill()

    def _keep(self) -> None:
        """Receive replies, and start the process again when it ends too early; the body of the keeper thread."""
        start_children_as_ordinary()
        self._flush_all()
        starts = 0
        was_ready = finished = False
        while True:
            reply = self._child.replies.read()
            if reply is not None:
                if "failing" in reply:
                    self._failing = cast("str | None", reply["failing"])
                elif was_ready and "ready" in reply:
                    self._send_again()
                    self._flush_all()
                else:
                    self._reports.put(reply)
                    was_ready = "ready" in reply
                    finished = not was_ready
                continue
            trouble = self._child.trouble()
            if finished or self._closing.is_set():
                break
            self.troubles.append(trouble)
            starts = 1 if time.monotonic() - self._child.started_s > _LONG_LIFE_S else starts + 1
            if not (self._restart and was_ready) or starts > _STARTS_IN_A_ROW:
                break
            if self._closing.wait(_FIRST_BACK_OFF_S * 2 ** (starts - 1)) or not self._start_next():
                break
            self._flush_all()
        self._gone.set()

    def _start_next(self) -> bool:
        """Replace the process that ended by a new one; False when that fails, or the run is over."""
        with self._swap:
            if self._closing.is_set():
                return False
            self._child.close()
            self._takes_lines = False
            try:
                self._child = self._child.again()
            except OSError as error:
                self.troubles.append(f"the recorder could not be started again: {error}")
                return False
            self.restarts += 1
            self._failing = None
            self._send_config()
        self._send_waiting()
        return True

    def _send_again(self) -> None:
        """Send the lines that the last process had not saved to the new one, which is ready now."""
        with self._swap:
            if self._closing.is_set():
                return
            self._takes_lines = True
            self._forget_saved_lines()
            for record in self._unsaved if self._last_line is None else [*self._unsaved, self._last_line]:
                self._child.lines.send(record, always=True)
        self._send_waiting()

    def _send_waiting(self) -> None:
        """Send the unsent lines, unless another thread holds ``_swap``: that thread calls this after it releases it."""
        while self._unsent and self._swap.acquire(blocking=False):
            try:
                self._send_unsent()
            finally:
                self._swap.release()

    def _send_unsent(self) -> None:
        self._forget_saved_lines()
        while self._unsent:
            record = self._unsent.popleft()
            if not self._gone.is_set() and (not self._takes_lines or self._child.lines.send(record)):
                self._unsaved.append(record)
            else:
                self._lines_dropped += 1

    def _flush_all(self) -> None:
        """Write what the pipe did not take at once, such as a large config or many lines."""
        while True:
            with self._swap:
                is_done = self._closing.is_set() or self._child.lines.flush()
            self._send_waiting()
            if is_done:
                return
            self._closing.wait(_FLUSH_PERIOD_S)

    def _forget_saved_lines(self) -> None:
        while self._unsaved and self._lines_seen_saved < self.ring.lines_saved:
            self._unsaved.popleft()
            self._lines_seen_saved += 1

    def _put_later(self, row: Row) -> bool:
        """With ``blocking`` wait for room; otherwise, or when the process stalls, drop the row and count it.

        Raises as ``wait_ready``.
        """
        self.wait_ready()
        stall = StallTimeout(_STALL_WAITS)
        while self._waits and not self._gone.is_set() and stall.wait((self.ring.tail, self.restarts)):
            if not self.ring.full:
                return self.ring.try_put(row)
        self._waits = False
        self.ring.count_dropped()
        return False
