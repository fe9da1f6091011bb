"""Ground truth by a path of its own: a loopback TCP socket, never the wheel link.

The client sends one JSON line ``{"scenario": HASH, "reset": BOOL}``; the server answers one JSON line, ``{"ok": true}``
or ``{"error": TEXT}``, and then sends records: robot time since power-on, pose, twist, set points, age of the newest
command and state.

Faults of the robot and its plant go the same way, each request in a connection of its own: with ``"faults"`` in its
line, ``{"arm": ROWS}``, ``{"begin": TICK}`` or ``{"applied": true}``, the client gets its answer and no records.
"""

import json
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar
from urllib.parse import urlsplit

from firmware_protocol.generated.messages import State
from firmware_protocol.host import View
from hil.devices.faults import RobotFaults
from hil.errors import BadInputError, DeviceError, HilError
from hil.faults.kinds import FaultRow
from hil.types import Pose, PoseFix, Twist, Wheels

_RECORD = struct.Struct("<q6d4dIB")
_HOST = "127.0.0.1"
_ANSWER_S = 2.0
_LONGEST_ANSWER = 65536
_CHUNK = 65536


class TruthRecord(NamedTuple):
    """A fix with the firmware's set points, the age of its newest command and its state at that time."""

    fix: PoseFix
    set_point_rad_s: Wheels
    command_age_ms: int
    state: State


def _unpack(data: bytes | bytearray) -> TruthRecord:
    time_ns, x, y, heading, vx, vy, yaw_rate, fl, fr, rr, rl, age_ms, state = _RECORD.unpack(data)
    fix = PoseFix(time_ns, Pose(x, y, heading), Twist(vx, vy, yaw_rate))
    return TruthRecord(fix, Wheels(fl, fr, rr, rl), age_ms, State(state))


class _Client:
    """A connected reader. Records are whole or missing: what does not fit into its buffer is dropped."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._connection.setblocking(False)
        self._rest = b""

    def send(self, record: bytes) -> bool:
        """Send a record if there is room; return False when the reader has gone."""
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


class _Wish(NamedTuple):
    """The line that a client begins with."""

    scenario: str
    reset: bool
    faults: Mapping[str, Any] | None

    @classmethod
    def parse(cls, line: bytes) -> "_Wish":
        """Read a line. Raises DeviceError when it is none of ours."""
        try:
            wish = json.loads(line)
            faults = wish.get("faults")
            if faults is None or isinstance(faults, dict):
                return cls(str(wish["scenario"]), bool(wish["reset"]), faults)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            pass
        raise DeviceError("the request was not understood")


Answer = TypeVar("Answer")


def _await(ask: Callable[[Callable[[Answer], None]], None]) -> Answer:
    """Ask the robot's own thread and wait for its answer. Raises DeviceError when there is none."""
    answers: queue.Queue[Answer] = queue.Queue()
    ask(answers.put)
    try:
        return answers.get(timeout=_ANSWER_S)
    except queue.Empty:
        raise DeviceError("the robot did not answer") from None


