"""Temporary folders that a killed process leaves are removed by the next one, and no others."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.processes import ROOT, environment

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows locks no folders")
HOLD = """
import sys
from hil.core.scratch import scratch_folder
with scratch_folder("test") as folder:
    (folder / "deep").mkdir()
    (folder / "deep" / "file").write_text("content")
    print(folder, flush=True)
    sys.stdin.read()
"""
SERVE_A_NODE = """
import sys
from hil.service.ros2.robot import OwnService
with OwnService(["circle_speed"]) as service:
    print(service.client().status()["scenario"], flush=True)
    sys.stdin.read()
"""


@contextmanager
def process(code: str, temporary: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Run Python in a process of its own until stdin ends; yield it with its first line."""
    temporary.mkdir(exist_ok=True)
    there = environment() | {"TMPDIR": str(temporary)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=there, cwd=ROOT
    ) as one:
        assert one.stdout is not None
        yield one, one.stdout.readline().strip()
        assert one.stdin is not None
        one.stdin.close()


def test_a_folder_is_private_and_goes_with_its_process(tmp_path: Path) -> None:
    with process(HOLD, tmp_path / "tmp") as (_, name):
        assert Path(name).parent == tmp_path / "tmp"
        assert Path(name).stat().st_mode & 0o777 == 0o700
    assert list((tmp_path / "tmp").iterdir()) == []


def test_the_folder_of_a_killed_process_goes_with_the_next_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    with process(HOLD, temporary) as (killed, left), process(HOLD, temporary) as (_, lives):
        killed.kill()
        killed.wait()
        assert Path(left, "deep", "file").exists()
        (temporary / "mecanum-hil-scratch-link").symlink_to(tmp_path)  # whatever it leads to is not ours to remove
        (temporary / "hil-of-a-user").mkdir()
        with process(HOLD, temporary) as (_, third):
            there = {path.name for path in temporary.iterdir()}
        assert there == {Path(lives).name, Path(third).name, "mecanum-hil-scratch-link", "hil-of-a-user"}
        assert Path(lives, "deep", "file").exists()
    assert tmp_path.exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may give folders away")
def test_a_folder_of_another_user_stays(tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    theirs = temporary / "mecanum-hil-scratch-theirs"
    theirs.mkdir()
    os.chown(theirs, 65534, 65534)
    with process(HOLD, temporary):
        pass
    assert theirs.exists()


@pytest.mark.alone
def test_what_the_service_of_a_killed_ros_2_node_was_given_goes_with_the_next_node(
    tmp_path: Path, state_home: None
) -> None:
    temporary = tmp_path / "tmp"
    with process(SERVE_A_NODE, temporary) as (killed, serves):
        assert serves == "circle_speed"
        (left,) = (path for path in temporary.iterdir() if (path / "clients").exists())
        killed.kill()
        killed.wait()
        assert (left / "token").exists()
    with process(SERVE_A_NODE, temporary) as (_, serves):
        assert serves == "circle_speed"
        assert not left.exists()
    assert not any((path / "clients").exists() for path in temporary.iterdir())
