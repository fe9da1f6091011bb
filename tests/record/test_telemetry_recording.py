"""Recordings by the real recorder process, and what becomes of them when either side is killed."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hil.core.errors import BadInputError, DeviceError
from hil.core.ports import Event
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.judge.recorded import judged_run
from hil.judge.run_json import to_json
from hil.record import ring_process
from hil.record.decode import decode
from hil.record.files import check_output_path, numbered_path, rotation
from hil.record.reader import read
from hil.record.recording import Recording, RecordingReport, early_recorder
from hil.record.started_process import StartedProcess, rerun_environment
from tests.support.processes import wait_for
from tests.support.recorded_circle import circle_rows, circle_table

posix_only = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline, "waited for 60 s"
        time.sleep(0.005)


def has_ended(pid: int) -> bool:
    """Whether a process has ended; one that its new parent does not collect has ended too."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rsplit(") ", 1)[1].startswith("Z")


def assert_same_bits(path: Path, count: int) -> None:
    """The recording holds exactly the first ``count`` rows of the circle, bit for bit."""
    _, signals = decode(path)
    expected = circle_table(count)
    for i, name in enumerate(SIGNAL_NAMES):
        assert signals[name].tobytes() == np.ascontiguousarray(expected[:, i]).tobytes(), name


def record(path: Path, *, blocking: bool = True, capacity: int = 16384) -> Recording:
    return Recording(path, properties={}, blocking=blocking, capacity=capacity)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({}, None),
        ({"head": 9}, "the recorder ended: it was killed"),
        ({"dropped": 2}, "the recorder ended: it was killed"),
        ({"lines_lost": 1}, "the recorder ended: it was killed"),
    ],
)
def test_a_report_has_what_the_recorder_could_not_write_and_then_why(more: dict[str, int], why: str | None) -> None:
    ring = SimpleNamespace(head=more.get("head", 7), saved=7, dropped=more.get("dropped", 0), files=dict)
    run = SimpleNamespace(path=Path("run.mcap"), ring=ring, restarts=1, troubles=["it was killed"])
    run.lines_lost, run._left_alone = more.get("lines_lost", 0), lambda _kept: ["there was another"]
    report = Recording._make_report(run, {})  # type: ignore[arg-type]
    troubles = ("the recorder ended: it was killed", "there was another")
    lost = more.get("head", 7) - 7
    assert report == RecordingReport(
        run.path, 7 + lost + ring.dropped, 7, ring.dropped, lost, run.lines_lost, why, (), 1, troubles
    )
    told = Recording._make_report(run, {"error": "no summary", "live_error": "no port"})  # type: ignore[arg-type]
    assert told.error == "no summary"


@pytest.mark.parametrize(
    ("live_port", "keep_live", "is_open"),
    [(None, False, False), (None, True, False), (9, False, False), (9, True, True)],
)
def test_a_recorder_is_let_go_when_it_has_reported_unless_it_still_serves_viewers(
    live_port: int | None, keep_live: bool, is_open: bool
) -> None:
    told: list[object] = []
    run = SimpleNamespace(_result=None, _live_port=live_port, close=lambda: told.append("closed"))
    run.end = lambda summary, keep_live: told.append((summary, keep_live))
    run._make_report = lambda _reply: "the report"
    for _ in range(2):  # the second time there is nothing left to do
        assert Recording.finish(run, {"passed": True}, keep_live=keep_live) == "the report"  # type: ignore[arg-type]
        assert told == [({"passed": True}, is_open), *["closed"] * (not is_open)]


@linux_only
def test_lockstep_waits_for_room_and_leaves_nothing_behind(tmp_path: Path) -> None:
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    with record(tmp_path / "run.rrd", capacity=256) as recording:
        for row in circle_rows(2000):
            recording.put(pack_row(row))
        report = recording.finish({})
    path = tmp_path / "run.rrd"
    assert report == RecordingReport(path, 2000, 2000, 0, 0, 0, None, parts=(path,))
    assert report.complete
    assert has_ended(recording.pid)
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors
    assert_same_bits(tmp_path / "run.rrd", 2000)


