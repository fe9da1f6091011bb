"""Names, ends and limits of recording files, and the words in which what is wrong with them is said."""

import errno
from pathlib import Path

import pytest

from hil.core.errors import BadInputError
from hil.record import files
from hil.record.files import (
    NoRoomError,
    Rotation,
    check_is_recording,
    check_output_path,
    check_quota,
    has_end,
    later_files,
    make_folder,
    numbered_path,
    rotation,
    why_not_written,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("none", Rotation()), ("1MB", Rotation(size_bytes=1_000_000)), (" 1500 kb ", Rotation(size_bytes=1_500_000)),
        ("2.5GB", Rotation(size_bytes=2_500_000_000)), ("1s", Rotation(duration_s=1.0)),
        ("1.5min", Rotation(duration_s=90.0)), ("2H", Rotation(duration_s=7200.0)),
    ],
)  # fmt: skip
def test_a_rotation_is_a_size_or_a_time(text: str, expected: Rotation) -> None:
    assert rotation(text) == expected


@pytest.mark.parametrize("text", ["", "10", "MB", "-1s", "1.MB", "1TB", "1 MB 2", "none "])
def test_another_rotation_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match=r"expected a size or a time, as in 1GB or 10min, or none$") as refused:
        rotation(text)
    assert str(refused.value).startswith(f"rotate {text!r}: ")


@pytest.mark.parametrize("text", ["999kb", "0.99s", "0min", "0.999MB"])
def test_a_part_is_no_shorter_than_1_mb_or_1_s(text: str) -> None:
    with pytest.raises(BadInputError, match=rf"^rotate '{text}': expected at least 1MB or 1s for a part$"):
        rotation(text)


def test_later_parts_are_found_by_their_names_in_order(tmp_path: Path) -> None:
    path = tmp_path / "run.v1.rrd"
    names = ["run.v1-10.rrd", "run.v1-2.rrd", "run.v1-1.rrd", "run.v1-03.rrd", "run.v1-2.mcap", "runxv1-4.rrd"]
    for name in (*names, "run.v1-5x.rrd", "run.v1.rrd"):
        (tmp_path / name).touch()
    assert [one.name for one in later_files(path)] == ["run.v1-2.rrd", "run.v1-10.rrd"]
    assert [numbered_path(path, number).name for number in (1, 2)] == ["run.v1.rrd", "run.v1-2.rrd"]
    assert later_files(tmp_path / "none" / "run.rrd") == []


def test_only_the_name_of_a_part_beside_its_first_one_is_kept_from_being_replaced(tmp_path: Path) -> None:
    for name in ("run.rrd", "run-2.rrd", "run-1.rrd", "run-02.rrd", "alone-2.rrd", "run-2.html", "run.html"):
        (tmp_path / name).touch()
    problem = r"recording .*run-2\.rrd: by its name it is a later part of run\.rrd; choose another name, or remove it"
    with pytest.raises(BadInputError, match=problem):
        check_output_path("recording", tmp_path / "run-2.rrd", "replace")
    for name in ("run-1.rrd", "run-02.rrd", "alone-2.rrd", "run-3.rrd"):
        check_output_path("recording", tmp_path / name, "replace")
    check_output_path("page", tmp_path / "run-2.html", "replace")
    check_output_path("recording", tmp_path / "run-2.rrd", "number")


def test_each_kind_of_output_names_its_endings(tmp_path: Path) -> None:
    told = {
        "recording": ".rrd or .mcap", "trace": ".blf, .asc or .log", "page": ".html", "export": ".csv or .parquet",
        "urdf": ".urdf",
    }  # fmt: skip
    for what, endings in told.items():
        path = tmp_path / "file.txt"
        with pytest.raises(BadInputError) as refused:
            check_output_path(what, path)
        assert str(refused.value) == f"{what} {path}: its name must end in {endings}, which tells its format"
    missing = tmp_path / "none" / "run.rrd"
    with pytest.raises(BadInputError) as refused:
        check_output_path("recording", missing)
    assert str(refused.value) == (
        f"recording {missing}: there is no folder {missing.parent}; make it, or choose another path"
    )


