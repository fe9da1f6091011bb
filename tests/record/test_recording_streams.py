"""Files of both formats, written and read in this process: what is damaged in them is told to the row and the byte."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.opcode import Opcode

from hil.core.signals import SIGNAL_NAMES
from hil.record import decode_mcap, decode_rrd, stream
from hil.record.checks import Contained
from hil.record.contents import Contents, DamagedError
from hil.record.decode import decode
from hil.record.mcap_file import McapFile
from hil.record.ring import Rows
from hil.record.stream import RowTimes, Stream, nanoseconds
from tests.support.recorded_circle import circle_table

PIECES = (4, 5, 6)
ROWS = sum(PIECES)
PART = {"recording_id": "one", "number": 1, "first_row": 0, "first_event": 0}
LEFT_OUT = "cannot be read and are left out"


class Drawing:
    """Notes what it is asked to show."""

    blueprint = None

    def __init__(self, *_: object) -> None:
        self.told: list[Any] = []
        DRAWINGS.append(self)

    def describe(self) -> None:
        self.told.append("describe")

    def rows(self, rows: Rows) -> None:
        self.told.append(rows[:, SIGNAL_NAMES.index("loop.tick")].tolist())

    def event(self, *event: object) -> None:
        self.told.append(event)

    def finish(self, *told: object) -> None:
        self.told.append(told)


DRAWINGS: list[Drawing] = []


def written(path: Path, *, ends: bool = True, make_drawing: Any = None) -> Path:
    """Write rows in pieces, each in a chunk of its own, with an event after each."""
    file: McapFile | Stream
    if path.suffix == ".mcap":
        file = McapFile(path, 10**18, signals=SIGNAL_NAMES, properties={"law": "none"}, part=PART, make_frames=None)
    else:
        import rerun as rr

        columns = {"signals": SIGNAL_NAMES, "properties": {"law": "none"}, "part": PART}
        file = Stream(rr.FileSink(path), recording_id="one", path=path, make_drawing=make_drawing, **columns)
    table, begin = circle_table(ROWS), 0
    for count in PIECES:
        file.rows(table[begin : begin + count], begin if begin else None)
        begin += count
        file.flush()
        file.event(begin / 1000, "warning", f"after {begin}")
        file.flush()
    if ends:
        file.finish({"passed": True}, {"rows_in_part": ROWS})
    file.close()
    return path


@pytest.fixture(params=[".mcap", ".rrd"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return written(tmp_path / f"run{request.param}")


def read(path: Path, selection: list[str] | None = None) -> Contents:
    module = {".mcap": decode_mcap.decode_mcap, ".rrd": decode_rrd.decode_rrd}[path.suffix]
    return module(path, selection)


def assert_whole(found: Contents) -> None:
    table = circle_table(ROWS)
    assert sorted(found.signals) == sorted(SIGNAL_NAMES)
    for i, name in enumerate(SIGNAL_NAMES):
        assert found.signals[name].tobytes() == table[:, i].tobytes(), name
    assert found.events == [(n / 1000, "WARN", f"after {n}") for n in (4, 9, 15)]


def test_an_event_is_in_the_file_as_soon_as_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    file = McapFile(path, 10**18, signals=SIGNAL_NAMES, properties={}, part=PART, make_frames=None)
    file.rows(circle_table(2))
    file.event(0.25, "error", "it is lost")
    assert read(path).events == [(0.25, "ERROR", "it is lost")]
    file.close()


def test_a_stream_that_cannot_be_flushed_at_its_end_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rerun as rr

    columns: dict[str, Any] = {"signals": SIGNAL_NAMES, "properties": {}, "make_drawing": None}
    stream = Stream(rr.FileSink(tmp_path / "run.rrd"), recording_id="one", **columns)

    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(stream._rerun, "flush", fails)
        with pytest.raises(RuntimeError, match="the disk is full"):
            stream.close()
    stream.close()


def test_a_file_is_read_alike_whatever_the_size_of_the_pieces(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decode_mcap, "_COPY_BYTES", 37)
    monkeypatch.setattr(decode_rrd, "_COPY_BYTES", 37)
    monkeypatch.setattr(decode_rrd, "_GROWN_ROWS", 2)
    found = read(path)
    assert_whole(found)
    assert (found.damage, found.remarks, found.cut_bytes, found.lost_rows, found.lost_events) == ((), (), None, 0, 0)
    assert found.numbers is not None
    assert found.numbers.tolist() == list(range(ROWS))
    some = read(path, ["error.y_m", "loop.t_s"]).signals
    assert some.keys() == {"error.y_m", "loop.t_s"}
    assert some["error.y_m"].tobytes() == found.signals["error.y_m"].tobytes()
    path.write_bytes(path.read_bytes()[:-1])
    cut = read(path)
    assert_whole(cut)
    assert cut.cut_bytes == {".mcap": 7, ".rrd": 31}[path.suffix]


def records(path: Path) -> Iterator[tuple[int, int, int]]:
    """Yield where each record of an MCAP file begins, its kind and its length."""
    content, place = path.read_bytes(), 8
    while place < len(content) - 8:
        kind, length = struct.unpack_from("<BQ", content, place)
        yield place, kind, length
        place += 9 + length


def flip(path: Path, place: int, mask: int = 1) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= mask
    path.write_bytes(content)


def damage_chunk(path: Path, which: int) -> None:
    """Spoil the compressed content of a chunk: 0, 2 and 4 have rows, 1, 3 and 5 an event."""
    at = [(place, length) for place, kind, length in records(path) if kind == Opcode.CHUNK]
    place, length = at[which + len(at) - 6]
    flip(path, place + 9 + length - 20)


def test_a_damaged_chunk_costs_its_rows_or_its_event(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    damage_chunk(path, 2)
    found = read(path)
    assert found.damage == (f"5 rows (4 to 8), after t = 0.003 s and before t = 0.009 s, {LEFT_OUT}",)
    assert (found.lost_rows, found.lost_events) == (5, 0)
    assert found.signals["loop.tick"].tolist() == [0, 1, 2, 3, 9, 10, 11, 12, 13, 14]
    damage_chunk(path, 3)
    found = read(path)
    assert (found.lost_rows, found.lost_events, len(found.damage)) == (5, 1, 3)
    assert found.damage[0].startswith("what was recorded from t = 0.009 s to 0.009 s cannot be read and are left out: ")
    assert found.damage[1] == "1 event cannot be read and is left out"
    assert [text for *_, text in found.events] == ["after 4", "after 15"]


def test_of_a_file_without_its_end_the_last_damaged_chunk_is_told_by_its_times(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", ends=False)
    whole = path.read_bytes()
    damage_chunk(path, 2)
    assert read(path).damage == (f"5 rows (4 to 8), after t = 0.003 s and before t = 0.009 s, {LEFT_OUT}",)
    damage_chunk(path, 4)
    assert [one.partition(": ")[0] for one in read(path).damage] == [
        f"5 rows from t = 0.004 s to 0.008 s {LEFT_OUT}", f"6 rows from t = 0.009 s to 0.014 s {LEFT_OUT}",
    ]  # fmt: skip
    path.write_bytes(whole)
    damage_chunk(path, 4)
    assert [one[:32] for one in read(path).damage] == ["6 rows from t = 0.009 s to 0.014"]


def test_of_a_version_without_check_values_each_damaged_chunk_is_told_by_its_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Contained, "checked", lambda _self, _name, texts: dict(texts))
    path = written(tmp_path / "run.mcap")
    whole = read(path)
    assert_whole(whole)
    assert (whole.damage, whole.numbers) == ((), None)
    assert whole.remarks == ("a version without check values recorded it: damage of its properties cannot be noticed",)
    damage_chunk(path, 2)
    damage_chunk(path, 4)
    found = read(path)
    assert [one.partition(": ")[0] for one in found.damage] == [
        f"5 rows from t = 0.004 s to 0.008 s {LEFT_OUT}", f"6 rows from t = 0.009 s to 0.014 s {LEFT_OUT}",
    ]  # fmt: skip
    assert found.lost_rows == 11
    assert found.signals["loop.tick"].tolist() == [0, 1, 2, 3]


def test_bytes_between_the_chunks_and_behind_them_are_compared_too(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    whole = path.read_bytes()
    indexes = [(place, length) for place, kind, length in records(path) if kind == Opcode.MESSAGE_INDEX]
    (statistics,) = [place for place, kind, _ in records(path) if kind == Opcode.STATISTICS]
    place, length = indexes[2]
    differ = "that are not read here differ from their check value (CRC-32)"
    flip(path, place + 9 + length - 1)
    assert read(path).damage == (f"records {differ}",)
    path.write_bytes(whole)
    flip(path, statistics + 9)
    assert read(path).damage == (f"parts of its index {differ}",)
    for at, mask in ((place, 0x70), (place + 9 + 2, 4), (place + 9 + 5, 1)):
        path.write_bytes(whole)
        flip(path, at, mask)
        assert read(path).damage == (f"{length} bytes from byte {place} on {LEFT_OUT}",)
        assert_whole(read(path))


def test_what_names_no_signals_is_no_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "run.mcap")
    monkeypatch.setattr(decode_mcap, "SIGNALS_TOPIC", "/other")
    with pytest.raises(DamagedError, match=r"^damaged: it does not say what its signals are$"):
        read(path)


def test_a_record_that_is_too_long_to_be_read_is_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "run.mcap")
    longest = max(length for _, opcode, length in records(path) if opcode == Opcode.CHUNK)
    monkeypatch.setattr(decode_mcap, "_LONGEST_RECORD_BYTES", longest - 1)
    with pytest.raises(
        DamagedError, match=rf"^damaged: CHUNK record has length {longest} that exceeds limit {longest - 1}$"
    ):
        read(path)


def of_rerun(path: Path, **properties: Any) -> Any:
    """Return rerun's own stream into a file, with the JSON of these properties and without check values."""
    import rerun as rr

    stream = rr.RecordingStream("mecanum-hil", recording_id="one")
    stream.set_sinks(rr.FileSink(path))
    for name, content in properties.items():
        stream.send_property(name, rr.AnyValues(json=json.dumps(content)))
    return stream


