"""The window in which a command runs is closed: it ends in order, and under nohup it goes on."""

import contextlib
import os
import select
import signal
import sys
from pathlib import Path

import pytest

from hil.core.tokens import state_folder
from hil.record.files import has_end
from tests.support.processes import HIL, environment, wait_for

if sys.platform == "win32":
    pytest.skip("windows of a POSIX system", allow_module_level=True)
import pty

pytestmark = pytest.mark.usefixtures("state_home")
ROBOT = ("device", "circle_speed", "--mode", "realtime", "--link", "serial:pty")
RUN = ("run", "circle_speed", "--mode", "lockstep", "--set", "loop.duration_s=600", "--record", "run.mcap")


class Window:
    """A terminal with a command in it, and what that has shown."""

    def __init__(self, *command: str) -> None:
        self.pid, self._terminal = pty.fork()
        if self.pid == 0:
            os.execvpe(command[0], command, environment())
        self._is_closed = False
        self.shown = b""

    def shows(self, text: bytes) -> bool:
        """Read the output so far, so that the command need not wait for room, and return whether the text is there."""
        while select.select([self._terminal], [], [], 0.0)[0]:
            self.shown += os.read(self._terminal, 65536)
        return text in self.shown

    def close(self) -> None:
        """Close the window: the kernel sends SIGHUP, and then the shell does too."""
        os.close(self._terminal)
        self._is_closed = True
        os.kill(self.pid, signal.SIGHUP)

    def exit_code(self) -> int:
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def __enter__(self) -> "Window":
        return self

    def __exit__(self, *_: object) -> None:
        if not self._is_closed:
            os.close(self._terminal)
        with contextlib.suppress(ChildProcessError, ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)


def tokens() -> list[Path]:
    return list(state_folder("truth").glob("*.token"))


def test_a_virtual_robot_takes_its_token_with_it() -> None:
    with Window(*HIL, *ROBOT) as window:
        wait_for(lambda: window.shows(b"ready "))
        assert len(tokens()) == 1
        window.close()
        assert window.exit_code() == 0
        assert tokens() == []


def test_a_run_ends_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with Window(*HIL, *RUN) as window:
        wait_for(lambda: window.shows(b"s of 600 s"))
        window.close()
        assert window.exit_code() == 130
        assert has_end(tmp_path / "run.mcap", ".mcap")


def test_under_nohup_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with Window("nohup", *HIL, *ROBOT) as window:
        wait_for(lambda: (out := tmp_path / "nohup.out").exists() and out.read_text().startswith("ready "))
        window.close()
        assert os.waitpid(window.pid, os.WNOHANG) == (0, 0)
        os.kill(window.pid, signal.SIGTERM)
        assert window.exit_code() == 0
        assert tokens() == []
