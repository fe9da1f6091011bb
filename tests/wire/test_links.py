"""Links: what goes in comes out, wrong bytes are counted, and each way of not opening says what to do."""

import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import can
import pytest
import serial
from can.interfaces.virtual import VirtualBus
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec, host_line
from firmware_protocol.built import BuildError
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, LinkError
from hil.wire.can_bus import CanLink
from hil.wire.can_url import CanUrl
from hil.wire.framed import StreamLink
from hil.wire.robot_end import CanWire, ReopeningWire, SerialWire
from hil.wire.serial_port import SerialStream
from hil.wire.streams import DirectStream, memory_pair
from hil.wire.url import parse_link
from tests.support.heard import the_next
from tests.support.processes import environment, network_of_its_own, wait_for
from tests.support.wheel_rig import WheelRig

pty = pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")

WAIT_NS = 2_000_000_000
FRAMES = [
    Frame(m.Step.ID, bytes(6)),
    Frame(m.WheelCommand.ID, bytes(range(8))),
    Frame(m.HelloRequest.ID, b"\1"),
]


@pytest.mark.parametrize("url", ["serial:pty?symlink={}", "can:virtual/no_pair"])
def test_a_pair_of_which_the_second_end_fails_leaves_the_first_closed(url, tmp_path, monkeypatch):
    """A name that leads to a pseudo-terminal goes with it, and python-can tells which buses were shut down."""
    name = tmp_path / "port"
    opened, shut = [], []
    open_bus, shut_down = can.Bus, VirtualBus.shutdown

    def open_once(**options: object) -> can.BusABC:
        if opened:
            raise can.CanInitializationError("no second one")
        opened.append(open_bus(**options))
        return opened[0]

    def fail(*_: object, **__: object) -> None:
        raise serial.SerialException("no second one")

    monkeypatch.setattr(VirtualBus, "shutdown", lambda bus: (shut.append(bus), shut_down(bus)))
    monkeypatch.setattr(can, "Bus", open_once)
    monkeypatch.setattr(serial, "serial_for_url", fail)
    with pytest.raises(LinkError, match="no second one"):
        parse_link(url.format(name)).open_pair(lockstep=True)
    assert not name.is_symlink()
    assert shut == opened


def test_a_reopening_that_takes_long_does_not_hold_the_firmware_up():
    host, robot = memory_pair()
    begun, may_end, said = threading.Event(), threading.Event(), []

    def reopen() -> None:
        begun.set()
        assert may_end.wait(10.0)
        robot._peer = host

    rig = WheelRig()  # whose plant the node steps
    node = rig.node
    wire = ReopeningWire(SerialWire(robot), reopen, said.append)
    host.write(b"\0")
    assert wire.receive_into(node, 0)
    robot.close()
    node.run(5)
    wire.send_from(node)
    wait_for(lambda: wire.receive_into(node, 0) or begun.is_set())
    node.run(100)
    wire.send_from(node)
    assert not wire.receive_into(node, 0)
    assert said == ["link lost, reopening: the memory link was closed; open a new one"]
    may_end.set()
    wait_for(lambda: wire.receive_into(node, 0) or len(said) == 2)
    assert said[1] == "link reopened"
    node.run(5)
    wire.send_from(node)
    assert host.read(0), "what the robot sends now, and not what was lost"


@given(chunks=st.lists(st.binary(max_size=20)))
def test_memory_stream_keeps_the_bytes(chunks):
    one, other = memory_pair()
    for chunk in chunks:
        one.write(chunk)
    assert other.read(0) == b"".join(chunks)
    assert other.read(0) == b""


def test_closed_memory_stream_is_lost():
    one, _ = memory_pair()
    one.close()
    with pytest.raises(LinkError, match="closed"):
        one.write(b"x")


@given(chunks=st.lists(st.binary(max_size=9), min_size=1))
def test_a_direct_stream_is_answered_when_it_is_read(chunks):
    asked = []
    stream = DirectStream(lambda data: asked.append(data) or data[::-1])
    assert stream.read(0) == b""
    for chunk in chunks:
        stream.write(chunk)
    assert asked == []
    written = b"".join(chunks)
    assert (stream.read(0), stream.read(0)) == (written[::-1], b"")
    assert asked == ([written] if written else [])
    stream.close()
    with pytest.raises(LinkError, match="closed"):
        stream.write(b"x")


