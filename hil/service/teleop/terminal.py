"""The terminal as teleop uses it: keys as they are pressed, a screen of its own, all put back in order. POSIX only."""

import contextlib
import os
import select
import signal
import sys
import termios
import time
from collections.abc import Iterator, Sequence
from types import FrameType

from hil.core.errors import BadInputError, LinkError
from hil.service.teleop.keys import Attributes, Event, Flags, KeyDecoder

# Kitty's keyboard protocol: 1 no sequence of Esc is ambiguous, 2 press, repeat and release, 8 for every key.
_WANTED_FLAGS = 1 | 2 | 8
_PUSH_FLAGS, _POP_FLAGS = b"\x1b[>11u", b"\x1b[<u"
_ASK_FLAGS, _ASK_ATTRIBUTES = b"\x1b[?u", b"\x1b[c"
# The other screen has keyboard flags of its own, so it comes first. 25: cursor; 1004: tell of the window's focus.
_ENTER = b"\x1b[?1049h\x1b[?25l\x1b[?1004h"
_LEAVE = b"\x1b[?1004l\x1b[?25h\x1b[?1049l"
_Attributes = list[int | list[bytes | int]]
_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
_ANSWER_S = 1.0
"""For the slowest network; a terminal at hand answers at once."""
_ESC_S = 0.05
"""After which an ESC is the key and no beginning of a sequence."""


class LostTerminalError(LinkError):
    """The terminal has gone, and with it whoever held a key."""


class Terminal:
    """The controlling terminal, between ``enter`` and ``leave``.

    ``tells_releases``: whether it has kitty's keyboard protocol. Every method raises LostTerminalError.
    """

    def __init__(self) -> None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise BadInputError("teleop needs a terminal for keys and screen; begin it in one, without pipes")
        # Asked now: of a terminal that has gone, the answer is no.
        self._streams = [stream.fileno() for stream in (sys.stdin, sys.stdout, sys.stderr) if stream.isatty()]
        self._in, self._out = self._streams[:2]
        self._before: _Attributes | None = None
        self._decoder = KeyDecoder()
        self._esc_s = 0.0
        self.tells_releases = False

    def enter(self) -> None:
        """Take keys as they are pressed, unseen, and the other screen."""
        with _lost():
            before = termios.tcgetattr(self._in)
            changed = termios.tcgetattr(self._in)
            # Ctrl-C and Ctrl-Z stay signals, so that they are heard whatever hangs here; Ctrl-S must not hang it.
            changed[0] &= ~(termios.IXON | termios.ICRNL)
            changed[3] &= ~(termios.ICANON | termios.ECHO)
            changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
            self._before = before
            termios.tcsetattr(self._in, termios.TCSAFLUSH, changed)
        self._write(_ENTER, _ANSWER_S)
        self.tells_releases = self._ask_flags() is not None
        if self.tells_releases:
            self._write(_PUSH_FLAGS, _ANSWER_S)
            if ((self._ask_flags() or 0) & _WANTED_FLAGS) != _WANTED_FLAGS:
                self._write(_POP_FLAGS, _ANSWER_S)
                self.tells_releases = False

    def leave(self) -> None:
        """Put the terminal back in order. Does what it can, twice no harm."""
        if self._before is None:
            return
        before, self._before = self._before, None
        with contextlib.suppress(LostTerminalError):
            self._write((_POP_FLAGS if self.tells_releases else b"") + _LEAVE, _ANSWER_S)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(self._in, termios.TCSAFLUSH, before)

    def forget(self) -> None:
        """The terminal has gone: let nothing that is still printed fail because of that."""
        null = os.open(os.devnull, os.O_RDWR)
        for stream in self._streams:
            os.dup2(null, stream)

    def wait(self, until_s: float, other: int) -> bool:
        """Wait for keys, for something on ``other``, or until then; return whether there is something on ``other``."""
        if self._decoder.waits:
            until_s = min(until_s, self._esc_s + _ESC_S)
        ready, _, _ = select.select([self._in, other], [], [], max(until_s - time.monotonic(), 0.0))
        return other in ready

    def read(self) -> list[Event]:
        """Return what has come; does not wait."""
        now_s = time.monotonic()
        if not self._is_ready():
            return self._decoder.settle() if self._decoder.waits and now_s - self._esc_s >= _ESC_S else []
        with _lost():
            data = os.read(self._in, 4096)
        if not data:
            raise LostTerminalError("the terminal has gone")
        self._esc_s = now_s
        return self._decoder.feed(data)

    def ask(self) -> None:
        """Have the terminal say that it is there; the answer is an event of type Flags."""
        self._write(_ASK_FLAGS)

    def show(self, lines: Sequence[str]) -> None:
        """Show lines from the top, if the terminal takes them now."""
        try:
            size = os.get_terminal_size(self._out)
        except OSError:
            raise LostTerminalError("the terminal has gone") from None
        columns, rows = size.columns or 80, size.lines or 24
        shown = f"{_REST_OF_LINE}\r\n".join(line[:columns] for line in lines[:rows])
        self._write(f"{_HOME}{shown}{_REST_OF_LINE}{_REST_OF_SCREEN}".encode())

    def _ask_flags(self) -> int | None:
        """Return the flags in force; None when the terminal does not know the protocol."""
        self._write(_ASK_FLAGS + _ASK_ATTRIBUTES)
        end_s = time.monotonic() + _ANSWER_S
        flags = None
        while (left_s := end_s - time.monotonic()) > 0.0:
            select.select([self._in], [], [], left_s)
            for event in self.read():
                if isinstance(event, Flags):
                    flags = event.flags
                if isinstance(event, Attributes):
                    return flags
        return flags

    def _is_ready(self) -> bool:
        ready, _, _ = select.select([self._in], [], [], 0.0)
        return bool(ready)

    def _write(self, data: bytes, within_s: float = 0.0) -> None:
        """Write, unless the terminal takes nothing: then it must not keep us from stopping the robot."""
        with _lost():
            _, ready, _ = select.select([], [self._out], [], within_s)
            if ready:
                os.write(self._out, data)


@contextlib.contextmanager
def _lost() -> Iterator[None]:
    try:
        yield
    except (OSError, termios.error):
        raise LostTerminalError("the terminal has gone") from None


class Signals:
    """Signals that are waited for like keys: they are noted, and ``fd`` becomes readable."""

    NOTED = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGCONT)

    def __enter__(self) -> "Signals":
        self.fd, self._write_fd = os.pipe()
        for end in (self.fd, self._write_fd):
            os.set_blocking(end, False)
        self._handlers = {number: signal.signal(number, _note) for number in self.NOTED}
        self._wakeup = signal.set_wakeup_fd(self._write_fd, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        os.close(self.fd)
        os.close(self._write_fd)

    def take(self) -> set[int]:
        """Return the signals that have come since the last time."""
        try:
            return set(os.read(self.fd, 4096))
        except BlockingIOError:
            return set()

    def suspend(self) -> None:
        """Be stopped as Ctrl-Z does it, and come back when continued."""
        handler = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, handler)


def _note(_number: int, _frame: FrameType | None) -> None:
    """The number is in the pipe."""
