"""The ARM binary in QEMU: the host library's frames over its first serial line, and no process left behind."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from firmware_protocol.framer import Deframer
from firmware_protocol.generated import messages as m
from hil.addons.targets import qemu_board
from hil.addons.targets.qemu_board import QEMU, QemuBoard
from hil.core.errors import BadInputError, DeviceError
from hil.plant.process import ChildProcess
from tests.support.arm_programs import compile_program
from tests.support.emulated_boards import Host, converse, firmware, needs_compiler, needs_qemu, plant_of, stored
from tests.support.processes import environment, wait_for
from tests.support.wheel_rig import WheelRig

pytestmark = [needs_compiler, needs_qemu]

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc to find the process")

# The last frame of what the firmware answers to a request.
ANSWER = {
    m.Step.ID: m.StepDone.ID,
    m.HelloRequest.ID: m.HelloGeometry.ID,
    m.TimeSyncRequest.ID: m.TimeSyncResponse.ID,
    m.ParameterRequest.ID: m.ParameterResponse.ID,
}


class Patient:
    """A board in QEMU as a node that has answered when ``feed`` returns, as the host library has."""

    def __init__(self, board: QemuBoard) -> None:
        self._board = board
        self._asked, self._answered = Deframer(), Deframer()
        self._bytes = b""
        self._arrived = threading.Event()
        board.on_output = self._arrived.set

    def feed(self, data: bytes) -> None:
        self._board.feed(data)
        for frame in self._asked.feed(data):
            wanted = ANSWER.get(frame.id)
            while wanted is not None:
                self._arrived.wait(0.05)
                self._arrived.clear()
                new = self._board.take_bytes()
                self._bytes += new
                if wanted in [answer.id for answer in self._answered.feed(new)]:
                    break
                self._board.check()

    def take_bytes(self) -> bytes:
        taken, self._bytes = self._bytes, b""
        return taken


@contextlib.contextmanager
def open_board(rig: WheelRig | None = None) -> Iterator[QemuBoard]:
    """A board in front of a rig, which lives as long."""
    rig = WheelRig(lockstep=True) if rig is None else rig
    board = QemuBoard(firmware("serial"), *plant_of(rig), stored())
    try:
        yield board
    finally:
        board.close()


def descendants(pid: int) -> list[int]:
    """Return the processes that a process started, and those that they started."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            found += [int(child), *descendants(int(child))]
    return found


@pytest.fixture
def begun() -> Callable[[], list[int]]:
    """Return a function that returns the processes of this test that live."""
    others = descendants(os.getpid())
    return lambda: [number for number in descendants(os.getpid()) if number not in others]


def qemu_of(pid: int) -> int:
    """Return the QEMU process among the descendants of a process."""
    (found,) = [n for n in descendants(pid) if QEMU in Path(f"/proc/{n}/cmdline").read_text()]
    return found


def has_gone(pid: int) -> bool:
    try:
        return "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return True


def test_every_frame_is_the_host_librarys():
    rig, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    library = Host(rig.node, "serial")
    converse(library, 11, 15)
    with open_board(other) as board:
        host = Host(Patient(board), "serial")
        converse(host, 11, 15)
        assert host.without_identity() == library.without_identity()
        assert board.look().state is m.State.ESTOP
    assert other.angle_rad == rig.angle_rad
    assert any(abs(angle) > 0.1 for angle in rig.angle_rad)


@on_linux
def test_killed_qemu_is_told_in_a_sentence(begun: Callable[[], list[int]]):
    with open_board() as board:
        os.kill(qemu_of(os.getpid()), signal.SIGKILL)
        told = wait_for(lambda: _failure(board))
        assert str(told).startswith("QEMU is gone: its process exited with code 1; its last words: ")
        assert "was ended by signal 9" in str(told)
    wait_for(lambda: begun() == [])


def deadman_of(pid: int) -> int:
    """Return the process that watches over QEMU among the descendants of a process."""
    (found,) = [n for n in descendants(pid) if "deadman" in Path(f"/proc/{n}/cmdline").read_text()]
    return found


@on_linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_qemu_does_not_outlive_its_deadman_process(number: signal.Signals):
    with open_board() as board:
        qemu = qemu_of(os.getpid())
        os.kill(deadman_of(os.getpid()), number)
        assert str(wait_for(lambda: _failure(board))).startswith("QEMU is gone: its process ")
        wait_for(lambda: has_gone(qemu))


@on_linux
def test_what_a_program_under_the_deadman_process_has_started_ends_with_it(tmp_path: Path):
    """A grandchild, which no signal at its parent's death reaches; the deadman process has ended before we look."""
    note = tmp_path / "pid"
    program = (
        "import subprocess, sys, pathlib; quiet = subprocess.DEVNULL\n"
        "p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'], stdout=quiet, stderr=quiet)\n"
        "pathlib.Path(sys.argv[1]).write_text(str(p.pid))\n"
    )
    child = ChildProcess("hil.addons.targets.deadman", tmp_path / "scratch")
    child.send({"command": [sys.executable, "-c", program, str(note)], "inherited": []})
    assert child.receive() is None, "the deadman process has ended"
    grandchild = int(note.read_text())
    assert not has_gone(grandchild)
    child.close(30.0)
    wait_for(lambda: has_gone(grandchild))


