"""The viewer as a user may have it: not installed, broken, too slow, or of another version."""

import importlib.metadata
import os
import re
import sys
from pathlib import Path

import pytest

from hil.addons.report import viewer
from hil.core.findings import note, problem
from tests.support.processes import hil

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the viewers are shell scripts")
SDK = importlib.metadata.version("rerun-sdk")


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the search path in which alone a viewer is looked for, without a display."""
    monkeypatch.setitem(sys.modules, "rerun_cli", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return tmp_path


def script(folder: Path, commands: str) -> Path:
    """Write a viewer that does this."""
    file = folder / "rerun"
    file.write_text(f"#!/bin/sh\n{commands}\n", encoding="utf-8")
    file.chmod(0o700)
    return file


@pytest.mark.parametrize(
    ("commands", "limit_s", "sentence"),
    [
        (None, 60.0, "the rerun viewer was not found: install it with 'pip install rerun-sdk==0.41.*'"),
        ("exit 7", 60.0, "the rerun viewer did not start: exit status 7"),
        ("exec /bin/sleep 60", 0.1, "the rerun viewer does not listen on port N after 0.1 s"),
    ],
)
def test_a_viewer_that_does_not_come_is_told_in_one_sentence(
    commands: str | None, limit_s: float, sentence: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "_START_TIMEOUT_S", limit_s)
    (recording := path / "run.rrd").write_bytes(b"RRF2")
    if commands is not None:
        script(path, commands)
    done = hil("view", recording, "--web")
    assert (done.returncode, done.stdout) == (3, "")
    assert re.sub(r"port \d+", "port N", done.stderr) == f"hil: {sentence}\n"


REMEDY = f"pip install --force-reinstall rerun-sdk=={SDK}"


def test_the_doctor_says_what_is_wrong_with_a_viewer(path: Path) -> None:
    _, display = viewer.check_viewer()
    assert display == note(
        "display", "none, so that no window can be opened", "use hil view RUN.rrd --web and a browser"
    )
    file = script(path, "exit 7")
    why = f"rerun's viewer does not run: Command '['{file}', '--version']' returned non-zero exit status 7."
    assert next(viewer.check_viewer()) == problem("viewer", why, REMEDY)
    script(path, "echo rerun-cli 0.1.22 [rustc]")
    why = f"{file} is rerun 0.1.22, the SDK that records is {SDK}: it may not read the recordings"
    assert next(viewer.check_viewer()) == problem("viewer", why, REMEDY)


def test_the_doctor_says_that_the_sdk_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    remedy = "pip install rerun-sdk, or record with --record run.mcap"
    assert next(viewer.check_viewer()) == note("viewer", "rerun-sdk is not installed", remedy)
