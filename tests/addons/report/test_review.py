"""Reading a recording back: the real recorder wrote it, cut and foreign files are told apart."""

import importlib.util
import os
import random
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode

import hil
from hil.addons.report.review_command import review as command
from hil.core.errors import BadInputError
from hil.core.options import options_of
from hil.core.ports import Event
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.judge.figures import MEASURES, signal_figures
from hil.judge.recorded import judged_run, review
from hil.judge.run_json import to_json
from hil.record.contents import DamagedError
from hil.record.decode import decode
from hil.record.properties import SIGNALS_PATH
from hil.record.reader import RecordedRun, read
from hil.record.recording import Recording
from hil.scenario.trial import AllowTable
from tests.support.recorded_circle import circle_table, column

ROWS = 6000
PROPERTIES = {"scenario_name": "made_up_circle", "law": "none", "scenario": '{"robot.mass_kg": 20.0}' + " " * 5000}
SUMMARY = {
    "passed": True,
    "realtime_factor": None,
    "lateness_us": {"p50": 31.0, "p99": 65.0, "p99.9": 640.0, "max": 8700.0, "edges": [1.0], "counts": [0, 12]},
    "frames": {"sent": 12, "received": 34, "rejected": {"crc": 1}},
    "link_statistics": {"lost": {"snapshots": 3}, "load": None, "reasons": {"load": "memory has no bit rate"}},
    "pose_fixes": {"received": 60, "accepted": 58, "refused": {"waited": 12}},
    "wire_sha256": "ab" * 32,
    "stale_ticks": 3,
    "allow": [{"name": name, "passed": True, "text": ""} for name in options_of(AllowTable)],
    "robot_slipped_ticks": 7,
    "reasons": {"realtime_factor": "because"},
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("review") / "run.rrd")


@pytest.fixture(scope="module")
def mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("review") / "run.mcap")


def recorded(path: Path) -> Path:
    with Recording(path, properties=PROPERTIES, blocking=True) as recorder:
        recorder.event(-0.02, "info", "ARMED")
        for row in circle_table(ROWS):
            recorder.put(pack_row(tuple(row)))
        recorder.event(5.4, "warning", "STOPPING: host request")
        assert recorder.finish(SUMMARY).complete
    return path


@pytest.fixture(scope="module")
def run(recording: Path) -> RecordedRun:
    return read(recording)


def test_every_signal_comes_back_bit_for_bit(run: RecordedRun) -> None:
    table = circle_table(ROWS)
    assert sorted(run.signals) == sorted(SIGNAL_NAMES)
    for name in SIGNAL_NAMES:
        assert run.signals[name].tobytes() == np.ascontiguousarray(column(table, name)).tobytes(), name


def test_what_the_run_was_and_said_comes_back(run: RecordedRun) -> None:
    assert run.properties == PROPERTIES
    assert run.summary == SUMMARY
    assert run.rows_dropped == 0
    assert run.events == (Event(-0.02, "INFO", "ARMED"), Event(5.4, "WARN", "STOPPING: host request"))


def test_a_review_has_the_figures_of_the_run(recording: Path, run: RecordedRun) -> None:
    table = circle_table(ROWS)
    of_signals, reasons = signal_figures({name: column(table, name) for name in SIGNAL_NAMES})
    reviewed = to_json(judged_run(run))
    assert reviewed.pop("reasons") == {**reasons, "realtime_factor": "because"}
    kept = ("passed", "realtime_factor", "frames", "link_statistics", "pose_fixes", "wire_sha256")
    expected = {**of_signals, **{name: SUMMARY[name] for name in kept}, "recording": str(recording)}
    assert {name: reviewed[name] for name in expected} == expected
    assert (reviewed["scenario"], reviewed["law"], reviewed["notes"]) == ("made_up_circle", "none", [])
    assert reviewed["events"][0] == {"t_s": -0.02, "level": "INFO", "text": "ARMED"}