def test_a_quota_counts_the_recordings_of_a_folder_alone(tmp_path: Path) -> None:
    sizes = {"a.rrd": 1_000_000, "b.mcap": 1_500_000, "c.html": 9_000_000}
    for name, size in sizes.items():
        with (tmp_path / name).open("wb") as file:
            file.truncate(size)
    (tmp_path / "link.rrd").symlink_to(tmp_path / "c.html")
    (tmp_path / "folder.rrd").mkdir()
    check_quota(tmp_path, None)
    check_quota(tmp_path, 2_500_000)
    with pytest.raises(NoRoomError) as full:
        check_quota(tmp_path, 2_400_000)
    told = f"the recordings in {tmp_path} take 0.0025 GB, and 0.0024 GB are allowed; remove some, or allow more"
    assert (full.value.errno, full.value.strerror) == (errno.EDQUOT, told)
    assert why_not_written(tmp_path / "a.rrd", full.value) == told


def test_why_a_file_was_not_written_is_the_system_s_reason(tmp_path: Path) -> None:
    full, other = "the disk is full (words)", "it could not be written any more (words)"
    for number, told in ((errno.ENOSPC, full), (errno.EDQUOT, full), (errno.EIO, other)):
        assert why_not_written(tmp_path, OSError(number, "words")) == told
    # An error of rerun lacks it: writing there tells.
    assert why_not_written(tmp_path / "run.rrd", RuntimeError("of rerun")) == "of rerun"
    gone = tmp_path / "gone" / "run.rrd"
    assert why_not_written(gone, RuntimeError("of rerun")) == (
        "it could not be written any more (No such file or directory)"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_recording_is_known_by_its_first_bytes_and_its_end_by_its_last(tmp_path: Path) -> None:
    path, expected = tmp_path / "run.rrd", " an .rrd or .mcap file made by 'hil run --record'"
    for content, kind in ((b"RRF2", ".rrd"), (b"\x89MCAP0\r\n", ".mcap")):
        path.write_bytes(content)
        assert check_is_recording(path) == kind
    empty, another = "the file is empty; expected", "not a recording; expected"
    for content, problem in ((b"", empty), (b"RRF", another), (b"xRRF2", another)):
        path.write_bytes(content)
        with pytest.raises(BadInputError) as refused:
            check_is_recording(path)
        assert str(refused.value) == f"{path}: {problem}{expected}"
    for content, kind, ends in (
        (b"....RRF2FOOT1234", ".rrd", True), (b"....RRF2FOOT123", ".rrd", False), (b"FOOT1234", ".rrd", False),
        (b"..\x89MCAP0\r\n", ".mcap", True), (b"..\x89MCAP0\r\n.", ".mcap", False), (b"", ".mcap", False),
    ):  # fmt: skip
        path.write_bytes(content)
        assert has_end(path, kind) is ends
    (tmp_path / "gone-2.rrd").touch()
    (tmp_path / "gone-3.rrd").touch()
    with pytest.raises(BadInputError) as refused:
        check_is_recording(tmp_path / "gone.rrd")
    assert str(refused.value) == (
        f"{tmp_path / 'gone.rrd'}: No such file or directory; expected{expected}; there is {tmp_path / 'gone-2.rrd'}, "
        "a later part of it"
    )


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path: Path) -> None:
    make_folder(tmp_path / "runs", "")
    make_folder(tmp_path / "runs", "")
    new = files.new_in_runs("circle", ".mcap", "", tmp_path / "runs")
    assert new.parent == tmp_path / "runs"
    assert (new.name.startswith("circle-"), new.suffix, new.exists()) == (True, ".mcap", False)
    (tmp_path / "file").touch()
    with pytest.raises(BadInputError) as refused:
        files.new_in_runs("circle", ".rrd", "name another", tmp_path / "file")
    assert str(refused.value) == (
        f"recording folder {tmp_path / 'file'}: it cannot be made (File exists); name another"
    )
