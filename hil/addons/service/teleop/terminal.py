"""The terminal of teleop: reads single key presses, shows its own screen, and is restored at the end. POSIX only."""

import contextlib
import os
import re
import select
import signal
import sys
import termios
import textwrap
import time
from collections.abc import Iterator, Sequence

from hil.core.errors import BadInputError, LinkError
from hil.core.printable import printable

# The alternate screen (1049), and the cursor (25).
_ENTER, _LEAVE = b"\x1b[?1049h\x1b[?25l", b"\x1b[?25h\x1b[?1049l"
_Attributes = list[int | list[bytes | int]]
_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
_TEXT = " " * 10  # where the text of a labelled line begins
_SLOW_S = 1.0  # a terminal over a slow network

_ARROWS = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}
_NAMED = {4: "ctrl-d", 10: "enter", 13: "enter", 27: "escape", 32: "space"}
# An arrow, in both modes of the keypad; another control sequence (ECMA-48, 5.4); a key with Alt; or one byte.
_KEY = re.compile(rb"\x1b[\[O]([A-D])|\x1b\[[0-?]*[ -/]*[@-~]|\x1b[^\x1b]|[\x00-\xff]", re.DOTALL)


class LostTerminalError(LinkError):
    """The terminal is gone, and with it the operator."""


def keys_of(data: bytes) -> list[str]:
    """Return the keys that a terminal sends as these bytes, by name: a character, or one such as ``up`` or ``escape``.

    A key with Alt is the key Esc alone: it must not drive. So is a sequence that is cut off; teleop knows no character
    of its rest.
    """
    keys = []
    for found in _KEY.finditer(data):
        code = found[0][0]
        if found[1]:
            keys.append(_ARROWS[found[1]])
        elif len(found[0]) <= 2 and (code in _NAMED or 33 <= code <= 126):
            keys.append(_NAMED.get(code) or chr(code))
    return keys


class Terminal:
    """The controlling terminal, between ``enter`` and ``leave``. Every method raises LostTerminalError."""

    def __init__(self) -> None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise BadInputError("teleop needs a terminal for keys and screen; start it in one, without pipes")
        # Asked now, because isatty returns False once the terminal is gone.
        self._streams = [stream.fileno() for stream in (sys.stdin, sys.stdout, sys.stderr) if stream.isatty()]
        self._in, self._out = self._streams[:2]
        self._before: _Attributes | None = None

    def enter(self) -> None:
        """Read keys as they are pressed, without echo, and switch to the alternate screen."""
        with _lost():
            self._before, changed = termios.tcgetattr(self._in), termios.tcgetattr(self._in)
            # Ctrl-C and Ctrl-Z stay signals, so that they work even if this program hangs; Ctrl-S must not stop it.
            changed[0] &= ~(termios.IXON | termios.ICRNL)
            changed[3] &= ~(termios.ICANON | termios.ECHO)
            changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
            termios.tcsetattr(self._in, termios.TCSAFLUSH, changed)
        self._write(_ENTER, _SLOW_S)

    def leave(self) -> None:
        """Restore the terminal as far as possible. Calling twice is allowed."""
        if self._before is None:
            return
        before, self._before = self._before, None
        with contextlib.suppress(LostTerminalError):
            self._write(_LEAVE, _SLOW_S)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self._in, termios.TCSAFLUSH, before)

    def forget(self) -> None:
        """Send the output to the null device after the terminal is gone, so that no print fails."""
        null = os.open(os.devnull, os.O_RDWR)
        for stream in self._streams:
            os.dup2(null, stream)

    def wait(self, until_s: float, other: int) -> bool:
        """Wait for keys, for input on ``other``, or until ``until_s``; return whether ``other`` has input."""
        return other in select.select([self._in, other], [], [], max(until_s - time.monotonic(), 0.0))[0]

    def read(self) -> list[str]:
        """Return the keys that have been typed; does not wait."""
        if not select.select([self._in], [], [], 0.0)[0]:
            return []
        with _lost():
            data = os.read(self._in, 4096)
        if not data:
            raise LostTerminalError("the terminal is gone")
        return keys_of(data)

    def show(self, lines: Sequence[str]) -> None:
        """Show lines, with texts of a robot or a gamepad in them, from the top, if the terminal accepts output now.

        Long lines take several rows.
        """
        try:
            size = os.get_terminal_size(self._out)
        except OSError:
            raise LostTerminalError("the terminal is gone") from None
        columns, rows = size.columns or 80, size.lines or 24
        whole = (printable(line).replace("\n", " ") for line in lines)
        folded = [part for line in whole for part in textwrap.wrap(line, columns, subsequent_indent=_TEXT) or [""]]
        shown = f"{_REST_OF_LINE}\r\n".join(folded[:rows])
        self._write(f"{_HOME}{shown}{_REST_OF_LINE}{_REST_OF_SCREEN}".encode())

    def _write(self, data: bytes, within_s: float = 0.0) -> None:
        """Write, unless the terminal is blocked, because that must not delay stopping the robot."""
        with _lost():
            if select.select([], [self._out], [], within_s)[1]:
                os.write(self._out, data)


@contextlib.contextmanager
def _lost() -> Iterator[None]:
    try:
        yield
    except (OSError, termios.error):
        raise LostTerminalError("the terminal is gone") from None


class Signals:
    """Makes signals wait for like keys: ``fd`` becomes readable when one comes."""

    NOTED = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGCONT)

    def __enter__(self) -> "Signals":
        self.fd, self._write_fd = os.pipe()
        for end in (self.fd, self._write_fd):
            os.set_blocking(end, False)
        # A handler is needed, but does nothing: Python writes the signal's number to the wakeup pipe.
        noted = [number for number in self.NOTED if signal.getsignal(number) is not signal.SIG_IGN]  # as under nohup
        self._handlers = {number: signal.signal(number, lambda *_: None) for number in noted}
        self._wakeup = signal.set_wakeup_fd(self._write_fd, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        os.close(self.fd)
        os.close(self._write_fd)

    def received(self) -> set[int]:
        """Return the signals that have come since the last call."""
        try:
            return set(os.read(self.fd, 4096))
        except BlockingIOError:
            return set()

    def suspend(self) -> None:
        """Stop this process as Ctrl-Z does, and return when it is continued."""
        handler = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, handler)
