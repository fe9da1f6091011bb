"""A pseudo-terminal that nobody reads for a while: nothing is cut, and losses are counted."""

import contextlib
import itertools
import os
import threading
import time
from pathlib import Path

import pytest

from firmware_protocol import codec
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.clock import WallClock
from hil.core.errors import LinkError
from hil.robot.channel import open_channel
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.pty import PtyStream
from hil.wire.robot_end import SerialWire
from hil.wire.streams import memory_pair
from hil.wire.url import parse_link
from tests.support.client_rig import new_client
from tests.support.heard import the_next
from tests.support.processes import device
from tests.support.wheel_rig import WheelRig

pty = pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")

WAIT_NS = 2_000_000_000
FRAME = Frame(m.WheelCommand.ID, bytes(range(8)))


def read_all(port: int, enough: int = 1 << 30) -> bytes:
    """Read the data that wait at the host's side, and further data up to this many bytes."""
    data = b""
    os.set_blocking(port, enough < 1 << 30)
    with contextlib.suppress(BlockingIOError):
        while len(data) < enough:
            piece = os.read(port, 65536)
            assert piece, "somebody else has set up the line, or hung it up"
            data += piece
    return data


@contextlib.contextmanager
def opened(stream):
    """The host's side of a stream, as a descriptor."""
    port = os.open(stream.port, os.O_RDWR | os.O_NOCTTY)
    try:
        yield port
    finally:
        os.close(port)
        stream.close()


@pytest.mark.alone
@pytest.mark.parametrize("at_once", [1, 7, 500])
def test_in_real_time_whole_frames_are_lost_and_counted(at_once: int):
    """Whatever is written at once, before and after the host begins to read."""
    stream, framer, deframer = pty.PtyStream(), Framer(), Deframer()
    written = 0
    with opened(stream) as port:
        heard = []
        for _ in range(3):
            for _ in range(3500 // at_once):
                stream.write(b"".join(framer.encode(FRAME) for _ in range(at_once)))
                written += at_once
            heard += deframer.feed(read_all(port))
        stream.write(framer.encode(FRAME))
        heard += deframer.feed(read_all(port))
    assert not any(deframer.rejected.values())
    assert set(heard) == {FRAME}
    assert stream.lost_frames > 0
    assert len(heard) + stream.lost_frames == written + 1


def test_in_lockstep_nothing_is_lost_while_the_host_goes_on_reading():
    stream = pty.PtyStream(waits=True)
    sent = b"".join(itertools.repeat(Framer().encode(FRAME), 20_000))
    with opened(stream) as port:
        writer = threading.Thread(target=stream.write, args=(sent,))
        writer.start()
        assert read_all(port, len(sent)) == sent
        writer.join()
        assert stream.lost_frames == 0


def test_in_lockstep_a_host_that_has_gone_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pty, "_PATIENCE_S", 0.1)
    stream, deframer = pty.PtyStream(waits=True), Deframer()
    with opened(stream) as port:
        stream.write(b"".join(itertools.repeat(Framer().encode(FRAME), 20_000)))
        heard = deframer.feed(read_all(port))
        assert len(heard) + stream.lost_frames in (19_999, 20_000), "one may have begun"
        assert stream.lost_frames > 0
        assert not any(deframer.rejected.values())


def test_a_host_that_reads_nothing_is_waited_for_2_s_and_a_read_waits_as_it_is_asked_to(
    monkeypatch: pytest.MonkeyPatch,
):
    """By the sum of the waits: ``select`` is replaced, so that none lasts."""
    waits: list[float] = []

    def select_nothing(*arguments: float) -> tuple[list[int], ...]:
        waits.append(arguments[3])
        return [], [], []

    monkeypatch.setattr(pty.select, "select", select_nothing)
    stream = pty.PtyStream(waits=True)
    with opened(stream):
        assert (stream.read(0), waits) == (b"", [])
        assert stream.read(3_000_000) == b""
        assert [waits.pop()] == [pytest.approx(0.003)]
        while stream.lost_frames == 0:
            waits.clear()
            stream.write(Framer().encode(FRAME))
        assert sum(waits) == pytest.approx(2.0)


