"""The robot's side of the true pose: serves the protocol of ``hil.robot.truth_client`` on loopback."""

import contextlib
import json
import queue
import secrets
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from firmware_protocol.host import View
from hil.core.errors import BadInputError, DeviceError, HilError
from hil.core.tokens import clear_tokens, is_of_elsewhere, make_token, read_token, token_file
from hil.core.types import PoseFix
from hil.faults.rows import FaultRow
from hil.robot.faults import RobotFaults
from hil.robot.truth_client import ANSWER_S, KIND, LONGEST_ANSWER, NO_TOKEN, RECORD

_HOST = "127.0.0.1"
_MOST_SILENT = 64
_RETRY_S = 0.1


class _Client:
    """A connected reader. A record is sent whole or, if the socket's buffer is full, not at all."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._connection.setblocking(False)
        self._rest = b""

    def send(self, record: bytes) -> bool:
        """Send a record if the buffer has space; return False when the reader has disconnected."""
        data = self._rest or record
        try:
            self._rest = data[self._connection.send(data) :]
        except BlockingIOError:
            pass
        except OSError:
            self._connection.close()
            return False
        return True

    def close(self) -> None:
        self._connection.close()


class _Request(NamedTuple):
    token: str
    scenario: str
    reset: bool
    faults: Mapping[str, Any] | None

    @classmethod
    def parse(cls, line: bytes) -> "_Request":
        """Parse the line. Raises DeviceError when it is invalid."""
        try:
            request = json.loads(line)
            faults = request.get("faults")
            if faults is None or isinstance(faults, dict):
                return cls(str(request.get("token", "")), str(request["scenario"]), bool(request["reset"]), faults)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            pass
        raise DeviceError("the request was not understood")


Answer = TypeVar("Answer")


def _await(start: Callable[[Callable[[Answer], None]], None]) -> Answer:
    """Return the answer of the robot's thread. Raises DeviceError without one in 2 s."""
    answers: queue.Queue[Answer] = queue.Queue()
    start(answers.put)
    try:
        return answers.get(timeout=ANSWER_S)
    except queue.Empty:
        raise DeviceError("the robot did not answer") from None


def _read_line(connection: socket.socket, until_s: float) -> bytes:
    """Return the first line of a client. Raises TimeoutError when it has not come by then, however slowly it comes."""
    line = bytearray()
    while not line.endswith(b"\n") and len(line) < LONGEST_ANSWER:
        if (left_s := until_s - time.monotonic()) <= 0.0:
            raise TimeoutError
        connection.settimeout(left_s)
        if not (data := connection.recv(LONGEST_ANSWER)):
            break
        line += data
    return bytes(line)


