"""The guardian between real processes: a host that dies or hangs while a board that knows no time limit is driving."""

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from hil.addons.motors.guardian import Guardian, watch_over
from hil.core.errors import DeviceError
from hil.core.subprocesses import module_command
from hil.core.types import CommandMode
from hil.robot.driver import RobotFacts
from hil.robot.driver_registry import dialect
from hil.wire.serial_port import SerialStream
from hil.wire.url import parse_link
from tests.support.dialect_testbed import Rig
from tests.support.guarded_host import STOP, encoded
from tests.support.processes import environment, is_running, wait_for

if sys.platform == "win32":
    pytest.skip("pseudo-terminals need a POSIX system", allow_module_level=True)

from hil.wire.pty import PtyStream

PATIENCE_S = 60.0
NEVER_S = 60.0  # for tests of something else than silence: a test may be kept waiting


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

    def hear_out(self) -> None:
        """Hear all that is on the line already, as from a host that says nothing more."""
        while self.hear(0.0):
            pass

    def hear_stops(self, count: int) -> None:
        """Hear until so many stops have come."""
        while self.heard.count(encoded(*STOP)) < count:
            assert self.hear(PATIENCE_S)


class Host(NamedTuple):
    """A host in a process of its own."""

    process: "subprocess.Popen[str]"

    def order(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def says(self, word: str) -> str:
        """Wait for its next line, which begins so; return the rest of it."""
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], PATIENCE_S)[0]
        said, _, rest = self.process.stdout.readline().partition(" ")
        assert said.strip() == word, (said, rest)
        return rest.strip()

    def last_words(self) -> str:
        """Return the errors of the host and its guardian; they end when both have."""
        assert self.process.stderr is not None
        return self.process.stderr.read()


@contextlib.contextmanager
def driven_board(limit_s: float = NEVER_S) -> Iterator[tuple[Board, Host, int]]:
    """A host in a process of its own that drives a board, with its guardian's process id."""
    line = PtyStream()
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.guarded_host", line.port, str(limit_s)],
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    host = Host(process)
    try:
        guardian = int(host.says("driving"))
        board = Board(line)
        assert board.hear(PATIENCE_S)
        assert board.rig.node.is_driving
        yield board, host, guardian
    finally:
        process.kill()
        process.communicate()
        line.close()


def test_a_host_that_is_killed_is_followed_by_a_stop_and_the_wheels_stand() -> None:
    with driven_board() as (board, host, _):
        host.process.kill()
        assert "the host has ended without a stop; the guardian has sent it" in host.last_words()
        board.hear_stops(5)
        board.rig.node.run(1000)
        assert not board.rig.node.is_driving
        assert board.rig.is_still()
        assert board.heard.endswith(5 * encoded(*STOP))


@pytest.mark.parametrize("word", ["raise", ""])
def test_a_host_that_falls_over_is_followed_by_a_stop(word: str) -> None:
    """By an uncaught exception; and by SIGTERM, which ends the host, but not the guardian next to it."""
    with driven_board() as (board, host, guardian):
        if word:
            host.order(word)
        else:
            os.kill(guardian, signal.SIGTERM)
            host.process.terminate()
        assert "the host has ended without a stop" in host.last_words()
        board.hear_stops(1)
        assert not board.rig.node.is_driving


def test_a_host_that_hangs_is_stopped_learns_of_it_and_drives_on_by_a_new_arm_alone() -> None:
    """It holds the port, and its lock, all the time."""
    with driven_board(0.5) as (board, host, _):
        host.process.send_signal(signal.SIGSTOP)
        board.hear_stops(5)
        board.hear_out()
        board.rig.node.run(1000)
        assert board.rig.is_still()
        host.process.send_signal(signal.SIGCONT)
        told = host.says("told")
        assert told.startswith("no command went out for ")
        assert told.endswith(" s, and the guardian stops the robot after 0.5 s of silence (device.guardian_s)")
        board.hear_out()
        assert board.heard.endswith(encoded(*STOP))
        assert not board.rig.node.is_driving

        host.order("arm")
        host.says("driving")
        board.hear(PATIENCE_S)
        assert board.rig.node.is_driving
        host.order("goodbye")
        assert "no command has come from the host for 0.5 s; the guardian has sent the stop to" in host.last_words()
        assert host.process.wait(PATIENCE_S) == 0