def test_an_overlay_of_an_older_version_is_no_recording(tmp_path: Path) -> None:
    of_rerun(tmp_path / "two.rrd", overlay=["one", "another"]).disconnect()
    with pytest.raises(DamagedError, match=r"^an overlay of two runs$"):
        read(tmp_path / "two.rrd")


def test_without_check_values_a_message_that_makes_no_sense_is_damage(tmp_path: Path) -> None:
    import rerun as rr

    stream = of_rerun(tmp_path / "run.rrd", signals={"/signals": ["a"]})
    words = rr.AnyValues.columns(number_crc32=np.zeros(4, np.uint64)).partition([2, 2])
    stream.send_columns("/signals", [rr.TimeColumn("tick", sequence=[0, 1])], words)
    stream.disconnect()
    with pytest.raises(DamagedError) as refused:
        read(tmp_path / "run.rrd")
    assert str(refused.value) == "damaged: 1 of its messages make no sense: /signals has 4 check values for 2 rows"


def test_a_message_that_rerun_cannot_read_is_counted_and_left_out(tmp_path: Path) -> None:
    path = written(tmp_path / "run.rrd")
    with path.open("rb") as file:
        begins = [begin for _, (begin, _) in decode_rrd._messages(file)]
    flip(path, begins[-7] + 16, 0xFF)  # before index, counts, summary, event, rows and event
    found = decode(path)[0]
    assert found["notes"] == [
        "run.rrd is damaged: 1 of its 12 messages cannot be read",
        f"run.rrd is damaged: 5 rows (4 to 8), after t = 0.003 s and before t = 0.009 s, {LEFT_OUT}",
    ]
    assert (found["rows"], found["rows_missing"]) == (10, 5)


