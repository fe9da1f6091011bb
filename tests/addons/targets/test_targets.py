"""``hil device --target``: the circle with the ARM binary behind the wire, in processes of their own."""

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.addons.targets import emulated_stm32
from tests.addons.targets.test_qemu import has_gone, on_linux, qemu_of
from tests.support.emulated_boards import needs_compiler, needs_qemu, needs_unicorn
from tests.support.processes import device, hil, run_json, wait_for

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

LOCKSTEP = ("--mode", "lockstep")
AT_200_HZ = ("--set", "loop.rate_hz=200", "--set", "expect=[]")


def circle(target: str, link: str, there: str | None, *options: str) -> dict[str, object]:
    """Run the paper's circle against a target in another process; ``there`` is the link's other end."""
    with device("paper_circle", *LOCKSTEP, "--target", target, "--link", link, *options) as robot:
        reach = ("--link", there or robot.link, "--truth", robot.truth)
        figures = run_json("paper_circle", *LOCKSTEP, *reach, "--record", "none", *options)
    assert robot.process.returncode == 0
    return figures


def circle_here(*options: str) -> dict[str, object]:
    """Run the circle with the host library in one process."""
    return run_json("paper_circle", *LOCKSTEP, "--link", "memory:", "--record", "none", *options)


@contextlib.contextmanager
def can_cable() -> Iterator[tuple[str, str]]:
    """Two serial ports with a cable between them: for slcan, two adapters on one bus."""
    import pty
    import tty

    ends = [pty.openpty() for _ in range(2)]
    stop, stopped = os.pipe()
    for _, slave in ends:
        tty.setraw(slave)
    (one, _), (other, _) = ends

    def carry() -> None:
        while True:
            readable, _, _ = select.select([one, other, stop], [], [])
            if stop in readable:
                return
            for end in readable:
                os.write(other if end == one else one, os.read(end, 65536))

    thread = threading.Thread(target=carry)
    thread.start()
    try:
        yield tuple(os.ttyname(slave) for _, slave in ends)  # type: ignore[misc]
    finally:
        os.write(stopped, b"x")
        thread.join()
        for number in (*(n for end in ends for n in end), stop, stopped):
            os.close(number)


@needs_compiler
@needs_unicorn
def test_unicorn_tracks_the_circle_over_serial_with_the_host_librarys_bytes():
    below_3_mm = ("--set", "expect.1.from_s=1", "--set", "expect.1.to_s=2")
    options = ("--set", "loop.rate_hz=200", "--set", "loop.duration_s=2", *below_3_mm)
    expected = circle_here(*options)
    figures = circle("unicorn", "serial:pty", None, *options)
    assert figures["wire_sha256"] == expected["wire_sha256"]
    assert figures["tracked_s"] == expected["tracked_s"]
    assert figures["passed"]


@needs_compiler
@needs_unicorn
def test_unicorn_tracks_the_circle_over_can_with_the_host_librarys_bytes():
    options = (*AT_200_HZ, "--set", "loop.duration_s=1")
    expected = circle_here(*options)
    with can_cable() as (board, controller):
        figures = circle("unicorn", f"can:slcan/{board}", f"can:slcan/{controller}", *options)
    assert figures["wire_sha256"] == expected["wire_sha256"]
    assert figures["tracked_s"] == expected["tracked_s"]
    assert figures["tracked_s"] < 1.0


@needs_compiler
@needs_qemu
def test_qemu_tracks_the_circle_with_the_host_librarys_bytes():
    options = (*AT_200_HZ, "--set", "loop.duration_s=1")
    expected = circle_here(*options)
    figures = circle("qemu", "serial:pty", None, *options)
    assert figures["wire_sha256"] == expected["wire_sha256"]
    assert figures["tracked_s"] == expected["tracked_s"]
    assert figures["tracked_s"] < 1.0


@needs_compiler
@needs_unicorn
def test_a_second_run_begins_with_a_board_that_was_power_cycled():
    options = (*AT_200_HZ, "--set", "loop.duration_s=0.3")
    with device("paper_circle", *LOCKSTEP, "--target", "unicorn", "--link", "serial:pty", *options) as robot:
        there = (*LOCKSTEP, "--link", robot.link, "--truth", robot.truth, "--record", "none", *options)
        first, second = (run_json("paper_circle", *there) for _ in range(2))
    assert first["wire_sha256"] == second["wire_sha256"]


@on_linux
@needs_compiler
@needs_qemu
def test_killed_qemu_ends_the_device_with_a_sentence_and_nothing_behind():
    with device("paper_circle", *LOCKSTEP, "--target", "qemu", "--link", "serial:pty") as robot:
        qemu = qemu_of(robot.process.pid)
        os.kill(qemu, signal.SIGKILL)
        _, said = robot.process.communicate(timeout=30)
        assert robot.process.returncode == 3
        assert said.startswith("hil: QEMU is gone")
        assert said.count("\n") == 1
        wait_for(lambda: has_gone(qemu))


@on_linux
@needs_compiler
@needs_qemu
def test_a_device_that_is_killed_leaves_neither_qemu_nor_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with device("paper_circle", *LOCKSTEP, "--target", "qemu", "--link", "serial:pty") as robot:
        qemu = qemu_of(robot.process.pid)
        robot.process.kill()
    wait_for(lambda: has_gone(qemu))
    wait_for(lambda: not list(tmp_path.iterdir()))  # the process that ends QEMU removes them after it


@on_linux
@needs_compiler
@needs_qemu
def test_a_device_whose_cache_cannot_be_written_starts_and_takes_qemu_with_it(tmp_path, monkeypatch):
    (tmp_path / "no folder").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "no folder"))
    with device("paper_circle", *LOCKSTEP, "--target", "qemu", "--link", "serial:pty") as robot:
        qemu = qemu_of(robot.process.pid)
    assert robot.process.returncode == 0
    assert has_gone(qemu)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--target", "qmu", *LOCKSTEP), "did you mean 'qemu'?"),
        (("--target", "unicorn", "--mode", "realtime"), "its robot time comes from STEP; add --mode lockstep"),
        (
            ("--target", "qemu", *LOCKSTEP, "--link", "can:slcan//dev/ttyX"),
            "--target qemu has no CAN controller; use --link serial:..., or --target unicorn\n",
        ),
    ],
)
def test_what_a_target_cannot_do_is_refused_before_anything_starts(options: tuple[str, ...], said: str):
    link = () if "--link" in options else ("--link", "serial:pty")
    refused = hil("device", "paper_circle", *link, *options)
    assert refused.returncode == 2
    assert said in refused.stderr
    assert refused.stderr.count("\n") == 1


def test_without_the_tools_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", "")
    refused = hil("device", "paper_circle", *LOCKSTEP, "--link", "serial:pty", "--target", "qemu")
    assert refused.returncode == 2
    assert "install" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_without_a_compiler_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "ziglang", None)
    emulated_stm32._build.cache_clear()  # of a test that had a compiler
    refused = hil("device", "paper_circle", *LOCKSTEP, "--link", "serial:pty", "--target", "qemu")
    assert (refused.returncode, refused.stderr) == (
        2,
        "hil: the firmware for the emulated target was not built: no C compiler for ARM is installed: install "
        "arm-none-eabi-gcc (on Debian: gcc-arm-none-eabi), or ziglang with pip\n",
    )