def test_a_host_that_is_slow_for_half_the_limit_is_left_alone() -> None:
    with driven_board(2.0) as (board, host, _):
        host.order("busy 1.0")
        host.says("done")
        host.order("goodbye")
        assert host.last_words() == ""
        board.hear_out()
        assert encoded(*STOP) not in board.heard
        assert board.rig.node.is_driving


def test_a_guardian_that_is_killed_is_noticed_and_replaced_and_the_new_one_does_the_same() -> None:
    with driven_board() as (board, host, first):
        os.kill(first, signal.SIGKILL)
        assert host.says("told").startswith("the guardian died")
        host.order("arm")
        assert int(host.says("driving")) != first
        board.heard = b""
        host.process.kill()
        assert "the host has ended without a stop; the guardian has sent it" in host.last_words()
        board.hear_stops(5)
        assert not board.rig.node.is_driving


def test_a_goodbye_leaves_the_port_alone() -> None:
    with driven_board() as (board, host, _):
        host.order("goodbye")
        assert host.last_words() == ""
        assert host.process.wait(PATIENCE_S) == 0
        board.hear_out()
        assert encoded(*STOP) not in board.heard
        assert board.rig.node.is_driving


def lose_and_kill(port: str, patience_s: float) -> "subprocess.Popen[str]":
    """A host that arms, loses its link, and dies: its guardian has to open the port anew."""
    program = (
        "import os, sys, signal, time\n"
        "from hil.addons.motors.guardian import Guardian\n"
        "guardian = Guardian(sys.argv[1], 115200, b'stop', silence_s=60, patience_s=float(sys.argv[2]))\n"
        "while not guardian.begin(): time.sleep(0.01)\n"
        "guardian.hold()\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    host = subprocess.Popen(
        [sys.executable, "-c", program, port, str(patience_s)], env=environment(), stderr=subprocess.PIPE, text=True
    )
    assert host.wait(PATIENCE_S) == -signal.SIGKILL
    return host


def test_a_port_that_somebody_else_has_is_left_to_them_and_it_is_said() -> None:
    with contextlib.closing(PtyStream()) as line, contextlib.closing(SerialStream(line.port, 115200)):
        host = lose_and_kill(line.port, 0.1)
        words = host.communicate()[1]
        assert "the robot could not be stopped: serial port" in words
        assert "is busy: another program holds it" in words
        assert line.read(0) == b""


def test_a_port_that_becomes_free_late_is_waited_for() -> None:
    """As when the system has ended the pipe of a dead host before its port."""
    with contextlib.closing(PtyStream()) as line:
        with contextlib.closing(SerialStream(line.port, 115200)):
            host = lose_and_kill(line.port, PATIENCE_S)
            assert line.read(0) == b""
        assert "has sent it" in host.communicate()[1]
        assert line.read(int(PATIENCE_S * 1e9)) == 5 * b"stop"


@contextlib.contextmanager
def guarded(port: str, silence_s: float = NEVER_S) -> Iterator[Guardian]:
    """A guardian of this process."""
    guardian = Guardian(port, 115200, b"stop", silence_s=silence_s)
    try:
        yield guardian
    finally:
        guardian.rest()
        guardian.release()


def test_nothing_is_stopped_while_nothing_is_armed() -> None:
    """A resting guardian stays silent at least until another one, which began later, has sent its stop."""
    with contextlib.ExitStack() as resources:
        line, other = (resources.enter_context(contextlib.closing(PtyStream())) for _ in range(2))
        # Long enough that a busy machine lets the first one rest before it sees a silence.
        resting, watching = (resources.enter_context(guarded(one.port, 2.0)) for one in (line, other))
        wait_for(resting.begin)
        resting.rest()
        wait_for(watching.begin)
        assert other.read(int(PATIENCE_S * 1e9)).startswith(b"stop")
        assert line.read(0) == b""
        assert resting.failure is None


def test_nothing_is_armed_when_the_guardian_cannot_open_the_port() -> None:
    with guarded("no such port") as guardian:
        with pytest.raises(DeviceError, match=r"cannot open serial port 'no such port' .*No such file"):
            wait_for(guardian.begin)
        guardian.rest()
        assert guardian.failure is None


def test_one_that_hangs_is_replaced_whether_it_watches_or_is_asked_to() -> None:
    with contextlib.closing(PtyStream()) as line, guarded(line.port) as guardian:
        first = guardian.pid
        assert first is not None
        os.kill(first, signal.SIGSTOP)
        wait_for(guardian.begin)
        second = guardian.pid
        assert second not in (None, first)
        assert second is not None

        def failure() -> str | None:
            guardian.beat()
            return guardian.failure

        assert failure() is None
        os.kill(second, signal.SIGSTOP)
        assert "has not answered for 1.5 s" in wait_for(failure)
        wait_for(guardian.begin)
        assert guardian.failure is None
        assert not is_running(first)
        assert not is_running(second)


