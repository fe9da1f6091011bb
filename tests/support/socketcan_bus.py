"""CAN interfaces for one test, and an onlooker on a bus that shares nothing with our links: a raw socket, cantools."""

import contextlib
import fcntl
import hashlib
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cantools

from tests.support.processes import ROOT, environment

DBC = cantools.database.load_file(ROOT / "firmware_protocol" / "wheel.dbc")
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000  # flags in can_id, linux/can.h
FIRST_HELLO_ID = DBC.get_message_by_name("HELLO_REQUEST").frame_id
CLASSIC = struct.Struct("=IB3x8s")  # struct can_frame
FD = struct.Struct("=IBB2x64s")  # struct canfd_frame
_IFREQ = struct.Struct("=16sH22x")  # struct ifreq with its flags, netdevice(7)
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _IFF_UP = 0x8913, 0x8914, 0x1
_SO_RXQ_OVFL = 40
_SO_RCVBUFFORCE = 33
_ROOM_BYTES = 64 * 2**20


def ip(*arguments: str) -> None:
    """Run ``ip link ...``."""
    subprocess.run(["ip", "link", *arguments], check=True)


def set_up(interface: str, *, up: bool) -> None:
    """Bring an interface up or down, in no time: a process made for it takes that of a robot being driven."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as any_socket:
        request = _IFREQ.pack(interface.encode(), 0)
        name, flags = _IFREQ.unpack(fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, _IFREQ.pack(name, flags | _IFF_UP if up else flags & ~_IFF_UP))


@contextlib.contextmanager
def vcan(name: str) -> Iterator[str]:
    """Make a classic bus of its own: everyone on the interface hears everyone."""
    ip("add", name, "type", "vcan")
    ip("set", name, "mtu", "16", "up")
    try:
        yield name
    finally:
        with contextlib.suppress(subprocess.CalledProcessError):  # the test may have removed it
            ip("delete", name)


@contextlib.contextmanager
def cable(host: str, robot: str, *, is_fd: bool) -> Iterator[None]:
    """Make a cable with an interface at each end; what one end sends is received at the other."""
    ip("add", host, "type", "vxcan", "peer", "name", robot)
    for name in (host, robot):
        ip("set", name, "mtu", str(FD.size if is_fd else CLASSIC.size), "up")
    try:
        yield
    finally:
        ip("delete", host)


def raw_socket(interface: str) -> socket.socket:
    """Return a raw socket on an interface that takes classic and FD frames."""
    opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    opened.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    opened.bind((interface,))
    return opened


def classic_frame(can_id: int, payload: bytes) -> bytes:
    """Return the bytes of a struct can_frame; flags are part of the identifier."""
    return CLASSIC.pack(can_id, len(payload), payload)


class Seen(NamedTuple):
    """A frame on the bus."""

    can_id: int
    payload: bytes
    is_fd: bool


class Onlooker:
    """Takes every frame on an interface from now on, in order."""

    def __init__(self, interface: str) -> None:
        self._socket = raw_socket(interface)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _ROOM_BYTES)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._socket.setblocking(False)

    def take(self) -> list[Seen]:
        """Return the frames since the last call; none may have been lost."""
        frames = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data, ancillary, _, _ = self._socket.recvmsg(FD.size, 64)
                # The kernel adds how many were dropped, once there were any.
                assert not ancillary, "the onlooker's buffer was too small"
                is_fd = len(data) == FD.size
                can_id, length = struct.unpack_from("=IB", data)
                frames.append(Seen(can_id, data[8 : 8 + length], is_fd))
        return frames

    def close(self) -> None:
        self._socket.close()


def wire_sha256(frames: Sequence[Seen]) -> str:
    """Return the host's expected ``wire_sha256`` from the frames on the bus: wheel.dbc has the sender of each.

    The session begins after HELLO. A STEP that the host repeated because this machine stalled is no part of it, nor is
    its second answer.
    """
    begin = max(index for index, frame in enumerate(frames) if frame.can_id >= FIRST_HELLO_ID) + 1
    digests = {"HOST": hashlib.sha256(), "ROBOT": hashlib.sha256()}
    step, step_done = (DBC.get_message_by_name(name).frame_id for name in ("STEP", "STEP_DONE"))
    host_s_last, is_answered = None, True
    for frame in frames[begin:]:
        (sender,) = DBC.get_message_by_frame_id(frame.can_id).senders
        # The host sends nothing else before it has the answer.
        if frame.can_id == step and frame == host_s_last:
            continue
        if frame.can_id == step_done and is_answered:
            continue
        if sender == "HOST":
            host_s_last = frame
        if frame.can_id in (step, step_done):
            is_answered = frame.can_id == step_done
        digests[sender].update(struct.pack("<HB", frame.can_id, len(frame.payload)) + frame.payload)
    return hashlib.sha256(digests["HOST"].digest() + digests["ROBOT"].digest()).hexdigest()


@contextlib.contextmanager
def foreign_traffic(interface: str) -> Iterator[subprocess.Popen[str]]:
    """Run ``tests.support.foreign_traffic`` on the interface; its last line says how much it sent."""
    command = [sys.executable, str(Path(__file__).with_name("foreign_traffic.py")), interface]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment())
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=30)
