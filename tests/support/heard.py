"""Frames received on a link, one by one: several may have arrived together."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.ports import Link


def everything(link: Link) -> list[Frame]:
    """Take what has arrived."""
    frames: list[Frame] = []
    while (received := link.receive(0)) is not None:
        frames += received.frames
    return frames


def the_next(link: Link, count: int = 1, timeout_ns: int = 1_000_000_000) -> Sequence[Frame]:
    """Wait for so many frames, for so long each time; more that came with the last of them are returned too."""
    frames: list[Frame] = []
    while len(frames) < count:
        received = link.receive(timeout_ns)
        assert received is not None, f"{len(frames)} frames came, not {count}"
        frames += received.frames
    return frames
