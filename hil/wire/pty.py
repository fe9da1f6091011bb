"""The robot's end of a pseudo-terminal: a serial port that needs no hardware. POSIX only."""

import os
import re
import select
import tty
from pathlib import Path

from hil.core.errors import BadInputError, LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.wire.serial_failures import PORT_ERRORS, words_of

_CHUNK = 65536
_PATIENCE_S = 2.0
_WAITS = 40
_PSEUDO_TERMINAL = re.compile(r"/dev/(pts/|ttys)\d+")  # on Linux, and on macOS; one that has gone is a name only


def _not_replaced(symlink: Path, why: str) -> BadInputError:
    return BadInputError(f"symlink {str(symlink)!r} exists and is not replaced ({why}); choose another path")


class PtyStream:
    """The master side of a new pseudo-terminal; ``port`` names the other side for any serial program.

    When the buffer is full, further frames are dropped whole and counted in ``lost_frames``; a frame that has begun is
    finished first. A frame ends with the protocol's delimiter; if it has none, each call of ``write`` is one frame.

    With ``waits`` (for lockstep: time stands still until the host has read) a write waits for the reader, and drops
    only if no byte was read for 2 s. With ``symlink`` the port also has a fixed name; a symlink to a pseudo-terminal,
    which an earlier process left, is replaced, and nothing else.

    Raises BadInputError when the symlink cannot be made, LinkError when the system has no pseudo-terminal left.
    """

    def __init__(self, symlink: Path | None = None, *, waits: bool = False, protocol: LinkProtocol = WHEEL_DBC) -> None:
        try:
            self._master, slave = os.openpty()
            # Held open, so that the line stays up when a client closes it.
            self._slave = slave
            tty.setraw(slave)
            os.set_blocking(self._master, False)
            self.port = os.ttyname(slave)
        except PORT_ERRORS as error:
            raise LinkError(
                f"no pseudo-terminal can be made ({words_of(error)}); close programs that use some, and see "
                "ulimit -n and, on Linux, /proc/sys/kernel/pty"
            ) from error
        self.lost_frames = 0
        self._waits = waits
        self._delimiter = protocol.delimiter
        self._begun = b""  # the rest of a frame whose beginning is on the line
        self._symlink: Path | None = None
        if symlink is not None:
            self._make_symlink(symlink)

    def _make_symlink(self, symlink: Path) -> None:
        try:
            if symlink.is_symlink():
                if not _PSEUDO_TERMINAL.fullmatch(target := str(symlink.readlink())):
                    raise _not_replaced(symlink, f"it leads to {target!r}, which is no pseudo-terminal")
                symlink.unlink()
            elif symlink.exists():
                raise _not_replaced(symlink, "it is not a symbolic link")
            symlink.symlink_to(self.port)
        except BadInputError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise BadInputError(
                f"symlink {str(symlink)!r} cannot be made ({error.strerror}); choose a folder that you may write to"
            ) from error
        self._symlink = symlink

    def write(self, data: bytes) -> None:
        begun, data = len(self._begun), self._begun + data
        at = 0
        while at < len(data) and (taken := self._put(data[at:])):
            at += taken
        # A frame that has begun must be completed, or the next frame would be joined to it.
        if self._delimiter is None:
            end = begun if at <= begun else len(data)
            self.lost_frames += end < len(data)
        else:
            end = begun if at == 0 else data.find(self._delimiter, at - 1) + 1 or len(data)
            self.lost_frames += data.count(self._delimiter, end)
        self._begun = data[at:end]

    def _put(self, data: bytes) -> int:
        """Return how many bytes were written, 0 when the line is full. With ``waits`` first wait for a reader."""
        while True:
            try:
                return os.write(self._master, data)
            except BlockingIOError:
                if not (self._waits and self._has_room_soon()):
                    return 0
            except OSError as error:
                raise LinkError(f"pseudo-terminal {self.port!r} was lost: {error.strerror}") from error

    def _has_room_soon(self) -> bool:
        """Wait up to 2 s until the other side has read, and return whether there is room for more bytes.

        The limit is a number of short waits, not a time: a suspended machine uses up one of them, for however long.
        """
        return any(select.select([], [self._master], [], _PATIENCE_S / _WAITS)[1] for _ in range(_WAITS))

    def read(self, timeout_ns: int) -> bytes:
        if timeout_ns > 0:
            select.select([self._master], [], [], timeout_ns * 1e-9)
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkError(f"pseudo-terminal {self.port!r} was lost: {error.strerror}") from error

    def close(self) -> None:
        if self._master < 0:
            return
        if self._symlink is not None and self._symlink.is_symlink() and str(self._symlink.readlink()) == self.port:
            self._symlink.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._master = -1