def test_one_that_starts_slowly_is_not_taken_for_one_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = "import time; time.sleep(1.8); from hil.addons.motors.guardian_process import _main; _main()"
    with contextlib.closing(PtyStream()) as line, guarded(line.port) as guardian:
        first = guardian.pid
        assert first is not None
        monkeypatch.setattr("hil.addons.motors.guardian.module_command", lambda _: [sys.executable, "-c", slow])
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: guardian.pid is None)
        assert not guardian.begin()
        second = guardian.pid
        wait_for(guardian.begin)
        assert guardian.pid == second


def test_the_pipe_of_one_that_died_is_closed() -> None:
    with guarded("any") as guardian:
        first = guardian._process
        assert first is not None
        assert first.stdin is not None
        first.kill()
        wait_for(lambda: guardian.pid is None)
        assert first.stdin.closed


def test_the_guardian_counts_the_silence_from_the_arming_as_the_host_does() -> None:
    with contextlib.closing(PtyStream()) as line, guarded(line.port, 1.0) as guardian:
        assert guardian.pid is not None
        os.kill(guardian.pid, signal.SIGSTOP)
        assert not guardian.begin()
        os.kill(guardian.pid, signal.SIGCONT)
        wait_for(lambda: guardian._watching)
        watched_ns = time.monotonic_ns()
        wait_for(lambda: time.monotonic_ns() - watched_ns > 600_000_000)
        assert guardian.begin()
        guardian.beat()
        wait_for(lambda: time.monotonic_ns() - watched_ns > 1_200_000_000)
        assert guardian.failure is None
        assert line.read(0) == b""


def test_a_pause_of_the_host_is_not_taken_for_one_of_the_guardians() -> None:
    with contextlib.closing(PtyStream()) as line, guarded(line.port) as guardian:
        wait_for(guardian.begin)
        first = guardian.pid
        wait_for(lambda: time.monotonic_ns() - guardian._answered_ns > 1_600_000_000)
        for _ in range(3):
            assert guardian.failure is None
            guardian.beat()
        assert guardian.failure is None
        assert guardian.pid == first


def test_one_that_takes_nothing_holds_nobody_up() -> None:
    """A pipe holds 64 KiB here; a blocking write to a full one would not end."""
    with guarded("no such port") as guardian:
        pid = guardian.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        for _ in range(20_000):
            guardian._write(b"beat")
        os.kill(pid, signal.SIGKILL)


def test_a_command_that_comes_after_the_stop_is_followed_by_another_stop() -> None:
    """By the process's own lines: the host may have been about to send when it stood still."""
    with contextlib.closing(PtyStream()) as line:
        process = subprocess.Popen(
            module_command("hil.addons.motors.guardian_process"),
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        order = {"port": line.port, "baud": 115200, "stop": b"stop".hex(), "silence_s": 0.1}
        order |= {"patience_s": 1.0, "priority": 0}
        process.stdin.write(json.dumps(order).encode() + b"\nwatch 1\n")
        process.stdin.flush()
        assert [process.stdout.readline() for _ in range(3)] == [b"ready\n", b"watching 1\n", b"stopped 1\n"]
        assert read_exactly(line, 20) == 5 * b"stop"
        process.stdin.write(b"beat\n")
        process.stdin.flush()
        assert read_exactly(line, 4) == b"stop"
        _, said = process.communicate(b"hold\nrest\n")
        assert process.returncode == 0
        assert said.count(b"\n") == 1
        assert line.read(0) == b""


def read_exactly(line: PtyStream, count: int) -> bytes:
    heard = b""
    while len(heard) < count:
        data = line.read(int(PATIENCE_S * 1e9))
        assert data
        heard += data
    return heard


def test_a_port_that_hangs_up_is_let_go_of() -> None:
    """Whoever keeps an adapter open that was unplugged keeps its name from the one that is plugged in."""
    line = PtyStream()
    with guarded(line.port) as guardian:
        wait_for(guardian.begin)
        held = Path(f"/proc/{guardian.pid}/fd")
        if not held.is_dir():
            pytest.skip("needs /proc to see what another process has open")
        assert line.port in opened(held)
        line.close()

        def is_let_go() -> bool:
            guardian.beat()
            return not {line.port, f"{line.port} (deleted)"} & opened(held)

        wait_for(is_let_go)
        assert guardian.failure is None


def opened(folder: Path) -> set[str]:
    found = set()
    for descriptor in folder.iterdir():
        with contextlib.suppress(OSError):
            found.add(str(descriptor.readlink()))
    return found


FACTS = RobotFacts(0.05, 0.3, (0, 1, 2, 3), (1, 1, 1, 1), 1.0, 20.0, 0.1, 0.1, 0.01, CommandMode.SPEED)


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (
            "can:socketcan/can0",
            "if this program dies or hangs: a guardian process watches over serial lines alone",
        ),
        (
            "serial:socket://robot:3000",
            "if it hangs, or both are killed together, nothing stops it: socket://robot:3000",
        ),
        ("serial:/dev/ttyACM0", "sends nothing for 0.3 s (device.guardian_s), but if both are killed or stopped toge"),
    ],
)
def test_what_is_not_covered_is_one_sentence(link: str, words: str) -> None:
    made = dialect("vesc")
    url = parse_link(link)
    driver = made.make(made.settings(), FACTS._replace(wire="serial" if link.startswith("serial:") else "can"))
    watch = watch_over(made, driver, url, 0.3, 0)
    watch.release()
    assert words in str(watch.warning)
    assert ". " not in str(watch.warning)