class TruthServer:
    """Publishes the truth of a virtual robot on loopback. ``request_reset`` is told when a client wants the start.

    ``ask_faults`` has something done with the robot's faults, in the robot's own thread.

    ``port`` 0 takes any free port. Raises BadInputError when the port is taken.
    """

    wants_view = True

    def __init__(self, scenario_hash: str, port: int = 0) -> None:
        self._hash = scenario_hash
        try:
            self._listener = socket.create_server((_HOST, port))
        except (OSError, OverflowError) as error:
            raise BadInputError(f"truth port {port} cannot be opened ({error}); choose another") from error
        self.url = f"tcp://{_HOST}:{self._listener.getsockname()[1]}"
        self._clients: list[_Client] = []
        self._newest: bytes | None = None
        self._lock = threading.Lock()
        self.request_reset: Callable[[Callable[[bool], None]], None] | None = None
        self.ask_faults: Callable[[Callable[[RobotFaults], None]], None] | None = None
        threading.Thread(target=self._accept, name="truth", daemon=True).start()

    def publish(self, fix: PoseFix, view: View | None) -> None:
        """Send a record to every reader; never blocks."""
        if view is None:
            return
        record = _RECORD.pack(
            fix.time_ns, *fix.pose, *fix.twist, *view.set_point_rad_s, view.command_age_ticks, view.state
        )
        self._newest = record
        if self._clients:
            with self._lock:
                self._clients = [client for client in self._clients if client.send(record)]

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return  # closed
            # Each in a thread of its own: one that says nothing keeps no other waiting.
            threading.Thread(target=self._greet, args=(connection,), name="truth client", daemon=True).start()

    def _greet(self, connection: socket.socket) -> None:
        try:
            self._answer(connection)
        except OSError:
            connection.close()  # it left while greeting

    def _answer(self, connection: socket.socket) -> None:
        connection.settimeout(_ANSWER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answer: dict[str, object]
        try:
            wish = _Wish.parse(connection.makefile("rb").readline(_LONGEST_ANSWER))
            self._grant(wish)
            answer = {"ok": True} if wish.faults is None else self._answer_faults(wish.faults)
        except HilError as refusal:
            answer = {"error": str(refusal)}
        connection.sendall(json.dumps(answer).encode() + b"\n")
        if "error" in answer or wish.faults is not None:
            connection.close()
            return
        client = _Client(connection)
        with self._lock:
            if self._newest is not None:
                client.send(self._newest)
            self._clients = [*self._clients, client]

    def _grant(self, wish: _Wish) -> None:
        """Do what is asked for before anything else. Raises DeviceError with the reason when it is refused."""
        if wish.scenario != self._hash:
            raise DeviceError(
                f"the robot runs another scenario (hash {self._hash[:12]}, asked for {wish.scenario[:12]}); start both "
                "from the same scenario and overrides"
            )
        if wish.reset and self.request_reset is not None and not _await(self.request_reset):
            raise DeviceError(
                "the robot is armed or moves, and was not put back to its start; stop its controller first"
            )

    def _answer_faults(self, wish: Mapping[str, Any]) -> dict[str, object]:
        ask = self.ask_faults
        if ask is None:
            raise DeviceError("this robot takes no faults")

        def work(faults: RobotFaults) -> dict[str, object]:
            if "arm" in wish:
                faults.arm([FaultRow(*row) for row in wish["arm"]])
            elif "begin" in wish:
                faults.begin(int(wish["begin"]))
            return {"applied": faults.applied()}

        def guarded(faults: RobotFaults, answer: Callable[[dict[str, object]], None]) -> None:
            try:
                answer(work(faults))
            except BadInputError as error:
                answer({"error": str(error)})
            except (TypeError, ValueError) as error:
                answer({"error": f"the request was not understood ({error})"})

        return _await(lambda answer: ask(lambda faults: guarded(faults, answer)))

    def close(self) -> None:
        """Stop listening and let the readers go."""
        self._listener.close()
        with self._lock:
            for client in self._clients:
                client.close()
            self._clients = []


class TruthClient:
    """Reads the truth of a robot in another process: a PoseSource.

    ``not_before`` gives, in lockstep, the robot time that the next fix must have; ``poll`` then waits for it.

    Raises BadInputError for a URL that is none, DeviceError when nobody listens or the scenarios differ.
    """

    def __init__(
        self, url: str, scenario_hash: str, *, reset: bool, not_before: Callable[[], int] | None = None
    ) -> None:
        self._url = url
        self._scenario_hash = scenario_hash
        self._not_before = not_before
        self._whole = bytearray()
        self.newest: TruthRecord | None = None
        self._connection, answer, self._data = _greet(url, {"scenario": scenario_hash, "reset": reset})
        if "error" in answer:
            raise DeviceError(f"truth {url!r}: {answer['error']}")

    def arm(self, rows: Sequence[FaultRow]) -> None:
        """Give the robot the faults of the run. Raises BadInputError when it has no part for one of them."""
        answer = self._ask_faults({"arm": rows})
        if "error" in answer:
            raise BadInputError(str(answer["error"]))

    def begin(self, tick: int) -> None:
        """Say at which tick of the firmware's the scenario's time began. Raises DeviceError when that is refused."""
        answer = self._ask_faults({"begin": tick})
        if "error" in answer:
            raise DeviceError(f"truth {self._url!r}: {answer['error']}")

    def applied(self) -> list[int]:
        """Return how often each fault was applied so far. Raises DeviceError when the robot's process has gone."""
        applied = self._ask_faults({"applied": True}).get("applied")
        if not isinstance(applied, list):
            raise DeviceError(f"truth {self._url!r}: the robot does not say how often a fault was applied")
        return [int(count) for count in applied]

    def _ask_faults(self, wish: Mapping[str, object]) -> Mapping[str, object]:
        connection, answer, _ = _greet(self._url, {"scenario": self._scenario_hash, "reset": False, "faults": wish})
        connection.close()
        return answer

    def poll(self) -> PoseFix | None:
        """Return the newest fix. Raises DeviceError when the robot's process has gone."""
        self._whole.clear()
        self._read(blocking=False)
        if self._not_before is not None:
            wanted_ns = self._not_before()
            deadline = time.monotonic() + _ANSWER_S
            while self.newest is None or self.newest.fix.time_ns < wanted_ns:
                if time.monotonic() > deadline:
                    raise DeviceError(f"truth {self._url!r} is silent; the robot's process was lost")
                self._read(blocking=True)
        return self.newest.fix if self.newest is not None else None

    @property
    def taken(self) -> list[TruthRecord]:
        """Every record that the last poll took, the newest last."""
        return [_unpack(self._whole[at : at + _RECORD.size]) for at in range(0, len(self._whole), _RECORD.size)]

    def _read(self, *, blocking: bool) -> None:
        """Take all that has arrived; with ``blocking``, wait for something first."""
        timeout_s = _ANSWER_S if blocking else 0.0
        try:
            # One system call where it can be: a tick has no time for those that change nothing and find nothing.
            if self._connection.gettimeout() != timeout_s:
                self._connection.settimeout(timeout_s)
            while chunk := self._connection.recv(_CHUNK):
                self._data += chunk
                if len(chunk) < _CHUNK:
                    break
                self._connection.settimeout(0)
        except (BlockingIOError, TimeoutError):
            pass
        except OSError as error:
            raise DeviceError(f"truth {self._url!r} was lost: {error}") from error
        else:
            if not chunk:
                raise DeviceError(f"truth {self._url!r} was closed: the robot's process has ended")
        whole = len(self._data) // _RECORD.size * _RECORD.size
        if whole:
            self._whole += self._data[:whole]
            self.newest = _unpack(self._whole[-_RECORD.size :])
            del self._data[:whole]

    def close(self) -> None:
        """Leave."""
        self._connection.close()


def _greet(url: str, wish: Mapping[str, object]) -> tuple[socket.socket, dict[str, object], bytearray]:
    """Connect and send the first line; return the connection, the answer and what came after it.

    Raises BadInputError for a URL that is none, DeviceError when nobody of ours listens.
    """
    connection = None
    try:
        connection = socket.create_connection(_address(url), timeout=2 * _ANSWER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(json.dumps(wish).encode() + b"\n")
        return connection, *_read_answer(connection)
    except (OSError, ValueError) as error:
        if connection is not None:
            connection.close()
        if isinstance(error, OSError):
            raise DeviceError(f"truth {url!r}: nobody answers ({error}); start hil device first") from error
        raise DeviceError(f"truth {url!r}: something else listens there; use the URL of hil device") from error


def _address(url: str) -> tuple[str, int]:
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme != "tcp" or not parts.hostname or port is None:
        raise BadInputError(f"truth {url!r} is no address; expected tcp://127.0.0.1:PORT as hil device prints it")
    return parts.hostname, port


def _read_answer(connection: socket.socket) -> tuple[dict[str, object], bytearray]:
    data = bytearray()
    while b"\n" not in data:
        if len(data) > _LONGEST_ANSWER:
            raise ValueError("no line")
        chunk = connection.recv(4096)
        if not chunk:
            raise ConnectionError("the connection was closed")
        data += chunk
    line, _, rest = data.partition(b"\n")
    answer = json.loads(line)
    if not isinstance(answer, dict):
        raise ValueError("no object")
    return answer, rest
