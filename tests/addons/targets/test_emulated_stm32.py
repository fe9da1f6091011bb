"""Where the emulated targets keep object files, and how the server of QEMU serves, with stand-ins."""

from pathlib import Path

import pytest

from hil.addons.targets import emulated_stm32


def test_object_files_are_kept_in_the_users_cache_where_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emulated_stm32, "user_cache_path", lambda name: tmp_path / "cache" / name)
    folder = tmp_path / "cache" / "mecanum-hil" / "stm32f4"
    assert [emulated_stm32._objects() for _ in range(2)] == [folder, folder]
    assert folder.is_dir()
    monkeypatch.setattr(
        emulated_stm32.os, "access", lambda path, right: (path, right) != (folder, emulated_stm32.os.W_OK)
    )
    assert emulated_stm32._objects() is None
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(emulated_stm32, "user_cache_path", lambda name: tmp_path / "file" / name)
    assert emulated_stm32._objects() is None
