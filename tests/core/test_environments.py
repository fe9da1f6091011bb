"""What surrounds a command, and files that no sane tool writes: one sentence and an exit code, never a traceback."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")
HIL = f"'{sys.executable}' -m hil"
DEEP = "a." * 1100 + "a = 1\n"


def done(line: str, folder: Path, **environment: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("line", "environment", "code", "words"),
    [
        (f"{HIL} list signals >&-", {}, 0, ""),
        (f"{HIL} list signals >&- 2>&- <&-", {}, 0, ""),
        (f"{HIL} list signals > /dev/full", {}, 2, "no space is left for the output"),
        (f"{HIL} list signals | head -1", {}, 0, ""),
        (f"{HIL} list signals", {"LANG": "C", "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}, 0, ""),
        (f"env -u TERM -u HOME {HIL} list signals", {}, 0, ""),
        (f"env HOME=/nonexistent {HIL} list signals", {}, 0, ""),
        (
            f"mkdir gone; cd gone; rmdir ../gone; {HIL} run circle_speed",
            {},
            2,
            "the folder in which you are has been removed",
        ),
        (f"{HIL} check deep.hil.toml", {}, 2, "nested more than 50 deep"),
        (f"{HIL} run circle_speed --record none --robot deep.toml", {}, 2, "nested more than 50 deep"),
        (f"ulimit -f 10; {HIL} run circle_speed --record run.rrd", {}, 2, "File too large"),
        (f"ulimit -f 5000; {HIL} run circle_speed --record run.rrd", {}, 2, "File too large"),
    ],
)
def test_a_command_says_what_is_wrong_with_its_surroundings(
    line: str, environment: dict[str, str], code: int, words: str, tmp_path: Path
) -> None:
    for name in ("deep.toml", "deep.hil.toml"):
        (tmp_path / name).write_text(DEEP)
    ended = done(line, tmp_path, **environment)
    assert "Traceback" not in ended.stderr, ended.stderr
    assert words in ended.stderr
    assert ended.returncode == code, ended.stderr


@pytest.mark.parametrize("module", ["hil.cli.main", "typer", "numpy", "pydantic", "fmpy"])
def test_ctrl_c_while_a_module_is_imported_ends_a_command_with_130(module: str, tmp_path: Path) -> None:
    """A hook of the interpreter sends the signal at the import of the module."""
    (tmp_path / "sitecustomize.py").write_text(
        "import os, signal, sys\n"
        f"sys.addaudithook(lambda event, of: event == 'import' and of[0] == {module!r} and "
        f"os.kill(os.getpid(), {int(signal.SIGINT)}))\n"
    )
    ended = done(f"{HIL} check circle_speed", tmp_path, PYTHONPATH=str(tmp_path))
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr.count("\n") <= 1, ended.stderr
