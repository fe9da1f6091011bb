"""Printed commands: a shell in the same folder does as they say, whatever the names."""

import json
import os
import subprocess
import sys
from pathlib import Path, PurePath

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.printable import command
from tests.support.processes import environment, hil

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs sh")

TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1)
FOLDER = 'Müller\'s "robot" ✓ $(x)'


@settings(max_examples=20, deadline=None)
@given(st.lists(TEXT))
def test_a_shell_reads_the_words_of_a_command_as_they_are(words: list[str]) -> None:
    line = command("printf", r"%s\0", "--", *words)
    done = subprocess.run(["sh", "-c", line], capture_output=True, check=True)
    assert done.stdout.decode().split("\0")[1:-1] == words


def test_a_path_is_never_an_option() -> None:
    assert command("hil", "view", PurePath("-rf.rrd"), "-x") == "hil view ./-rf.rrd -x"


def next_commands(text: str) -> list[str]:
    return [line.strip() for line in text.partition("Next:\n")[2].splitlines()]


def typed(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a line in a shell, with the commands of this installation."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return subprocess.run(
        ["sh", "-c", line], cwd=folder, env=environment() | {"PATH": path}, capture_output=True, text=True, check=False
    )


def test_what_is_printed_next_can_be_typed(tmp_path: Path) -> None:
    begun = hil("init", FOLDER, "--defaults", cwd=tmp_path)
    run, tests = next_commands(begun.stdout)
    assert tests == command("pytest", FOLDER)
    driven = typed(run, tmp_path)
    assert driven.returncode == 0, driven.stderr
    view, review, show = next_commands(driven.stdout)
    assert view.partition("view")[2] == review.partition("review")[2]
    told = [typed(f"{line} --json", tmp_path) for line in (review, show)]
    assert "passed" in json.loads(told[0].stdout)
    assert "robot.mass_kg" in json.loads(told[1].stdout)
