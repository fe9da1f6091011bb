"""A file that is there is never replaced unless ``--force`` says so: by any command, and by a service at all."""

import os
import socket
from collections.abc import Callable
from datetime import datetime, tzinfo
from multiprocessing.pool import ThreadPool
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
import hil.record.files
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.core.outputs import claim, free_name, write_whole
from hil.core.signals import pack_row
from hil.record.files import check_output_path, new_in_runs, numbered_path
from hil.record.reader import read
from hil.record.recording import Recording
from hil.wire.trace import Trace
from tests.support import processes
from tests.support.recorded_circle import circle_rows

OLD = Path(__file__).parents[1] / "recordings" / "circle_speed_ca92b7a.rrd"
SHORT = ("--set", "loop.duration_s=0.1", "--set", "expect=[]")
KEPT = b"evidence of another day"


def test_none_is_a_word_for_no_recording_and_no_parts(tmp_path: Path) -> None:
    run = tmp_path / "run.rrd"
    done = processes.hil("run", "circle_speed", *SHORT, "--rotate", "none", "--record", run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert processes.hil("run", "circle_speed", *SHORT, "--record", "none", cwd=tmp_path).returncode == 0
    assert list(tmp_path.iterdir()) == [run]


@pytest.mark.parametrize("name", ["a\x1b[31m.rrd", "two\nlines.rrd", "two\u2028lines.rrd", "del\x7f.rrd"])
def test_a_name_that_a_terminal_would_obey_is_refused_and_printed_harmlessly(name: str, tmp_path: Path) -> None:
    done = processes.hil("run", "circle_speed", *SHORT, "--record", name, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        f"hil: recording {name!r}: its name has a character that cannot be printed; choose another name\n"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (("run", "circle_speed", *SHORT, "--record", "{}"), "keep.rrd"),
        (("run", "circle_speed", *SHORT, "--record", "{}"), "keep.mcap"),
        (("run", "circle_speed", *SHORT, "--record", "none", "--trace", "{}"), "bus.log"),
        (("review", str(OLD), "--html", "{}"), "page.html"),
        (("review", str(OLD), "--export", "{}"), "run.csv"),
        (("review", str(OLD), "--export", "{}"), "run.parquet"),
        (("compare", "pid", "circle_speed", "--quick", "--html", "{}"), "page.html"),
        (("catalogue", "--kind", "mute", "--html", "{}"), "page.html"),
        (("reproduce", "--quick", "--out", "."), "summary.json"),
        (("reproduce", "--quick", "--out", "."), "delay.png"),
        (("reproduce", "--quick", "--out", "."), "dsc_common_together.rrd"),
        (("campaign", "report", "."), "report.html"),
        (("campaign", "report", ".", "--html", "{}"), "page.html"),
        (("init", ".", "--defaults"), "robot.toml"),
        (("init", ".", "--defaults"), "first_circle.hil.toml"),
    ],
)
def test_a_command_refuses_a_file_that_is_there(words, file, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(file).write_bytes(KEPT)
    done = CliRunner().invoke(app, [word.format(file) for word in words])
    assert isinstance(done.exception, BadInputError), done.output
    assert file in str(done.exception)
    assert "--force" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == [file], "nothing was begun"
    assert Path(file).read_bytes() == KEPT


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (("run", "circle_speed", *SHORT, "--record", "{}"), "keep.mcap"),
        (("run", "circle_speed", *SHORT, "--record", "none", "--trace", "{}"), "bus.log"),
        (("review", str(OLD), "--export", "{}"), "run.csv"),
        (("init", ".", "--defaults"), "robot.toml"),
    ],
)
def test_force_replaces_it(words, file, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(file).write_bytes(KEPT)
    done = CliRunner().invoke(app, [*(word.format(file) for word in words), "--force"])
    assert done.exit_code == 0, done.exception
    assert KEPT not in Path(file).read_bytes()


def test_a_run_in_python_refuses_and_replaces_alike(tmp_path: Path) -> None:
    path, short = tmp_path / "run.mcap", {"loop.duration_s": 0.1, "expect": []}
    path.write_bytes(KEPT)
    with pytest.raises(BadInputError, match=r"recording .*run\.mcap: the file exists already"):
        hil.run("circle_speed", set=short, record=path)
    assert hil.run("circle_speed", set=short, record=path, force=True).metrics["recording"] == str(path)
    assert len(read(path).signals["loop.t_s"])


@pytest.mark.parametrize(
    "write",
    [
        lambda path: Recording(path, properties={}, blocking=True),
        lambda path: write_whole(path, b"new"),
    ],
)
def test_what_writes_refuses_too(write: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(KEPT)
    with pytest.raises(BadInputError, match="the file exists already; choose another name, or replace it with --force"):
        write(path)
    assert path.read_bytes() == KEPT


def test_a_trace_refuses_too(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_bytes(KEPT)
    with pytest.raises(BadInputError, match=r"trace .*bus\.log: the file exists already"):
        Trace(path, blocking=True)
    assert path.read_bytes() == KEPT


def test_of_many_at_once_each_gets_a_name_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with ThreadPool(8) as pool:
        names = pool.map(lambda _: claim("recording", path, "number"), range(64))
    assert sorted(names) == sorted(tmp_path.iterdir())
    assert len(set(names)) == 64
    with pytest.raises(BadInputError):
        claim("recording", path)


def test_a_numbered_recording_is_no_part_of_another(tmp_path: Path) -> None:
    first = tmp_path / "run.mcap"
    first.write_bytes(KEPT)
    with Recording(first, properties={}, blocking=True, existing="number") as recording:
        for row in circle_rows(20):
            recording.put(pack_row(row))
        report = recording.finish({})
    assert recording.path == report.path == tmp_path / "run_2.mcap"
    assert report.parts == (tmp_path / "run_2.mcap",)
    assert recording.path not in [numbered_path(first, number) for number in range(1, 10)]
    assert len(read(recording.path).signals["loop.t_s"]) == 20


def test_a_recording_that_cannot_begin_leaves_nothing(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(BadInputError, match="live port"):
        Recording(tmp_path / "run.mcap", properties={}, blocking=True, live_port=taken.getsockname()[1])
    assert list(tmp_path.iterdir()) == []


def test_a_default_name_is_free_whatever_the_clock_says(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)

    class Stopped(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime(2026, 1, 2, tzinfo=tz)

    monkeypatch.setattr(hil.record.files, "datetime", Stopped)
    names = []
    for _ in range(3):
        names.append(new_in_runs("circle", ".rrd", ""))
        names[-1].touch()
    assert [name.name for name in names] == [
        f"circle-20260102-000000-000000{number}.rrd" for number in ("", "_2", "_3")
    ]


def test_a_name_that_a_broken_link_has_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.symlink_to(tmp_path / "gone.rrd")
    assert free_name(path) == tmp_path / "run_2.rrd"
    with pytest.raises(BadInputError, match="the file exists already"):
        claim("recording", path)


def test_a_file_that_cannot_be_replaced_stays(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_bytes(KEPT)
    with pytest.raises(TypeError):
        write_whole(path, None, "page", "replace")  # type: ignore[arg-type]
    assert path.read_bytes() == KEPT
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_to_its_end_is_told_and_leaves_what_was_there(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="limits of files need a POSIX system")
    path, limits = tmp_path / "page.html", resource.getrlimit(resource.RLIMIT_FSIZE)
    path.write_bytes(KEPT)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(BadInputError) as refused:
            write_whole(path, bytes(101), "page", "replace")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(refused.value) == (
        f"page {path}: it cannot be written (File too large); choose a folder that exists, is writable and has free "
        "space"
    )
    assert [(one, one.read_bytes()) for one in tmp_path.iterdir()] == [(path, KEPT)]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_what_is_no_file_is_refused_with_force_too(tmp_path: Path) -> None:
    pipe = tmp_path / "run.rrd"
    os.mkfifo(pipe)
    with pytest.raises(BadInputError, match="a pipe or a socket; name a file"):
        check_output_path("recording", pipe, "replace")
