"""A full disk costs the run only the data without room, and the run says so."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import HIL, environment, hil

SHORT = ("--set", "loop.duration_s=12", "--set", "expect=[]")
# A disk of its own that goes away with the process, whatever becomes of that.
ON_A_SMALL_DISK = 'mount -t tmpfs -o size=1400k tmpfs "$1" || exit 77; shift; exec "$@"'


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a disk in a namespace, as Linux can")
def test_a_recording_says_that_the_disk_is_full_what_is_lost_and_what_is_safe(tmp_path) -> None:
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    path = tmp_path / "run.rrd"
    command = [*own, "sh", "-c", ON_A_SMALL_DISK, "sh", tmp_path, *HIL, "run", "circle_speed", *SHORT, "--record", path]
    how: dict[str, Any] = {"capture_output": True, "text": True, "check": False, "env": environment(), "timeout": 120}
    done = subprocess.run(command, **how)
    if done.returncode == 77 or done.stderr.startswith("unshare"):
        pytest.skip(f"no disk may be mounted here: {done.stderr}")
    assert done.returncode == 1, done.stderr  # rows are missing, and [allow] permits none
    # Its summary is what could not be written last, unless some room was left for that.
    why = r"incomplete: (?:its summary could not be written: )?the disk is full \(No space left on device\); "
    text = " ".join(done.stdout.split())  # lines are broken at 80 columns
    told = re.search(rf"{why}0 rows were dropped and (\d+) lost, (\d+) are safe in {re.escape(str(path))} ", text)
    assert told, done.stdout
    lost, safe = map(int, told.groups())
    assert safe > 0
    assert lost + safe == 2400
    assert done.stdout.split()[0] == "FAILED"
    exploring = subprocess.run([*command, "--lenient", "--force"], **how)
    assert exploring.returncode == 0, exploring.stderr
    assert exploring.stdout.split()[:2] == ["PASSED,", "INCOMPLETE"]


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a disk in a namespace, as Linux can")
def test_a_service_that_finds_the_disk_full_says_what_to_do_and_leaves_nothing_there(tmp_path) -> None:
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    fill = 'cd "$1"; shift; head -c 2000000 /dev/zero > fill; "$@"; code=$?; find . -name "*token*"; exit $code'
    serve = [*HIL, "serve", "circle_speed", "--set", "service.port=0"]
    command = [*own, "sh", "-c", ON_A_SMALL_DISK, "sh", tmp_path, "sh", "-c", fill, "sh", tmp_path, *serve]
    state = {"XDG_STATE_HOME": str(tmp_path / "state")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment() | state, timeout=120)
    if done.returncode == 77 or done.stderr.startswith("unshare"):
        pytest.skip(f"no disk may be mounted here: {done.stderr}")
    assert done.returncode == 2
    assert "it cannot be written (No space left on device); make room, or name one" in done.stderr, done.stderr
    assert done.stdout == ""


def test_a_disk_that_is_full_ends_the_trace_and_not_the_run(tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full, as Linux has it")
    path = tmp_path / "bus.log"
    path.symlink_to("/dev/full")
    done = hil("run", "paper_circle", "--set", "loop.duration_s=0.4", "--set", "expect=[]", "--record", "none",
               "--mode", "lockstep", "--trace", path, "--force")  # fmt: skip
    assert done.returncode == 0, done.stderr
    text = " ".join(done.stdout.split())  # lines are broken at 80 columns
    assert "is incomplete: the disk is full (No space left on device)" in text
    assert "lost, 0 are safe in it" in text
    assert "Traceback" not in done.stdout + done.stderr