def test_a_library_that_is_not_built_is_told_as_what_to_do(monkeypatch):
    def missing():
        raise BuildError("_wheel.abi3.so is not built; run: python -m tools.build.wheel_host")

    monkeypatch.setattr(host_line, "library", missing)
    with pytest.raises(BadInputError, match=r"is not built; run: python -m tools\.build\.wheel_host"):
        StreamLink(memory_pair()[0])


def received_all(link):
    return the_next(link, len(FRAMES), WAIT_NS)


def test_frames_over_memory_and_wrong_bytes_between_them():
    one, other = memory_pair()
    link = StreamLink(other)
    framer = Framer()
    for frame in FRAMES:
        one.write(b"\x07wrong\0" + framer.encode(frame))
    assert received_all(link) == FRAMES
    assert sum(link.rejected().values()) == 3
    assert link.receive(0) is None


def test_frames_over_a_pseudo_terminal_both_ways():
    master = pty.PtyStream()
    with (
        contextlib.closing(master),
        contextlib.closing(StreamLink(SerialStream(master.port, 921_600))) as link,
    ):
        robot = StreamLink(master)
        for frame in FRAMES:
            link.send(frame)
        assert received_all(robot) == FRAMES
        for frame in FRAMES:
            robot.send(frame)
        assert received_all(link) == FRAMES
        assert link.receive(1_000_000) is None


def test_a_line_that_hangs_up_is_lost():
    master = pty.PtyStream()
    link = StreamLink(SerialStream(master.port, 921_600))
    master.close()
    with contextlib.closing(link), pytest.raises(LinkError, match="lost"):
        link.receive(WAIT_NS)


def test_symlink_is_made_replaced_and_removed(tmp_path: Path):
    name = tmp_path / "robot"
    name.symlink_to("/dev/pts/99999")  # of a robot that was killed
    master = pty.PtyStream(name)
    assert str(name.readlink()) == master.port
    master.close()
    assert not name.is_symlink()


@pytest.mark.parametrize("target", ["thesis.tex", "gone", "/dev/null"])
def test_symlink_never_replaces_a_file_or_a_link_that_leads_elsewhere_than_to_a_terminal(target, tmp_path: Path):
    name, thesis = tmp_path / "robot", tmp_path / "thesis.tex"
    thesis.write_text("precious")
    name.symlink_to(target)
    for existing, why in ((name, f"it leads to '{target}', which is no pseudo-terminal"), (thesis, "not a symbolic")):
        with pytest.raises(BadInputError, match=f"exists and is not replaced .*{why}"):
            pty.PtyStream(existing)
    assert str(name.readlink()) == target
    assert thesis.read_text() == "precious"
    with pytest.raises(BadInputError, match="cannot be made"):
        pty.PtyStream(tmp_path / "missing" / "robot")


def test_serial_port_that_does_not_exist():
    with pytest.raises(LinkError, match=r"'/dev/ttyNOPE' does not exist; list the ports"):
        parse_link("serial:/dev/ttyNOPE").open_host()


def test_serial_port_that_is_busy():
    master = pty.PtyStream()
    with (
        contextlib.closing(master),
        contextlib.closing(SerialStream(master.port, 921_600)),
        pytest.raises(LinkError, match="is busy: another program holds it"),
    ):
        SerialStream(master.port, 921_600)


def test_serial_port_that_is_a_file(tmp_path: Path):
    file = tmp_path / "port"
    file.write_text("")
    with pytest.raises(LinkError, match="is not a serial port"):
        SerialStream(str(file), 921_600)


def test_serial_port_that_is_forbidden():
    master = pty.PtyStream()
    with contextlib.closing(master):
        Path(master.port).chmod(0o600 if os.geteuid() == 0 else 0)
        # Root may open anything, so it first becomes a user who may not.
        program = (
            "import os\nfrom hil.wire.serial_port import SerialStream\n"
            f"os.geteuid() == 0 and os.seteuid(65534)\nSerialStream({master.port!r}, 9600)"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "permission denied" in done.stderr.splitlines()[-1]
    assert "dialout" in done.stderr.splitlines()[-1]


FOREIGN = [
    can.Message(arbitration_id=m.Tick.ID, is_extended_id=True, data=bytes(8)),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=bytes(8)),
    can.Message(arbitration_id=m.Tick.ID, is_extended_id=False, data=bytes(m.Tick.LENGTH - 1)),
    can.Message(arbitration_id=m.WheelCommand.ID, is_extended_id=False, data=bytes(3)),
    can.Message(arbitration_id=m.Tick.ID, is_extended_id=False, is_remote_frame=True),
    can.Message(is_error_frame=True),
]


