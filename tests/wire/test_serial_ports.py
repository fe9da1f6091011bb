"""Serial ports in every form that pyserial has: what goes in comes out, and each loss and refusal is said."""

import contextlib
import itertools
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import DeviceError, LinkError
from hil.robot import handshake
from hil.wire.framed import StreamLink
from hil.wire.reopening import OpeningBeside
from hil.wire.serial_port import Reader, SerialStream
from hil.wire.url import parse_link
from tests.support.heard import the_next
from tests.support.serial_server import SerialServer, ThreeWirePort

pty = pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")

WAIT_NS = 5_000_000_000
FRAMES = [Frame(m.WheelCommand.ID, bytes([i, 0, 0xFF, 0x0D, 0x0A, 0x11, 0x13, i])) for i in range(50)]


class PickyPort(ThreeWirePort):
    """A port whose hardware goes up to 115200 baud."""

    @serial.Serial.baudrate.setter
    def baudrate(self, rate: int) -> None:
        if rate > 115_200:
            raise ValueError(f"Not a valid baudrate: {rate!r}")
        serial.Serial.baudrate.fset(self, rate)


@contextlib.contextmanager
def served(kind: str, port_class: type[serial.Serial] = ThreeWirePort) -> Iterator[tuple[StreamLink, SerialServer]]:
    """The robot's end of a pseudo-terminal, and a server for the other side."""
    master = pty.PtyStream()
    port = port_class(master.port, timeout=0)
    server = SerialServer(port, rfc2217=kind == "rfc2217")
    try:
        yield StreamLink(master), server
    finally:
        server.close()
        port.close()
        master.close()


def exchange(host: StreamLink, robot: StreamLink) -> None:
    for one, other in ((host, robot), (robot, host)):
        for frame in FRAMES:
            one.send(frame)
        assert the_next(other, len(FRAMES), WAIT_NS) == FRAMES


@pytest.mark.parametrize("kind", ["rfc2217", "socket"])
def test_frames_pass_a_serial_server_both_ways(kind):
    with served(kind) as (robot, server), contextlib.closing(parse_link(f"serial:{server.url}").open_host()) as host:
        exchange(host, robot)
        assert host.receive(0) is None
        assert server.url in host.describe()


def reopen(host: StreamLink) -> None:
    """Reopen a link to a server, which answers at once or after a while."""
    while True:
        try:
            host.reopen()
        except LinkError as error:
            if "has not answered yet" not in str(error):
                raise
        else:
            return


def use_until_lost(host: StreamLink) -> None:
    for _ in range(100):
        host.receive(100_000_000)
        host.send(FRAMES[0])


@pytest.mark.parametrize("kind", ["rfc2217", "socket"])
def test_a_serial_server_that_ends_is_a_lost_link_and_can_be_reopened(kind):
    with served(kind) as (_, server):
        host = parse_link(f"serial:{server.url}").open_host()
        url, number = server.url, server.number
    with pytest.raises(LinkError, match=r"was lost|took no byte"):
        use_until_lost(host)
    with pytest.raises(LinkError, match=r"Connection refused.*with the serial server running there"):
        reopen(host)
    master = pty.PtyStream()
    port = ThreeWirePort(master.port, timeout=0)
    again = SerialServer(port, rfc2217=kind == "rfc2217", listen=number)
    try:
        assert again.url == url
        reopen(host)
        exchange(host, StreamLink(master))
    finally:
        host.close()
        again.close()
        port.close()
        master.close()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a server is refused that takes nobody in")
def test_nobody_waits_for_a_serial_server_that_does_not_answer() -> None:
    with served("socket") as (_, server):
        host = parse_link(f"serial:{server.url}").open_host()
        number = server.number
    with contextlib.ExitStack() as resources:
        listener = resources.enter_context(socket.create_server(("127.0.0.1", number), backlog=0))
        # Nobody accepts this one, and who comes after it is not even answered.
        resources.enter_context(socket.create_connection(("127.0.0.1", number)))
        for _ in range(2):
            with pytest.raises(LinkError, match="has not answered yet"):
                host.reopen()
        listener.accept()[0].close()
        reopen(host)
        connection = resources.enter_context(listener.accept()[0])
        host.send(FRAMES[0])
        assert connection.recv(100)
        host.close()
        assert connection.recv(100) == b""


