"""A terminal that is read and written in the host library: against the system's own calls, over a pseudo-terminal."""

import contextlib
import os
import select
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.extension import wheel
from hil.wire import serial_port
from hil.wire.serial_port import Terminal

tty = pytest.importorskip("tty", reason="terminals need a POSIX system")


@contextlib.contextmanager
def line() -> Iterator[tuple[Terminal, int]]:
    """A terminal in raw mode that does not block, and the descriptor of its other end."""
    other, here = os.openpty()
    try:
        tty.setraw(here)
        os.set_blocking(here, False)
        yield Terminal(here), other
    finally:
        os.close(here)
        os.close(other)


def waits(descriptor: int) -> None:
    assert select.select([descriptor], [], [], 5.0)[0], "nothing came within 5 s"


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=8))
def test_what_is_written_at_one_end_is_read_at_the_other(pieces: list[bytes]) -> None:
    with line() as (made, other):
        for piece in pieces:
            os.write(other, piece)
            waits(made._descriptor)
            assert made.read() == piece
            assert made.write(piece) == len(piece)
            waits(other)
            assert os.read(other, 4096) == piece


def test_a_quiet_terminal_is_told_apart_from_one_with_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ns = iter((1, 20_000_000, 20_000_001, 30_000_000))
    monkeypatch.setattr(serial_port, "time", SimpleNamespace(monotonic_ns=lambda: next(times_ns)))
    with line() as (made, other):
        assert [made.read() for _ in range(3)] == [b"", b"", None]
        os.write(other, b"x")
        waits(made._descriptor)
        assert made.read() == b"x"
        assert made.read() == b""


def test_a_full_line_takes_what_it_has_room_for_and_then_nothing() -> None:
    with line() as (made, other):
        taken = 0
        while written := made.write(bytes(1000)):
            taken += written
        left = taken
        while left:
            waits(other)
            left -= len(os.read(other, left))
        assert taken > 0


def test_a_terminal_that_was_closed_is_lost_and_takes_nothing() -> None:
    with line() as (made, _):
        gone = Terminal(os.dup(made._descriptor))
        os.close(gone._descriptor)
        assert gone.read() is None
        assert gone.write(b"x") == 0


def test_what_is_no_descriptor_and_no_bytes_is_refused() -> None:
    with line() as (made, other):
        os.write(other, b"x")
        waits(made._descriptor)
        for number in (-1, 1 << 31, made._descriptor + (1 << 32)):
            with pytest.raises(ValueError, match=f"{number} is no descriptor"):
                wheel.terminal_read(number)
            with pytest.raises(ValueError, match=f"{number} is no descriptor"):
                wheel.terminal_write(number, b"x")
        assert made.read() == b"x", "it was left there"
        with pytest.raises(TypeError):
            wheel.terminal_read(None)  # type: ignore[arg-type]
        with pytest.raises(TypeError):
            wheel.terminal_write(made._descriptor, "text")  # type: ignore[arg-type]
