"""``hil doctor --clean``: what nothing uses is listed and removed; what is in use, and evidence, stays."""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hil.core.private_files import write_private
from hil.core.tokens import make_token
from tests.processes import HIL, environment, hil

LEAVE = """
import os, signal, sys
from hil.core.scratch import scratch_folder
with scratch_folder("test") as folder:
    print(folder, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
HOLD = """
import sys
from pathlib import Path
from hil.core.process_lock import ProcessLock
from hil.core.scratch import scratch_folder
from hil.core.tokens import state_folder
from hil.service.discovery import Service, announce
claim = announce(Service("http://127.0.0.1:2", 1, "mine", "memory:", "2.token"))  # whose API is being started again
lock = ProcessLock(state_folder("locks"), "held", {})
with scratch_folder("test") as folder:
    print(folder, flush=True)
    sys.stdin.read()
"""


def state_of(home: Path) -> Path:
    return home / ".local" / "state" / "mecanum-hil"


def doctor(user: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    command = [*HIL, "doctor", *words]
    return subprocess.run(command, env=user, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)


@pytest.fixture
def user(tmp_path: Path) -> dict[str, str]:
    """The environment of a user with a home and a temporary folder of their own."""
    (tmp_path / "tmp").mkdir()
    kept = {name: value for name, value in environment().items() if not name.startswith("XDG_")}
    return {**kept, "HOME": str(tmp_path), "TMPDIR": str(tmp_path / "tmp")}


@pytest.mark.skipif(sys.platform != "linux", reason="the folders are those of Linux")
def test_what_nothing_uses_is_listed_and_removed_and_all_else_stays(tmp_path: Path, user: dict[str, str]) -> None:
    state, cache = state_of(tmp_path), tmp_path / ".cache" / "mecanum-hil"
    for folder in (state / "services", state / "fixes", state / "locks", state / "audit", cache / "stm32f4"):
        folder.mkdir(parents=True, mode=0o700)
    killed = subprocess.run([sys.executable, "-c", LEAVE], env=user, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL
    left = Path(killed.stdout.strip())
    assert left.is_dir()
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        subprocess.Popen(
            [sys.executable, "-c", HOLD], env=user, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as holder,
    ):
        assert holder.stdout is not None
        in_use = Path(holder.stdout.readline().strip())
        left.mkdir(exist_ok=True)  # the holder's first folder has removed it, as a run's does
        alive, dead, restarts = (state / "services" / f"{port}.token" for port in (server.getsockname()[1], 1, 2))
        of_fixes = state / "fixes" / "1.token"  # kept for the next run, and its port is one of UDP
        free = state / "locks" / "free.lock"
        audit = state / "audit" / "8770.jsonl"
        for file in (alive, dead, restarts, of_fixes, free, audit, cache / "stm32f4" / "hil.elf"):
            file.write_text("x" * 20)
        elsewhere = alive.with_name("3.token")  # of a container that has this state folder too
        write_private(elsewhere, "0123abcd.of-another-machine")
        for token in (dead, restarts):
            make_token(token)
        gone = {cache, left, dead, free}

        refused = doctor(user, "--clean")
        assert (refused.returncode, refused.stdout) == (2, "")
        assert "nothing was removed: stdin is not a terminal; add --yes" in refused.stderr
        assert {Path(line.partition("  ")[0]) for line in refused.stderr.splitlines()[:-1]} == gone
        assert all(path.exists() for path in gone)

        done = doctor(user, "--clean", "--yes", "--json")
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found["removed"]
        assert {Path(one["path"]) for one in found["leftovers"]} == gone
        assert not any(path.exists() for path in gone)
        assert all(
            path.exists()
            for path in (alive, restarts, elsewhere, of_fixes, audit, in_use, state / "locks" / "held.lock")
        )
    assert doctor(user, "--clean").returncode == 2  # those of the holder that has ended now


def test_yes_alone_is_refused() -> None:
    done = hil("doctor", "--yes")
    assert (done.returncode, done.stderr) == (2, "hil: --yes answers --clean; add --clean\n")


@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal stands for the person")
@pytest.mark.parametrize(("answer", "stays"), [("n", True), ("y", False)])
def test_a_person_is_asked(answer: str, stays: bool, tmp_path: Path, user: dict[str, str]) -> None:
    import pty

    cache = tmp_path / ".cache" / "mecanum-hil"
    cache.mkdir(parents=True)
    pid, terminal = pty.fork()
    if pid == 0:
        os.execve(sys.executable, [*HIL, "doctor", "--clean"], user)
    os.write(terminal, f"{answer}\n".encode())
    while True:
        try:
            if not os.read(terminal, 4096):
                break
        except OSError:  # how a pseudo-terminal ends
            break
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert cache.exists() == stays
