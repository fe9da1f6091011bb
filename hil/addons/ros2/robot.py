"""The robot behind a service: its orders, and what it says."""

import contextlib
import os
import secrets
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

from hil.addons.service.client import Client, Live
from hil.addons.service.discovery import running
from hil.addons.service.messages import Action
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError
from hil.core.private_files import write_private
from hil.core.scratch import scratch_folder
from hil.core.subprocesses import child_environment, module_command

Hear = Callable[[Mapping[str, Any]], None]
"""Takes what a robot says, in the robot's own thread: ``{"status": ...}``, ``{"motion": ...}`` or ``{"lost": why}``."""

Answered = Callable[[str | None], None]
"""Takes an order's outcome: None when it was accepted, else the reason in a sentence."""

_READY_S = 60.0
_POLL_S = 0.05
_AGAIN_S = 0.5
_END_S = 15.0


class ServedRobot:
    """A robot behind a service. The connection is made anew when it was lost, and meanwhile orders are refused."""

    def __init__(self, client: Client, rate_hz: float, service: "OwnService | None") -> None:
        self._client = client
        self._rate_hz = rate_hz
        self._service = service
        self._lock = threading.Lock()
        self._live: Live | None = None
        self._open: dict[int, Answered] = {}
        self._closing = threading.Event()
        self._why = "the service is not connected yet"
        self._thread: threading.Thread | None = None

    def start(self, hear: Hear) -> None:
        """Begin to say how the robot is."""
        self._thread = threading.Thread(target=self._run, args=(hear,), name="service", daemon=True)
        self._thread.start()

    def order(self, action: Action, arguments: Mapping[str, Any], answered: Answered) -> None:
        """Give an order, without waiting; ``answered`` is called in any thread."""
        if action is Action.ESTOP:  # it needs no WebSocket
            threading.Thread(target=self._estop, args=(answered,), name="e-stop", daemon=True).start()
            return
        with self._lock:
            if self._live is not None:
                try:
                    self._open[self._live.order(action, arguments)] = answered
                except Exception as error:  # noqa: BLE001 - a WebSocket that was closed meanwhile has many errors
                    self._why = f"the order could not be sent: {error}"
                else:
                    return
        answered(self._why)

    def _estop(self, answered: Answered) -> None:
        try:
            self._client.order(Action.ESTOP)
        except HilError as error:
            answered(str(error))
        else:
            answered(None)

    def failure(self) -> HilError | None:
        """Return the error that ended the service for good, or None."""
        return None if self._service is None else self._service.failure()

    def close(self) -> None:
        """Stop to listen, and leave the robot to itself."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=_END_S)

    def _run(self, hear: Hear) -> None:
        while not self._closing.is_set():
            try:
                with self._client.live() as live:
                    self._listen(live, hear)
            except HilError as error:
                self._lose(str(error))
                hear({"lost": str(error)})
                self._closing.wait(_AGAIN_S)
        self._lose("the node is ending")

    def _lose(self, why: str) -> None:
        with self._lock:
            self._live, self._why = None, why
            answers, self._open = self._open, {}
        for answered in answers.values():
            answered(why)

    def _listen(self, live: Live, hear: Hear) -> None:
        live.ask_for_motion(self._rate_hz)
        with self._lock:
            self._live = live
        while not self._closing.is_set():
            message = live.receive(_POLL_S)
            if message is None:
                continue
            if (answer := message.get("answer")) is None:
                hear(message)
                continue
            with self._lock:
                answered = self._open.pop(answer["number"], None)
            if answered is not None:
                answered(answer["refused"])


class OwnService:
    """A ``hil serve`` process of this one, with a token of its own that may drive; it ends when this process ends.

    ``arguments`` are those of ``hil serve``. Raises DeviceError when it ends before it is ready.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._resources = contextlib.ExitStack()
        folder = self._resources.enter_context(scratch_folder("ros2"))
        token, clients = secrets.token_urlsafe(32), folder / "clients"
        self._token_file = folder / "token"
        write_private(self._token_file, token + "\n")
        write_private(clients, f"ros2 drive {token}\n")
        end, self._life_line = os.pipe()
        words = ["serve", *arguments, "--set", "service.port=0", "--clients", str(clients), "--lifeline", str(end)]
        command = module_command("hil.cli.main", *words)
        # A session of its own: Ctrl-C reaches this process, which ends the service in order.
        self._process = subprocess.Popen(
            command, env=child_environment(), stdin=subprocess.DEVNULL, pass_fds=(end,), start_new_session=True
        )
        os.close(end)

    def client(self) -> Client:
        """Wait until the service is ready, and return a client of it."""
        until_s = time.monotonic() + _READY_S
        while time.monotonic() < until_s:
            if (failure := self.failure()) is not None:
                raise failure
            for service in running():
                if service.pid == self._process.pid:
                    return Client(service.url, self._token_file, service.estop_url)
            time.sleep(_POLL_S)
        raise LinkError(f"the service was not ready within {_READY_S:g} s; see its log above")

    def failure(self) -> HilError | None:
        """Return an error when the service has ended, else None."""
        code = self._process.poll()
        if code is None:
            return None
        kind = BadInputError if code == BadInputError.exit_code else DeviceError
        return kind(f"hil serve ended with exit code {code}; what it said is above")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._life_line)  # it ramps down, disarms, finishes its recording and ends
        try:
            self._process.wait(timeout=_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._resources.close()
