"""slcan, byte for byte over pseudo-terminals: two emulated adapters on one bus."""

import collections
import contextlib
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import LinkError
from hil.wire.can_bus import CanLink
from hil.wire.url import parse_link
from tests.support.heard import the_next
from tests.support.processes import device, run_json

fcntl = pytest.importorskip("fcntl", reason="pseudo-terminals need a POSIX system")
termios = pytest.importorskip("termios", reason="pseudo-terminals need a POSIX system")
adapters = pytest.importorskip("tests.support.slcan_adapters", reason="pseudo-terminals need a POSIX system")

FEEDBACK = [Frame(m.WheelSpeeds.ID, bytes([i] * 8)) for i in range(80)]
COMMANDS = [Frame(m.WheelCommand.ID, bytes([i] * 8)) for i in range(80)]


@pytest.fixture(autouse=True)
def _adapters_that_start_at_once(monkeypatch):
    """python-can waits 2 s for an adapter that opening its port resets; the emulated ones are ready."""
    monkeypatch.setenv("CAN_CONFIG", '{"sleep_after_open": 0.0}')


@contextlib.contextmanager
def two_links(filler: bytes = b"", bitrate: int = 1_000_000, bus=None) -> Iterator[tuple[CanLink, CanLink]]:
    bus = bus or adapters.SlcanBus(2, filler)
    host = CanLink(parse_link(f"can:slcan/{bus.ports[0]}"), "ROBOT")
    robot = CanLink(parse_link(f"can:slcan/{bus.ports[1]}?bitrate={bitrate}"), "HOST")
    bus.wait_until_open()
    try:
        yield host, robot
    finally:
        host.close()
        robot.close()
        bus.close()


def test_an_adapter_that_takes_no_bytes_is_lost_and_holds_nobody_for_ever(monkeypatch):
    monkeypatch.setattr("hil.wire.can_bus._WRITE_TIMEOUT_S", 0.05)
    master, slave = os.openpty()
    host = CanLink(parse_link(f"can:slcan/{os.ttyname(slave)}"), "ROBOT")
    with pytest.raises(LinkError, match="takes no bytes any more"):
        collections.deque(map(host.send, itertools.repeat(COMMANDS[0])), maxlen=0)
    host.reopen()
    host.close()
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("filler", [b"", b"\r", b"F00\r"])
def test_frames_pass_both_ways_whatever_the_adapter_says_between(filler):
    with two_links(filler) as (host, robot):
        for command, feedback in zip(COMMANDS, FEEDBACK, strict=True):
            host.send(command)
            robot.send(feedback)
        assert the_next(robot, len(COMMANDS)) == COMMANDS
        assert the_next(host, len(FEEDBACK)) == FEEDBACK


def test_a_poll_without_waiting_takes_all_that_came_past_the_replies():
    """Each command leaves a reply of the adapter in the line, before the next feedback; none may end the poll early."""
    with two_links() as (host, robot):
        for command, feedback in zip(COMMANDS, FEEDBACK, strict=True):
            host.send(command)
            assert the_next(robot) == [command]
            robot.send(feedback)
        taken = the_next(host)
        # The last ones may still be on their way.
        while (received := host.receive(0 if len(taken) < len(FEEDBACK) - 3 else 100_000_000)) is not None:
            taken += received.frames
        assert taken == FEEDBACK


@pytest.mark.parametrize(
    "line", [b"t12\r", b"t3028zz00000000000000\r", b"tqqq0\r", b"t302\r", b"d302z\r", b"\xff\xfe\r"]
)
def test_a_line_that_is_cut_or_garbled_is_counted_and_the_link_goes_on(line):
    bus = adapters.SlcanBus(2)
    with two_links(bus=bus) as (host, robot):
        bus.say(0, line)
        assert host.receive(100_000_000) is None
        assert host.rejected()["garbled"] == 1
        for feedback in FEEDBACK:
            robot.send(feedback)
        assert the_next(host, len(FEEDBACK)) == FEEDBACK


def test_adapters_of_different_bit_rates_do_not_hear_each_other():
    with two_links(bitrate=500_000) as (host, robot):
        robot.send(FEEDBACK[0])
        assert host.receive(100_000_000) is None


def test_a_bit_rate_that_the_adapter_has_not_is_one_sentence():
    bus = adapters.SlcanBus(1)
    try:
        with pytest.raises(LinkError, match=r"cannot run at 800001 bit/s .*500000.*set bitrate= to one of these"):
            parse_link(f"can:slcan/{bus.ports[0]}?bitrate=800001").open_host()
    finally:
        bus.close()


