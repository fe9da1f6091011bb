"""The command that runs another with real SocketCAN: its input and output, and that nothing stays behind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes import ROOT, environment, is_running, wait_for
from tools import socketcan

pytestmark = pytest.mark.skipif(socketcan.missing() is not None, reason=socketcan.missing() or "")
COMMAND = [sys.executable, "-m", "tools.socketcan"]


def inside(*command: str, temporary: Path) -> "subprocess.CompletedProcess[str]":
    variables = environment() | {"TMPDIR": str(temporary)}
    return subprocess.run(
        [*COMMAND, *command], capture_output=True, text=True, check=False, timeout=120, cwd=ROOT, env=variables
    )


def test_output_and_exit_code_come_out_and_the_interfaces_are_there(tmp_path: Path):
    script = "cat /sys/class/net/vcan0/mtu /sys/class/net/vcan1/mtu; pwd; exit 7"
    done = inside("sh", "-c", script, temporary=tmp_path)
    assert (done.stdout, done.returncode) == (f"16\n72\n{ROOT}\n", 7), done.stderr
    assert list(tmp_path.iterdir()) == []


def test_what_runs_too_long_is_killed_with_all_its_processes(tmp_path: Path):
    done = inside("--limit-s", "6", "sh", "-c", "sleep 1000 & sleep 1000", temporary=tmp_path)
    assert done.returncode == 124
    assert "killed after 6 s; --limit-s sets how long it may take" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_nothing_outlives_a_killed_caller(tmp_path: Path):
    process = subprocess.Popen(
        [*COMMAND, "sh", "-c", "echo begun; sleep 1000"],
        stdout=subprocess.PIPE,
        cwd=ROOT,
        env=environment() | {"TMPDIR": str(tmp_path)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"begun\n"
    children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, check=True)
    deadman = int(children.stdout)
    process.kill()
    process.communicate()
    wait_for(lambda: not is_running(deadman))
    wait_for(lambda: not list(tmp_path.iterdir()))


def test_a_command_that_is_not_there_is_named(tmp_path: Path):
    done = inside("no_such_command", temporary=tmp_path)
    assert done.returncode == 127
    assert "no_such_command cannot be started" in done.stdout


def test_a_probe_that_hangs_is_no_namespace(tmp_path: Path):
    for tool, script in (("ip", "exit 0"), ("unshare", "exec sleep 1000")):
        (tmp_path / tool).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / tool).chmod(0o755)
    code = "from tools import socketcan; socketcan._PROBE_S = 0.5; print(socketcan._namespace())"
    variables = environment() | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT, env=variables
    )
    assert done.stdout == "None\n", done.stderr


def test_marked_tests_run_though_pytest_was_started_in_another_folder(tmp_path: Path):
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--rootdir={ROOT}"]
    command += ["-c", str(ROOT / "pyproject.toml"), "-k", "is_not_there"]
    command += [str(ROOT / "tests" / "wire" / "test_socketcan_links.py")]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment(), timeout=300
    )
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout
