"""slcan, byte for byte over pseudo-terminals: two emulated adapters on one bus."""

import contextlib
from collections.abc import Iterator

import pytest

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.errors import LinkError
from hil.links.can_bus import CanLink
from hil.links.opening import open_host
from hil.links.url import parse_link
from tests.processes import device, run_json

adapters = pytest.importorskip("tests.slcan_adapters", reason="pseudo-terminals need a POSIX system")

FEEDBACK = [Frame(m.WheelSpeeds.ID, bytes([i] * 8)) for i in range(80)]
COMMANDS = [Frame(m.WheelCommand.ID, bytes([i] * 8)) for i in range(80)]


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


@pytest.mark.parametrize("filler", [b"", b"\r", b"F00\r"])
def test_frames_pass_both_ways_whatever_the_adapter_says_between(filler):
    with two_links(filler) as (host, robot):
        for command, feedback in zip(COMMANDS, FEEDBACK, strict=True):
            host.send(command)
            robot.send(feedback)
        assert [robot.receive(1_000_000_000).frame for _ in COMMANDS] == COMMANDS
        assert [host.receive(1_000_000_000).frame for _ in FEEDBACK] == FEEDBACK


def test_a_poll_without_waiting_takes_all_that_came_past_the_replies():
    """Each command leaves a reply of the adapter in the line, before the next feedback; none may end the poll early."""
    with two_links() as (host, robot):
        for command, feedback in zip(COMMANDS, FEEDBACK, strict=True):
            host.send(command)
            assert robot.receive(1_000_000_000).frame == command
            robot.send(feedback)
        taken = [host.receive(1_000_000_000).frame]
        # The last ones may still be on their way.
        while (received := host.receive(0 if len(taken) < len(FEEDBACK) - 3 else 100_000_000)) is not None:
            taken.append(received.frame)
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
        assert [host.receive(1_000_000_000).frame for _ in FEEDBACK] == FEEDBACK


def test_adapters_of_different_bit_rates_do_not_hear_each_other():
    with two_links(bitrate=500_000) as (host, robot):
        robot.send(FEEDBACK[0])
        assert host.receive(100_000_000) is None


def test_a_bit_rate_that_the_adapter_has_not_is_one_sentence():
    bus = adapters.SlcanBus(1)
    try:
        with pytest.raises(LinkError, match=r"cannot run at 800001 bit/s .*500000.*set bitrate= to one of these"):
            open_host(parse_link(f"can:slcan/{bus.ports[0]}?bitrate=800001"))
    finally:
        bus.close()


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