@pytest.mark.proves("R-CAN-3", "R-CAN-4")
@pytest.mark.parametrize("fd", [False, True])
def test_a_host_gets_the_robots_messages_over_can_and_counts_what_is_foreign(fd):
    url = CanUrl("virtual", f"test_links_{fd}", fd=fd)
    with contextlib.closing(CanLink(url, "HOST")) as robot, contextlib.closing(CanLink(url, "ROBOT")) as host:
        with can.Bus(interface="virtual", channel=url.channel) as stranger:
            for message in FOREIGN:
                stranger.send(message)
        sent = [Frame(m.Tick.ID, bytes(range(m.Tick.LENGTH))), Frame(m.StepDone.ID, bytes(m.StepDone.LENGTH))]
        for frame in sent:
            robot.send(frame)
        assert the_next(host, len(sent), WAIT_NS) == sent
        rejected = {cause: n for cause, n in host.rejected().items() if n}
        assert rejected == {"foreign": 2, "error_other": 1, "unknown_id": 1, "length": 1}
        assert host.receive(1_000_000) is None


@pytest.mark.proves("R-CAN-3", "R-CNT-4", "R-CNT-6", "R-STEP-8")
def test_a_robots_firmware_gets_and_counts_every_standard_data_frame_of_others():
    url = CanUrl("virtual", "test_links_robot")
    rig = WheelRig(lockstep=True)
    with contextlib.closing(CanWire(CanLink(url, "HOST"))) as wire:
        with can.Bus(interface="virtual", channel=url.channel) as stranger:
            for message in FOREIGN:
                stranger.send(message)
            stranger.send(can.Message(arbitration_id=m.Step.ID, is_extended_id=False, data=bytes([0] * 4 + [200, 0])))
        while wire.receive_into(rig.node, WAIT_NS) and rig.node.look().tick == 0:
            pass
        assert rig.node.look().rejected["unknown_id"] == 1
        assert rig.node.look().rejected["length"] == 1
    told = [codec.decode(frame) for frame in rig.node.take_frames() if frame.id == m.LinkCounters.ID]
    assert (told[-1].unknown_id, told[-1].length) == (1, 1)


ALONE = """
import contextlib, sys
from firmware_protocol.generated import messages as m
from hil.wire.url import parse_link
from tests.support.wheel_rig import WheelRig
rig = WheelRig()
wire, _ = parse_link("can:udp_multicast/239.74.163.2").open_robot(print, lockstep=False)
with contextlib.closing(wire):
    rig.node.run(500)
    wire.send_from(rig.node)
    while wire.receive_into(rig.node, 200_000_000):
        pass
print(rig.node.look().rejected["unknown_id"], rig.node.look().rejected["length"])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="network namespaces are Linux's")
def test_what_a_robot_sends_comes_back_over_multicast_and_is_not_counted():
    command = [*network_of_its_own(), sys.executable, "-c", ALONE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment())
    assert done.stdout == "0 0\n", done.stderr


def test_unknown_can_interface_names_the_nearest():
    with pytest.raises(BadInputError) as refused:
        parse_link("can:socketcna/can0").open_host()
    assert str(refused.value) == (
        "link 'can:socketcna/can0': unknown CAN interface 'socketcna'; did you mean 'socketcan'?"
    )


def test_can_interface_that_is_not_there():
    """Without CAN in the kernel, or with it and no such interface: one sentence either way."""
    with pytest.raises(LinkError, match=r"modprobe can_raw|does not exist") as caught:
        parse_link("can:socketcan/nope0").open_host()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("url", ["can:slcan/%2Fdev%2FttyNOPE", "can:slcan//dev/ttyNOPE", "can:pcan/PCAN_USBBUS1"])
def test_can_adapter_that_is_not_there(url):
    with pytest.raises(LinkError, match="CAN interface"):
        parse_link(url).open_host()


def test_memory_has_no_end_in_another_process():
    url = parse_link("memory:")
    for opening in (url.open_host, lambda: url.open_robot(print, lockstep=True)):
        with pytest.raises(BadInputError, match="memory:"):
            opening()


@pytest.mark.parametrize("url", ["memory:", "serial:pty", "can:virtual/test_links_pair"])
def test_a_pair_connects_host_and_robot(url):
    pair = parse_link(url).open_pair(lockstep=True)
    with contextlib.closing(pair.link), contextlib.closing(pair.wire):
        pair.link.send(FRAMES[0])
        assert pair.link.receive(0) is None
