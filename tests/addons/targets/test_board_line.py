"""``hil device --target board``: the plant of a board whose second serial line is a real pseudo-terminal.

QEMU with the ARM binary is the board; both of its lines leave it as terminals, and `hil run` and `hil device` know no
more of it than of one on the desk.
"""

import contextlib
import itertools
import os
import select
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from firmware_protocol.host import stored_parameters
from firmware_protocol.plant_port import Drive, PlantDeframer, PlantFramer, Sample, Sense
from firmware_protocol.stm32_flash import HIL_BOARD, SECTOR_BYTES, flash_image
from hil.addons.targets.emulated_board import EmulatedBoard
from hil.addons.targets.qemu_board import QemuProcess, _command
from hil.addons.targets.real_board import BoardRobot, open_board
from hil.core.errors import BadInputError, DeviceError
from hil.faults.rows import FaultRow
from hil.runtime.robots import firmware_values, virtual_robot
from hil.scenario import load
from hil.wire.url import parse_link
from tests.support.emulated_boards import firmware, needs_compiler, needs_qemu
from tests.support.processes import HIL, environment, hil, run_json

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

LOCKSTEP = ("--mode", "lockstep")
SHORT = ("--set", "loop.rate_hz=200", "--set", "loop.duration_s=0.3", "--set", "expect=[]")
AT_REST = ((0.0,) * 4, (0.0,) * 4)


class Terminals(NamedTuple):
    """The names of the terminals of a board's two lines, and the board's ends of them."""

    host: str
    plant: str
    ends: tuple[int, int]


@contextlib.contextmanager
def terminals() -> Iterator[Terminals]:
    """Yield two lines, on which nobody is yet."""
    import pty
    import tty

    (host, at_host), (plant, at_plant) = pty.openpty(), pty.openpty()
    for end in (at_host, at_plant):
        tty.setraw(end)
    try:
        yield Terminals(os.ttyname(at_host), os.ttyname(at_plant), (host, plant))
    finally:
        for end in (host, at_host, plant, at_plant):
            os.close(end)


@contextlib.contextmanager
def board_on(lines: Terminals, *settings: str) -> Iterator[None]:
    """Switch on a board in QEMU, with the parameters of the paper's circle in its flash, and end it."""
    values = firmware_values(load("paper_circle", set=settings))
    flash = flash_image(stored_parameters(values, HIL_BOARD)).ljust(2 * SECTOR_BYTES, b"\xff")
    stop, stopped = os.pipe()
    process = QemuProcess(firmware("serial"), flash)
    sockets = (process.host.fileno(), process.plant.fileno())
    other = dict(zip((*sockets, *lines.ends), (*lines.ends, *sockets), strict=True))

    for end in other:
        os.set_blocking(end, False)

    def carry() -> None:
        while stop not in (readable := select.select([*other, stop], [], [])[0]):
            for end in readable:
                left = memoryview(os.read(end, 65536))
                while left:
                    if stop in select.select([stop], [other[end]], [])[0]:  # nobody reads any more
                        return
                    left = left[os.write(other[end], left) :]

    thread = threading.Thread(target=carry)
    thread.start()
    try:
        yield
    finally:
        os.write(stopped, b"x")
        thread.join()
        process.close()
        os.close(stop)
        os.close(stopped)


@contextlib.contextmanager
def plant_behind(terminal: str, *settings: str) -> Iterator[str]:
    """Yield the truth's address of a ``hil device`` that serves the plant over a terminal."""
    words = [*HIL, "device", "paper_circle", *LOCKSTEP, "--target", "board", "--link", f"serial:{terminal}", *settings]
    process = subprocess.Popen(words, text=True, stdout=subprocess.PIPE, env=environment())
    try:
        assert process.stdout is not None
        told = dict(part.split("=", 1) for part in process.stdout.readline().split()[1:])
        assert told["plant"].startswith(f"serial:{terminal}")
        yield told["truth"]
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 0


@needs_compiler
@needs_qemu
def test_a_board_drives_the_plant_over_its_second_line_with_the_host_librarys_bytes() -> None:
    expected = run_json("paper_circle", *LOCKSTEP, "--link", "memory:", "--record", "none", *SHORT)
    # The plant is there first: a board that waits for it longer than 2 s of its own faults.
    with terminals() as lines, plant_behind(lines.plant, *SHORT) as truth, board_on(lines, *SHORT[1::2]):
        reach = ("--link", f"serial:{lines.host}", "--truth", truth)
        figures = run_json("paper_circle", *LOCKSTEP, *reach, "--record", "none", *SHORT)
    assert figures["wire_sha256"] == expected["wire_sha256"]
    assert figures["overshoot_m"] == expected["overshoot_m"]


def board() -> BoardRobot:
    """Return the robot of the paper's circle with its firmware on the other side of a line."""
    return open_board(virtual_robot(load("paper_circle")), parse_link("serial:/dev/ttyUSB1"))


