"""Messages of ROS 2 as MCAP holds them: their definitions, and their bytes as CDR. Needs no ROS.

Foxglove draws a robot by them: ``std_msgs/msg/String`` with its URDF, and ``tf2_msgs/msg/TFMessage`` with where its
links are. It lists ``rcl_interfaces/msg/Log`` as a log.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

CDR_HEADER = b"\0\1\0\0"  # little-endian
LOG_LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40}
"""The numbers of the levels in ``rcl_interfaces/msg/Log``."""
_LENGTH, _STAMP, _TRANSFORM = struct.Struct("<I"), struct.Struct("<iI"), struct.Struct("<7d")
_LEVEL_AT = 8


class Definition(NamedTuple):
    """A type of message, with the definitions of the types that it uses after its own."""

    name: str
    text: str


def definition(name: str, *others: tuple[str, str], fields: str) -> Definition:
    """Return a definition in the form that MCAP calls ``ros2msg``; ``others`` are the types used, with their fields."""
    parts = [f"{fields}\n", *(f"MSG: {other}\n{inner}\n" for other, inner in others)]
    return Definition(name, ("=" * 80 + "\n").join(parts))


_TIME = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec")
STRING = definition("std_msgs/msg/String", fields="string data")
LOG = definition(
    "rcl_interfaces/msg/Log",
    _TIME,
    fields="builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
    "uint32 line",
)
TF_MESSAGE = definition(
    "tf2_msgs/msg/TFMessage",
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    ),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
    _TIME,
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    fields="geometry_msgs/TransformStamped[] transforms",
)


def string_message(text: str) -> bytes:
    """Return a ``std_msgs/msg/String``."""
    return CDR_HEADER + _string(text)


def log_message(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """Return a ``rcl_interfaces/msg/Log`` at a Unix time, without a place in a source file."""
    body = bytearray(_STAMP.pack(*divmod(stamp_ns, 1_000_000_000)) + bytes([level]))
    for one in (name, text, "", ""):  # the last two: file, function
        _grown(body, 4, 0)
        body += _string(one)
    _grown(body, 4, 4)  # line
    return CDR_HEADER + bytes(body)


def log_fields(message: bytes) -> tuple[int, str]:
    """Return the level and the text of a ``rcl_interfaces/msg/Log``. Raises struct.error or ValueError for damage."""
    body = message[len(CDR_HEADER) :]
    at = _LEVEL_AT + 4
    (size,) = _LENGTH.unpack_from(body, at)
    at += _LENGTH.size + size
    at += -at % 4
    (size,) = _LENGTH.unpack_from(body, at)
    at += _LENGTH.size
    return body[_LEVEL_AT], body[at : at + size - 1].decode()


class TransformMessages:
    """Makes the bytes of ``tf2_msgs/msg/TFMessage`` for the same frames again and again.

    Args:
        frames: parent and child of each transform.
    """

    def __init__(self, frames: Iterable[tuple[str, str]]) -> None:
        body = bytearray()
        self._stamps: list[int] = []
        self._transforms: list[int] = []
        pairs = list(frames)
        body += _LENGTH.pack(len(pairs))
        for parent, child in pairs:
            self._stamps.append(_grown(body, 4, _STAMP.size))
            body += _string(parent)
            _grown(body, 4, 0)
            body += _string(child)
            self._transforms.append(_grown(body, 8, _TRANSFORM.size))
        self._body = body

    def message(self, stamp_ns: int, transforms: Iterable[Sequence[float]]) -> bytes:
        """Return a message at a Unix time; each transform is x, y, z [m] and the quaternion x, y, z, w."""
        stamp = divmod(stamp_ns, 1_000_000_000)
        for at in self._stamps:
            _STAMP.pack_into(self._body, at, *stamp)
        for at, transform in zip(self._transforms, transforms, strict=True):
            _TRANSFORM.pack_into(self._body, at, *transform)
        return CDR_HEADER + bytes(self._body)


def _string(text: str) -> bytes:
    data = text.encode(errors="backslashreplace") + b"\0"
    return _LENGTH.pack(len(data)) + data


def _grown(body: bytearray, alignment: int, size: int) -> int:
    """Align the end of a body (CDR aligns a number to its size), add so many bytes and return where they begin."""
    body += bytes(-len(body) % alignment)
    at = len(body)
    body += bytes(size)
    return at
