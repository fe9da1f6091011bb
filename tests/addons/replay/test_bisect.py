"""The commit that made a controller differ from a recording is found, in a repository with a law of its own."""

import re
import subprocess
import sys

import pytest

import hil
from hil.addons.replay.bisect import bisect
from hil.core.errors import BadInputError, DeviceError

LAW = """
from hil.core.types import CommandMode, WheelCommand, Wheels

GAIN = 3.0  # {number}

class Law:
    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        push = {sign}GAIN * (state.pose.x_m - reference.pose.x_m)
        return WheelCommand(CommandMode.SPEED, Wheels(push, push, push, push), Wheels(0.0, 0.0, 0.0, 0.0))
"""
KEYS = {"loop.duration_s": 0.2, "expect": [], "controller.gains": {}, "controller.law": "./my_law.py:Law"}


def git(folder, *words):
    own = ["-c", "user.name=Someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false"]
    return subprocess.run(["git", *own, *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def repository(folder, laws):
    """A repository with a commit for each text of the law; return the hashes of the commits."""
    (folder / "robot").mkdir()
    git(folder, "init", "-q")
    commits = []
    for number, text in enumerate(laws):
        (folder / "robot" / "my_law.py").write_text(text)
        git(folder, "add", ".")
        git(folder, "commit", "-q", "-m", f"change {number}")
        commits.append(git(folder, "rev-parse", "HEAD"))
    return commits


def recorded(folder, monkeypatch):
    monkeypatch.chdir(folder / "robot")
    path = folder.parent / "run.mcap"
    assert hil.run("circle_speed", set=KEYS, record=path, lenient=True).failure is None
    return path


@pytest.mark.parametrize(("count", "culprit"), [(30, 17)])
def test_of_thirty_commits_the_one_that_changed_a_sign_is_found(tmp_path, monkeypatch, capfd, count, culprit):
    laws = [LAW.format(number=number, sign="" if number < culprit else "-") for number in range(count)]
    root = tmp_path / "ours"
    root.mkdir()
    commits = repository(root, laws[:1])
    path = recorded(root, monkeypatch)
    for number, text in enumerate(laws[1:], 1):
        (root / "robot" / "my_law.py").write_text(text)
        git(root, "commit", "-q", "-a", "-m", f"change {number}")
        commits.append(git(root, "rev-parse", "HEAD"))
    command = [sys.executable, "-m", "hil", "replay", str(path), "--bisect", f"{commits[0]}..{commits[-1]}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(
        f"{commits[culprit][:12]} change {culprit}: it is the first that differs, law first\n"
    )
    assert "first frame: WHEEL_COMMAND (fl_rad_s " in done.stdout
    assert "first signal: wheel.fl.speed_command_rad_s at t = 0.000 s: " in done.stdout
    assert done.stderr.count(": equal\n") + done.stderr.count(": different, law first\n") <= 8
    assert git(root, "worktree", "list").count("\n") == 0
    assert git(root, "status", "--porcelain") == ""


def test_what_cannot_be_told_apart_is_said(tmp_path, monkeypatch):
    """The law that differs came with a commit that cannot be run."""
    root = tmp_path / "ours"
    root.mkdir()
    good, broken, bad = LAW.format(number=0, sign=""), "this is no law", LAW.format(number=1, sign="-")
    commits = repository(root, [good, broken, bad])
    git(root, "checkout", "-q", commits[0])
    path = recorded(root, monkeypatch)
    with pytest.raises(DeviceError, match="the first that differs cannot be replayed; their lines above say why"):
        bisect(f"{commits[0]}..{commits[2]}", path)
    with pytest.raises(BadInputError, match=f"--bisect: {commits[1]} cannot be replayed; the line above says why"):
        bisect(f"{commits[0]}..{commits[1]}", path)
    with pytest.raises(BadInputError, match="is equal already, so nothing differs up to it"):
        bisect(f"{commits[0]}..{commits[0]}", path)
    with pytest.raises(BadInputError, match="differs already; name an older one"):
        bisect(f"{commits[2]}..{commits[2]}", path)


def test_a_span_that_is_none_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for span in ("main", "..main", "v1.."):
        with pytest.raises(
            BadInputError, match=re.escape(f"--bisect {span}: expected GOOD..BAD, two commits, as in v1.2..main")
        ):
            bisect(span, tmp_path / "run.mcap")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(BadInputError, match="--bisect: git rev-parse: not a git repository"):
        bisect("a..b", tmp_path / "run.mcap")
