"""Recordings by the real recorder process, and what becomes of them when either side is killed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.errors import BadInputError
from hil.review import figures, read
from hil.review.decode import decode
from hil.signals import SIGNAL_NAMES
from hil.telemetry import Recording, RecordingReport, check_output_path
from tests.processes import wait_for
from tests.recorded_circle import circle_rows, circle_table

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


@linux_only
def test_lockstep_waits_for_room_and_leaves_nothing_behind(tmp_path: Path) -> None:
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    with record(tmp_path / "run.rrd", capacity=256) as recording:
        for row in circle_rows(2000):
            recording.put(row)
        report = recording.finish({})
    assert report == RecordingReport(tmp_path / "run.rrd", 2000, 2000, 0, 0, 0, None)
    assert report.complete
    assert has_ended(recording.pid)
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors
    assert_same_bits(tmp_path / "run.rrd", 2000)


@pytest.mark.alone
@posix_only
def test_real_time_drops_what_a_stopped_recorder_has_no_room_for(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd", blocking=False, capacity=256) as recording:
        os.kill(recording.pid, signal.SIGSTOP)
        for row in circle_rows(1000):
            recording.put(row)
        os.kill(recording.pid, signal.SIGCONT)
        report = recording.finish({})
    assert (report.rows_put, report.rows_written, report.rows_dropped, report.rows_lost) == (
        1000,
        256,
        744,
        0,
    )
    assert_same_bits(tmp_path / "run.rrd", 256)
    assert figures(read(tmp_path / "run.rrd"))["ticks"] == 1000


@posix_only
@pytest.mark.parametrize("blocking", [True, False])
def test_the_run_goes_on_when_the_recorder_is_killed(tmp_path: Path, blocking: bool) -> None:
    rows = list(circle_rows(4000))
    with record(tmp_path / "run.rrd", blocking=blocking, capacity=2048) as recording:
        for row in rows[:2000]:
            recording.put(row)
        wait_until(lambda: recording.rows_saved >= 1000)
        os.kill(recording.pid, signal.SIGKILL)
        for row in rows[2000:]:
            recording.put(row)
        report = recording.finish({"passed": True})
    assert "ended before the run" in str(report.error)
    assert not report.complete
    assert report.rows_put == 4000
    assert report.rows_written + report.rows_lost + report.rows_dropped == 4000
    assert report.rows_written >= 1000
    assert report.rows_dropped > 0
    found = decode(tmp_path / "run.rrd")[0]["rows"]
    assert found >= report.rows_written
    assert_same_bits(tmp_path / "run.rrd", found)


_KILLED_RUN = """
import os, signal, sys
from pathlib import Path
from hil.telemetry import Recording
from tests.recorded_circle import circle_rows

recording = Recording(Path(sys.argv[1]), properties={}, blocking=True)
heir = os.fork() if sys.argv[2] == "heir" else 0
if sys.argv[2] == "heir" and heir == 0:
    os.close(1)
    signal.pause()
for row in circle_rows(1500):
    recording.put(row)
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
    reviewed = figures(run)
    assert reviewed["passed"] is None
    assert "did not come to its end" in reviewed["reasons"]["passed"]


@posix_only
def test_an_interrupt_of_the_terminal_does_not_reach_the_file(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd") as recording:
        assert os.getpgid(recording.pid) != os.getpgrp()
        os.kill(recording.pid, signal.SIGINT)
        for row in circle_rows(100):
            recording.put(row)
        assert recording.finish({}).complete
    assert_same_bits(tmp_path / "run.rrd", 100)


@posix_only
def test_a_recorder_that_is_told_to_end_finishes_the_file(tmp_path: Path) -> None:
    with record(tmp_path / "run.rrd") as recording:
        for row in circle_rows(100):
            recording.put(row)
        os.kill(recording.pid, signal.SIGTERM)
        wait_for(lambda: has_ended(recording.pid))
        report = recording.finish({})
    assert report.rows_written == 100
    assert "ended before the run" in str(report.error)
    assert_same_bits(tmp_path / "run.rrd", 100)


@linux_only
def test_a_limit_of_the_file_costs_rows_and_not_the_run(tmp_path: Path) -> None:
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, limits[1]))
    try:
        recording = record(tmp_path / "run.rrd", capacity=512)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with recording:
        for row in circle_rows(4000):
            recording.put(row)
        report = recording.finish({})
    assert report.error == "it could not be written any more (File too large)"
    assert report.rows_dropped == 0
    assert 0 < report.rows_written < 4000
    assert report.rows_written + report.rows_lost == 4000
    found = decode(tmp_path / "run.rrd")[0]["rows"]
    assert found >= report.rows_written
    assert_same_bits(tmp_path / "run.rrd", found)


def test_paths_that_cannot_be_written_are_refused_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "directory.rrd").mkdir()
    cases = {
        tmp_path / "directory.rrd": "is a folder",
        tmp_path / "missing" / "run.rrd": "there is no folder",
        tmp_path / "run.mcap": r"must end in \.rrd, ",
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