def test_what_was_lost_behind_a_cut_is_told(path: Path) -> None:
    why = "the recorder was killed or could not write it, or the file was cut, and what came after"
    written(path, ends=False)
    assert decode(path)[0]["notes"] == [f"{path.name} has no end: {why} is lost"]
    path.write_bytes(path.read_bytes()[:-9])
    cut = {".mcap": 37 - 9, ".rrd": 32 - 9}[path.suffix]  # what is left of the record at the end
    why += f", with its last {cut} bytes, which were cut short,"
    assert decode(path)[0]["notes"] == [f"{path.name} has no end: {why} is lost"]


def test_the_views_get_rows_in_large_pieces_and_the_rest_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "_DRAWN_AT_ONCE", 9)
    written(tmp_path / "run.rrd", make_drawing=Drawing)
    assert DRAWINGS.pop().told == [
        "describe", (0.004, "WARN", "after 4"), [float(n) for n in range(9)], (0.009, "WARN", "after 9"),
        (0.015, "WARN", "after 15"), [float(n) for n in range(9, 15)], ({"passed": True}, None),
    ]  # fmt: skip
    end = decode_rrd.decode_rrd(tmp_path / "run.rrd", None).properties.end
    assert (end["rows_until"], end["events_until"], end["rows_in_part"]) == (15, 3, 15)
    assert end["holds"] == ["part", "signals", "run", "summary"]


