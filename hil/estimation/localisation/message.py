"""The message of an external pose fix: one JSON object in one datagram (hil/estimation/ESTIMATORS.md). No I/O.

{"version": 1, "token": "...", "age_s": 0.1, "x_m": 1.0, "y_m": 0.5, "heading_rad": 0.7,
 "covariance": [4e-4, 0, 0, 4e-4, 0, 1e-4]}
"""

import ipaddress
import json
import math
import secrets
from typing import NamedTuple
from urllib.parse import urlsplit

from hil.core.errors import BadInputError
from hil.core.types import Pose, PoseCovariance
from hil.estimation.correction import is_regular

LOOPBACK = "127.0.0.1"
_EXPECTED = 'expected "simulated" or udp://127.0.0.1:PORT with a port from 1 to 65535'


def parse_address(address: str, named: str = "estimator.fix", expected: str = _EXPECTED) -> tuple[str, int]:
    """Return host and port of ``udp://HOST:PORT``; without a host it is 127.0.0.1.

    Other hosts must be given as an IPv4 address in numbers, because whoever can send there moves the robot's pose.
    Raises BadInputError, which begins with ``named``, for anything else.
    """
    refusal = f"{named} = {address!r}"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or LOOPBACK, parts.port
    except ValueError:
        raise BadInputError(f"{refusal}: no address; {expected}") from None
    extra = parts.path or parts.query or parts.fragment or parts.username
    if parts.scheme != "udp" or not parts.netloc or extra or port is None or port == 0:
        raise BadInputError(f"{refusal}: no address; {expected}")
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
    """A fix as it was sent; one of ``age_s`` and ``unix_time_s`` is None."""

    age_s: float | None
    unix_time_s: float | None
    pose: Pose
    covariance: PoseCovariance

    def age_at(self, unix_time_s: float) -> float:
        """Return the age [s] of its sample at this Unix time [s]."""
        if self.unix_time_s is not None:
            return unix_time_s - self.unix_time_s
        assert self.age_s is not None
        return self.age_s


def parse(datagram: bytes, token: str) -> Received:
    """Read a datagram that must have the token.

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
    age_s, unix_time_s = (stamp if name in stamps else None for name in _STAMPS)
    return Received(age_s, unix_time_s, pose, covariance)


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
    """Return whether it is positive definite and far from singular, so that a filter can invert it.

    No sigma is below 10 µm or 10 µrad, and the other two components determine none to less than a twentieth of its
    sigma, which is a correlation of 0.9987.
    """
    xx, xy, xh, yy, yh, hh = covariance
    if max(xx, yy, hh) > LARGEST or min(xx, yy, hh) < LEAST_VARIANCE:
        return False
    # Cholesky's pivots, as shares of the diagonal: of three the order matters, so that the last is asked for each.
    return all(
        is_regular(*ordered, share=_LEAST_SHARE)
        for ordered in ((xx, xy, xh, yy, yh, hh), (yy, yh, xy, hh, xh, xx), (hh, xh, yh, xx, xy, yy))
    )
