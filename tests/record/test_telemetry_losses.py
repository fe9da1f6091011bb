"""What is lost of a recording is counted and said, and nothing is in it twice or written over."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.addons.report.viewer import viewer_executable
from hil.core.errors import BadInputError
from hil.core.signals import pack_row
from hil.judge.judged_run import JudgedRun, Recorded
from hil.judge.recorded import judged_run
from hil.judge.run_json import to_json
from hil.judge.run_text import outcome_rows
from hil.record import reader, ring_process
from hil.record.decode import decode
from hil.record.files import Rotation, check_output_path, has_end, numbered_path
from hil.record.reader import RecordedRun, read
from hil.record.recording import Recording, early_recorder
from hil.record.run_files import RefusedError
from hil.record.started_process import StallTimeout
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.processes import wait_for
from tests.support.recorded_circle import Memory, circle_rows

posix_only = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs limits of a process")
ROTATION = Rotation(duration_s=0.2)


@pytest.fixture(scope="module")
def rotated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 500 rows in three parts, with an event at the beginning of each."""
    path = tmp_path_factory.mktemp("rotated") / "run.rrd"
    with Recording(path, properties={}, blocking=True, rotation=ROTATION) as recording:
        for tick, row in enumerate(circle_rows(500)):
            if tick % 200 == 0:
                wait_for(lambda tick=tick: recording.ring.saved == tick)
                recording.event(row[0], "info", f"tick {tick}")
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.parts == (path, numbered_path(path, 2), numbered_path(path, 3))
    assert report.troubles == ()
    return path


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Memory]:
    memory = Memory(tmp_path / "run.mcap")
    yield memory
    memory.close()


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@posix_only
def test_parts_that_are_removed_in_mid_run_are_counted_as_lost(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "run.mcap"
    path.parent.mkdir()
    with Recording(path, properties={}, blocking=True, rotation=ROTATION) as recording:
        recording.event(0.0, "info", "in the first part")
        for tick, row in enumerate(circle_rows(900)):
            if tick == 500:
                wait_for(lambda: recording.ring.saved == 500)
                shutil.rmtree(path.parent)
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert (report.rows_written, report.rows_lost, report.rows_dropped, report.events_lost) == (400, 500, 0, 1)
    assert report.error is not None
    assert "run.mcap, run-2.mcap" in report.error
    assert "with 400 rows and 1 events" in report.error
    assert report.parts == tuple(sorted(path.parent.iterdir()))
    assert decode(report.parts[-1])[0]["summary"] == {"passed": True}
    found = Recorded(400, 0, 500, 1, report.error, parts=[*map(str, report.parts)])
    (row,) = outcome_rows(JudgedRun(recorded=found, recording=str(path)))
    assert f"400 are safe in {report.parts[0]}" in row[1]


def test_what_a_killed_recorder_had_no_time_to_count_is_in_the_recording_once(memory: Memory, tmp_path: Path) -> None:
    rows = list(circle_rows(30))
    first = memory.files()
    first.event(0.0, "info", "counted")
    first.check()
    for row in rows[:20]:
        memory.writer.try_put(pack_row(row))
    before = memory.copy()
    first.event(0.01, "info", "written")
    first.write_until(20)
    memory.restore(before)  # the file has them; the recorder was killed before it could say so
    second = memory.files(restarts=1)
    second.event(0.01, "info", "written")
    second.event(0.02, "info", "later")
    for row in rows[20:]:
        memory.writer.try_put(pack_row(row))
    second.finish({})
    whole, signals = decode(tmp_path / "run.mcap")
    assert [text for _, _, text in whole["events"]] == ["counted", "written", "later"]
    assert signals["loop.tick"].tolist() == list(range(30))
    assert decode(numbered_path(tmp_path / "run.mcap", 2))[0]["rows"] == 30
    assert whole["notes"] == []


def test_a_recorder_that_is_told_to_end_leaves_what_it_cannot_write_to_the_next(memory: Memory, tmp_path: Path) -> None:
    """As when it is ended while its disk is full: the run goes on, and so do its rows."""
    folder = tmp_path / "runs"
    folder.mkdir()
    memory_of_folder = Memory(folder / "run.mcap")
    parts = memory_of_folder.files()
    shutil.rmtree(folder)
    folder.write_text("in the place of the folder")
    for row in circle_rows(30):
        memory_of_folder.writer.try_put(pack_row(row))
    parts.finish(None)
    assert (memory_of_folder.ring.tail, memory_of_folder.ring.saved) == (0, 0)
    folder.unlink()
    memory_of_folder.files(restarts=1).finish({})
    assert memory_of_folder.ring.saved == 30
    assert decode(folder / "run-2.mcap")[0]["rows"] == 30
    memory_of_folder.close()


@linux_only
def test_a_summary_that_cannot_be_written_leaves_the_recording_incomplete(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with files_of_at_most(500_000):
        recording = Recording(path, properties={}, blocking=True, capacity=256)
    with recording:
        for row in circle_rows(100):
            recording.put(pack_row(row))
        report = recording.finish({"text": "x" * 600_000})
    assert (report.rows_written, report.rows_lost, report.complete) == (100, 0, False)
    assert report.error == "its summary could not be written: it could not be written any more (File too large)"
    run = read(path)
    assert len(run.signals["loop.t_s"]) == 100
    assert run.notes[0].startswith("run-2.mcap has no end: the recorder was killed or could not write it")
    assert to_json(judged_run(run))["failure"] == (
        "the recording has no summary and no end: how the run ended is not known"
    )


@linux_only
def test_a_file_that_cannot_have_its_beginning_is_refused_at_once(tmp_path: Path) -> None:
    """rerun now and then waits for ever for such a file: its constructor must not be reached."""
    memory = Memory(tmp_path / "run.rrd")
    with files_of_at_most(5000), pytest.raises(RefusedError, match="File too large"):
        memory.files()
    assert list(tmp_path.iterdir()) == []
    memory.close()


@linux_only
def test_what_a_recorder_refuses_when_the_run_is_under_way_ends_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    refusal = r"recording .*run\.mcap: File too large; choose a path that can be written"
    scenario = load("paper_circle", mode="lockstep", link="memory:", set=["loop.duration_s=86400"])
    with limited_recorder() as make_recording, pytest.raises(BadInputError, match=refusal):
        run_scenario(scenario, RunOptions(record=path, make_recording=make_recording, keep_signals=False))
    assert list(tmp_path.iterdir()) == []
    with limited_recorder() as make_recording, make_recording(path, properties={}, blocking=True, wait=False) as short:
        short.put(pack_row(next(circle_rows(1))))
        with pytest.raises(BadInputError, match=refusal):
            short.finish({})
    assert list(tmp_path.iterdir()) == []


@contextmanager
def limited_recorder() -> Iterator[Callable[..., Recording]]:
    """A recorder process that cannot write the beginning of a file."""
    with ExitStack() as stack:
        with files_of_at_most(5000):
            make_recording = stack.enter_context(early_recorder(".mcap"))
        yield make_recording


def test_a_part_does_not_take_the_place_of_another_runs(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    numbered_path(path, 2).write_text("of another run")
    with Recording(path, properties={}, blocking=True, rotation=ROTATION) as recording:
        for row in circle_rows(300):
            recording.put(pack_row(row))
        report = recording.finish({})
    assert numbered_path(path, 2).read_text() == "of another run"
    assert report.complete
    assert report.parts == (path, numbered_path(path, 3))
    assert report.troubles == ("it did not go on in run-2.mcap: there was such a file before, which was left alone",)
    numbered_path(path, 2).unlink()
    assert decode(path)[0]["rows"] == 300


def test_a_later_part_is_not_written_over(rotated: Path) -> None:
    with pytest.raises(BadInputError, match=r"run-2\.rrd: by its name it is a later part of run\.rrd; choose another"):
        check_output_path("recording", numbered_path(rotated, 2))
    check_output_path("recording", numbered_path(rotated, 4))


def test_a_part_alone_says_so_and_where_the_others_are(rotated: Path, tmp_path: Path) -> None:
    assert decode(numbered_path(rotated, 2))[0]["notes"] == [
        "run-2.rrd is part 2 of its run, from row 200 on, and read alone; review run.rrd for the whole run",
        "the run went on in part 3, which is not read here",
    ]
    shutil.copy(rotated, tmp_path)
    reviewed = to_json(judged_run(read(tmp_path / "run.rrd")))
    assert reviewed["notes"][0] == "the run went on in part 2, which is not read here"
    assert reviewed["failure"] == "the recording has no summary: it is in a later part, which was not read"
    shutil.copy(numbered_path(rotated, 2), tmp_path / "other-2.rrd")
    note = decode(tmp_path / "other-2.rrd")[0]["notes"][0]
    assert note.endswith("read alone; other.rrd is not beside it")


def test_a_part_is_one_by_its_own_number(rotated: Path, tmp_path: Path) -> None:
    for path in (rotated, numbered_path(rotated, 2), numbered_path(rotated, 3)):
        shutil.copy(path, tmp_path)
    shutil.copy(numbered_path(rotated, 2), tmp_path / "run-7.rrd")
    decoded, signals = decode(tmp_path / "run.rrd")
    assert decoded["notes"] == ["run-7.rrd is left out: it is part 2 of the run by its content"]
    assert signals["loop.tick"].tolist() == list(range(500))
    assert [text for _, _, text in decoded["events"]] == ["tick 0", "tick 200", "tick 400"]


def test_parts_that_rerun_has_made_one_file_of_are_one_run(rotated: Path, tmp_path: Path) -> None:
    """Its tool puts a file's metadata behind the rows."""
    path = tmp_path / "one.rrd"
    parts = [numbered_path(rotated, number) for number in (3, 1, 2)]
    subprocess.run([viewer_executable(), "rrd", "optimize", *parts, "-o", path], check=True, capture_output=True)
    decoded, signals = decode(path)
    assert signals["loop.tick"].tolist() == list(range(500))
    [note] = decoded["notes"]
    assert "another program has written it again" in note
    assert decoded["summary"] == {"passed": True}
    assert [text for _, _, text in decoded["events"]] == ["tick 0", "tick 200", "tick 400"]


def test_a_file_has_its_end_or_not(rotated: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.rrd"
    assert has_end(rotated, ".rrd")
    for count in (1, 1000):
        cut.write_bytes(rotated.read_bytes()[:-count])
        assert not has_end(cut, ".rrd")
    assert not has_end(tmp_path / "missing.rrd", ".rrd")


@posix_only
def test_a_decoder_that_aborts_leaves_no_copy_behind(
    rotated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Aborted when it begins to write the copy of a cut file, as rerun may do a moment later."""
    hook = (
        "sys.addaudithook(lambda event, told: os.abort() if event == 'open' and 'whole.rrd' in str(told[0]) else None)"
    )
    (tmp_path / "sitecustomize.py").write_text(f"import os, sys\n{hook}\n")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(rotated.read_bytes()[:-1000])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with pytest.raises(BadInputError, match="its content makes no sense"):
        read(cut)
    assert list(temporary.iterdir()) == []


def test_a_decoder_that_ends_amid_the_values_is_told(rotated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = json.dumps({"signals": ["loop.t_s"], "rows": 2})
    ends = [sys.executable, "-c", f"print({head!r}); print('7 bytes', end='')"]
    monkeypatch.setattr(reader, "module_command", lambda *_: ends)
    with pytest.raises(BadInputError) as told:
        read(rotated)
    assert str(told.value) == "decoding the recording ended too early; there may be too little memory"


@posix_only
def test_a_config_of_more_than_a_pipe_holds_reaches_a_recorder_that_was_restarted(tmp_path: Path) -> None:
    with Recording(
        tmp_path / "run.mcap", properties={"scenario": "x" * 200_000}, blocking=False, capacity=512
    ) as recording:
        os.kill(recording.pid, signal.SIGKILL)
        for row in circle_rows(300):
            recording.put(pack_row(row))
        wait_for(lambda: recording.ring.saved == 300)
        assert recording.restarts == 1
        assert recording.finish({}).complete


@posix_only
def test_a_restart_that_fails_ends_the_restarts_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Recording(tmp_path / "run.mcap", properties={}, blocking=True, capacity=64) as recording:
        monkeypatch.setattr(sys, "executable", str(tmp_path / "no-python"))
        os.kill(recording.pid, signal.SIGKILL)
        for row in circle_rows(200):
            recording.put(pack_row(row))
        report = recording.finish({})
    assert (report.restarts, report.rows_put, report.rows_written) == (0, 200, 0)
    assert report.rows_lost + report.rows_dropped == 200
    assert report.error is not None
    assert "the recorder could not be started again" in report.error
    assert "no-python" in report.error


@posix_only
def test_a_recorder_that_hangs_is_waited_for_30_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each turn of waiting for its last word counts for all the time that it takes."""
    turns: list[bool] = []

    class Counted(StallTimeout):
        def wait(self, progress: object) -> bool:
            turns.append(super().wait(progress))
            return turns[-1]

    assert ring_process._STALL_WAITS * 0.0005 == 30.0
    with Recording(tmp_path / "run.mcap", properties={}, blocking=True) as recording:
        monkeypatch.setattr(ring_process, "_STALL_WAITS", 220)
        monkeypatch.setattr(ring_process, "StallTimeout", Counted)
        os.kill(recording.pid, signal.SIGSTOP)
        report = recording.finish({})
    assert report.error is not None
    assert "exit status -9" in report.error
    assert turns.index(False) == 19  # the 20th turn of 5.5 ms: 220 waits of 0.5 ms


def test_an_export_without_its_library_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.addons.report.review_command import write_export

    run = RecordedRun(tmp_path / "run.mcap", {"loop.t_s": np.zeros(3)}, (), {}, None, 0)
    for name in ("pyarrow", "pyarrow.csv", "pyarrow.parquet"):  # what has been imported is found without its parent
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("run.csv", "run.parquet"):
        with pytest.raises(BadInputError, match=rf"{name}: no library to write .*; install pyarrow"):
            write_export(run, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
