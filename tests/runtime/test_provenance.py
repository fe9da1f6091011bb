"""What a result says of the versions that it depends on."""

import subprocess
from pathlib import Path

import pytest

from hil.runtime import provenance


def test_a_result_of_a_checkout_names_its_commit_and_whether_it_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
        done = subprocess.run(
            ["git", "-C", str(tmp_path), *identity, *words], capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    module = tmp_path / "hil" / "runtime" / "provenance.py"
    module.parent.mkdir(parents=True)
    module.write_text("")
    monkeypatch.setattr(provenance, "__file__", str(module))
    assert "commit" not in provenance.versions()
    git("init", "--quiet")
    assert "commit" not in provenance.versions(), "nothing is committed yet"
    git("add", ".")
    git("commit", "--quiet", "--message", "one")
    git("tag", "v1")
    commit = git("rev-parse", "--short=12", "HEAD")
    assert provenance.versions()["commit"] == commit
    module.write_text("changed")
    found = provenance.versions()
    assert found.pop("commit") == f"{commit}-dirty"
    assert set(found) == {"mecanum_hil", "rerun_sdk", "python", "machine"}


def test_git_is_asked_without_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A git that is killed while it refreshes the index would leave the lock there."""
    asked: list[str] = []

    def run(command: list[str], *, env: dict[str, str], **_: object) -> "subprocess.CompletedProcess[str]":
        asked.append(env["GIT_OPTIONAL_LOCKS"])
        return subprocess.CompletedProcess(command, 0, "0123abc\n", "")

    (tmp_path / ".git").mkdir()
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "hil" / "runtime" / "provenance.py"))
    monkeypatch.setattr(provenance.subprocess, "run", run)
    assert provenance.versions()["commit"] == "0123abc"
    assert asked == ["0"]
