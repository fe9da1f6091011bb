"""Error frames, bus-off, full queues and wrong bit rates: seen, counted, said."""

import contextlib
import errno

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, DeviceError, LinkError
from hil.robot import handshake
from hil.wire.can_bus import CanLink
from hil.wire.can_errors import BUS_OFF, CAUSES, causes_of, failure
from hil.wire.can_url import CanUrl
from hil.wire.url import parse_link
from tests.support.heard import the_next

TICK = Frame(m.Tick.ID, bytes(8))
COMMAND = Frame(m.WheelCommand.ID, bytes(8))


def error_frame(identifier: int, *data: int) -> can.Message:
    return can.Message(arbitration_id=identifier, is_error_frame=True, is_extended_id=False, data=bytes(data))


# From Linux, include/uapi/linux/can/error.h.
KNOWN = [
    (0x001, (), ("error_transmit_timeout",)),
    (0x004, (0, 0x04), ("error_warning",)),
    (0x004, (0, 0x10), ("error_passive",)),
    (0x004, (0, 0x20), ("error_passive",)),
    (0x004, (0, 0x01), ("error_overflow",)),
    (0x088, (0, 0, 0x01), ("error_bit",)),
    (0x088, (0, 0, 0x08), ("error_bit",)),
    (0x008, (0, 0, 0x02), ("error_form",)),
    (0x008, (0, 0, 0x04), ("error_stuff",)),
    (0x020, (), ("error_acknowledgement",)),
    (0x040, (), ("error_bus_off",)),
    (0x100, (), ("error_restarted",)),
    (0x08C, (0, 0x30, 0x04), ("error_passive", "error_stuff")),
    (0x000, (), ("error_other",)),
]


@pytest.mark.parametrize(("identifier", "data", "causes"), KNOWN)
def test_an_error_frame_is_counted_by_its_class(identifier, data, causes):
    assert causes_of(identifier, bytes(data)) == causes


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_every_error_frame_has_a_cause_that_is_counted(identifier, data):
    causes = causes_of(identifier, data)
    assert causes
    assert set(causes) <= set(CAUSES)


@contextlib.contextmanager
def host_and_stranger(channel: str):
    with (
        contextlib.closing(CanLink(CanUrl("virtual", channel), "ROBOT")) as host,
        can.Bus(interface="virtual", channel=channel) as stranger,
    ):
        yield host, stranger


def counted(link: CanLink) -> dict[str, int]:
    return {cause: count for cause, count in link.rejected().items() if count}


def test_error_frames_between_ours_are_counted_and_ours_arrive():
    with host_and_stranger("errors") as (host, stranger):
        stranger.send(error_frame(0x088, 0, 0, 0x04))
        stranger.send(error_frame(0x020))
        stranger.send(can.Message(arbitration_id=TICK.id, is_extended_id=False, data=TICK.payload))
        assert the_next(host) == [TICK]
        assert counted(host) == {"error_stuff": 1, "error_acknowledgement": 1}


def test_bus_off_is_a_lost_link_and_reopening_goes_on():
    with host_and_stranger("bus_off") as (host, stranger):
        stranger.send(error_frame(0x040))
        with pytest.raises(LinkError, match=r"is bus-off .*two terminators; .*restart-ms 100"):
            host.receive(1_000_000_000)
        host.reopen()
        stranger.send(can.Message(arbitration_id=TICK.id, is_extended_id=False, data=TICK.payload))
        assert the_next(host) == [TICK]
        assert counted(host) == {BUS_OFF: 1}


def test_bus_off_is_seen_where_only_the_interface_knows(monkeypatch):
    from can.interfaces.virtual import VirtualBus

    monkeypatch.setattr(VirtualBus, "state", can.BusState.ERROR)
    with host_and_stranger("state") as (host, _), pytest.raises(LinkError, match=r"is bus-off"):
        host.receive(0)


def refuse(monkeypatch: pytest.MonkeyPatch, times: int) -> None:
    """Make so many sends fail as SocketCAN's do while its queue is full."""
    from can.interfaces.virtual import VirtualBus

    send, left = VirtualBus.send, [times]

    def full(bus: VirtualBus, message: can.Message, timeout: float | None = None) -> None:
        left[0] -= 1
        if left[0] >= 0:
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        send(bus, message, timeout)

    monkeypatch.setattr(VirtualBus, "send", full)


def test_a_queue_that_is_full_for_a_moment_loses_nothing(monkeypatch):
    with host_and_stranger("queue") as (host, stranger):
        refuse(monkeypatch, 5)
        host.send(COMMAND)
        assert stranger.recv(1.0).arbitration_id == COMMAND.id


