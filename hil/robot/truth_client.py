"""True pose of a virtual robot in another process, and the faults injected there: over TCP, not over the robot's link.

The client sends one JSON line ``{"token": TEXT, "scenario": HASH, "reset": BOOL}``; the server (``truth_server``)
answers one JSON line, ``{"ok": true}`` or ``{"error": TEXT}``, and then sends records: robot time since power-on, pose,
twist, set points, age of the newest command, and state.

The token is a secret (``hil.core.tokens``) in a file of the user who runs the server. The client finds the file by the
port, or it is named: ``tcp://127.0.0.1:PORT?token_file=FILE``.

Requests about faults each use a connection of their own. Their line also has ``"faults"``: ``{"arm": ROWS}``,
``{"begin": TICK}`` or ``{"applied": true}``. The client gets an answer and no records.
"""

import json
import socket
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

from firmware_protocol.generated.messages import State
from hil.core.errors import BadInputError, DeviceError
from hil.core.tokens import read_token, token_file
from hil.core.types import Pose, PoseFix, Twist, Wheels
from hil.faults.rows import FaultRow

RECORD = struct.Struct("<q6d4dIB")
ANSWER_S = 2.0
LONGEST_ANSWER = 65536
KIND = "truth"
"""Of the servers, in the state folder with their tokens."""
NO_TOKEN = "the token is missing or wrong"
"""The refusal of a client without it."""
_CHUNK = 65536


class TruthRecord(NamedTuple):
    """A true pose with the firmware's set points, the age of its newest command and its state at that time."""

    fix: PoseFix
    set_point_rad_s: Wheels
    command_age_ms: int
    state: State


def unpack(data: bytes | bytearray) -> TruthRecord:
    time_ns, x, y, heading, vx, vy, yaw_rate, fl, fr, rr, rl, age_ms, state = RECORD.unpack(data)
    fix = PoseFix(time_ns, Pose(x, y, heading), Twist(vx, vy, yaw_rate))
    return TruthRecord(fix, Wheels(fl, fr, rr, rl), age_ms, State(state))


class TruthClient:
    """Reads the true pose of a robot in another process: a PoseSource.

    In lockstep ``not_before`` returns the robot time that the next pose must have reached; ``poll`` waits for it.

    Raises BadInputError for an invalid URL, DeviceError when no robot listens there or the scenarios differ.
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
        """Send the faults of the run to the robot. Raises BadInputError when it does not support one of them."""
        answer = self._request_faults({"arm": rows})
        if "error" in answer:
            raise BadInputError(str(answer["error"]))

    def begin(self, tick: int) -> None:
        """Send the firmware tick at which the scenario's time starts. Raises DeviceError when it is refused."""
        answer = self._request_faults({"begin": tick})
        if "error" in answer:
            raise DeviceError(f"truth {self._url!r}: {answer['error']}")

    def applied(self) -> list[int]:
        """Return how often each fault was applied so far. Raises DeviceError when the robot's process has ended."""
        applied = self._request_faults({"applied": True}).get("applied")
        if not isinstance(applied, list):
            raise DeviceError(f"truth {self._url!r}: the robot does not report how often a fault was applied")
        return [int(count) for count in applied]

    def _request_faults(self, request: Mapping[str, object]) -> Mapping[str, object]:
        connection, answer, _ = _greet(self._url, {"scenario": self._scenario_hash, "reset": False, "faults": request})
        connection.close()
        return answer

    def poll(self) -> PoseFix | None:
        """Return the newest true pose. Raises DeviceError when the robot's process has ended."""
        self._whole.clear()
        self._read(blocking=False)
        if self._not_before is not None:
            expected_ns = self._not_before()
            deadline = time.monotonic() + ANSWER_S
            while self.newest is None or self.newest.fix.time_ns < expected_ns:
                if time.monotonic() > deadline:
                    raise DeviceError(f"truth {self._url!r} is silent; the robot's process was lost")
                self._read(blocking=True)
        return self.newest.fix if self.newest is not None else None

    @property
    def taken(self) -> list[TruthRecord]:
        """All records that the last poll read, oldest first."""
        return [unpack(self._whole[at : at + RECORD.size]) for at in range(0, len(self._whole), RECORD.size)]

    def _read(self, *, blocking: bool) -> None:
        """Read everything that has arrived; with ``blocking`` wait for data first."""
        timeout_s = ANSWER_S if blocking else 0.0
        try:
            # Usually one system call only: a tick has no time for more.
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
        whole = len(self._data) // RECORD.size * RECORD.size
        if whole:
            self._whole += self._data[:whole]
            self.newest = unpack(self._whole[-RECORD.size :])
            del self._data[:whole]

    def close(self) -> None:
        self._connection.close()


def _greet(url: str, request: Mapping[str, object]) -> tuple[socket.socket, dict[str, object], bytearray]:
    """Connect and send the first line with the token; return the connection, the answer and the bytes after it.

    Raises BadInputError for an invalid URL or token file, DeviceError when no ``hil device`` listens there.
    """
    host, port, named = _address(url)
    file = token_file(KIND, port) if named is None else named
    # Without a token the server's refusal shows that it is a hil device.
    token = read_token(file) if named is not None or file.exists() else ""
    connection = None
    try:
        connection = socket.create_connection((host, port), timeout=2 * ANSWER_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(json.dumps({"token": token, **request}).encode() + b"\n")
        answer, rest = _read_answer(connection)
        if answer.get("error") == NO_TOKEN:
            answer["error"] = (
                f"{NO_TOKEN}; expected it in {file}. The hil device of another user, or of a container, has it in its "
                "own state folder: name a copy by ?token_file=FILE after the port"
            )
        return connection, answer, rest
    except (OSError, ValueError) as error:
        if connection is not None:
            connection.close()
        if isinstance(error, OSError):
            raise DeviceError(f"truth {url!r}: nobody answers ({error}); start hil device first") from error
        raise DeviceError(f"truth {url!r}: something else listens there; use the URL of hil device") from error


def _address(url: str) -> tuple[str, int, Path | None]:
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme != "tcp" or not parts.hostname or port is None:
        raise BadInputError(f"truth {url!r} is no valid address; expected tcp://127.0.0.1:PORT as hil device prints it")
    named = parse_qs(parts.query).get("token_file")
    return parts.hostname, port, None if named is None else Path(named[-1])


def _read_answer(connection: socket.socket) -> tuple[dict[str, object], bytearray]:
    data = bytearray()
    while b"\n" not in data:
        if len(data) > LONGEST_ANSWER:
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
