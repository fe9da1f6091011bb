"""The files of a recording, written without processes: where each ends, what it counts, and when the next is tried."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.core.signals import INDEX, SIGNAL_NAMES, pack_row
from hil.record import run_files, started_process
from hil.record.contents import DamagedError
from hil.record.decode import decode
from hil.record.decode_mcap import decode_mcap
from hil.record.files import numbered_path
from hil.record.mcap_file import McapFile
from hil.record.recorder import BATCH_AGE_S, Recorder
from hil.record.ring import RingReader, RingWriter, SharedBlock, ring_bytes
from hil.record.run_files import RunFiles
from hil.record.started_process import StallTimeout
from tests.support.clocks import StandingClock
from tests.support.recorded_circle import Memory, circle_rows


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> StandingClock:
    clock = StandingClock()
    monkeypatch.setattr(run_files, "time", clock)
    return clock


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Memory]:
    memory = Memory(tmp_path / "run.mcap")
    yield memory
    memory.close()


def put(memory: Memory, first: int, until: int) -> None:
    for row in list(circle_rows(until))[first:]:
        assert memory.writer.try_put(pack_row(row))


def counts(path: Path) -> Mapping[str, int]:
    """Return what the recorder wrote at the end of a file, but for what the format itself has."""
    return {name: value for name, value in decode_mcap(path).properties.end.items() if name != "holds"}


def test_a_file_ends_within_a_batch_where_its_time_is_over(
    memory: Memory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_files, "BATCH_ROWS", 7)
    memory._config["rotate"] = [None, 0.02]
    files = memory.files()
    put(memory, 0, 50)
    for stop in (3, 19, 34, 50):
        files.event(0.001 * stop, "info", f"before {stop}")
        files.write_until(stop)
    memory.writer.count_dropped()
    files.finish({"passed": True})
    paths = [numbered_path(tmp_path / "run.mcap", number) for number in (1, 2, 3)]
    parts = [decode_mcap(path) for path in paths]
    assert [part.signals["loop.tick"].tolist() for part in parts] == [
        [*range(20)], [*range(20, 40)], [*range(40, 50)],
    ]  # fmt: skip
    assert [[text for *_, text in part.events] for part in parts] == [
        ["before 3", "before 19", "before 34"], ["before 50"], [],
    ]  # fmt: skip
    each = {"rows_dropped": 0, "rows_lost": 0}
    assert [counts(path) for path in paths] == [
        each | {"rows_written": 20, "rows_in_part": 20, "rows_until": 20, "events_until": 3, "next_part": 2},
        each | {"rows_written": 40, "rows_in_part": 20, "rows_until": 40, "events_until": 4, "next_part": 3},
        each | {"rows_written": 50, "rows_in_part": 10, "rows_until": 50, "events_until": 4, "rows_dropped": 1},
    ]
    assert [part.properties.part for part in parts] == [
        {"recording_id": "one", "number": number, "first_row": row, "first_event": event}
        for number, row, event in ((1, 0, 0), (2, 20, 3), (3, 40, 4))
    ]


@pytest.mark.parametrize(("size_bytes", "rows"), [(1, [7, 7, 4]), (10_000_000, [18])])
def test_a_file_ends_after_the_batch_with_which_it_has_its_size(
    memory: Memory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size_bytes: int, rows: list[int]
) -> None:
    monkeypatch.setattr(run_files, "BATCH_ROWS", 7)
    memory._config["rotate"] = [size_bytes, None]
    files = memory.files()
    put(memory, 0, 18)
    files.write_until(18)
    files.finish({})
    parts = [decode_mcap(path) for path in sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)]
    found = [len(part.signals["loop.tick"]) for part in parts]
    assert [count for count in found if count] == rows
    assert decode(tmp_path / "run.mcap")[1]["loop.tick"].tolist() == list(range(18))


def test_the_next_file_is_tried_after_pauses_that_double_up_to_eight_seconds(
    memory: Memory, tmp_path: Path, clock: StandingClock
) -> None:
    tried: list[float] = []

    class Told(RunFiles):
        def _open(self) -> Any:
            tried.append(clock.now_s - 100.0)
            return super()._open()

    folder = tmp_path / "runs"
    folder.mkdir()
    memory._config["path"] = str(folder / "run.mcap")
    files = Told({**memory._config, "restarts": 0}, memory.ring)
    shutil.rmtree(folder)
    folder.write_text("in the place of the folder")
    files.event(0.0, "info", "waits")
    while clock.now_s < 130.0:
        files.check()
        clock.now_s += 0.25
    assert tried == [0.0, 0.5, 1.5, 3.5, 7.5, 15.5, 23.5]
    assert files.failing == files.trouble == "it could not be written any more (File exists)"
    assert memory.ring.lines_saved == 0
    folder.unlink()
    while files.failing:
        files.check()
        clock.now_s += 0.25
    assert tried[7:] == [31.5]
    assert (memory.ring.lines_saved, [path.name for path in folder.iterdir()]) == (1, ["run-2.mcap"])


def test_a_second_file_takes_no_other_ones_place_and_leaves_room_on_the_disk(
    memory: Memory, tmp_path: Path, clock: StandingClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory._config["rotate"] = [None, 0.01]
    second, third = (numbered_path(tmp_path / "run.mcap", number) for number in (2, 3))
    files = memory.files()
    put(memory, 0, 15)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage._replace(free=run_files.ROOM_BYTES - 1))
    files.write_until(15)
    assert files.failing == "the disk is full (No space left on device)"
    assert not second.exists()
    second.write_text("of another run")
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage._replace(free=run_files.ROOM_BYTES))
    for error in (OSError(5, "Input/output error"), RuntimeError("odd")):

        def fails(*_: object, error: Exception = error) -> None:
            raise error

        with monkeypatch.context() as patch:
            patch.setattr(run_files, "_open_file", fails)
            clock.now_s += 8.0
            files.write_until(15)
            assert files.failing is not None
            assert str(error.args[-1]) in files.failing
            assert not third.exists(), "a file that could not be begun is removed"
    clock.now_s += 8.0
    files.write_until(15)
    files.finish({})
    assert (files.failing, memory.ring.tail, second.read_text()) == (None, 15, "of another run")
    assert decode_mcap(third).signals["loop.tick"].tolist() == list(range(10, 15))


def test_while_no_file_can_be_written_the_newest_half_of_the_ring_is_kept(
    memory: Memory, tmp_path: Path, clock: StandingClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_files, "BATCH_ROWS", 10)
    memory._config["quota_bytes"] = 1_000_000
    files = memory.files()
    full = tmp_path / "other.mcap"
    full.write_bytes(bytes(1_500_000 - (tmp_path / "run.mcap").stat().st_size))
    files.check()
    assert files.failing == (
        f"the recordings in {tmp_path} take 0.0015 GB, and 0.001 GB are allowed; remove some, or allow more"
    )
    put(memory, 0, 300)
    files.write_until(256)
    assert (memory.ring.tail, memory.ring.saved) == (50, 0), "300 of 512 rows: 250 are no more than half"
    full.unlink()
    clock.now_s += 0.49
    files.check()
    files.write_until(256)
    assert memory.ring.saved == 0
    clock.now_s += 0.01
    files.check()
    files.write_until(256)
    assert (memory.ring.tail, memory.ring.saved, files.failing) == (256, 206, None)
    files.finish({})
    assert counts(tmp_path / "run.mcap")["rows_lost"] == 50
    found = decode(tmp_path / "run.mcap")[0]
    assert found["notes"] == ["run.mcap: 50 rows (0 to 49), before t = 0.05 s, were lost when the run was recorded"]


def test_waits_are_counted_anew_after_each_step_of_the_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(started_process, "_WAIT_S", 0.0)
    stall = StallTimeout(3)
    progress = [1, 1, 2, 3, 3, 3, 3]
    assert [stall.wait(one) for one in progress] == [True, True, True, True, True, False, False]


def test_what_cannot_be_finished_is_tried_once_more_and_then_told(
    memory: Memory, tmp_path: Path, clock: StandingClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file vanishes when the end of the run is written, and so does the next one."""
    files = memory.files()
    put(memory, 0, 5)
    files.write_until(5)
    real = RunFiles._check_there

    def vanishes(self: RunFiles) -> None:
        self._file_path.unlink()
        real(self)

    monkeypatch.setattr(RunFiles, "_check_there", vanishes)
    files.finish({"passed": True})
    gone = "it could not be written any more (run-2.mcap was removed)"
    assert files.summary_trouble == f"its summary could not be written: {gone}"
    assert (memory.ring.tail, memory.ring.saved) == (5, 0)
    assert list(tmp_path.iterdir()) == []


