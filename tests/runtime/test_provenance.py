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