def test_a_row_without_a_time_has_that_of_the_last_one() -> None:
    times = RowTimes({"x": 0, "loop.tick": 1, "loop.t_s": 2})
    nan = np.nan
    rows = np.array([[9, nan, nan], [9, 1, 0.5], [9, nan, 0.75], [9, 3, np.inf]])
    assert times(rows).tolist() == [[0, 0], [0.5, 1], [0.75, 1], [0.75, 3]]
    assert times(np.array([[9, nan, nan], [9, 7, nan]])).tolist() == [[0.75, 3], [0.75, 7]]
    assert nanoseconds(np.array([1e-9, 0.0015, 1.0000000006])).tolist() == [1, 1_500_000, 1_000_000_001]


def test_parts_are_read_as_one_and_what_is_between_them_is_counted(tmp_path: Path) -> None:
    """Of the rows and events that two parts have, those of the later one count."""
    table = circle_table(30)

    def part(number: int, rows: range, events: range, **told: int) -> None:
        first = {"first_row": rows[0], "first_event": events[0]}
        path = tmp_path / ("run.mcap" if number == 1 else f"run-{number}.mcap")
        file = McapFile(path, 10**18, signals=SIGNAL_NAMES, properties={}, part=PART | first | {"number": number},
                        make_frames=None)  # fmt: skip
        file.rows(table[rows[0] : rows[-1] + 1])
        for event in events:
            file.event(0.001 * event, "info", f"event {event} of part {number}")
        if told:
            file.finish(None, told)
        file.close()

    part(1, range(12), range(4))  # it was killed before it could count the last two of each
    part(2, range(10, 20), range(2, 5), rows_in_part=10)
    part(3, range(23, 30), range(6, 7), rows_in_part=7, next_part=4)
    found, signals = decode(tmp_path / "run.mcap")
    assert signals["loop.tick"].tolist() == [*range(20), *range(23, 30)]
    assert [text for *_, text in found["events"]] == [
        "event 0 of part 1", "event 1 of part 1", "event 2 of part 2", "event 3 of part 2", "event 4 of part 2",
        "event 6 of part 3",
    ]  # fmt: skip
    assert found["notes"] == [
        "3 rows between its parts were lost", "1 events between its parts were lost",
        "the run went on in part 4, which is not read here",
    ]  # fmt: skip
    assert (found["rows"], found["rows_missing"], found["is_damaged"], found["is_continued"]) == (27, 3, False, True)
    (tmp_path / "run-3.mcap").write_bytes((tmp_path / "run-3.mcap").read_bytes()[:-3])
    assert decode(tmp_path / "run.mcap")[0]["notes"][2:] == [
        "run-3.mcap has no index at its end: the recorder was killed or could not write it, or the file was cut, and "
        "its last 5 bytes, which were cut short, are left out; all that the run recorded is before that",
        "the run went on in part 4, which is not read here",
    ]
    (tmp_path / "run-3.mcap").unlink()
    (tmp_path / "run-4.mcap").write_bytes(b"")
    assert decode(tmp_path / "run.mcap")[0]["notes"] == [
        f"run-4.mcap, by its name a part of it, is left out: {tmp_path / 'run-4.mcap'}: the file is empty; "
        "expected an .rrd or .mcap file made by 'hil run --record'",
    ]
