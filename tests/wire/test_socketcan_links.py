"""One link and a kernel's CAN bus: passed frames, counts, and messages on failure."""

import errno
import socket
import subprocess
from collections.abc import Iterator

import can
import pytest

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import LENGTHS, SENDERS
from hil.core.errors import LinkError
from hil.core.ports import Link
from hil.wire.can_bus import SocketCan
from hil.wire.can_url import CanUrl
from hil.wire.url import parse_link
from tests.support.heard import the_next
from tests.support.socketcan_bus import (
    CLASSIC,
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    classic_frame,
    ip,
    raw_socket,
    set_up,
    vcan,
)

pytestmark = pytest.mark.socketcan

MS = 1_000_000
EVERY_ID = range(0x800)
HEARD = {can_id: length for can_id, length in LENGTHS.items() if SENDERS[can_id] == "ROBOT"}
A_ROBOT_S, ITS_LENGTH = max(HEARD.items(), key=lambda one: one[1])
END = Frame(A_ROBOT_S, b"\xff" * ITS_LENGTH)


@pytest.fixture
def bus() -> Iterator[str]:
    with vcan("hil_test") as name:
        yield name


@pytest.fixture
def other(bus: str) -> Iterator[socket.socket]:
    """Another device on the bus."""
    with raw_socket(bus) as opened:
        yield opened


@pytest.fixture
def link(bus: str) -> Iterator[Link]:
    opened = parse_link(f"can:socketcan/{bus}").open_host()
    yield opened
    opened.close()


def take_all(link: Link, other: socket.socket) -> list[Frame]:
    """Return the frames that the link passes of all sent before, up to a frame that marks the end.

    The kernel delivers later than it sends, so that nothing is there yet proves nothing.
    """
    other.send(classic_frame(*END))
    frames: list[Frame] = []
    while END not in frames:
        frames += the_next(link, 1, 10_000 * MS)
    return frames[: frames.index(END)]


def send_often(link: Link, frame: Frame) -> None:
    for _ in range(100_000):
        link.send(frame)


@pytest.mark.proves("R-CAN-3")
def test_of_all_identifiers_only_the_robot_s_pass_in_order(link: Link, other: socket.socket):
    arrived = []
    for can_id in EVERY_ID:
        payload = bytes(range(LENGTHS.get(can_id, 8)))
        for flags in (0, EXTENDED, REMOTE):
            other.send(classic_frame(can_id | flags, payload))
        if can_id % 32 == 31:  # a socket's buffer holds some 200
            arrived += take_all(link, other)
    assert arrived == [Frame(can_id, bytes(range(length))) for can_id, length in sorted(HEARD.items())]


@pytest.mark.proves("R-TRN-1")
def test_a_frame_of_ours_with_another_length_is_dropped_and_counted(link: Link, other: socket.socket):
    for number, (can_id, expected) in enumerate(HEARD.items(), start=1):
        for length in range(9):
            if length != expected:
                other.send(classic_frame(can_id, bytes(length)))
        assert take_all(link, other) == []
        assert link.rejected()["length"] == 8 * number


def test_error_frames_reach_the_counters_and_nobody_else(link: Link, other: socket.socket):
    """Bus error, error passive and an arbitration that was lost, as a controller's driver tells them."""
    for classes, data in ((0x088, bytes(8)), (0x004, bytes([0, 0x30, 0, 0, 0, 0, 0, 0])), (0x002, bytes(8))):
        other.send(classic_frame(ERROR | classes, data))
    assert take_all(link, other) == []
    assert sum(count for cause, count in link.rejected().items() if cause.startswith("error")) >= 3


@pytest.mark.proves("R-CAN-2")
def test_what_a_link_sends_is_a_classic_frame_with_its_bits(link: Link, other: socket.socket):
    for can_id, length in LENGTHS.items():
        link.send(Frame(can_id, bytes(range(1, length + 1))))
        sent = CLASSIC.unpack(other.recv(FD.size))
        assert sent == (can_id, length, bytes(range(1, length + 1)).ljust(8, b"\0"))
    assert take_all(link, other) == [], "a link does not hear itself"


