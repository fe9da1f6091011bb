"""Pose fixes from another program, by UDP: one JSON object in one datagram (hil/estimation/ESTIMATORS.md).

{"version": 1, "token": "...", "age_s": 0.1, "x_m": 1.0, "y_m": 0.5, "heading_rad": 0.7,
 "covariance": [4e-4, 0, 0, 4e-4, 0, 1e-4]}
"""

import ipaddress
import json
import math
import secrets
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from hil.core.errors import BadInputError
from hil.core.tokens import make_token, read_token, token_file
from hil.core.types import MeasuredPose, Pose, PoseCovariance, PoseFix
from hil.estimation.kalman import is_regular, worst_and_best

LOOPBACK = "127.0.0.1"
_EXPECTED = 'expected "simulated" or udp://127.0.0.1:PORT with a port from 1 to 65535'


def parse_address(address: str) -> tuple[str, int]:
    """Return host and port of ``udp://HOST:PORT``; without a host it is 127.0.0.1.

    Other hosts must be given as an IPv4 address in numbers, because whoever can send there moves the robot's pose.
    Raises BadInputError for anything else.
    """
    refusal = f"estimator.fix = {address!r}"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or LOOPBACK, parts.port
    except ValueError:
        raise BadInputError(f"{refusal}: no address; {_EXPECTED}") from None
    extra = parts.path or parts.query or parts.fragment or parts.username
    if parts.scheme != "udp" or not parts.netloc or extra or port is None or port == 0:
        raise BadInputError(f"{refusal}: no address; {_EXPECTED}")
    try:
        return str(ipaddress.IPv4Address(LOOPBACK if host == "localhost" else host)), port
    except ValueError:
        raise BadInputError(
            f"{refusal}: {host!r} is no IPv4 address in numbers; expected 127.0.0.1, or that of a network card"
        ) from None


VERSION = 1
LONGEST_BYTES = 1024
LEAST_VARIANCE = 1e-10
LARGEST = 1e6
_LEAST_SHARE = 0.0025
_FIELDS = {"version", "x_m", "y_m", "heading_rad", "covariance"}
_STAMPS = ("age_s", "unix_time_s")


class Refused(Exception):  # noqa: N818 - not an error: a datagram is refused and counted
    """A datagram is not a valid fix; it is counted by ``cause``."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


class Received(NamedTuple):
    """A fix as it was sent, and the age [s] of its sample."""

    age_s: float
    pose: Pose
    covariance: PoseCovariance


def parse(datagram: bytes, token: str, now_unix_s: float) -> Received:
    """Read a datagram that must have the token; ``now_unix_s`` is the present Unix time [s].

    Raises Refused with the cause: too_long, malformed, token, version, not_finite or covariance.
    """
    if len(datagram) > LONGEST_BYTES:
        raise Refused("too_long")
    try:
        message = json.loads(datagram.decode("utf-8"))
    except (ValueError, RecursionError):
        raise Refused("malformed") from None
    if not isinstance(message, dict):
        raise Refused("malformed")
    if not secrets.compare_digest(str(message.pop("token", "")).encode(errors="replace"), token.encode()):
        raise Refused("token")
    version = message.get("version")
    if type(version) is int and version != VERSION:
        raise Refused("version")
    stamps = [name for name in _STAMPS if name in message]
    if len(stamps) != 1 or message.keys() != _FIELDS | set(stamps) or type(version) is not int:
        raise Refused("malformed")
    entries = message["covariance"]
    if not isinstance(entries, list) or len(entries) != len(PoseCovariance._fields):
        raise Refused("malformed")
    stamp = _number(message[stamps[0]])
    pose = Pose(*(_number(message[name]) for name in Pose._fields))
    covariance = PoseCovariance(*map(_number, entries))
    if max(map(abs, pose)) > LARGEST:
        raise Refused("not_finite")
    if not _is_covariance(covariance):
        raise Refused("covariance")
    return Received(stamp if stamps == ["age_s"] else now_unix_s - stamp, pose, covariance)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused("malformed")
    try:
        number = float(value)
    except OverflowError:
        raise Refused("not_finite") from None
    if not math.isfinite(number):
        raise Refused("not_finite")
    return number


def _is_covariance(covariance: PoseCovariance) -> bool:
    """Return whether it is positive definite and far from singular in every frame, so that a filter can invert it.

    No sigma is below 10 µm or 10 µrad in any direction, and heading and position leave each other at least a twentieth
    of their sigma, which is a correlation of 0.9987.
    """
    worst_m2, best_m2 = worst_and_best(covariance.xx_m2, covariance.xy_m2, covariance.yy_m2)
    if max(worst_m2, covariance.hh_rad2) > LARGEST or min(best_m2, covariance.hh_rad2) < LEAST_VARIANCE:
        return False
    return is_regular(covariance, _LEAST_SHARE)


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
        age_s, pose, covariance = parse(datagram, self._token, self._unix_time_s())
        if age_s > self._oldest_s:
            raise Refused("stale")
        if age_s < -_FUTURE_S:
            raise Refused("future")
        return MeasuredPose(now_ns - round(age_s * _NS), pose, covariance)