def test_an_adapter_that_is_unplugged_is_lost_and_not_there_when_it_is_opened_again(tmp_path):
    bus = adapters.SlcanBus(1)
    port = tmp_path / "adapter"
    port.symlink_to(bus.ports[0])
    with contextlib.closing(parse_link(f"can:slcan/{port}").open_host()) as host:
        bus.close()
        with pytest.raises(LinkError) as lost:
            host.receive(1_000_000_000)
        port.unlink()
        with pytest.raises(LinkError) as missing:
            host.reopen()
    where = f"CAN interface 'slcan', channel {str(port)!r}"
    assert str(lost.value).startswith(f"{where} was lost (it is gone, or ")
    assert str(missing.value).startswith(f"{where} does not exist; list the ports with: ")


@pytest.mark.parametrize("call", [lambda host: host.send(COMMANDS[0]), lambda host: host.receive(0), CanLink.reopen])
def test_an_adapter_that_has_vanished_is_lost_at_whichever_call(call):
    """A port whose other end is closed fails in termios too, whose error is no OSError."""
    master, slave = os.openpty()
    with contextlib.closing(CanLink(parse_link(f"can:slcan/{os.ttyname(slave)}"), "ROBOT")) as host:
        os.close(slave)
        os.close(master)
        for _ in range(3):
            with pytest.raises(LinkError, match=r"was lost \(it is gone|does not exist|is closed; reopen it"):
                call(host)


def test_an_adapter_whose_port_another_program_reads_too_is_lost(monkeypatch):
    bus = adapters.SlcanBus(1)
    try:
        with contextlib.closing(parse_link(f"can:slcan/{bus.ports[0]}").open_host()) as host:
            bus.wait_until_open()  # from then on it reads nothing
            bus.say(0, b"t1230\r")
            monkeypatch.setattr(serial.serialposix.os, "read", lambda *_: b"")  # what the other one left
            with pytest.raises(LinkError, match=r"was lost .*another program reads it too"):
                host.receive(1_000_000_000)
            monkeypatch.undo()
    finally:
        monkeypatch.undo()
        bus.close()


@contextlib.contextmanager
def as_nobody() -> Iterator[None]:
    """Root is neither forbidden anything nor kept out."""
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if is_root:
            os.seteuid(0)


@pytest.mark.parametrize("scheme", ["serial:", "can:slcan/"])
@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("no port", "is not a serial port; expected a device such as /dev/ttyACM0 or COM3"),
        ("missing", "does not exist; list the ports with: python -m serial.tools.list_ports"),
        (
            "forbidden",
            "may not be opened (permission denied); on Linux add yourself to its group, mostly dialout, with",
        ),
        ("busy", "is busy: another program holds it; close that program"),
    ],
)
def test_a_port_that_cannot_be_opened_is_the_same_sentence_for_a_line_and_an_adapter(scheme, what, says, tmp_path):
    (tmp_path / "no port").touch()
    with contextlib.ExitStack() as held:
        port = tmp_path / what
        if what in ("forbidden", "busy"):
            port = Path(held.enter_context(contextlib.closing(adapters.SlcanBus(1))).ports[0])
            port.chmod(0o666 if what == "busy" else 0)
        if what == "busy":
            fcntl.ioctl(held.enter_context(port.open("rb", buffering=0)), termios.TIOCEXCL)
        with pytest.raises(LinkError):
            parse_link(f"{scheme}{tmp_path}").open_host()  # and all that has to be imported is
        with pytest.raises(LinkError) as refused, as_nobody() if what in ("forbidden", "busy") else held:
            parse_link(f"{scheme}{port}").open_host()
    assert f"{str(port)!r} {says}" in str(refused.value)
    assert "Errno" not in str(refused.value)


def test_controller_and_robot_in_two_processes_over_two_adapters():
    bus = adapters.SlcanBus(2)
    lockstep = ("paper_circle", "--mode", "lockstep", "--set", "loop.rate_hz=100")
    try:
        with device(*lockstep, "--link", f"can:slcan/{bus.ports[0]}") as robot:
            short = ("--set", "loop.duration_s=1", "--set", "expect=[]")
            link = ("--link", f"can:slcan/{bus.ports[1]}", "--set", "estimator.source=odometry", "--record", "none")
            figures = run_json(*lockstep, *link, *short)
            assert robot.process.poll() is None
    finally:
        bus.close()
    assert figures["failure"] is None
    assert figures["ticks"] == 100