class TruthServer:
    """Publishes the true pose of a virtual robot on loopback. ``request_reset`` is called when a client wants a reset.

    ``run_on_faults`` runs a function on the robot's faults, in the robot's own thread. Only clients with the token of
    ``token_file`` are served. Of those that have not sent their request, ``_MOST_SILENT`` are waited for.

    ``port`` 0 picks a free port. Raises BadInputError when the port cannot be opened, or the token's file not written.
    """

    needs_view = True

    def __init__(self, scenario_hash: str, port: int = 0) -> None:
        self._hash = scenario_hash
        try:
            self._listener = socket.create_server((_HOST, port))
        except (OSError, OverflowError) as error:
            raise BadInputError(f"truth port {port} cannot be opened ({error}); choose another") from error
        port = self._listener.getsockname()[1]
        self.url = f"tcp://{_HOST}:{port}"
        self.token_file = token_file(KIND, port)
        try:
            clear_tokens(KIND)
            if is_of_elsewhere(self.token_file):
                raise BadInputError(
                    f"truth port {port}: {self.token_file} has the token of a robot on another machine, or in another "
                    "network namespace (a container); choose another port, or remove the file when that has ended"
                )
            make_token(self.token_file)
        except BadInputError:
            self._listener.close()
            raise
        self._token = read_token(self.token_file)
        self._closed = threading.Event()
        self._silent: dict[socket.socket, None] = {}  # oldest first
        self._clients: list[_Client] = []
        self._newest: bytes | None = None
        self._lock = threading.Lock()
        self.request_reset: Callable[[Callable[[bool], None]], None] | None = None
        self.run_on_faults: Callable[[Callable[[RobotFaults], None]], None] | None = None
        threading.Thread(target=self._accept, name="truth", daemon=True).start()

    def publish(self, fix: PoseFix, view: View | None) -> None:
        """Send a record to every reader, without blocking."""
        if view is None:
            return
        record = RECORD.pack(
            fix.time_ns, *fix.pose, *fix.twist, *view.set_point_rad_s, view.command_age_ticks, view.state
        )
        self._newest = record
        if self._clients:
            with self._lock:
                self._clients = [client for client in self._clients if client.send(record)]

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                self._closed.wait(_RETRY_S)  # for want of descriptors; or it is closed
                continue
            with self._lock:
                self._silent[connection] = None
                if len(self._silent) > _MOST_SILENT:
                    with contextlib.suppress(OSError):  # the client has disconnected
                        next(iter(self._silent)).shutdown(socket.SHUT_RDWR)  # which ends its thread
            # One thread per client: a silent client must not block the others.
            threading.Thread(target=self._greet, args=(connection,), name="truth client", daemon=True).start()

    def _greet(self, connection: socket.socket) -> None:
        try:
            self._answer(connection)
        except OSError:
            connection.close()  # the client disconnected during the exchange
        finally:
            with self._lock:
                self._silent.pop(connection, None)

    def _answer(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line = _read_line(connection, time.monotonic() + ANSWER_S)
        with self._lock:
            self._silent.pop(connection, None)
        connection.settimeout(ANSWER_S)
        answer: dict[str, object]
        try:
            request = _Request.parse(line)
            self._grant(request)
            answer = {"ok": True} if request.faults is None else self._answer_faults(request.faults)
        except HilError as refusal:
            answer = {"error": str(refusal)}
        connection.sendall(json.dumps(answer).encode() + b"\n")
        if "error" in answer or request.faults is not None:
            connection.close()
            return
        client = _Client(connection)
        with self._lock:
            if self._newest is not None:
                client.send(self._newest)
            self._clients = [*self._clients, client]

    def _grant(self, request: _Request) -> None:
        """Check token and scenario, and do a requested reset. Raises DeviceError with the reason when it is refused."""
        if not secrets.compare_digest(request.token.encode(errors="replace"), self._token.encode()):
            raise DeviceError(NO_TOKEN)  # and nothing more: every user of the machine may ask
        if request.scenario != self._hash:
            raise DeviceError(
                f"the robot runs another scenario (hash {self._hash[:12]}, asked for {request.scenario[:12]}); start "
                "both from the same scenario and overrides"
            )
        if request.reset and self.request_reset is not None and not _await(self.request_reset):
            raise DeviceError(
                "the robot is armed or moves, and was not put back to its start; stop its controller first"
            )

    def _answer_faults(self, request: Mapping[str, Any]) -> dict[str, object]:
        run = self.run_on_faults
        if run is None:
            raise DeviceError("this robot does not support faults")

        def handle(faults: RobotFaults) -> dict[str, object]:
            if "arm" in request:
                faults.arm([FaultRow(*row) for row in request["arm"]])
            elif "begin" in request:
                faults.begin(int(request["begin"]))
            return {"applied": faults.applied()}

        def guarded(faults: RobotFaults, answer: Callable[[dict[str, object]], None]) -> None:
            try:
                answer(handle(faults))
            except BadInputError as error:
                answer({"error": str(error)})
            except (TypeError, ValueError, OverflowError) as error:
                answer({"error": f"the request was not understood ({error})"})

        return _await(lambda answer: run(lambda faults: guarded(faults, answer)))

    def close(self) -> None:
        """Stop listening, disconnect the readers, and remove the token."""
        self._closed.set()
        with contextlib.suppress(OSError):  # Linux: wakes the thread that accepts
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.token_file.unlink(missing_ok=True)
        with self._lock:
            for client in self._clients:
                client.close()
            self._clients = []
