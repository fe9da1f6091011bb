"""Failures of serial ports as sentences with cause and remedy; CAN adapters use such ports too."""

import errno
import os
import re
import sys

_TERMIOS_ERROR: tuple[type[Exception], ...] = ()
if sys.platform != "win32":
    import termios

    # pyserial lets termios.error pass. It is not an OSError; its arguments are an error number and a text.
    _TERMIOS_ERROR = (termios.error,)
PORT_ERRORS: tuple[type[Exception], ...] = (OSError, *_TERMIOS_ERROR)
"""What a port raises, besides pyserial's own exceptions (an OSError, mostly without a number)."""

LIST_PORTS = "list the ports with: python -m serial.tools.list_ports"
BUSY = "is busy: another program holds it; close that program"
"""The problem of a device that another program has locked, to follow its name in a sentence."""

GONE = "it is gone, or another program reads it too and takes bytes meant for this one"
"""Why a port ``is_gone``: pyserial has the same words for both."""

_GONE = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF)
# The words of pyserial (on reading, and on Windows) and of python-can for a device that is gone.
_GONE_WORDS = ("disconnected", "ClearCommError failed", "Could not read from serial", "Could not write to serial")


def _number_of(error: BaseException | None) -> int | None:
    """Return the system's error number, which pyserial and python-can may have wrapped or written into the text."""
    while error is not None:
        number = error.args[0] if isinstance(error, _TERMIOS_ERROR) else getattr(error, "errno", None)
        if isinstance(number, int):
            return number
        if found := re.search(r"(?:\[Errno |configure port: \()(\d+)", str(error)):
            return int(found.group(1))
        error = error.__cause__
    return None


def words_of(error: Exception) -> str:
    """Return the system's message, without its number and pyserial's words around it."""
    number = _number_of(error)
    return os.strerror(number) if number is not None else " ".join(str(error).split())


def opening_problem(error: Exception) -> str | None:
    """Return why a port could not be opened, in words that follow its name; None for any other error."""
    number, text = _number_of(error), str(error)
    if number == errno.ENOENT or "FileNotFoundError" in text:
        return f"does not exist; {LIST_PORTS}"
    if number in (errno.EACCES, errno.EPERM) or "PermissionError" in text:
        return (
            "may not be opened (permission denied); on Linux add yourself to its group, mostly dialout, with: "
            "sudo usermod -aG dialout $USER, and log in again; on Windows another program may hold it"
        )
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK) or "exclusively lock" in text:
        return BUSY
    if number in (errno.ENOTTY, errno.EISDIR):
        return "is not a serial port; expected a device such as /dev/ttyACM0 or COM3"
    return None


def is_gone(error: Exception) -> bool:
    """Whether a port that was open no longer exists."""
    return _number_of(error) in _GONE or any(words in str(error) for words in _GONE_WORDS)
