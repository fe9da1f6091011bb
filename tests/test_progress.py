"""A command that takes long says on a terminal what it does, and nothing where no terminal is."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import hil.scenario
from hil.cli import output
from hil.cli.main import app
from hil.core.errors import BadInputError
from tests.broken_fmu import lag
from tests.processes import hil as hil_command


@contextlib.contextmanager
def on_a_terminal() -> Iterator[int]:
    """Make stderr a terminal, and yield its other side; what takes long is told on it at once."""
    if sys.platform == "win32":
        pytest.skip("pseudo-terminals need a POSIX system")
    import pty

    ours, inner = pty.openpty()
    with os.fdopen(inner, "w", encoding="utf-8") as stream, pytest.MonkeyPatch.context() as patch:
        patch.setattr(output, "_SILENT_S", 0.0)
        patch.setattr(sys, "stderr", stream)
        yield ours
    os.close(ours)


def test_what_takes_long_is_told_on_a_terminal_in_one_line_that_goes_again() -> None:
    with on_a_terminal() as terminal:
        with output.slowly("reading a large file") as say:
            told = os.read(terminal, 1000)
            say("half of it")
        told += os.read(terminal, 1000)
    begin, *_, blank, end = told.decode().split("\r")
    assert (begin, end) == ("", "")
    assert told.startswith(b"\rreading a large file, 0 s")
    assert not blank.strip()
    assert len(blank) >= len("reading a large file, 0 s")


def test_reading_a_scenario_with_large_files_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one with a DBC of 8 MB, which takes 8 s; here it takes as long as the terminal needs to be told."""

    def read(*_: object, **__: object) -> None:
        told = b""
        while not told.endswith(b" s"):
            told += os.read(terminal, 1000)
        assert told.startswith(b"\rreading circle_speed and the files that it names, ")
        raise BadInputError("enough")

    monkeypatch.setattr(hil.scenario, "load", read)
    with on_a_terminal() as terminal, pytest.raises(BadInputError, match="enough"):
        app(["check", "circle_speed"], standalone_mode=False)


def test_a_file_gets_no_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "_SILENT_S", 0.0)
    assert hil_command("fmu", "check", lag(tmp_path, 2)).stderr == ""