def ask(robot: BoardRobot, framer: PlantFramer, message: Sample | Drive) -> Sense:
    """Return the plant's answer to a frame of the firmware."""
    node = robot.node
    node.feed(framer.encode(message))
    [answer] = PlantDeframer().feed(node.take_bytes())
    assert isinstance(answer, Sense)
    return answer


def test_a_board_that_was_on_before_its_plant_keeps_its_own_time() -> None:
    with contextlib.closing(board()) as robot:
        framer = PlantFramer()
        assert ask(robot, framer, Sample(5000)).tick == 5000
        assert ask(robot, framer, Drive(5000, False, *AT_REST)).tick == 5001
        assert (robot.faults.ahead, robot.plant.truth().time_ns) == (5000, 1_000_000)
        assert ask(robot, framer, Drive(5000, False, *AT_REST)).tick == 5001  # asked again: no time passes
        assert robot.plant.truth().time_ns == 1_000_000
        robot.power_cycle()
        assert (robot.faults.ahead, robot.plant.truth().time_ns) == (5001, 0)
        ask(robot, framer, Drive(5001, True, (1.0,) * 4, (0.0,) * 4))
        assert (robot.faults.ahead, robot.plant.truth().time_ns) == (5001, 1_000_000)
        assert robot.node.look().state.name == "ACTIVE"
        ask(robot, framer, Sample(0))  # its button was pressed
        ask(robot, framer, Drive(0, False, *AT_REST))
        assert (robot.faults.ahead, robot.node.look().state.name) == (-1, "IDLE")


def test_what_the_frames_of_a_board_say_is_what_is_known_of_its_firmware() -> None:
    with contextlib.closing(board()) as robot:
        node, framer = robot.node, PlantFramer()
        assert isinstance(node, EmulatedBoard)
        fresh = EmulatedBoard.look(node)
        assert (fresh.tick, fresh.state, fresh.command_age_ticks) == (0, m.State.BOOT, 0xFFFF_FFFF)
        assert (fresh.torque_n_m, fresh.duty, fresh.rejected) == ((0.0,) * 4, (0.0,) * 4, {"transmit_overruns": 0})
        ask(robot, framer, Drive(41, True, (1.0, -2.0, 0.5, 0.25), (0.1, 0.2, -0.3, 0.4)))
        node.observe(codec.encode(m.Status(3, 1, 4, 2, 3, 0, 9, 0, 0)))
        for age, ticks in ((254, 254), (255, 0xFFFF_FFFF), (7, 7)):
            node.observe(codec.encode(m.Tick(5, 6, age, 4, 0, 0)))
            assert EmulatedBoard.look(node).command_age_ticks == ticks
        node.observe(codec.encode(m.LinkCounters(1, 2, 3, 4, 5, 6, 7, 8)))
        node.count_unsent(3)
        node.count_unsent(2)
        seen = EmulatedBoard.look(node)
        assert (seen.tick, seen.torque_n_m, seen.duty) == (
            42,
            (1.0, -2.0, 0.5, 0.25),
            pytest.approx((0.1, 0.2, -0.3, 0.4)),
        )
        assert (seen.state, seen.mode, seen.fault, seen.fault_wheel, seen.stop_reason) == (4, 1, 4, 2, 3)
        assert [seen.rejected[name] for name in ("cobs", "state", "transmit_overruns")] == [1, 8, 5]
        assert not seen.plant_failed
        node.observe(codec.encode(m.Status(1, 0, 0, 0, 0, 0, 0, 0, 0)))
        assert EmulatedBoard.look(node).state == 1
        with pytest.raises(DeviceError, match="its robot time comes from STEP; use --mode lockstep"):
            node.run(1)
        with pytest.raises(DeviceError, match="plant port is a serial line, and no bus"):
            node.receive(codec.encode(m.Tick(0, 0, 0, 0, 0, 0)))


def test_what_a_real_board_cannot_do_is_refused() -> None:
    with (
        contextlib.closing(board()) as robot,
        pytest.raises(BadInputError, match="nothing here can reset a real board"),
    ):
        robot.faults.arm([FaultRow("reset", "robot", "robot", 0, 10**9)])
    for link in ("memory:", "can:virtual/x"):
        done = hil("device", "paper_circle", "--target", "board", "--link", link)
        assert done.returncode == 2
        assert "expected the board's second serial line" in done.stderr


def test_qemu_gets_both_lines_in_order_and_the_parameters_at_their_place() -> None:
    words = _command("qemu", Path("a.elf"), Path("a,b.bin"), (7, 9))
    assert words[:3] == ["qemu", "-M", "netduinoplus2"]
    pairs = list(itertools.pairwise(words))
    assert [two for one, two in pairs if one == "-chardev"] == ["socket,id=host,fd=7", "socket,id=plant,fd=9"]
    assert [two for one, two in pairs if one == "-serial"] == ["chardev:host", "chardev:plant"]
    assert ("-kernel", "a.elf") in pairs
    assert ("-device", "loader,file=a,,b.bin,addr=0x8040000,force-raw=on") in pairs
