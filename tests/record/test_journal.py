"""The journal of a run: what is added comes back, in order, and a piece that is missing or damaged is told."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.core.clock import LockstepClock
from hil.core.types import MeasuredPose, Pose, PoseCovariance, PoseFix, Twist
from hil.record import journal as journals
from hil.record.journal import (
    Journal,
    JournalDamagedError,
    KeptFixes,
    KeptTruth,
    Kind,
    entries,
    fixes_of,
    frames_of,
    logs_of,
    truth_of,
)

FRAMES = st.lists(st.builds(Frame, st.integers(0, 0xFFFF_FFFF), st.binary(max_size=70)), max_size=5)
TIMES = st.integers(-(2**63), 2**63 - 1)


def written(journal):
    """What the journal gives to an event log: its texts."""
    lines = []
    journal.begin(lambda t_s, level, text: lines.append((level, text)))
    journal.flush()
    assert {level for level, _ in lines} <= {"journal"}
    return [text for _, text in lines]


@given(st.lists(st.tuples(st.sampled_from([Kind.SENT, Kind.RECEIVED, Kind.ARRIVED]), TIMES, TIMES, FRAMES)))
def test_frames_come_back_in_their_order(added):
    journal = Journal()
    for kind, time_ns, other_ns, frames in added:
        journal.frames(kind, time_ns, other_ns, frames)
    found = list(entries(written(journal)))
    assert [(one.kind, one.time_ns, one.other_ns, frames_of(one.body)) for one in found] == added


@given(st.lists(st.tuples(st.binary(max_size=9), st.binary(max_size=9)), max_size=4))
def test_logs_of_the_client_come_back_and_empty_ones_are_left_out(logs):
    journal = Journal()
    for sent, received in logs:
        journal.logs(sent, received)
    assert [logs_of(one.body) for one in entries(written(journal))] == [one for one in logs if any(one)]


@given(st.data())
def test_an_entry_may_reach_over_pieces_of_any_length(data):
    sizes = data.draw(st.lists(st.integers(0, 40), min_size=1, max_size=30))
    journal, lines = Journal(), []
    journal.begin(lambda t_s, level, text: lines.append(text))
    for number, size in enumerate(sizes):
        journal.add(Kind.EMPTY, number, 0, bytes(size))
        if data.draw(st.booleans()):
            journal.flush()
    journal.flush()
    assert [(one.time_ns, len(one.body)) for one in entries(lines)] == list(enumerate(sizes))


def test_a_piece_is_written_once_a_tick_when_it_is_long_enough(monkeypatch):
    monkeypatch.setattr(journals, "_PIECE_BYTES", 100)
    journal, lines = Journal(), []
    journal.add(Kind.EMPTY, 1_500_000_000, 0, bytes(99))
    journal.put(b"")
    journal.begin(lambda *line: lines.append(line))
    journal.put(b"")
    assert [(t_s, level) for t_s, level, _ in lines] == [(1.5, "journal")]
    journal.add(Kind.EMPTY, 2)
    journal.put(b"")
    assert len(lines) == 1


def pieces():
    journal, lines = Journal(), []
    journal.begin(lambda t_s, level, text: lines.append(text))
    for number in range(3):
        journal.add(Kind.EMPTY, number)
        journal.flush()
    return lines


def told(texts):
    """What is told of damaged pieces."""
    with pytest.raises(JournalDamagedError) as damage:
        list(entries(texts))
    return str(damage.value)


def test_damage_is_told_where_it_is():
    first, second, third = pieces()
    assert told([first, third]) == "piece 1 of its journal is missing"
    assert told([first, second[:-3] + "***"]) == "piece 1 of its journal is damaged"
    assert told([second]) == "piece 0 of its journal is missing"
    cut = first[:-8]
    assert told([cut]) == "the last entry of its journal is cut"
    wrong = "0 " + "/w" + first[4:]
    assert told([wrong]).startswith("piece 0 of its journal has an entry of kind 255")


def test_entries_before_the_damage_are_read():
    first, _, third = pieces()
    found = entries([first, third])
    assert next(found).time_ns == 0
    with pytest.raises(JournalDamagedError):
        next(found)


class Source:
    def __init__(self, *answers):
        self.answers = iter(answers)
        self.skipped = 0

    def poll(self, *_):
        return next(self.answers)

    def skip(self):
        self.skipped += 1

    restart = figures = close = skip


def test_true_poses_and_fixes_pass_unchanged_and_come_back():
    clock, journal = LockstepClock(), Journal()
    fix = PoseFix(7, Pose(1.0, 2.0, 3.0), Twist(4.0, 5.0, 6.0))
    truth = KeptTruth(Source(None, fix), journal, clock)
    assert [truth.poll(), truth.poll()] == [None, fix]
    measured = [MeasuredPose(i, Pose(0.1, 0.2, i), PoseCovariance(1, 2, 3, 4, 5, 6)) for i in range(2)]
    source = Source([], measured)
    fixes = KeptFixes(source, journal, clock)
    assert [fixes.poll(0, None), fixes.poll(0, fix)] == [[], measured]
    fixes.skip()
    assert source.skipped == 1
    found = list(entries(written(journal)))
    assert [truth_of(one.body) for one in found if one.kind is Kind.TRUTH] == [None, fix]
    assert [fixes_of(one.body) for one in found if one.kind is Kind.FIXES] == [[], measured]