def test_a_port_that_opens_when_nobody_waits_for_it_any_more_is_closed() -> None:
    opens, closed = threading.Event(), threading.Event()

    class Port:
        close = closed.set

    def opened() -> Port:
        opens.wait()
        return Port()

    beside = OpeningBeside(opened)
    assert beside.result(0.0) is None
    beside.abandon()
    opens.set()
    assert closed.wait(30)


def test_a_refused_baud_rate_names_the_rate_and_others():
    with (
        served("rfc2217", PickyPort) as (_, server),
        pytest.raises(LinkError, match=r"refuses 2000000 baud; common rates are .*set baud= in the link") as caught,
    ):
        parse_link(f"serial:{server.url}?baud=2000000").open_host()
    assert "\n" not in str(caught.value)


def test_loop_gives_back_what_was_sent():
    with contextlib.closing(parse_link("serial:loop://").open_host()) as link:
        for frame in FRAMES:
            link.send(frame)
        assert the_next(link, len(FRAMES), WAIT_NS) == FRAMES


@pytest.mark.parametrize("baud", [9600, 921_600, 2_000_000, 3_500_000, 4_000_000])
def test_a_baud_rate_is_set(baud):
    """stty is the independent witness of what the kernel holds."""
    master = pty.PtyStream()
    with contextlib.closing(master), contextlib.closing(SerialStream(master.port, baud)) as stream:
        told = subprocess.run(["stty", "-F", master.port, "speed"], capture_output=True, text=True, check=True)
        assert int(told.stdout) == baud
        assert f"at {baud} baud" in stream.describe()


@pytest.mark.proves("R-SER-1")
def test_a_line_has_eight_bits_no_parity_one_stop_bit_and_no_flow_control_whatever_it_had():
    master = pty.PtyStream()
    with contextlib.closing(master):
        subprocess.run(["stty", "-F", master.port, "cstopb", "crtscts", "ixon", "ixoff"], check=True)
        url = parse_link(f"serial:{master.port}")
        with contextlib.closing(url.open_host()) as link:
            told = subprocess.run(["stty", "-F", master.port, "-a"], capture_output=True, text=True, check=True).stdout
            assert "at 921600 baud" in link.describe()
    assert {"cs8", "-parenb", "-cstopb", "-crtscts", "-ixon", "-ixoff"} <= set(told.replace(";", " ").split())


def test_a_baud_rate_without_a_name_of_its_own_is_set():
    """stty tells only rates that have one."""
    master = pty.PtyStream()
    with contextlib.closing(master), contextlib.closing(StreamLink(SerialStream(master.port, 12_000_000))) as host:
        exchange(host, StreamLink(master))


def test_a_driver_without_low_latency_mode_is_said_in_the_description():
    master = pty.PtyStream()
    with contextlib.closing(master), contextlib.closing(SerialStream(master.port, 921_600)) as stream:
        assert "low latency not offered by its driver" in stream.describe()


def test_a_read_waits_for_the_first_byte_and_no_longer():
    master = pty.PtyStream()
    with contextlib.closing(master), contextlib.closing(SerialStream(master.port, 921_600)) as stream:
        later = threading.Timer(0.05, master.write, (b"late",))
        later.start()
        assert stream.read(60_000_000_000)
        later.join()
        begin_ns = time.monotonic_ns()
        while stream.read(0):
            pass
        assert stream.read(20_000_000) == b""
        assert time.monotonic_ns() - begin_ns > 15_000_000


def test_a_line_that_takes_no_byte_is_lost_after_a_second():
    master = pty.PtyStream()
    with (
        contextlib.closing(master),
        contextlib.closing(SerialStream(master.port, 921_600)) as stream,
        pytest.raises(
            LinkError, match=r"took no byte for 1 s; check that the robot reads, and the line's flow control$"
        ),
    ):
        stream.write(bytes(1 << 20))


def test_a_replugged_port_is_reopened_and_counters_go_on(tmp_path: Path):
    name = tmp_path / "port"
    first = pty.PtyStream(name)
    host = StreamLink(SerialStream(str(name), 921_600))
    first.write(b"\x07wrong\0")
    assert host.receive(100_000_000) is None
    rejected = host.rejected()
    assert sum(rejected.values()) == 1
    first.write(b"\x05half")
    first.close()
    with pytest.raises(LinkError, match="lost"):
        host.receive(WAIT_NS)
    with pytest.raises(LinkError, match="does not exist"):
        host.reopen()
    second = pty.PtyStream(name)
    with contextlib.closing(second), contextlib.closing(host):
        host.reopen()
        exchange(host, StreamLink(second))
        assert host.rejected() == rejected
        host.reopen()
        assert host.rejected() == rejected


