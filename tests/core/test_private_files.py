"""Files and folders of one user: who else may read or write is refused, and tokens are long enough."""

import os
import stat
import sys
from pathlib import Path

import pytest

from hil.core.errors import BadInputError
from hil.core.private_files import private_folder, read_private, write_private
from hil.core.process_lock import LockHeldError, ProcessLock, held
from hil.core.tokens import make_token, read_token, state_folder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such modes")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    old = os.umask(0o777)
    try:
        write_private(path, "0123456789abcdef")
    finally:
        os.umask(old)
    return path


def test_a_private_file_is_of_its_user_whatever_the_umask_and_nothing_is_left_beside_it(file: Path) -> None:
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    write_private(file, "again")
    assert (file.read_text(), [*file.parent.iterdir()]) == ("again", [file])


@pytest.mark.parametrize("mode", [0o640, 0o602, 0o601, 0o620, 0o604])
def test_a_secret_that_others_may_use_is_refused(file: Path, mode: int) -> None:
    file.chmod(mode)
    with pytest.raises(BadInputError) as refused:
        read_private(file, "key")
    assert str(refused.value) == (
        f"key {file}: others may read it (mode {mode:04o}), and could command the robot; chmod 600 {file}"
    )
    file.chmod(0o400)
    assert read_private(file, "key") == "0123456789abcdef"


def test_a_secret_that_cannot_be_read_says_why(file: Path) -> None:
    gone = file.with_name("gone")
    with pytest.raises(BadInputError) as refused:
        read_private(gone, "key")
    assert str(refused.value) == (
        f"key {gone}: it cannot be read (No such file or directory); name one that you may read"
    )
    file.write_bytes(b"\xe4")
    with pytest.raises(BadInputError, match=r"it cannot be read \(it is not ASCII\)"):
        read_private(file, "key")


@pytest.mark.parametrize("mode", [0o720, 0o702])
def test_a_folder_into_which_others_may_write_is_none(tmp_path: Path, mode: int) -> None:
    made = private_folder(tmp_path / "a" / "b")
    assert [stat.S_IMODE(one.stat().st_mode) for one in (made.parent, made)] == [0o700, 0o700]
    made.chmod(0o755)
    assert private_folder(made) == made, "others may read what is not secret"
    made.chmod(mode)
    with pytest.raises(OSError, match="no folder that this user alone may write to"):
        private_folder(made)
    (tmp_path / "link").symlink_to(tmp_path / "a")
    with pytest.raises(OSError, match="no folder that this user alone"):
        private_folder(tmp_path / "link")


def test_a_state_folder_into_which_others_may_write_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = state_folder("services")
    folder.chmod(0o777)
    with pytest.raises(BadInputError) as refused:
        state_folder("services")
    assert str(refused.value) == (
        f"folder {folder}: it cannot be used (it is no folder that this user alone may write to); "
        "make it yourself, with mode 0700"
    )


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("0123456789abcdef\n", True),
        ("0123456789abcde\n", False),
        ("01234567 89abcdef", False),
        ("01234567\t89abcdef", False),
    ],
)
def test_a_token_is_one_line_of_at_least_16_characters(file: Path, text: str, is_one: bool) -> None:
    write_private(file, text)
    if is_one:
        assert read_token(file) == text.strip()
        return
    with pytest.raises(BadInputError) as refused:
        read_token(file)
    assert f"{len(text.strip())} characters are no token; expected one line of at least 16" in str(refused.value)


def test_each_token_that_is_made_is_another_and_can_be_read(tmp_path: Path) -> None:
    tokens = set()
    for _ in range(3):
        make_token(tmp_path / "one.token")
        tokens.add(read_token(tmp_path / "one.token"))
    assert len(tokens) == 3
    assert min(map(len, tokens)) > 43, "256 bits, after the mark of this machine"
    with pytest.raises(
        BadInputError, match=r"it cannot be written \(No such file or directory\); name one in a folder"
    ):
        make_token(tmp_path / "gone" / "one.token")


def test_a_lock_is_held_by_one_and_its_record_goes_with_it(tmp_path: Path) -> None:
    first, second = (ProcessLock(tmp_path, name, {"name": name}) for name in ("b", "a"))
    assert [record["name"] for record in held(tmp_path)] == ["a", "b"]
    with pytest.raises(LockHeldError) as refused:
        ProcessLock(tmp_path, "a", {"name": "another"})
    assert refused.value.holder == {"name": "a"}
    second.release()
    second.release()
    (tmp_path / "c.json").write_text("{}")  # of one that was killed
    assert [record["name"] for record in held(tmp_path)] == ["b"]
    assert not (tmp_path / "c.json").exists()
    first.release()
    assert list(held(tmp_path)) == []