@linux_only
def test_a_recorder_that_was_started_early_records_and_needs_no_tables(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with early_recorder(".rrd") as make_recording, make_recording(path, properties={}, blocking=True) as recording:
        for row in circle_rows(200):
            recording.put(pack_row(row))
        mapped = Path(f"/proc/{recording.pid}/maps").read_text()
        assert recording.finish({"passed": True}).complete
    assert "rerun_bindings" in mapped
    assert "pandas" not in mapped
    assert_same_bits(path, 200)


@pytest.mark.parametrize("capacity", [16384, 256], ids=["all in the ring", "waits when it is full"])
def test_a_run_in_lockstep_goes_on_before_its_recorder_is_ready(tmp_path: Path, capacity: int) -> None:
    path = tmp_path / "run.rrd"
    properties = {"text": "x" * 200_000}  # more than the pipe holds
    with Recording(path, properties=properties, blocking=True, capacity=capacity, wait=False) as recording:
        recording.event(0.0, "info", "robot")
        for row in circle_rows(2000):
            recording.put(pack_row(row))
            if recording.ring.head == 256:
                assert recording.ring.file_number == 0, "256 rows took longer than to import rerun"
        assert recording.finish({"passed": True}).complete
    assert_same_bits(path, 2000)
    run = read(path)
    assert (run.summary, run.properties) == ({"passed": True}, properties)
    assert [event.text for event in run.events] == ["robot"]


def test_a_recorder_started_for_nothing_is_ended_and_one_that_died_meanwhile_is_told(tmp_path: Path) -> None:
    with StartedProcess("hil.record.recorder", rerun_environment()) as unused:
        assert unused.process.poll() is None
    assert unused.process.returncode is not None
    with StartedProcess("hil.record.recorder", rerun_environment()) as started:
        started.process.kill()
        with pytest.raises(DeviceError, match=r"^the recorder did not start: exit status .*; run without a recording"):
            Recording(tmp_path / "run.mcap", properties={}, blocking=True, started=started)
    assert list(tmp_path.iterdir()) == []
    with StartedProcess("hil.record.recorder", rerun_environment()) as started:
        started.process.kill()
        path = tmp_path / "run.mcap"
        with Recording(path, properties={}, blocking=True, started=started, wait=False) as recording:
            recording.put(pack_row(next(circle_rows(1))))
            with pytest.raises(DeviceError, match=r"^the recorder did not start: exit status .*; run without"):
                recording.finish({})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.alone
@posix_only
def test_real_time_drops_what_a_stopped_recorder_has_no_room_for(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd", blocking=False, capacity=256) as recording:
        os.kill(recording.pid, signal.SIGSTOP)
        for row in circle_rows(1000):
            recording.put(pack_row(row))
        os.kill(recording.pid, signal.SIGCONT)
        report = recording.finish({})
    assert (report.rows_put, report.rows_written, report.rows_dropped, report.rows_lost) == (
        1000,
        256,
        744,
        0,
    )
    assert_same_bits(tmp_path / "run.rrd", 256)
    assert to_json(judged_run(read(tmp_path / "run.rrd")))["ticks"] == 1000


@posix_only
def test_a_recorder_that_is_killed_is_restarted_and_nothing_is_lost(tmp_path: Path) -> None:
    name = "run.rrd"
    rows = list(circle_rows(3000))
    with record(tmp_path / name, blocking=False) as recording:
        recording.event(0.1, "info", "before")
        for row in rows[:2000]:
            recording.put(pack_row(row))
        wait_until(lambda: recording.ring.saved >= 1000)
        os.kill(recording.pid, signal.SIGKILL)
        recording.event(2.0, "info", "meanwhile")
        for row in rows[2000:]:
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.complete
    assert report.restarts == 1
    assert report.troubles == ("the recorder ended: exit status -9",)
    assert report.parts == (tmp_path / name, numbered_path(tmp_path / name, 2))
    assert (report.rows_put, report.rows_written) == (3000, 3000)
    assert_same_bits(tmp_path / name, 3000)
    run = read(tmp_path / name)
    assert run.summary == {"passed": True}
    assert run.parts == report.parts
    assert [event.text for event in run.events] == ["before", "meanwhile"]


@posix_only
def test_the_run_goes_on_when_the_recorder_dies_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ring_process, "_STARTS_IN_A_ROW", 1)
    rows = list(circle_rows(4000))
    with record(tmp_path / "run.mcap", capacity=2048) as recording:
        for row in rows[:1500]:
            recording.put(pack_row(row))
        wait_until(lambda: recording.ring.saved >= 1000)
        for restarts in (0, 1):
            wait_until(lambda restarts=restarts: recording.restarts == restarts)  # type: ignore[misc]
            os.kill(recording.pid, signal.SIGKILL)
        for row in rows[1500:]:
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.error == "the recorder ended before the run: exit status -9"
    assert report.rows_put == 4000
    assert report.rows_written + report.rows_lost + report.rows_dropped == 4000
    assert report.rows_dropped > 0
    assert read(tmp_path / "run.mcap").summary is None
    found = decode(tmp_path / "run.mcap")[0]["rows"]
    assert found >= report.rows_written >= 1000
    assert_same_bits(tmp_path / "run.mcap", found)


@pytest.mark.parametrize("name", ["run.rrd", "run.mcap"])
def test_a_long_run_goes_on_in_another_file_each_of_which_is_whole(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    numbered_path(path, 4).write_bytes(path_of_another_run(tmp_path, name).read_bytes())
    rotate = rotation("1s")
    with Recording(path, properties={"law": "none"}, blocking=True, rotation=rotate) as recording:
        for row in circle_rows(2500):
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.complete
    assert report.parts == (path, numbered_path(path, 2), numbered_path(path, 3))
    assert_same_bits(path, 2500)
    whole, _ = decode(path)
    assert (whole["parts"], whole["notes"], whole["summary"]) == ([*map(str, report.parts)], [], {"passed": True})
    for part, rows in zip(report.parts[1:], (1000, 500), strict=True):
        alone, _ = decode(part)
        assert alone["rows"] == rows
        assert alone["properties"] == {"law": "none"}
    numbered_path(path, 2).unlink()
    broken, _ = decode(path)
    assert broken["rows_missing"] == 1000
    assert broken["notes"] == ["1000 rows between its parts were lost"]


def path_of_another_run(folder: Path, name: str) -> Path:
    path = folder / f"other-{name}"
    with record(path) as recording:
        recording.put(pack_row(next(circle_rows(1))))
        recording.finish({"passed": False})
    return path


@posix_only
def test_a_folder_that_is_removed_costs_its_rows_and_no_more(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    rows = list(circle_rows(2000))
    with record(folder / "run.mcap", blocking=False) as recording:
        for row in rows[:1000]:
            recording.put(pack_row(row))
        wait_until(lambda: recording.ring.saved == 1000)
        shutil.rmtree(folder)
        for row in rows[1000:]:
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.error == "it could not be written any more (run.mcap was removed)"
    assert (report.rows_written, report.rows_lost) == (1000, 1000)
    found = read(folder / "run-2.mcap")
    assert len(found.signals["loop.t_s"]) == report.rows_written
    assert found.signals["loop.tick"][-1] == 1999
    assert found.summary == {"passed": True}


_FAST_RUN = """
import os, sys, time
from pathlib import Path
from hil.core.signals import pack_row
from hil.record.recording import Recording
from tests.support.recorded_circle import circle_rows

recording = Recording(Path(sys.argv[1]), properties={}, blocking=False)
rows = list(circle_rows(3000))
os.write(1, b"%d\\n" % recording.pid)
begin_s = time.perf_counter()
for i, row in enumerate(rows):
    while time.perf_counter() < begin_s + 0.001 * i:
        pass
    recording.put(pack_row(row))
    os.write(1, b"+")
"""


@pytest.mark.alone
@linux_only
@pytest.mark.parametrize("name", ["run.rrd", "run.mcap"])
def test_when_everything_is_killed_the_last_200_ms_are_lost_at_most(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    command = [sys.executable, "-c", _FAST_RUN, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0) as run:
        assert run.stdout is not None
        recorder = int(run.stdout.readline())
        put = 0
        while put < 1300:
            put += len(run.stdout.read(100))
        os.kill(recorder, signal.SIGKILL)
        run.kill()
        put += len(run.stdout.read())
    wait_until(lambda: has_ended(recorder))
    found = decode(path)[0]["rows"]
    assert put - 200 <= found <= put + 1
    assert_same_bits(path, found)


def test_mcap_needs_no_rerun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a robot's computer for which there is no wheel: importing rerun fails, in the recorder and in the review."""
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    for module in ("rerun", "rerun_bindings", "pyarrow"):
        (blocked / f"{module}.py").write_text("raise ImportError('there is no wheel for this machine')\n")
    monkeypatch.setenv("PYTHONPATH", str(blocked))
    path = tmp_path / "run.mcap"
    with record(path) as recording:
        for row in circle_rows(200):
            recording.put(pack_row(row))
        recording.event(0.1, "warning", "a line")
        assert recording.finish({"passed": True}).complete
    run = read(path)
    assert run.summary == {"passed": True}
    assert run.events == (Event(0.1, "WARN", "a line"),)
    assert [len(series) for series in run.signals.values()] == [200] * len(SIGNAL_NAMES)
    with pytest.raises(DeviceError, match=r"the recorder did not start: .*no wheel"):
        record(tmp_path / "run.rrd")
    (tmp_path / "of_another.rrd").write_bytes(b"RRF2")
    with pytest.raises(BadInputError, match=r"no library to read it \(there is no wheel.*; install rerun-sdk"):
        read(tmp_path / "of_another.rrd")


_KILLED_RUN = """
import os, signal, sys
from pathlib import Path
from hil.core.signals import pack_row
from hil.record.recording import Recording
from tests.support.recorded_circle import circle_rows

recording = Recording(Path(sys.argv[1]), properties={}, blocking=True)
heir = os.fork() if sys.argv[2] == "heir" else 0
if sys.argv[2] == "heir" and heir == 0:
    os.close(1)
    signal.pause()
for row in circle_rows(1500):
    recording.put(pack_row(row))
recording.event(1.5, "info", "last words")
print(recording.pid, heir, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@linux_only
@pytest.mark.parametrize("heir", ["none", "heir"])
def test_the_recorder_finishes_the_file_of_a_run_that_was_killed(tmp_path: Path, heir: str) -> None:
    """With an heir, a process that the run forked still holds the pipe open."""
    path = tmp_path / "run.rrd"
    killed = subprocess.run([sys.executable, "-c", _KILLED_RUN, str(path), heir], stdout=subprocess.PIPE, check=False)
    assert killed.returncode == -signal.SIGKILL
    recorder, heir_pid = map(int, killed.stdout.split())
    try:
        wait_until(lambda: has_ended(recorder))
    finally:
        if heir_pid:
            os.kill(heir_pid, signal.SIGKILL)
    assert_same_bits(path, 1500)
    run = read(path)
    assert run.summary is None
    assert [event.text for event in run.events] == ["last words"]
    reviewed = to_json(judged_run(run))
    assert reviewed["passed"] is None
    assert "did not come to its end" in reviewed["reasons"]["passed"]


@posix_only
def test_an_interrupt_of_the_terminal_does_not_reach_the_file(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd") as recording:
        assert os.getpgid(recording.pid) != os.getpgrp()
        os.kill(recording.pid, signal.SIGINT)
        for row in circle_rows(100):
            recording.put(pack_row(row))
        assert recording.finish({}).complete
    assert_same_bits(tmp_path / "run.rrd", 100)


@posix_only
def test_a_recorder_that_is_told_to_end_finishes_the_file(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd") as recording:
        for row in circle_rows(100):
            recording.put(pack_row(row))
        os.kill(recording.pid, signal.SIGTERM)
        wait_for(lambda: has_ended(recording.pid))
        report = recording.finish({})
    assert report.rows_written == 100
    assert report.troubles == ("the recorder ended: exit status 0",)
    assert_same_bits(tmp_path / "run.rrd", 100)


@linux_only
def test_a_limit_of_the_file_costs_rows_and_not_the_run(tmp_path: Path) -> None:
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, limits[1]))
    try:
        recording = record(tmp_path / "run.rrd", capacity=256)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with recording:
        for row in circle_rows(4000):
            recording.put(pack_row(row))
        report = recording.finish({"passed": True})
    assert report.error == "it could not be written any more (File too large)"
    assert report.rows_dropped == 0
    assert 0 < report.rows_written < 4000
    assert report.rows_written + report.rows_lost == 4000
    assert report.parts[1:] == (tmp_path / "run-2.rrd",)
    run = read(tmp_path / "run.rrd")
    assert run.rows_missing > 0
    assert len(run.signals["loop.tick"]) + run.rows_missing == 4000
    assert run.signals["loop.tick"][-1] == 3999  # what the ring still held is in the next part
    assert run.summary == {"passed": True}


def test_paths_that_cannot_be_written_are_refused_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "directory.rrd").mkdir()
    cases = {
        tmp_path / "directory.rrd": "is a folder",
        tmp_path / "missing" / "run.rrd": "there is no folder",
        tmp_path / "run.bag": r"must end in \.rrd or \.mcap, ",
    }
    for path, problem in cases.items():
        with pytest.raises(BadInputError, match=problem) as refused:
            Recording(path, properties={}, blocking=True)
        assert str(path) in str(refused.value)
    assert sorted(tmp_path.iterdir()) == [tmp_path / "directory.rrd"]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_directory_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(BadInputError, match="is not writable"):
        check_output_path("recording", tmp_path / "run.rrd")


@linux_only
def test_a_path_that_only_opening_proves_wrong_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"recording /proc/run\.rrd: .*choose a path that can be written"):
        Recording(Path("/proc/run.rrd"), properties={}, blocking=True)