def test_a_port_that_hangs_up_is_lost_and_so_is_a_read_of_one_that_another_program_reads_too(monkeypatch):
    """pyserial has the same words for both: there was something to read, and then nothing."""
    master = pty.PtyStream()
    with contextlib.closing(SerialStream(master.port, 921_600)) as stream:
        monkeypatch.setattr(serial.serialposix.os, "read", lambda _descriptor, _size: b"")  # what the other one left
        master.write(b"x")
        with pytest.raises(LinkError, match=rf"serial port '{master.port}' was lost .*another program reads it too"):
            stream.read(WAIT_NS)
        monkeypatch.undo()
        assert stream.read(WAIT_NS) == b"x"
        master.close()
        with pytest.raises(LinkError, match=r"was lost \(it is gone"):
            stream.read(WAIT_NS)


def test_a_port_that_is_unplugged_while_it_is_opened_is_one_sentence(monkeypatch):
    """pyserial then flushes a missing port; the result is an error of termios, which is no OSError."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    monkeypatch.setattr(serial.Serial, "_update_dtr_state", lambda _: os.close(master))
    monkeypatch.setattr(serial.Serial, "_update_rts_state", lambda _: None)
    with pytest.raises(LinkError, match=rf"'{name}' could not be opened: Input/output error; list the ports"):
        SerialStream(name, 921_600)


def test_waiting_for_a_port_without_a_descriptor_never_polls_in_waiting(monkeypatch):
    """loop:// has no descriptor. The wait is over when something comes, and in_waiting is asked only then."""
    from serial.urlhandler import protocol_loop

    asked = itertools.count()
    original = protocol_loop.Serial.in_waiting.fget

    def in_waiting(port: serial.SerialBase) -> int:
        next(asked)
        return original(port)

    monkeypatch.setattr(protocol_loop.Serial, "in_waiting", property(in_waiting))
    with contextlib.closing(SerialStream("loop://", 115_200)) as stream:
        assert stream.read(300_000_000) == b""
        assert next(asked) == 0
        threading.Timer(0.1, stream.write, [b"x"]).start()
        assert stream.read(WAIT_NS) == b"x"


@pytest.mark.parametrize(
    ("port", "says"),
    [
        ("bogus://x", r"protocol 'bogus' not known"),
        ("rfc2217://localhost", r"its port number is missing"),
        ("socket://127.0.0.1:1", r"Connection refused"),
        ("hwgrep://no_such_adapter", r"no ports found.*list the ports with"),
        ("hwgrep://(", r"unterminated subpattern"),
    ],
)
def test_a_url_that_cannot_be_opened_is_one_sentence(port, says):
    with pytest.raises(LinkError, match=says) as caught:
        SerialStream(port, 115_200)
    assert "\n" not in str(caught.value)


def test_a_handshake_over_noise_says_that_the_baud_rate_is_wrong(monkeypatch):
    master = pty.PtyStream()
    with (
        contextlib.closing(master),
        contextlib.closing(StreamLink(SerialStream(master.port, 921_600))) as host,
    ):
        monkeypatch.setattr(host, "send", lambda _: master.write(b"\x55\xaa noise \0"))
        with pytest.raises(DeviceError, match=r"were damaged: set baud= in the link"):
            handshake.greet(host, handshake.Greeting())


def test_a_handshake_in_silence_names_the_link():
    master = pty.PtyStream()
    with (
        contextlib.closing(master),
        contextlib.closing(StreamLink(SerialStream(master.port, 921_600))) as host,
        pytest.raises(DeviceError, match=r"did not answer HELLO within 2 s \(serial port .* check that it is"),
    ):
        handshake.greet(host, handshake.Greeting())


class FloodedPort:
    """A port whose driver gives this many bytes at once, and then fails in an unforeseen way."""

    timeout: float | None = None
    in_waiting = (1 << 20) + 9

    def read(self, size: int = 1, /) -> bytes:
        return bytes(size)


def test_a_port_whose_bytes_nobody_reads_is_lost():
    reader = Reader(FloodedPort())
    reader.join()
    assert len(reader.read(0)) > 1 << 20
    with pytest.raises(OSError, match="bytes were not read"):
        reader.read(WAIT_NS)
