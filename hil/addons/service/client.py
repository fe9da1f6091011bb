"""A client of a service's API: finds the service, sends the token, and raises an error when an order is refused."""

import contextlib
import itertools
import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect

from hil.addons.service.discovery import Service, running
from hil.addons.service.messages import HOST, LONG, Action, route
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, RunInterruptedError
from hil.core.tokens import read_token

TWIST_PERIOD_S = 0.05
STOP_UNANSWERED = "the service did not answer that it stops the robot; it does so when the twist times out"

# Longer than the API process's own timeouts for short and for long orders.
_TIMEOUT_S = 5.0
_LONG_TIMEOUT_S = 35.0
_ESTOP_TIMEOUT_S = 1.5  # then the API is asked
_NONE_RUNS = "no service of yours runs on this machine; start one with 'hil serve CONFIG', or name one with --url"


def find(url: str | None = None, port: int | None = None, token_file: Path | None = None) -> "Client":
    """Return a client of the service at ``url``, or of this user's only running service (at ``port``).

    Raises LinkError when none runs, BadInputError when several do or the token cannot be read.
    """
    url = None if url is None else url.rstrip("/").replace("//localhost:", f"//{HOST}:")
    services = running()
    found = [
        service for service in services if (service.url == url if url is not None else port in (None, service.port))
    ]
    if len(found) == 1:
        return Client(found[0].url, token_file or Path(found[0].token_file), found[0].estop_url)
    if url is not None and token_file is not None:
        return Client(url, token_file)
    if url is not None:
        raise BadInputError(f"service {url}: it is not one of yours; give the file with its token by --token-file")
    if found:
        raise BadInputError(f"{len(found)} services run: {_listed(found)}; choose one with --port")
    known = f": yours are {_listed(services)}" if services else ""
    raise LinkError(_NONE_RUNS if port is None else f"no service of yours runs at port {port}{known}")


def _listed(services: list[Service]) -> str:
    return ", ".join(f"port {service.port} ({service.title} on {service.device})" for service in services)