def test_a_queue_that_stays_full_is_a_lost_link(monkeypatch):
    with host_and_stranger("full") as (host, _):
        refuse(monkeypatch, 1_000_000)
        with pytest.raises(LinkError, match=r"transmit queue stays full; no node acknowledges"):
            host.send(COMMAND)


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (error_frame(0x088, 0, 0, 0x04), r"error frames came and no valid one: the bit rate is wrong"),
        (error_frame(0x020), r"no device on the bus acknowledges our frames"),
        (can.Message(arbitration_id=0x555, is_extended_id=False), r"frames of other devices came, so the bus works"),
        (
            can.Message(arbitration_id=TICK.id, is_extended_id=False, data=TICK.payload),
            r"frames of a robot came, but not its HELLO",
        ),
    ],
)
def test_a_handshake_in_vain_says_what_the_bus_tells(frame, says, monkeypatch):
    with host_and_stranger("handshake") as (host, stranger):
        monkeypatch.setattr(host, "send", lambda _: [stranger.send(frame) for _ in range(20)])
        with pytest.raises(DeviceError, match=says):
            handshake.greet(host, handshake.Greeting())


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("can:pcan/PCAN_USBBUS1", r"install PEAK's PCAN-Basic library"),
        ("can:kvaser/0", r"install Kvaser's CANlib"),
        ("can:ixxat/0", r"install IXXAT's VCI driver"),
        ("can:vector/0", r"install Vector's XL Driver Library"),
        ("can:slcan//dev/ttyNOPE", r"ttyNOPE.*list the ports with"),
    ],
)
def test_an_interface_that_cannot_be_opened_says_what_is_missing(url, says):
    with pytest.raises(LinkError, match=says) as caught:
        parse_link(url).open_host()
    assert "\n" not in str(caught.value)


CAN0, ADAPTER = CanUrl("socketcan", "can0", 250_000), CanUrl("slcan", "/dev/ttyS9", 250_000)
UP = "bring it up: ip link set can0 up type can bitrate 250000"


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("url", "error", "says"),
    [
        (CAN0, can.CanError("x", errno.ENETDOWN), f"is down; {UP}"),
        (CAN0, can.CanError("Error: Network is down"), f"is down; {UP}"),
        (CAN0, OSError(errno.ENODEV, "x"), f"does not exist; see the interfaces with: ip -br link; then {UP}"),
        (CAN0, OSError(errno.ENXIO, "x"), f"does not exist; see the interfaces with: ip -br link; then {UP}"),
        (CAN0, caused(can.CanError("x"), OSError(errno.EAFNOSUPPORT, "y")),
         ": this system's kernel has no CAN; load it with: modprobe can_raw"),
        (CAN0, can.CanError("Transmit buffer full"),
         ": the transmit queue stays full; no node acknowledges, check bit rate and cable"),
        (CAN0, NotImplementedError("[Error Code 7] no  driver"),
         " cannot be used: install its manufacturer's software, which python-can asks for: no driver"),
        (CAN0, OSError("Address family not supported by protocol"), ": this system's kernel has no CAN; load it with"),
        (CAN0, can.CanError("canlib32.dll could not be loaded"), "python-can asks for: canlib32.dll could not be"),
        (CAN0, can.CanError("the library not found"), " cannot be used: install its manufacturer's software"),
        (CAN0, ValueError("bitrate 250000 of 3"),
         " cannot run at 250000 bit/s (bitrate 250000 of 3); set bitrate= to one of these"),
        (CAN0, ValueError("odd"),
         " failed (odd); check that the adapter is plugged in and used by no other program"),
        (ADAPTER, caused(can.CanError("x"), OSError("Write timeout")),
         " takes no bytes any more; unplug the adapter and plug it in again"),
        (ADAPTER, OSError(errno.EIO, "x"), " was lost (it is gone, or another program reads it too"),
        (ADAPTER, OSError(errno.EIO, "x"), "); plug the adapter in again, and check its cable"),
        (ADAPTER, OSError(errno.EBUSY, "x"), " is busy: another program holds it"),
        (ADAPTER, ValueError("odd"),
         " failed (odd); check that the adapter is plugged in and free; list the ports with: python -m serial.tools"),
    ],
)  # fmt: skip
def test_a_failure_of_a_bus_is_one_sentence_with_its_remedy(url, error, says):
    message = str(failure(url, error))
    assert message.startswith(f"CAN interface '{url.interface}', channel '{url.channel}'")
    assert says in message


def test_an_interface_without_can_fd_is_refused():
    with pytest.raises(BadInputError, match=r"has no CAN FD in python-can; remove fd=1"):
        parse_link("can:slcan/loop:%2F%2F?fd=1").open_host()


def test_a_bus_that_cannot_be_shut_down_is_noted_and_closed_all_the_same(monkeypatch, caplog):
    from can.interfaces.virtual import VirtualBus

    def unplugged(_: VirtualBus) -> None:
        raise can.CanError("no such device")

    caplog.set_level("INFO")
    with host_and_stranger("unplugged") as (host, _), monkeypatch.context() as patch:
        patch.setattr(VirtualBus, "shutdown", unplugged)
        host.close()
    assert "CAN interface virtual, channel unplugged, 1000000 bit/s: closing failed: no such device" in caplog.messages


def test_a_closed_bus_is_a_lost_link():
    link = CanLink(CanUrl("virtual", "closed"), "ROBOT")
    link.close()
    link.close()
    for use in (lambda: link.send(COMMAND), lambda: link.receive(0)):
        with pytest.raises(LinkError, match=r"is closed; reopen it"):
            use()
