"""Pose fixes from another program, by UDP."""

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from hil.core.errors import BadInputError
from hil.core.tokens import make_token, read_token, token_file
from hil.core.types import MeasuredPose, PoseFix
from hil.estimation.localisation.message import Refused, parse, parse_address

_AT_MOST = 16  # datagrams per poll; the rest waits for the next poll
_SKIPPED_AT_MOST = 1024  # more than a usual socket holds; a flood of datagrams cannot block the tick
_BUFFER_BYTES = 65536
_FUTURE_S = 0.010
_NS = 1e9


class UdpFixes:
    """A FixSource that reads datagrams without waiting, and counts refused ones by cause.

    A fix older than ``oldest_s`` is refused as ``stale``. One stamped more than 10 ms ahead of now is refused as
    ``future``: clocks of one machine differ by less. ``unix_time_s`` is the clock for stamps of Unix time.

    Every datagram must have the token in ``token_file``, which is made if it is missing, and kept.

    Raises BadInputError for an address that is invalid or in use, and for a token file that cannot be used.
    """

    def __init__(self, address: str, oldest_s: float, unix_time_s: Callable[[], float] = time.time) -> None:
        self._oldest_s = oldest_s
        self._unix_time_s = unix_time_s
        self._refused: Counter[str] = Counter()
        self._received = 0
        parsed = parse_address(address)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(parsed)
        except OSError as error:
            self._socket.close()
            raise BadInputError(f"estimator.fix = {address!r} cannot be opened ({error}); choose another") from error
        try:
            self.token_file = token_file("fixes", parsed[1])
            if not self.token_file.exists():
                make_token(self.token_file)
            self._token = read_token(self.token_file)
        except BadInputError:
            self._socket.close()
            raise

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        """Return the fixes that have arrived; ``truth`` is not used."""
        fixes: list[MeasuredPose] = []
        for datagram in self._datagrams(_AT_MOST):
            try:
                fixes.append(self._read(datagram, now_ns))
            except Refused as refused:
                self._refused[refused.cause] += 1
        return fixes

    def skip(self) -> None:
        """Refuse waiting datagrams as ``waited``: an age read later would count from too late a time."""
        for _ in self._datagrams(_SKIPPED_AT_MOST):
            self._refused["waited"] += 1

    def _datagrams(self, at_most: int) -> Iterator[bytes]:
        for _ in range(at_most):
            try:
                datagram = self._socket.recv(_BUFFER_BYTES)
            except BlockingIOError:
                break
            except OSError:
                # Windows reports errors of sent datagrams here, and this socket sends none.
                self._refused["socket"] += 1
                continue
            self._received += 1
            yield datagram

    def restart(self) -> None:
        """Do nothing: what arrived without the robot was skipped."""

    def figures(self) -> dict[str, Any]:
        """Return the number of datagrams read, and of those refused by cause."""
        return {"received": self._received, "refused": dict(self._refused)}

    def close(self) -> None:
        """Release the port. Closing twice is allowed."""
        self._socket.close()

    def _read(self, datagram: bytes, now_ns: int) -> MeasuredPose:
        message = parse(datagram, self._token)
        age_s = message.age_at(self._unix_time_s())
        if age_s > self._oldest_s:
            raise Refused("stale")
        if age_s < -_FUTURE_S:
            raise Refused("future")
        return MeasuredPose(now_ns - round(age_s * _NS), message.pose, message.covariance)