def test_the_firmware_tells_how_many_frames_nobody_took():
    rig, stream = WheelRig(), pty.PtyStream()
    with opened(stream) as port:
        wire = SerialWire(stream)
        while stream.lost_frames < 3:
            rig.node.run(100)
            wire.send_from(rig.node)
        lost = stream.lost_frames
        assert rig.node.look().rejected["transmit_overruns"] == lost
        deframer = Deframer()
        deframer.feed(read_all(port))
        rig.node.run(1000)
        wire.send_from(rig.node)
        told = [codec.decode(frame) for frame in deframer.feed(read_all(port)) if frame.id == m.PortCounters.ID]
        assert told[0].transmit_overrun == lost & 0xFF


def test_a_step_of_1000_ticks_ends_over_a_pseudo_terminal_between_two_processes():
    with device("paper_circle", "--mode", "lockstep", "--link", "serial:pty") as robot:
        link = parse_link(robot.link).open_host()
        with contextlib.closing(link):
            link.send(codec.encode(m.Step(0, 1000)))
            heard: list[Frame] = []
            while not heard or heard[-1].id != m.StepDone.ID:
                heard += the_next(link, 1, WAIT_NS)
            assert codec.decode(heard[-1]) == m.StepDone(1000)
            assert sum(frame.id == m.Tick.ID for frame in heard) == 1001, "with that of its start"
            assert not any(link.rejected().values())


def reads(host, enough: int):
    """Read without waiting, for 2 s or until there are so many bytes."""
    deadline_s = time.monotonic() + 2.0
    while enough > 0 and time.monotonic() < deadline_s:
        data = host.read(0)
        enough -= len(data)
        yield data


def test_a_system_without_a_free_pseudo_terminal_is_one_sentence():
    resource = pytest.importorskip("resource", reason="limits of files need a POSIX system")
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with Path(os.devnull).open() as newest:  # no file beyond it may be opened
        resource.setrlimit(resource.RLIMIT_NOFILE, (newest.fileno() + 1, limits[1]))
        try:
            with pytest.raises(LinkError, match=r"no pseudo-terminal can be made \(Too many open files\)"):
                PtyStream()
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def test_a_read_that_does_not_wait_gets_what_is_there_and_notices_a_loss():
    from hil.wire.serial_port import SerialStream

    line = pty.PtyStream()
    with contextlib.closing(SerialStream(line.port, 921_600)) as host:
        assert host.read(0) == b""
        sent = bytes(range(256)) * 12
        line.write(sent)
        assert b"".join(reads(host, len(sent))) == sent
        line.close()
        with pytest.raises(LinkError, match=r"was lost \(.*\); check the cable and the robot's power"):
            list(reads(host, 1))


def test_a_client_takes_what_a_handshake_left_and_more_than_one_read_holds():
    here, there = memory_pair()
    line, clock, client, framer = StreamLink(here), WallClock(), new_client(), Framer()
    link = ConditionedLink(line, clock)
    heard: list[int] = []
    channel = open_channel(link, client, lambda message, _: heard.append(message.sequence))
    ticks = [codec.encode(m.Tick(number * 1000, number % 256, 3, 0, 0, 0)) for number in range(400)]
    frames = [*ticks[:50], *(codec.encode(m.TimeSyncResponse(0, 0, number)) for number in range(60)), *ticks[50:]]
    there.write(b"".join(framer.encode(frame) for frame in frames[:105]))
    for _ in range(2):
        channel.take(link.receive(0))
    assert heard == list(range(50))
    there.write(b"".join(framer.encode(frame) for frame in frames[105:]))
    assert channel.receive() is not None
    assert heard == list(range(60))
    assert (client.view.received, line.received_frames) == (460, 460)
    assert channel.receive() is not None