def test_a_review_prints_what_the_robot_knew_of_itself(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command([recording])
    printed = capsys.readouterr().out
    assert "pose fixes             60 received, 58 accepted, refused: waited 12" in printed
    assert "virtual robot          lost 7 ms of its time to stalls of this machine" in printed
    assert "stale                  3 ticks, in which the feedback or the truth was too" in printed


@pytest.mark.skipif(importlib.util.find_spec("pandas") is None, reason="needs pandas")
def test_a_frame_has_a_column_for_each_signal(recording: Path, run: RecordedRun) -> None:
    frame = hil.load(recording).frame()
    assert frame.shape == (ROWS, len(SIGNAL_NAMES))
    assert frame["reference.x_m"].loc[1.0] == run.signals["reference.x_m"][1000]


def test_states_are_recorded_by_name_where_they_change(recording: Path) -> None:
    import rerun.chunk as rrc

    chunks = rrc.RrdReader(recording).stream().filter(content="/state/2_robot", components="StateChange:state")
    changes = [
        (record["t"].total_seconds(), record["StateChange:state"][0])
        for chunk in chunks
        for record in chunk.to_record_batch().to_pylist()
    ]
    assert sorted(changes) == [(0.0, "ACTIVE"), (1.4, "STOPPING")]


@pytest.mark.parametrize(("kind", "count", "last"), [("recording", 12, (1,)), ("mcap", 12, range(1, 48, 3))])
def test_a_recording_cut_anywhere_gives_a_prefix_and_a_note(
    kind: str, count: int, last: Iterable[int], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Decoded in this process, to save the start of another for each cut; none of these may bring it down."""
    path: Path = request.getfixturevalue(kind)
    whole = path.read_bytes()
    table = circle_table(ROWS)
    cut = tmp_path / f"cut{path.suffix}"
    lengths = []
    anywhere = random.Random(1).sample(range(len(whole) // 4, len(whole)), count)
    for size in sorted({*anywhere, *(len(whole) - n for n in last)}):
        cut.write_bytes(whole[:size])
        decoded, signals = decode(cut)
        lengths.append(decoded["rows"])
        assert [note[: len("cut.mcap has no")].rstrip() for note in decoded["notes"]] == [f"{cut.name} has no"]
        for name in SIGNAL_NAMES:
            expected = np.ascontiguousarray(column(table, name)[: decoded["rows"]])
            assert signals[name].tobytes() == expected.tobytes(), name
    assert lengths == sorted(lengths)
    assert lengths[0] > 0
    assert lengths[-1] == ROWS


@pytest.mark.parametrize("kind", ["recording", "mcap"])
def test_a_file_without_its_index_says_so_and_how_many_bytes_were_cut_short(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    path: Path = request.getfixturevalue(kind)
    cut = tmp_path / f"cut{path.suffix}"
    cut.write_bytes(path.read_bytes()[:-1])
    run = read(cut, ["loop.tick"])
    assert len(run.signals["loop.tick"]) == ROWS
    assert run.summary == SUMMARY
    [note] = run.notes
    left = {".rrd": 31, ".mcap": 7}[path.suffix]  # of what closes a file of 32 and of 8 bytes
    assert note.startswith(f"{cut.name} has no index at its end: ")
    assert f"and its last {left} bytes, which were cut short, are left out" in note


@pytest.mark.parametrize("kind", ["recording", "mcap"])
def test_what_is_cut_before_its_first_rows_is_not_called_foreign(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    path: Path = request.getfixturevalue(kind)
    cut = tmp_path / f"cut{path.suffix}"
    for size, problem in (
        (20, "cut off so early that its program is not known"),
        (1000, "cut before its"),
    ):
        cut.write_bytes(path.read_bytes()[:size])
        with pytest.raises(DamagedError, match=problem):
            decode(cut)


def test_a_recording_without_a_row_has_a_reason_for_each_figure_that_it_lacks(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with Recording(path, properties={}, blocking=True):
        pass  # the run ended before it began, and without a summary
    found = review(path)
    assert found["ticks"] == 0
    judged = (*dict.fromkeys(one.name.partition(".")[0] for kind in MEASURES for one in kind.figures), *SUMMARY)
    without = {name for name in judged if found.get(name) is None} - {
        "reasons",
        "stale_ticks",
        "allow",
        "robot_slipped_ticks",
    }
    assert without == set(found["reasons"])
    assert found["failure"] == "the recording has no summary: the run did not come to its end"


def problem_of(path: Path) -> str | None:
    try:
        read(path)
    except BadInputError as error:
        return str(error)
    return None


def test_a_damaged_recording_is_read_or_refused_in_one_sentence(recording: Path, tmp_path: Path) -> None:
    whole = recording.read_bytes()
    damaged = tmp_path / "damaged.rrd"
    problems = []
    for seed in range(2):
        chance = random.Random(seed)
        content = bytearray(whole)
        for _ in range(200):
            content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        damaged.write_bytes(content)
        problems.append(problem_of(damaged))
    damaged.write_bytes(whole[:300] + bytes(len(whole) - 300))
    problems.append(problem_of(damaged))
    refused = [problem for problem in problems if problem is not None]
    assert refused
    for problem in refused:
        # Not always "damaged": where the length of a message is, the file ends for its reader.
        assert problem.startswith(f"{damaged}: ")
        assert "\n" not in problem
        assert "; expected an .rrd or .mcap file made by 'hil run --record'" in problem


def test_spoilt_rows_are_left_out(recording: Path, run: RecordedRun, tmp_path: Path) -> None:
    """400 bytes in the middle of the longest message of rows."""
    whole = recording.read_bytes()
    start, messages = 12, []
    while start < len(whole) - 32:
        length = int.from_bytes(whole[start + 8 : start + 16], "little")
        if SIGNALS_PATH.encode() in whole[start : start + 16 + min(length, 1000)]:
            messages.append((length, start))
        start += 16 + length
    length, start = max(messages)
    middle = start + 16 + length // 2
    spoilt = tmp_path / "spoilt.rrd"
    spoilt.write_bytes(whole[:middle] + random.Random(1).randbytes(400) + whole[middle + 400 :])
    left = read(spoilt)
    places = np.searchsorted(run.signals["loop.tick"], left.signals["loop.tick"])
    assert 0 < len(places) == ROWS - left.rows_missing < ROWS
    assert all(np.array_equal(left.signals[name], run.signals[name][places], equal_nan=True) for name in run.signals)
    assert to_json(judged_run(left))["ticks"] == ROWS
    assert not to_json(judged_run(left))["passed"]
    assert "cannot be read and are left out" in left.notes[-1]


def test_a_recording_that_crashes_its_decoder_is_refused(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rerun's reader aborts on some damage; what does that for certain changes with its version, so abort for it."""
    (tmp_path / "sitecustomize.py").write_text("import os; os.abort()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(BadInputError, match="its content makes no sense"):
        read(recording)


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"", "is empty"), (b"hello world\n" * 99, "not a recording"), (b"RRF2" + bytes(8), "cut off so early")],
)
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "foreign.rrd"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=problem):
        review(path)


