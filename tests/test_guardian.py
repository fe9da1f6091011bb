"""The guardian between real processes: a host that is killed while a board that knows no time limit is driving."""

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from hil.devices.guardian import Guardian
from hil.errors import DeviceError
from hil.links.serial_port import SerialStream
from tests.dialect_testbed import Rig
from tests.guarded_host import STOP, encoded
from tests.processes import environment, wait_for

if sys.platform == "win32":
    pytest.skip("pseudo-terminals need a POSIX system", allow_module_level=True)

from hil.links.pty import PtyStream

PATIENCE_S = 60.0


class Board:
    """The emulated board at the other end of a pseudo-terminal, and what came over that."""

    def __init__(self, line: PtyStream) -> None:
        self.line = line
        self.rig = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
        self.heard = b""

    def hear(self, timeout_s: float) -> bytes:
        """Return what comes within this time, and let the board have it."""
        data = self.line.read(int(timeout_s * 1e9))
        self.heard += data
        self.rig.node.feed(data)
        self.rig.node.run(500)
        return data


@contextlib.contextmanager
def driven_board() -> Iterator[tuple[Board, "subprocess.Popen[str]", int]]:
    """A host in a process of its own that drives a board, with its guardian's process id."""
    line = PtyStream()
    host = subprocess.Popen(
        [sys.executable, "-m", "tests.guarded_host", line.port],
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert host.stdout is not None
        assert select.select([host.stdout], [], [], PATIENCE_S)[0]
        word, guardian = host.stdout.readline().split()
        assert word == "driving"
        board = Board(line)
        assert board.hear(PATIENCE_S)
        assert board.rig.node.is_driving
        yield board, host, int(guardian)
    finally:
        host.kill()
        host.communicate()
        line.close()


def last_words(host: "subprocess.Popen[str]") -> str:
    """Return the errors of the host and its guardian; they end when both have."""
    assert host.stderr is not None
    return host.stderr.read()


def test_a_host_that_is_killed_is_followed_by_a_stop_and_the_wheels_stand() -> None:
    with driven_board() as (board, host, _):
        board.heard = b""
        host.kill()
        assert "the host has died without a stop; the guardian has sent it" in last_words(host)
        while board.heard.count(encoded(*STOP)) < 5:
            assert board.hear(PATIENCE_S)
        board.rig.node.run(1000)
        assert not board.rig.node.is_driving
        assert board.rig.is_still()
        assert board.heard == 5 * encoded(*STOP)


@pytest.mark.parametrize("word", ["raise", ""])
def test_a_host_that_falls_over_is_followed_by_a_stop(word: str) -> None:
    """By an exception that nobody catches; and by SIGTERM, which ends the host, and not the guardian beside it."""
    with driven_board() as (board, host, guardian):
        assert host.stdin is not None
        if word:
            host.stdin.write(f"{word}\n")
            host.stdin.flush()
        else:
            os.kill(guardian, signal.SIGTERM)
            host.terminate()
        assert "the host has died without a stop" in last_words(host)
        while encoded(*STOP) not in board.heard:
            assert board.hear(PATIENCE_S)
        assert not board.rig.node.is_driving


def test_a_goodbye_leaves_the_port_alone() -> None:
    with driven_board() as (board, host, _):
        board.heard = b""
        assert host.stdin is not None
        host.stdin.write("goodbye\n")
        host.stdin.flush()
        assert last_words(host) == ""
        assert host.wait(PATIENCE_S) == 0
        assert board.hear(0.0) == b""
        assert board.rig.node.is_driving


def start_and_kill(port: str, patience_s: float) -> "subprocess.Popen[str]":
    """A host that does nothing but to have a guardian, and to die."""
    program = (
        "import os, sys, signal\n"
        "from hil.devices.guardian import Guardian\n"
        "Guardian(sys.argv[1], 115200, b'stop', patience_s=float(sys.argv[2]))\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    host = subprocess.Popen(
        [sys.executable, "-c", program, port, str(patience_s)], env=environment(), stderr=subprocess.PIPE, text=True
    )
    assert host.wait(PATIENCE_S) == -signal.SIGKILL
    return host


def test_a_port_that_somebody_else_has_is_left_to_them_and_it_is_said() -> None:
    with contextlib.closing(PtyStream()) as line, contextlib.closing(SerialStream(line.port, 115200)):
        host = start_and_kill(line.port, 0.1)
        words = host.communicate()[1]
        assert "the robot could not be stopped: serial port" in words
        assert "is busy: another program holds it" in words
        assert line.read(0) == b""


def test_a_port_that_becomes_free_late_is_waited_for() -> None:
    """As when the system has ended the pipe of a dead host before its port."""
    with contextlib.closing(PtyStream()) as line:
        with contextlib.closing(SerialStream(line.port, 115200)):
            host = start_and_kill(line.port, PATIENCE_S)
            assert line.read(0) == b""
        assert "has sent it" in host.communicate()[1]
        assert line.read(int(PATIENCE_S * 1e9)) == 5 * b"stop"


def test_one_that_was_killed_is_seen_and_dismissed_without_a_word() -> None:
    guardian = Guardian("no such port", 115200, b"stop")
    assert guardian.is_watching
    os.kill(guardian.pid, signal.SIGKILL)
    os.waitid(os.P_PID, guardian.pid, os.WEXITED | os.WNOWAIT)
    assert not guardian.is_watching
    guardian.dismiss()


@pytest.mark.parametrize(
    ("python", "words"),
    [
        ("/no/such/python", "could not be started"),
        (shutil.which("false") or "false", r"did not start \(exit status 1\)"),
    ],
)
def test_one_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch, python: str, words: str) -> None:
    monkeypatch.setattr(sys, "executable", python)
    with pytest.raises(DeviceError, match=words):
        Guardian("any", 115200, b"stop")


def test_one_that_hangs_at_its_start_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.devices.guardian._START_LIMIT_S", 0.2)
    monkeypatch.setattr("hil.devices.guardian.module_command", lambda _: [sys.executable, "-c", "input(); input()"])
    with pytest.raises(DeviceError, match=r"did not start \(exit status -9\)"):
        Guardian("any", 115200, b"stop")


def test_ctrl_c_at_its_start_is_ctrl_c_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    interrupts = "import os, signal, sys; os.kill(os.getppid(), signal.SIGINT); sys.stdin.read()"
    monkeypatch.setattr("hil.devices.guardian.module_command", lambda _: [sys.executable, "-c", interrupts])
    threads = threading.active_count()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            Guardian("any", 115200, b"stop")
    finally:
        signal.signal(signal.SIGINT, before)
    wait_for(lambda: threading.active_count() == threads, 5.0)  # nothing that the interpreter would wait for at its end
