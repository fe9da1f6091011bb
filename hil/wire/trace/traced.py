"""A frame as a trace file has it, whatever the form of the file."""

from typing import NamedTuple


class TracedFrame(NamedTuple):
    """One frame of a file.

    Attributes:
        unix_s: the file's own time stamp [s]. It counts from the beginning of the file if that has no date.
        channel: the bus as the file names it, or None.
        is_rx: whether the writer received it; true if the file does not say.
        number: the identifier; of an error frame its class, if the file has it.
        extended: whether the identifier has 29 bits.
        payload: the data.
        is_remote: a request without data.
        is_error: an error frame.
        is_request: one that was to be sent; the frame itself follows if it was.
    """

    unix_s: float
    channel: str | None
    is_rx: bool
    number: int
    extended: bool
    payload: bytes
    is_remote: bool = False
    is_error: bool = False
    is_request: bool = False


class LeftOut(NamedTuple):
    """Something in a file that is not a CAN frame, or cannot be read as one: its kind, in the plural."""

    cause: str


class DamagedError(Exception):
    """The file is damaged from here on; the text gives the reason."""


MOST_CLASSIC_BYTES, MOST_BYTES = 8, 64
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
MOST_STANDARD, MOST_EXTENDED = 0x7FF, 0x1FFFFFFF


def length_of(code: int, *, fd: bool) -> int:
    """Return the bytes of data for a length code. Raises IndexError for one above 15 of an FD frame."""
    return _FD_LENGTHS[code] if fd else min(code, MOST_CLASSIC_BYTES)
