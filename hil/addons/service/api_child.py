"""The control process's side of the processes that take orders: starts them, and never waits.

There are two: the API, and one for emergency stops alone. One that ends is started again; no orders come from it
meanwhile. One that is silent for ``_HUNG_S`` is killed, because an emergency stop must reach a process that listens.
"""

import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from hil.addons.service import logs
from hil.addons.service.discovery import Service, announce
from hil.addons.service.messages import HOST, SILENT_S, Action, Answer, ApiConfig, Motion, Order, Status, to_line
from hil.core.errors import BadInputError, DeviceError
from hil.core.json_lines import LineReader, LineWriter
from hil.core.process_lock import ProcessLock
from hil.core.subprocesses import away_from_terminal, child_environment, module_command, start_children_as_ordinary
from hil.wire.reopening import BackOff

_READY_S = 60.0
_EXIT_S = 5.0
_HUNG_S = 5.0
_LONGEST_WAIT_NS = 5_000_000_000
_LONG_LIFE_S = 60.0  # after a life of this length the waits between attempts are short again


class LinePoll:
    """Reads the records that have arrived, without waiting; for the control loop (0.6 µs if none has).

    ``ended`` is true once the pipe has ended and all its records were returned. (Windows cannot poll a pipe
    without waiting: there a thread reads.)
    """

    ended = False

    if sys.platform == "win32":

        def __init__(self, fd: int) -> None:
            self._arrived: deque[dict[str, object] | None] = deque()
            threading.Thread(target=self._read, args=(LineReader(fd),), name="lines", daemon=True).start()

        def _read(self, lines: LineReader) -> None:
            record: dict[str, object] | None = {}
            while record is not None:
                record = lines.read()
                self._arrived.append(record)

        def receive(self) -> list[dict[str, object]]:
            """Return the records that have arrived, oldest first."""
            records = []
            while self._arrived:
                record = self._arrived.popleft()
                if record is None:
                    self.ended = True
                else:
                    records.append(record)
            return records

    else:

        def __init__(self, fd: int) -> None:
            self._fd = fd
            self._buffer = b""
            # poll takes half the time of a non-blocking read, which raises BlockingIOError if there is no data.
            self._poll = select.poll()
            self._poll.register(fd, select.POLLIN)

        def receive(self) -> list[dict[str, object]]:
            """Return the records that have arrived, oldest first."""
            if not self._poll.poll(0):
                return []
            data = os.read(self._fd, 65536)
            self.ended = not data
            *lines, self._buffer = (self._buffer + data).split(b"\n")
            return [json.loads(line) for line in lines]


