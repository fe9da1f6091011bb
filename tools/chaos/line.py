"""A cable that may be bad: a TCP server on loopback in front of the robot's pseudo-terminal."""

import os
import random
import select
import socket
import threading
import time
from collections import deque
from pathlib import Path

_CHUNK = 4096
_LATEST_S = 0.1


class Line:
    """Passes bytes between one host, at ``url``, and the robot at ``robot``, and spoils them as configured.

    The attributes may be changed at any time: ``loss`` is the share of chunks that vanish, ``late_s`` by how much each
    chunk is delayed at most, ``is_cut`` drops the host and takes no other one.
    """

    def __init__(self, robot: Path, rng: random.Random) -> None:
        self._robot = robot
        self._rng = rng
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"serial:socket://127.0.0.1:{self._server.getsockname()[1]}"
        self.loss = self.late_s = 0.0
        self.is_cut = False
        self._flood: deque[bytes] = deque()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="line", daemon=True)
        self._thread.start()

    def flood(self, data: bytes) -> None:
        """Put bytes of somebody else on the line towards the robot."""
        self._flood.append(data)

    def mend(self) -> None:
        """Be a good cable again."""
        self.loss = self.late_s = 0.0
        self.is_cut = False

    def close(self) -> None:
        """Drop the host and end. Closing twice is allowed."""
        self._ends.set()
        self._thread.join()
        self._server.close()

    def _run(self) -> None:
        self._server.settimeout(_LATEST_S)
        while not self._ends.is_set():
            try:
                host, _ = self._server.accept()
            except TimeoutError:
                continue
            with host:
                if not self.is_cut:
                    self._pass_on(host)

    def _pass_on(self, host: socket.socket) -> None:
        """Pass bytes on until either side ends or the line is cut."""
        try:
            robot = os.open(self._robot, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:  # the robot is being started again: the host tries later
            return
        host.setblocking(False)
        waiting: deque[tuple[float, int, bytes]] = deque()
        try:
            while not self._ends.is_set() and not self.is_cut:
                while self._flood:
                    _write(robot, self._flood.popleft())
                ready, _, _ = select.select([host.fileno(), robot], [], [], 0.002)
                now_s = time.monotonic()
                for end, to in ((host.fileno(), robot), (robot, host.fileno())):
                    if end not in ready:
                        continue
                    data = os.read(end, _CHUNK)
                    if not data:
                        return
                    if self.loss and self._rng.random() < self.loss:
                        continue
                    # Not before what was sent earlier: a cable does not change the order.
                    due_s = now_s + (self._rng.uniform(0.0, self.late_s) if self.late_s else 0.0)
                    waiting.append((max([due_s, *(item[0] for item in waiting if item[1] == to)]), to, data))
                for item in [item for item in waiting if item[0] <= now_s]:
                    waiting.remove(item)
                    _write(item[1], item[2])
        except OSError:  # one of the two has gone
            return
        finally:
            os.close(robot)


def _write(to: int, data: bytes) -> None:
    """Write what fits; the rest is lost, as on a line whose reader has stopped."""
    try:
        os.write(to, data)
    except BlockingIOError:
        return