@pytest.mark.parametrize("options", ["vcan0", "vcan1?fd=1", "vcan1?fd=1&data_bitrate=4000000"])
def test_frames_are_read_and_written_as_python_can_does(options: str):
    url = parse_link(f"can:socketcan/{options}")
    assert isinstance(url, CanUrl)
    sent = [classic_frame(can_id, bytes(range(8))) for can_id in (0x7FF, ERROR | 0x88, EXTENDED | 0x1ABCDEF0, EXTENDED)]
    sent += [classic_frame(0x123 | flags, bytes(length)) for flags in (0, REMOTE) for length in (0, 3, 8)]
    if url.fd:
        sent += [FD.pack(0x234, length, flags, bytes(range(length))) for length in (0, 8, 64) for flags in range(4)]
    with (
        can.Bus(interface="socketcan", channel=url.channel, fd=url.fd) as bus,
        can.Bus(interface="socketcan", channel=url.channel, fd=url.fd) as oracle,
        raw_socket(url.channel) as stranger,
    ):
        port = SocketCan(can, bus, url)
        for raw in sent:
            stranger.send(raw)
        for _ in sent:
            read, expected = port.message_of(port.receive(2_000 * MS)), oracle.recv(2)
            assert expected is not None
            assert read.equals(expected, timestamp_delta=None, check_channel=False, check_direction=False)
        port.send(END)
        written = oracle.recv(2)
        assert written is not None
        assert (written.arbitration_id, bytes(written.data)) == END
        assert (written.is_fd, written.bitrate_switch) == (url.fd, url.data_bitrate is not None)


def test_a_queue_that_stays_full_is_a_lost_link(bus: str, link: Link):
    subprocess.run(["tc", "qdisc", "add", "dev", bus, "root", "netem", "delay", "100s"], check=True)
    with pytest.raises(LinkError, match=r"the transmit queue stays full; no node acknowledges"):
        send_often(link, END)


def test_an_interface_that_is_not_there_is_named_with_the_remedy():
    with pytest.raises(LinkError, match=r"'socketcan', channel 'can7' does not exist; .*ip -br link.*bitrate 500000$"):
        parse_link("can:socketcan/can7?bitrate=500000").open_host()


def test_an_interface_that_goes_down_says_how_to_bring_it_up_and_can_be_opened_again(
    bus: str, link: Link, other: socket.socket
):
    set_up(bus, up=False)
    sentence = rf"channel '{bus}' is down; bring it up: ip link set {bus} up type can bitrate 1000000$"
    with pytest.raises(LinkError, match=sentence):
        link.receive(100 * MS)
    with pytest.raises(LinkError, match=sentence):
        link.send(Frame(0x10, bytes(2)))
    set_up(bus, up=True)
    again = parse_link(f"can:socketcan/{bus}").open_host()
    with pytest.raises(OSError, match=rf"\[Errno {errno.ENETDOWN}\]"):
        other.recv(FD.size)  # the other socket was told too
    other.send(classic_frame(*END))
    received = again.receive(2_000 * MS)
    assert received is not None
    assert list(received.frames) == [END]
    again.close()


def test_an_interface_that_is_unplugged_is_named(bus: str, link: Link):
    ip("delete", bus)
    with pytest.raises(LinkError, match=rf"channel '{bus}' (does not exist|is down)"):
        link.receive(100 * MS)
    with pytest.raises(LinkError, match=rf"channel '{bus}' does not exist; see the interfaces with: ip -br link"):
        link.send(Frame(0x10, bytes(2)))


def test_can_fd_on_a_classic_interface_is_a_link_error(bus: str):
    link = parse_link(f"can:socketcan/{bus}?fd=1").open_host()
    with pytest.raises(LinkError, match=f"channel '{bus}'"):
        link.send(Frame(0x10, bytes(2)))
    link.close()