class OrderProcess:
    """A process that takes orders, with its pipes. ``name`` is its name in the log; it inherits the ``listener``.

    Attributes:
        restarts: how often it was started again. motion_hz: how often clients want the robot's motion; 0 for none.
    """

    def __init__(self, module: str, name: str, config: ApiConfig, listener: socket.socket | None = None) -> None:
        self._module, self._name = module, name
        self._config = config
        self._inherited = () if listener is None else (listener.fileno(),)
        # The ticks may be pinned to a core later; the process must not share that core.
        self._cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
        self._closing = threading.Event()
        self._starter: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: LinePoll | None = None
        self._ready: dict[str, Any] | None = None
        self._waits = BackOff(_LONGEST_WAIT_NS)
        self._writer: LineWriter
        self._started_s = self._alive_s = self._polled_s = 0.0
        self.restarts = 0
        self.motion_hz = 0.0
        self._start()

    @property
    def alive(self) -> bool:
        """Whether it listens and has given a sign of life within ``SILENT_S`` before the last poll."""
        return self._ready is not None and self._polled_s - self._alive_s < SILENT_S

    @property
    def pid(self) -> int | None:
        """Process id; None while there is no process."""
        return None if self._process is None else self._process.pid

    def orders(self) -> list[Order]:
        """Return the orders that have arrived, oldest first."""
        lines = self._lines
        self._polled_s = time.monotonic()
        if lines is None or not ((records := lines.receive()) or lines.ended):
            return []
        orders = [order for record in records if (order := self._handle(record)) is not None]
        if lines.ended:
            self._restart()
        return orders

    def send(self, message: Answer | Status | Motion) -> None:
        """Send a message; only an answer waits where the pipe is full."""
        if self._ready is not None and (self._writer.flush() or isinstance(message, Answer)):
            self._writer.send(to_line(message), always=isinstance(message, Answer))

    def kill_if_hung(self) -> None:
        """Kill a process that is silent or does not become ready; ``orders`` then sees the end of its pipe."""
        is_ready = self._ready is not None
        silent_s = self._polled_s - (self._alive_s if is_ready else self._started_s)
        process = self._process
        if process is not None and self._lines is not None and silent_s > (_HUNG_S if is_ready else _READY_S):
            logs.error("process hangs and is killed", which=self._name, pid=process.pid, silent_s=round(silent_s, 1))
            self._ready = None
            self._started_s = time.monotonic()
            process.kill()

    def close(self) -> None:
        """End the process. May be called twice."""
        self._closing.set()
        if self._starter is not None:
            self._starter.join()
        self._ready = None
        self._lines = None
        self._end_process()

    def _start(self) -> None:
        """Start a process and give it its config. Raises OSError."""
        self._process = subprocess.Popen(
            module_command(self._module, *map(str, self._inherited)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env=child_environment(),
            pass_fds=self._inherited,
            **away_from_terminal(),
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._started_s = self._alive_s = time.monotonic()
        self._writer = LineWriter(self._process.stdin.fileno())
        self._writer.send({"config": asdict(self._config)}, always=True)
        self._lines = LinePoll(self._process.stdout.fileno())  # last, because the ticks poll it from here on

    def wait_until_ready(self) -> dict[str, Any]:
        """Wait until the first process is ready, and return what it says. Raises BadInputError and DeviceError."""
        assert self._lines is not None
        while self._ready is None:
            for record in self._lines.receive():
                if "refused" in record:
                    raise BadInputError(str(record["refused"]))
                self._handle(record)
            if self._lines.ended or time.monotonic() > self._started_s + _READY_S:
                raise DeviceError(
                    f"the {self._name} process did not start; its output is above, and 'pip install --force-reinstall "
                    "fastapi uvicorn' helps where a package of it is broken"
                )
            time.sleep(0.005)
        return self._ready

    def _handle(self, record: dict[str, Any]) -> Order | None:
        """Return the order in a line; handle a line of another kind, and return None."""
        if (order := record.get("order")) is not None:
            return Order(order["number"], Action(order["action"]), order["arguments"])
        if "refused" in record:
            logs.error("process cannot start again", which=self._name, why=record["refused"])
            return None
        self._alive_s = time.monotonic()
        self.motion_hz = record.get("motion_hz", self.motion_hz)
        if (ready := record.get("ready")) is not None:
            # With a fixed port and token file, clients find the service again after a restart.
            port = int(ready["url"].rpartition(":")[2])
            self._config = replace(self._config, port=port, token_file=ready.get("token_file", self._config.token_file))
            self._ready = ready
            if self._name == "API":  # the name of an event is a constant, which a user searches for
                logs.info("API listens", pid=self.pid, **ready)
            else:
                logs.info("e-stop listens", pid=self.pid, **ready)
        return None

    def _restart(self) -> None:
        """Start the next process in a thread, because that takes longer than a tick."""
        self._lines = None
        self._ready = None
        self.motion_hz = 0.0
        self.restarts += 1
        self._starter = threading.Thread(target=self._start_next, name=f"{self._name} starter")
        self._starter.start()

    def _start_next(self) -> None:
        """Start a process; retry until it starts or ``close`` is called."""
        start_children_as_ordinary()
        if self._cores is not None:
            os.sched_setaffinity(0, self._cores)
        status = self._end_process()
        if time.monotonic() - self._started_s > _LONG_LIFE_S:
            self._waits = BackOff(_LONGEST_WAIT_NS)
        again_in_s = self._waits.wait_ns * 1e-9
        logs.error("process ended", which=self._name, exit_status=status, again_in_s=again_in_s)
        while not self._closing.wait(self._waits.next_ns() * 1e-9):
            try:
                self._start()
            except OSError as error:
                again_in_s = self._waits.wait_ns * 1e-9
                logs.error("process could not be started", which=self._name, why=str(error), again_in_s=again_in_s)
            else:
                break

    def _end_process(self) -> int | None:
        """Close the pipes, which ends the process, and return its exit status."""
        process, self._process = self._process, None
        if process is None:
            return None
        try:
            process.communicate(timeout=_EXIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        return process.returncode


class ApiChild(OrderProcess):
    """The API, and the port for emergency stops, from the constructor to ``close``; only the ticks' thread uses them.

    The constructor returns when both listen and ``hil ctl`` can find the service. Raises BadInputError when the API
    cannot listen or the token file cannot be used, and DeviceError when a process does not start.

    Attributes:
        url: the API's URL; the same after a restart. estop_url: of the port for emergency stops.
        token_file: the file with the clients' token. estop: the process for emergency stops; None before it is started.
    """

    def __init__(self, config: ApiConfig) -> None:
        self._own_token = config.token_file is None
        self._claim: ProcessLock | None = None
        self._of_estop: set[int] = set()  # numbers of orders that came by its port, and are not answered
        # Listens until the service ends, so that nobody else takes the port while its process is started again. An
        # emergency stop may come late; the API's port does not wait so, because its orders may not.
        self._estop_socket = None if sys.platform == "win32" else socket.create_server((HOST, 0))
        self.estop: OrderProcess | None = None
        self.token_file: Path | None = None
        super().__init__("hil.addons.service.api_process", "API", config)
        try:
            ready = self.wait_until_ready()
            self.url, self.token_file = ready["url"], Path(ready["token_file"])
            beside = replace(config, port=0, token_file=ready["token_file"], audit=ready["audit"])
            self.estop = OrderProcess("hil.addons.service.estop_process", "e-stop", beside, self._estop_socket)
            self.estop_url: str = self.estop.wait_until_ready()["url"]
            self._claim = announce(
                Service(self.url, os.getpid(), config.title, config.device, ready["token_file"], self.estop_url)
            )
        except BaseException:
            self.close()
            raise

    def orders(self) -> list[Order]:
        """Return the orders that have arrived, emergency stops first. Called in each tick (1.6 µs without orders)."""
        assert self.estop is not None
        if estops := self.estop.orders():
            self._of_estop.update(order.number for order in estops)
        return sorted(estops + super().orders(), key=lambda order: order.action is not Action.ESTOP)

    def send(self, message: Answer | Status | Motion) -> None:
        """Send an answer, the status or a motion. Never waits: the latter two are left out when the pipe is full."""
        assert self.estop is not None
        self.kill_if_hung()
        self.estop.kill_if_hung()
        if isinstance(message, Answer) and message.number in self._of_estop:
            self._of_estop.discard(message.number)
            self.estop.send(message)
        else:
            super().send(message)

    def close(self) -> None:
        """End the processes, which inform their clients, and withdraw the announcement. May be called twice."""
        if self._claim is not None:
            self._claim.release()
        if self.estop is not None:
            self.estop.close()
        super().close()
        if self._estop_socket is not None:
            self._estop_socket.close()
        if self._own_token and self.token_file is not None:
            self.token_file.unlink(missing_ok=True)
