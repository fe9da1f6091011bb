"""A command that takes long says on a terminal what it does, and nothing where no terminal is."""

import os
import sys
from pathlib import Path

import pytest

from hil.cli import output
from tests.broken_fmu import lag
from tests.processes import hil


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_what_takes_long_is_told_on_a_terminal_in_one_line_that_goes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    import pty

    terminal, inner = pty.openpty()
    monkeypatch.setattr(output, "_SILENT_S", 0.0)
    with os.fdopen(inner, "w", encoding="utf-8") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        with output.slowly("reading a large file") as say:
            told = os.read(terminal, 1000)
            say("half of it")
        told += os.read(terminal, 1000)
    os.close(terminal)
    begin, *_, blank, end = told.decode().split("\r")
    assert (begin, end) == ("", "")
    assert told.startswith(b"\rreading a large file, 0 s")
    assert not blank.strip()
    assert len(blank) >= len("reading a large file, 0 s")


def test_a_file_gets_no_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "_SILENT_S", 0.0)
    assert hil("fmu", "check", lag(tmp_path, 2)).stderr == ""