def test_a_missing_file_and_a_directory_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="No such file"):
        review(tmp_path / "missing.rrd")
    (tmp_path / "missing-2.rrd").touch()
    with pytest.raises(BadInputError, match=r"there is \S*missing-2\.rrd, a later part of it"):
        review(tmp_path / "missing.rrd")
    with pytest.raises(BadInputError, match="Is a directory" if os.name == "posix" else ""):
        review(tmp_path)


def test_a_recording_of_another_program_is_refused(tmp_path: Path) -> None:
    import rerun as rr

    path = tmp_path / "other.rrd"
    other = rr.RecordingStream("other")
    other.set_sinks(rr.FileSink(path))
    other.log("/a", rr.Scalars([1.0]))
    other.flush()
    other.disconnect()
    with pytest.raises(BadInputError, match="another program"):
        read(path)


def chunks(path: Path) -> list[tuple[int, int]]:
    """Return where each chunk of an MCAP file begins and how long it is, with its head of 9 bytes."""
    content, place, found = path.read_bytes(), 8, []
    while place + 9 < len(content):
        length = 9 + int.from_bytes(content[place + 1 : place + 9], "little")
        if content[place] == Opcode.CHUNK:
            found.append((place, length))
        place += length
    return found


@pytest.mark.parametrize("from_end", [20, 40, 200, 1000])
def test_a_recording_with_a_damaged_index_is_read_without_it(recording: Path, tmp_path: Path, from_end: int) -> None:
    damaged = tmp_path / "run.rrd"
    content = bytearray(recording.read_bytes())
    content[-from_end] ^= 1
    damaged.write_bytes(content)
    whole, run = read(recording), read(damaged)
    assert run.notes == ("run.rrd is damaged: its index cannot be read; every row was read without it",)
    assert all(np.array_equal(run.signals[name], whole.signals[name], equal_nan=True) for name in whole.signals)


@pytest.mark.parametrize("which", [0, 1, -1])
def test_one_damaged_chunk_is_left_out_and_what_is_lost_with_it_is_said(mcap: Path, tmp_path: Path, which: int) -> None:
    damaged = tmp_path / "run.mcap"
    content = bytearray(mcap.read_bytes())
    begin, length = chunks(mcap)[which]
    content[begin + length - 50] ^= 1
    damaged.write_bytes(content)
    whole, run = read(mcap), read(damaged)
    assert run.summary == SUMMARY
    assert all(note.startswith("run.mcap is damaged: ") for note in run.notes)
    ticks = run.signals["loop.tick"]
    lost = ROWS - len(ticks)
    if lost:
        assert run.rows_missing == lost
        gone = np.setdiff1d(whole.signals["loop.tick"], ticks)
        assert f"{lost} rows ({gone[0]:.0f} to {gone[-1]:.0f}), " in run.notes[0]
        assert run.notes[0].endswith(" cannot be read and are left out")
        assert to_json(judged_run(run))["ticks"] == ROWS
    else:
        assert len(run.events) < len(whole.events)
        assert "cannot be read and" in run.notes[-1]
        assert f"{len(whole.events) - len(run.events)} event" in run.notes[-1]
    assert np.isin(ticks, whole.signals["loop.tick"]).all()


def test_a_file_of_which_no_chunk_is_whole_is_damaged(mcap: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "run.mcap"
    content = bytearray(mcap.read_bytes())
    for begin, length in chunks(mcap):
        content[begin + length - 50] ^= 1
    damaged.write_bytes(content)
    with pytest.raises(DamagedError, match="none of its rows can be read"):
        decode(damaged)


def test_a_recording_that_was_cut_before_its_first_row_is_none_of_a_run_of_no_ticks(mcap: Path, tmp_path: Path) -> None:
    cut = tmp_path / "run.mcap"
    first = chunks(mcap)[0][0]
    for size in (first, first + 20):
        cut.write_bytes(mcap.read_bytes()[:size])
        with pytest.raises(BadInputError, match="cut before its first rows"):
            read(cut)
