"""Without SocketCAN, and without a guest that has it, a test target fails at once and names the packages to install."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes import ROOT, environment

TOOLS = ("bash", "insmod", "ip", "mount", "sh", "taskset")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere SocketCAN is never there")
@pytest.mark.skipif(shutil.which("make") is None, reason="install make")
def test_a_target_that_could_run_nothing_fails_at_once(tmp_path: Path):
    """Only the guest's kernel and the right to make interfaces are missing; nothing is set up again."""
    system = os.pathsep.join([os.environ["PATH"], "/usr/sbin", "/sbin"])
    for tool in TOOLS:
        if (found := shutil.which(tool, path=system)) is not None:
            (tmp_path / tool).symlink_to(found)
    (tmp_path / "unshare").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "unshare").chmod(0o755)
    command = [shutil.which("make"), "-o", "setup", "-o", ".venv/for-tests", "test-socketcan"]
    done = subprocess.run(
        [*command, f"BIN={Path(sys.executable).parent}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=environment() | {"PATH": str(tmp_path)},
        timeout=60,
    )
    assert done.returncode != 0
    assert "apt-get install" in done.stderr
    assert "user-mode-linux" in done.stderr
    assert "skipped" not in done.stdout
