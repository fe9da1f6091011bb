"""The control process's side of the API process: starts it, receives orders and sends answers, and never waits.

An API process that ends is started again; no orders come meanwhile. One that is silent for ``_HUNG_S`` is killed,
because an emergency stop must reach a process that listens.
"""

import os
import subprocess
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, DeviceError
from hil.core.json_lines import LinePoll, LineWriter
from hil.core.process_lock import ProcessLock
from hil.core.subprocesses import away_from_terminal, child_environment, module_command, start_children_as_ordinary
from hil.service import logs
from hil.service.discovery import Service, announce
from hil.service.messages import SILENT_S, Action, Answer, ApiConfig, Motion, Order, Status, to_line
from hil.wire.reopening import BackOff

_READY_S = 60.0
_EXIT_S = 5.0
_HUNG_S = 5.0
_LONGEST_WAIT_NS = 5_000_000_000
_LONG_LIFE_S = 60.0  # after a life of this length the waits between attempts are short again


class ApiChild:
    """The API process of a service, from the constructor to ``close``; only the thread of the ticks uses it.

    The constructor returns when the API listens and ``hil ctl`` can find the service. Raises BadInputError when the API
    cannot listen or the token file cannot be used, and DeviceError when the process does not start.

    Attributes:
        url: the API's URL; the same after a restart.
        token_file: the file with the clients' token.
        restarts: number of restarts.
        motion_hz: how often clients want the robot's motion; 0 for none.
    """

    def __init__(self, config: ApiConfig) -> None:
        self._config = config
        self._own_token = config.token_file is None
        # The ticks may be pinned to a core later; the API process must not share that core.
        self._cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
        self._closing = threading.Event()
        self._starter: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: LinePoll | None = None
        self._ready = False
        self._waits = BackOff(_LONGEST_WAIT_NS)
        self._claim: ProcessLock | None = None
        self._writer: LineWriter
        self._started_s = self._alive_s = self._polled_s = 0.0
        self.url = ""
        self.token_file: Path | None = None
        self.restarts = 0
        self.motion_hz = 0.0
        try:
            self._start()
            self._wait_until_ready()
            service = Service(self.url, os.getpid(), config.title, config.device, str(self.token_file))
            self._claim = announce(service)
        except BaseException:
            self.close()
            raise

    @property
    def alive(self) -> bool:
        """Whether an API process listens and has given a sign of life within ``SILENT_S`` before the last poll."""
        return self._ready and self._polled_s - self._alive_s < SILENT_S

    @property
    def pid(self) -> int | None:
        """Process id of the API process; None while there is none."""
        return None if self._process is None else self._process.pid

    def orders(self) -> list[Order]:
        """Return the orders that have arrived, emergency stops first. Called in each tick (0.8 µs without orders)."""
        lines = self._lines
        self._polled_s = time.monotonic()
        if lines is None or not ((records := lines.receive()) or lines.ended):
            return []
        orders = [order for record in records if (order := self._handle(record)) is not None]
        if lines.ended:
            self._restart()
        return sorted(orders, key=lambda order: order.action is not Action.ESTOP)

    def send(self, message: Answer | Status | Motion) -> None:
        """Send an answer, the status or a motion. Never waits: the latter two are left out when the pipe is full."""
        self._kill_if_hung()
        if self._ready and (self._writer.flush() or isinstance(message, Answer)):
            self._writer.send(to_line(message), always=isinstance(message, Answer))

    def _kill_if_hung(self) -> None:
        """Kill a process that is silent or does not become ready; ``orders`` then sees the end of its pipe."""
        silent_s = self._polled_s - (self._alive_s if self._ready else self._started_s)
        process = self._process
        if process is not None and self._lines is not None and silent_s > (_HUNG_S if self._ready else _READY_S):
            logs.error("API process hangs and is killed", pid=process.pid, silent_s=round(silent_s, 1))
            self._ready = False
            self._started_s = time.monotonic()
            process.kill()

    def close(self) -> None:
        """End the API process, which informs its clients, and withdraw the announcement. May be called twice."""
        if self._claim is not None:
            self._claim.release()
        self._closing.set()
        if self._starter is not None:
            self._starter.join()
        self._ready = False
        self._lines = None
        self._end_process()
        if self._own_token and self.token_file is not None:
            self.token_file.unlink(missing_ok=True)

    def _start(self) -> None:
        """Start a process and give it its config. Raises OSError."""
        self._process = subprocess.Popen(
            module_command("hil.service.api_process"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env=child_environment(),
            **away_from_terminal(),
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._started_s = self._alive_s = time.monotonic()
        self._writer = LineWriter(self._process.stdin.fileno())
        self._writer.send({"config": asdict(self._config)}, always=True)
        self._lines = LinePoll(self._process.stdout.fileno())  # last, because the ticks poll it from here on

    def _wait_until_ready(self) -> None:
        """Wait until the first process is ready. Raises BadInputError and DeviceError as the constructor."""
        assert self._lines is not None
        while not self._ready:
            for record in self._lines.receive():
                if "refused" in record:
                    raise BadInputError(str(record["refused"]))
                self._handle(record)
            if self._lines.ended or time.monotonic() > self._started_s + _READY_S:
                raise DeviceError(
                    "the API process did not start; its output is above, and 'pip install --force-reinstall fastapi "
                    "uvicorn' helps where a package of it is broken"
                )
            time.sleep(0.005)

    def _handle(self, record: dict[str, Any]) -> Order | None:
        """Return the order in a line; handle a line of another kind, and return None."""
        if (order := record.get("order")) is not None:
            return Order(order["number"], Action(order["action"]), order["arguments"])
        if "refused" in record:
            logs.error("API process cannot start again", why=record["refused"])
            return None
        self._alive_s = time.monotonic()
        self.motion_hz = record.get("motion_hz", self.motion_hz)
        if (ready := record.get("ready")) is not None:
            self.url, self.token_file = ready["url"], Path(ready["token_file"])
            # With a fixed port and token file, clients find the service again after a restart.
            port = int(self.url.rpartition(":")[2])
            self._config = replace(self._config, port=port, token_file=str(self.token_file))
            self._ready = True
            logs.info("API listens", url=self.url, pid=self.pid, audit=ready["audit"])
        return None

    def _restart(self) -> None:
        """Start the next process in a thread, because that takes longer than a tick."""
        self._lines = None
        self._ready = False
        self.motion_hz = 0.0
        self.restarts += 1
        self._starter = threading.Thread(target=self._start_next, name="API starter")
        self._starter.start()

    def _start_next(self) -> None:
        """Start a process; retry until it starts or ``close`` is called."""
        start_children_as_ordinary()
        if self._cores is not None:
            os.sched_setaffinity(0, self._cores)
        status = self._end_process()
        if time.monotonic() - self._started_s > _LONG_LIFE_S:
            self._waits = BackOff(_LONGEST_WAIT_NS)
        logs.error("API process ended", exit_status=status, again_in_s=self._waits.wait_ns * 1e-9)
        while not self._closing.wait(self._waits.next_ns() * 1e-9):
            try:
                self._start()
            except OSError as error:
                again_in_s = self._waits.wait_ns * 1e-9
                logs.error("API process could not be started", why=str(error), again_in_s=again_in_s)
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