class Client:
    """A client of one service. Every method raises the errors of ``_checked``.

    ``estop_url`` is that of the service's port for emergency stops; by default the API takes them.
    """

    def __init__(self, url: str, token_file: Path, estop_url: str = "") -> None:
        if not url.startswith("http://") or not url.rpartition(":")[2].isdecimal():
            raise BadInputError(f"service {url!r}: expected http://127.0.0.1:PORT")
        self._url = url
        self._estop_url = estop_url
        self._token_file = token_file
        self._headers = {"Authorization": f"Bearer {read_token(token_file)}"}

    def status(self) -> dict[str, Any]:
        """Return the service's status, by the names of ``hil.addons.service.messages.Status``."""
        return self._request("GET", "/v1/status")

    def order(self, action: Action, arguments: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Give an order; return its result when it is done, or for a motion when it has begun."""
        if action is Action.ESTOP and (stopped := self._stop_at_once()) is not None:
            return stopped
        method, path = route(action)
        timeout_s = _LONG_TIMEOUT_S if action in LONG else _TIMEOUT_S
        result: dict[str, Any] = self._request(method, path, arguments, timeout_s)["result"]
        return result

    def _stop_at_once(self) -> dict[str, Any] | None:
        """Give an emergency stop by its own port, and return its result; None where the API has to be asked."""
        if not self._estop_url:
            return None
        with contextlib.suppress(HilError):
            return dict(self._request("POST", "/v1/estop", None, _ESTOP_TIMEOUT_S, self._estop_url)["result"])
        return None

    def watch(self) -> Iterator[dict[str, Any]]:
        """Yield the status as it comes. Raises LinkError when the service ends."""
        with self.live() as live:
            while True:
                message = live.receive(None) or {}
                if "status" in message:
                    yield message["status"]

    def twist(self, arguments: Mapping[str, float], for_s: float) -> None:
        """Drive by twist for ``for_s``, then stop. Ctrl-C stops at once, and raises RunInterruptedError."""
        end_s = time.monotonic() + for_s
        self.order(Action.TWIST, arguments)  # over HTTP, whose status tells wrong arguments from a refusal
        with self.live() as live:
            interrupted = False
            try:
                while (now_s := time.monotonic()) < end_s:
                    _await_answer(live, min(now_s + TWIST_PERIOD_S, end_s))
                    live.order(Action.TWIST, arguments)
            except KeyboardInterrupt:
                interrupted = True
            if not _await_answer(live, time.monotonic() + _TIMEOUT_S, live.order(Action.STOP)):
                raise LinkError(STOP_UNANSWERED)
            if interrupted:
                raise RunInterruptedError("interrupted; the robot was told to stop")

    def _request(
        self, method: str, path: str, body: Any = None, timeout_s: float = _TIMEOUT_S, url: str | None = None
    ) -> dict[str, Any]:
        try:
            # No proxy from the environment on this machine; without TLS there are no certificates to load (0.1 s).
            with httpx.Client(trust_env=False, verify=False, timeout=timeout_s) as http:
                response = http.request(method, (url or self._url) + path, headers=self._headers, json=body)
        except httpx.TimeoutException:
            raise LinkError(f"service {self._url}: no answer within {timeout_s:g} s; see its log") from None
        except httpx.HTTPError as error:
            raise LinkError(f"service {self._url}: {error}; it may be restarting, or has ended") from None
        return self._checked(response.status_code, response.content)

    def _checked(self, status: int, content: bytes | bytearray) -> dict[str, Any]:
        """Return the decoded content of a response.

        Raises BadInputError for a wrong token or wrong arguments, DeviceError when the service refuses, LinkError when
        the control process does not answer or another program answers.
        """
        try:
            body = json.loads(content)
            sentence = body["detail"] if status != 200 else ""
        except (ValueError, KeyError, TypeError):
            raise LinkError(f"service {self._url}: unknown answer, status {status}; it is another program") from None
        if status == 401:
            raise BadInputError(
                f"service {self._url}: it does not accept the token in {self._token_file}; each start makes a new one, "
                "so give the file of this start with --token-file"
            )
        if status in (403, 422):
            raise BadInputError(sentence)
        if status != 200:
            raise (
                DeviceError(f"refused: {sentence}") if status == 409 else LinkError(f"service {self._url}: {sentence}")
            )
        return dict(body)

    @contextlib.contextmanager
    def live(self) -> Iterator["Live"]:
        """Yield a WebSocket to the service. Raises LinkError, also in the body, when the service ends."""
        address = "ws" + self._url.removeprefix("http") + "/v1/live"
        try:
            with connect(address, additional_headers=self._headers, proxy=None, open_timeout=_TIMEOUT_S) as socket:
                yield Live(socket, self._stop_at_once)
        except InvalidStatus as error:
            self._checked(error.response.status_code, error.response.body or b"")
        except ConnectionClosed as error:
            why = error.rcvd.reason if error.rcvd is not None and error.rcvd.reason else "the connection was lost"
            raise LinkError(f"service {self._url}: {why}") from None
        except (OSError, WebSocketException) as error:
            raise LinkError(f"service {self._url}: {error}; it may be restarting, or has ended") from None


class Live:
    """A WebSocket to a service: sends orders, receives answers and statuses. ``Client.live`` makes it.

    ``stop_at_once`` gives an emergency stop by a quicker way; where it returns None, the WebSocket takes it.
    """

    def __init__(self, socket: ClientConnection, stop_at_once: Callable[[], dict[str, Any] | None]) -> None:
        self._socket = socket
        self._stop_at_once = stop_at_once
        self._stopped: deque[dict[str, Any]] = deque()
        self._numbers = itertools.count()

    def order(self, action: Action, arguments: Mapping[str, Any] | None = None) -> int:
        """Send an order; return the number that its answer will have."""
        number = next(self._numbers)
        if action is Action.ESTOP and (stopped := self._stop_at_once()) is not None:
            self._stopped.append({"answer": {"number": number, "refused": None, "result": stopped}})
            return number
        order = {"number": number, "action": action.value, "arguments": dict(arguments or {})}
        self._socket.send(json.dumps({"order": order}))
        return number

    def ask_for_motion(self, rate_hz: float) -> None:
        """Receive the robot's motion this often too, as far as its ticks allow it; 0 ends that."""
        self._socket.send(json.dumps({"motion": {"rate_hz": rate_hz}}))

    def receive(self, timeout_s: float | None) -> dict[str, Any] | None:
        """Return the next ``{"status": ...}``, ``{"answer": ...}`` or ``{"motion": ...}``, or None at the timeout.

        A ``timeout_s`` of None waits for ever.
        """
        if self._stopped:
            return self._stopped.popleft()
        try:
            message: dict[str, Any] = json.loads(self._socket.recv(timeout=timeout_s))
        except TimeoutError:
            return None
        return message


def _await_answer(live: Live, until_s: float, number: int | None = None) -> bool:
    """Read messages until ``until_s``, or until the answer to ``number``; return whether that came.

    Raises DeviceError when an order was refused.
    """
    while (left_s := until_s - time.monotonic()) > 0.0 and (message := live.receive(left_s)) is not None:
        answer = message.get("answer")
        if answer is not None and answer["refused"] is not None:
            raise DeviceError(f"refused: {answer['refused']}")
        if answer is not None and answer["number"] == number:
            return True
    return False