@on_linux
def test_no_other_process_can_reach_the_lines_of_qemu():
    """They are pairs of sockets, which no address leads to."""
    with open_board():
        shown = (str(link.readlink()) for link in Path(f"/proc/{qemu_of(os.getpid())}/fd").iterdir())
        sockets = {name[len("socket:[") : -1] for name in shown if name.startswith("socket:[")}
        assert len(sockets) >= 2
        rows = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
        assert sockets <= {row[6] for row in rows if len(row) == 7}, "of this kind, and without a name"


@on_linux
def test_a_board_that_is_interrupted_while_it_boots_leaves_no_process(begun: Callable[[], list[int]], tmp_path: Path):
    idle = compile_program(tmp_path, "int main(void) { for (;;) WAIT(); }")
    rig, main = WheelRig(lockstep=True), threading.main_thread().ident
    assert main is not None

    def is_booting() -> bool:
        return any(frame.f_code.co_name == "_boot" for frame, _ in traceback.walk_stack(sys._current_frames()[main]))

    def interrupt() -> None:
        wait_for(is_booting)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    # The error is kept, and with it all that its frames refer to: nothing is tidied up by chance.
    with pytest.raises(KeyboardInterrupt) as kept:
        QemuBoard(idle, *plant_of(rig), None)
    thread.join()
    assert begun() == []
    assert kept.value is not None


def test_whatever_ends_the_relay_is_told():
    def stumble() -> None:
        raise ValueError("of whoever listens")

    with open_board() as board:
        board.on_output = stumble
        board.feed(_encoded(m.Step(0, 1)))
        with pytest.raises(ValueError, match="of whoever listens"):
            wait_for(lambda: board.check())


@on_linux
def test_qemu_that_takes_nothing_does_not_hold_its_host_for_ever(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(qemu_board, "ACCEPT_S", 0.3)
    with open_board() as board:
        os.kill(qemu_of(os.getpid()), signal.SIGSTOP)
        with pytest.raises(DeviceError, match=r"QEMU has taken no byte of a line for 0\.3 s"):
            board.feed(bytes(1 << 20))


@on_linux
def test_silent_qemu_is_noticed_in_the_middle_of_a_step(
    begun: Callable[[], list[int]], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(qemu_board, "SILENCE_S", 0.3)
    with open_board() as board:
        host = Host(Patient(board), "serial")
        host.step(0, 3)
        os.kill(qemu_of(os.getpid()), signal.SIGSTOP)
        with pytest.raises(DeviceError, match=r"QEMU has been silent for 0\.3 s in the middle of a STEP"):
            host.step(3, 3)
    wait_for(lambda: begun() == [])


@on_linux
def test_qemu_does_not_outlive_a_process_that_was_killed():
    owner = (
        "import sys, time; from pathlib import Path; from tests.addons.targets.test_qemu import *\n"
        "rig = WheelRig(lockstep=True)\n"
        "board = QemuBoard(Path(sys.argv[1]), *plant_of(rig), None); print('there', flush=True); time.sleep(600)\n"
    )
    command = [sys.executable, "-c", owner, str(firmware("serial"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment()) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"there\n"
        qemu = qemu_of(process.pid)
        process.kill()
        process.wait()
    wait_for(lambda: has_gone(qemu))


def test_a_plant_that_fails_is_told_and_is_no_silence(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(qemu_board, "SILENCE_S", 0.2)
    rig = WheelRig(lockstep=True)
    with open_board(rig) as board:
        host = Host(Patient(board), "serial")
        tick = host.step(0, 2)
        rig.fail = True
        board.feed(_encoded(m.Step(tick, 2)))
        wait_for(lambda: board.look().plant_failed)
        board.check()


def test_firmware_without_a_plant_port_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(qemu_board, "_BOOT_S", 0.5)
    idle = compile_program(tmp_path, "int main(void) { for (;;) WAIT(); }")
    rig = WheelRig(lockstep=True)
    with pytest.raises(DeviceError, match="asked nothing of its plant"):
        QemuBoard(idle, *plant_of(rig), None)


def test_a_file_that_qemu_refuses_is_told_in_its_words(tmp_path: Path):
    missing = tmp_path / "none.elf"
    rig = WheelRig(lockstep=True)
    with pytest.raises(DeviceError, match=r"QEMU .*code 1; its last words: .*none\.elf"):
        QemuBoard(missing, *plant_of(rig), None)


def test_without_qemu_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch):
    elf, rig = firmware("serial"), WheelRig(lockstep=True)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BadInputError, match="qemu-system-arm, which is not installed"):
        QemuBoard(elf, *plant_of(rig), None)


def test_the_machine_has_no_can():
    said = "^QEMU's netduinoplus2 has no CAN controller; use a serial link, or --target unicorn$"
    with open_board() as board, pytest.raises(DeviceError, match=said):
        board.take_frames()


def test_windows_is_told_of_the_other_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(qemu_board, "sys", SimpleNamespace(platform="win32"))
    with pytest.raises(BadInputError, match=r"^--target qemu needs a POSIX system; use --target unicorn$"):
        qemu_board.QemuProcess(tmp_path / "program.elf", b"")


def _failure(board: QemuBoard) -> DeviceError | None:
    try:
        board.check()
    except DeviceError as error:
        return error
    return None


def _encoded(message: m.Step) -> bytes:
    from firmware_protocol import codec
    from firmware_protocol.framer import Framer

    return Framer().encode(codec.encode(message))