def test_an_index_that_was_not_written_is_told(memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing fails without an error, as rerun's writer may."""
    files = memory.files()
    put(memory, 0, 5)
    monkeypatch.setattr(McapFile, "close", lambda file: file._file.close())
    files.finish({"passed": True})
    assert (files.trouble, files.summary_trouble) == ("the index at the end of run.mcap could not be written", None)


class Viewers:
    """What live viewers get."""

    error = "it ended"

    def __init__(self, port: int, **columns: Any) -> None:
        self.told: list[object] = [port, sorted(columns)]
        SERVERS.append(self)

    def rows(self, rows: np.ndarray) -> None:
        self.told.append(rows[:, INDEX["loop.tick"]].tolist())

    def event(self, *event: object) -> None:
        self.told.append(event)

    def finish(self, *told: object) -> None:
        self.told.append(told)

    def close(self) -> None:
        self.told.append("closed")


SERVERS: list[Viewers] = []


@pytest.fixture
def ring() -> Iterator[tuple[RingWriter, RingReader]]:
    block = SharedBlock.reserve().allocate(ring_bytes(9, len(SIGNAL_NAMES)))
    writer, reader = RingWriter(block, 9, len(SIGNAL_NAMES)), RingReader(block)
    yield writer, reader
    reader.close()
    writer.close()
    block.close()


def test_viewers_get_each_row_at_the_poll_after_it_and_a_batch_is_half_the_ring(
    ring: tuple[RingWriter, RingReader], monkeypatch: pytest.MonkeyPatch
) -> None:
    import hil.record.recorder as recorder_module

    clock, (writer, reader) = StandingClock(), ring
    monkeypatch.setattr(recorder_module, "time", clock)
    config = {"path": None, "live_port": 9876, "restarts": 0, "viewer": {"live": f"{__name__}:Viewers"}}
    recorder = Recorder(config | {"recording_id": "one", "signals": [], "properties": {}}, reader)
    server = SERVERS.pop()
    rows = iter(circle_rows(30))
    tails = []
    for count in (2, 2, 0, 1, 0):
        for _ in range(count):
            assert writer.try_put(pack_row(next(rows)))
        recorder.poll()
        tails.append(reader.tail)
    assert tails == [0, 0, 0, 0, 5], "five rows, more than half of nine, are a batch"
    assert writer.try_put(pack_row(next(rows)))
    recorder.poll()
    clock.now_s += BATCH_AGE_S - 0.01
    recorder.poll()
    assert reader.tail == 5
    clock.now_s += 0.011
    recorder.poll()
    assert reader.tail == 6, "a smaller one is written when it is old enough"
    recorder.line({"event": [0.5, "info", "a line"]})
    assert writer.try_put(pack_row(next(rows)))
    report = recorder.finish({"passed": True})
    recorder.close()
    assert report == {"rows_written": 0, "live_error": "it ended"}
    assert recorder.failing is None
    assert (reader.tail, reader.lines_saved) == (7, 1)
    assert server.told == [
        9876, ["properties", "recording_id", "signals"], [0.0, 1.0], [2.0, 3.0], [4.0], [5.0], (0.5, "info", "a line"),
        [6.0], ({"passed": True}, {"rows_written": 0, "rows_dropped": 0}), "closed",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "No space left on device"), "No space left on device; make room on the disk, or run without"),
        (OSError(98, "Address in use"), "Address in use on 127.0.0.1; end the program that uses it, or choose another"),
        (RuntimeError("odd"), "odd on 127.0.0.1; end the program that uses it, or choose another port"),
    ],
)
def test_a_port_that_cannot_be_served_is_refused_at_the_start_and_told_later(
    ring: tuple[RingWriter, RingReader], monkeypatch: pytest.MonkeyPatch, error: Exception, sentence: str
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(Viewers, "__init__", fails)
    config = {"path": None, "live_port": 9876, "viewer": {"live": f"{__name__}:Viewers"}}
    config |= {"recording_id": "one", "signals": [], "properties": {}}
    with pytest.raises(run_files.RefusedError, match=rf"^live port 9876: {sentence}"):
        Recorder(config | {"restarts": 0}, ring[1])
    assert str(Recorder(config | {"restarts": 1}, ring[1]).finish({})["live_error"]).startswith("live port 9876: ")
    missing = {"viewer": {"live": "no_rerun:Viewers"}, "restarts": 0}
    with pytest.raises(run_files.RefusedError, match=r"'no_rerun'; install rerun-sdk==0.41.\*, or run without --live$"):
        Recorder(config | missing, ring[1])


def test_a_file_that_is_cut_where_a_record_ends_has_all_records_before(memory: Memory, tmp_path: Path) -> None:
    files = memory.files()
    put(memory, 0, 20)
    for stop in (3, 9, 20):
        files.event(0.001 * stop, "info", f"before {stop}")
        files.write_until(stop)
    files.finish({"passed": True})
    data = (tmp_path / "run.mcap").read_bytes()
    ends, place = [], 8  # magic; then records of kind, length and content
    while place + 9 < len(data) - 8:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
        ends.append(place)

    def found(length: int) -> tuple[list[float], list[str]]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:length])
        try:
            run = decode_mcap(cut)
        except DamagedError:  # before the first row
            return [], []
        return run.signals["loop.tick"].tolist(), [text for *_, text in run.events]

    whole = [found(end) for end in ends]
    assert [found(end + 1) for end in ends] == whole, "a byte of the next record changes nothing"
    assert whole[-1] == ([*range(20)], ["before 3", "before 9", "before 20"])
    assert len({len(ticks) for ticks, _ in whole}) > 3