@pytest.mark.parametrize(
    ("python", "words"),
    [
        ("/no/such/python", "could not be started"),
        (
            shutil.which("false") or "false",
            r"^the guardian of serial port 'any' did not start \(exit status 1\); without it nothing would stop the "
            "robot if this process is killed$",
        ),
    ],
)
def test_one_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch, python: str, words: str) -> None:
    monkeypatch.setattr(sys, "executable", python)
    with pytest.raises(DeviceError, match=words):
        Guardian("any", 115200, b"stop", silence_s=1.0)


def test_one_that_heard_no_command_in_time_ends_the_drive_although_they_went_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As when the pipe between them was full."""
    deaf = "import sys; print('ready\\nwatching 1\\nstopped 1', flush=True); sys.stdin.read()"
    monkeypatch.setattr("hil.addons.motors.guardian.module_command", lambda _: [sys.executable, "-c", deaf])
    with guarded("any", 30.0) as guardian:
        wait_for(guardian.begin)
        assert wait_for(lambda: guardian.failure) == (
            "no command reached the guardian in time, and it stopped the robot after 30 s of silence "
            "(device.guardian_s)"
        )


def test_one_that_hangs_at_its_start_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.addons.motors.guardian._START_LIMIT_S", 0.2)
    monkeypatch.setattr(
        "hil.addons.motors.guardian.module_command", lambda _: [sys.executable, "-c", "input(); input()"]
    )
    with pytest.raises(DeviceError, match=r"did not start \(exit status -9\)"):
        Guardian("any", 115200, b"stop", silence_s=1.0)


def no_thread(_thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize("kind", [threading.Thread, threading.Timer])
def test_without_a_thread_for_it_there_is_no_guardian(
    monkeypatch: pytest.MonkeyPatch, kind: type[threading.Thread]
) -> None:
    start = threading.Thread.start
    monkeypatch.setattr(
        threading.Thread, "start", lambda thread: (no_thread if type(thread) is kind else start)(thread)
    )
    with pytest.raises(DeviceError, match="could not be started: can't start new thread"):
        Guardian("any", 115200, b"stop", silence_s=1.0)


def test_one_that_no_thread_is_to_be_had_for_is_started_later(monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.closing(PtyStream()) as line, guarded(line.port) as guardian:
        assert guardian.pid is not None
        with monkeypatch.context() as patch:
            patch.setattr(threading.Timer, "start", no_thread)
            os.kill(guardian.pid, signal.SIGKILL)
            wait_for(lambda: guardian.pid is None)
            with pytest.raises(DeviceError, match="could not be started: can't start new thread"):
                guardian.begin()
        wait_for(guardian.begin)


def test_ctrl_c_at_its_start_is_ctrl_c_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    interrupts = "import os, signal, sys; os.kill(os.getppid(), signal.SIGINT); sys.stdin.read()"
    monkeypatch.setattr("hil.addons.motors.guardian.module_command", lambda _: [sys.executable, "-c", interrupts])
    threads = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        Guardian("any", 115200, b"stop", silence_s=1.0)
    wait_for(lambda: threading.active_count() <= threads, 5.0)  # nothing that the interpreter would wait for at its end
