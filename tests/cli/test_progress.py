"""A slow command shows its progress on a terminal, and prints nothing without a terminal."""

import contextlib
import os
import sys
from collections.abc import Iterator

import pytest

from hil.cli import output


@contextlib.contextmanager
def on_a_terminal() -> Iterator[int]:
    """Make stderr a terminal, and yield its other side."""
    if sys.platform == "win32":
        pytest.skip("pseudo-terminals need a POSIX system")
    import pty

    ours, inner = pty.openpty()
    with os.fdopen(inner, "w", encoding="utf-8") as stream, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stderr", stream)
        yield ours
    os.close(ours)


def test_what_takes_long_is_told_on_a_terminal() -> None:
    with on_a_terminal() as terminal, output.slowly("reading a large file") as say:
        for text in ("reading a large file", "half of it"):
            told = b""
            while text.encode() not in told:
                told += os.read(terminal, 1000)
            say("half of it")


def test_a_file_gets_no_progress(capfd: pytest.CaptureFixture[str]) -> None:
    with output.slowly("reading a large file") as say:
        say("half of it")
    assert capfd.readouterr().err == ""
