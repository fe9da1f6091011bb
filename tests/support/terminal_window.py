"""A terminal's window for a real process: the other end of its pseudo-terminal."""

import contextlib
import fcntl
import os
import pty
import select
import subprocess
import termios
import threading
from collections.abc import Iterator, Sequence

from tests.support.processes import environment, wait_for


class Window:
    """A window with a process in front. ``shown`` is all that was written to it."""

    def __init__(self, command: Sequence[str]) -> None:
        self.shown = b""
        self._end, inner = pty.openpty()
        self.before = termios.tcgetattr(inner)
        self._ends = threading.Event()
        self._repeats = threading.Event()
        self.process = subprocess.Popen(
            command,
            stdin=inner,
            stdout=inner,
            stderr=inner,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            env=environment() | {"TERM": "xterm-256color"},
        )
        self._inner = inner  # kept, so that its modes can be looked at when the process has ended
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    @property
    def modes(self) -> list[int | list[bytes | int]]:
        return termios.tcgetattr(self._inner)

    def type(self, text: str) -> None:
        """Type, or send what a terminal says of a key; ^ stands for ESC."""
        os.write(self._end, text.replace("^", "\x1b").encode())

    @contextlib.contextmanager
    def repeating(self, text: str) -> Iterator[None]:
        """Hold a key as a keyboard does: once, and after a pause 30 times a second."""
        let_go = threading.Event()

        def hold() -> None:
            self.type(text)
            pause_s = 0.4
            while not let_go.wait(pause_s):
                self.type(text)
                pause_s = 1.0 / 30.0

        holder = threading.Thread(target=hold)
        holder.start()
        try:
            yield
        finally:
            let_go.set()
            holder.join()

    def says(self, text: str) -> None:
        """Wait until something was shown."""
        wait_for(lambda: text.encode() in self.shown or self.process.poll() is not None)
        assert text.encode() in self.shown, self.shown.decode(errors="replace")

    def close(self) -> None:
        """Close the window; whatever is in front of it hangs up."""
        if not self._ends.is_set():
            self._ends.set()
            self._reader.join()
            os.close(self._inner)
            os.close(self._end)

    def _read(self) -> None:
        while not self._ends.is_set():
            ready, _, _ = select.select([self._end], [], [], 0.01)
            if ready:
                self.shown += os.read(self._end, 65536)
