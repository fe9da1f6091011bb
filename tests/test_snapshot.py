"""Feedback commits as one snapshot a tick, or not at all."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from hil.core.types import WHEEL_NAMES, Wheels
from hil.robot.snapshot import Feedback, SnapshotReader
from hil.robot.wheel_map import WheelMap

ALL = 31


def snapshot(number, parts=ALL, time_us=None):
    tick = m.Tick(number * 5000 if time_us is None else time_us, number & 0xFF, 0, m.State.ACTIVE, parts, number & 0xFF)
    at = tick.time_us // 1000 & 0xFFFF
    rest = [
        m.Encoders(number & 0xFFFF, 2, 3, 4),
        m.WheelSpeeds(float(number % 100), 2.0, 3.0, 4.0),
        m.Currents(1.0, 2.0, 3.0, 4.0),
        m.Accelerometer(0.25, -0.5, 9.75, at),
        m.Gyro(0.0, 0.0, 0.5, at),
    ]
    return [tick, *(part for place, part in enumerate(rest) if parts >> place & 1)]


def feed(reader, messages):
    """Return every snapshot that the messages complete."""
    heard = []
    for message in messages:
        before, frame = reader.feedback, pack([codec.encode(message)])
        assert reader.read(frame, 0) == len(frame)
        if reader.feedback is not before:
            heard.append(reader.feedback)
    return heard


def test_a_whole_snapshot_commits_once():
    (feedback,) = feed(SnapshotReader(), snapshot(7))
    assert feedback.encoder_count == (7, 2, 3, 4)
    assert feedback.speed_rad_s == Wheels(7.0, 2.0, 3.0, 4.0)
    assert feedback.acceleration_m_s2 == (0.25, -0.5, 9.75)
    assert feedback.yaw_rate_rad_s == 0.5


@given(keep=st.lists(st.lists(st.booleans(), min_size=6, max_size=6), min_size=1, max_size=20))
def test_whole_snapshots_commit_and_others_do_not(keep):
    """Frames lost anywhere: what commits has its encoders and its gyro from the same sampling instant."""
    reader = SnapshotReader()
    stream, whole = [], []
    for number, kept in enumerate(keep):
        stream += [message for message, k in zip(snapshot(number), kept, strict=True) if k]
        if all(kept):
            whole.append(number)
    heard = [f.command_sequence for f in feed(reader, stream)]
    assert set(whole) <= set(heard)
    assert all(keep[number][0] for number in heard), "none without its own TICK"
    lost_inside = [n for n, kept in enumerate(keep) if kept[0] and not all(kept)]
    if all(kept[0] for kept in keep):
        assert not set(heard) & set(lost_inside), "none with a part missing"


def test_a_part_of_another_instant_is_not_mixed_in():
    reader = SnapshotReader()
    assert feed(reader, [*snapshot(1)[:4], *snapshot(2)[4:]]) == []
    assert feed(reader, [*snapshot(3)[:2], *snapshot(4)[1:]]) == []
    assert [f.encoder_count[0] for f in feed(reader, snapshot(5))] == [5]
    assert reader.incomplete == 2


def test_slow_parts_hold_their_value():
    reader = SnapshotReader()
    feed(reader, snapshot(1))
    (feedback,) = feed(reader, snapshot(2, parts=3))
    assert feedback.current_a == Wheels(1.0, 2.0, 3.0, 4.0)


def test_time_is_unwrapped():
    reader = SnapshotReader()
    a, b = feed(reader, snapshot(0, time_us=0xFFFF_FFF0) + snapshot(1, time_us=0x10))
    assert b.robot_time_ns - a.robot_time_ns == 0x20 * 1000


def test_gaps_are_counted():
    reader = SnapshotReader()
    feed(reader, [*snapshot(1), *snapshot(4)[:2], *snapshot(5)])
    assert (reader.lost, reader.incomplete) == (2, 1)


@given(order=st.permutations(WHEEL_NAMES), reversed_wheels=st.sets(st.sampled_from(WHEEL_NAMES)))
def test_wheel_map_is_undone_by_its_inverse(order, reversed_wheels):
    wheel_map = WheelMap(order, sorted(reversed_wheels))
    value = Wheels(1.0, 2.0, 3.0, 4.0)
    assert wheel_map.from_wire(wheel_map.to_wire(value)) == value
    channel = list(order).index("rl")
    assert wheel_map.to_wire(value)[channel] == (-4.0 if "rl" in reversed_wheels else 4.0)


def test_a_burst_joining_two_instants_is_told_by_inertial_parts_or_counted_as_lost():
    """PROTOCOL.md, "Feedback": all from ENCODERS to the next TICK is lost, and its parts follow."""
    reader = SnapshotReader()
    assert feed(reader, [snapshot(1)[0], *snapshot(2)[1:], *snapshot(3)]) == feed(SnapshotReader(), snapshot(3))
    assert (reader.incomplete, reader.lost) == (1, 1)
    blind = SnapshotReader()
    joined, _ = feed(blind, [snapshot(1, 3)[0], *snapshot(2, 3)[1:], *snapshot(3, 3)])
    assert (joined.robot_time_ns, joined.encoder_count[0]) == (5_000_000, 2)
    assert (blind.incomplete, blind.lost) == (0, 1)


PARTS = (m.Tick, m.Encoders, m.WheelSpeeds, m.Currents, m.Accelerometer, m.Gyro)


@pytest.mark.parametrize("kind", [*PARTS, m.StepDone])
def test_an_invalid_message_stays_where_it_is_and_breaks_the_snapshot_that_lacks_it(kind):
    reader = SnapshotReader()
    feed(reader, snapshot(1))
    whole = [codec.encode(message) for message in [*snapshot(2), m.StepDone(10), *snapshot(3)]]
    place = next(place for place, frame in enumerate(whole) if frame.id == kind.ID)
    whole[place] = Frame(kind.ID, whole[place].payload[:-1])
    before, packed = reader.feedback, pack(whole)
    spoilt_at = len(pack(whole[:place]))
    at = reader.read(packed, 0) if place else 0
    assert reader.read(packed, at) == at == spoilt_at, "again and again, until who asks steps over it"
    behind = len(pack(whole[: place + 1]))
    while behind < len(packed):
        behind = reader.read(packed, behind)
    if kind is m.StepDone:
        assert (reader.incomplete, reader.lost) == (0, 0)
    else:
        assert (reader.incomplete, reader.lost) == ((0, 1) if kind is m.Tick else (1, 0))
    assert reader.feedback is not None
    assert reader.feedback.command_sequence == 3
    assert before is not None
    assert before.command_sequence == 1


def test_it_begins_anew_with_another_robot():
    reader = SnapshotReader()
    (before,) = feed(reader, snapshot(200, time_us=0xFFFF_0000))
    reader.restart()
    assert feed(reader, snapshot(1)[1:]) == []
    (feedback,) = feed(reader, snapshot(3, parts=3, time_us=5))
    assert (feedback.robot_time_ns, reader.lost, reader.incomplete) == (5_000, 0, 0)
    assert feedback.current_a == before.current_a, "what comes slowly holds its value"
    assert isinstance(feedback, Feedback)
    assert isinstance(feedback.state, m.State)


@given(data=st.binary(max_size=60), begin=st.integers(0, 70), frame=st.sampled_from(snapshot(1)), cut=st.integers(1, 8))
def test_packed_bytes_are_not_read_beyond_their_end(data, begin, frame, cut):
    reader = SnapshotReader()
    assert begin <= reader.read(data, begin) <= max(begin, len(data))
    whole = pack([codec.encode(message) for message in snapshot(1)[:-1]])
    assert reader.read(whole + pack([codec.encode(frame)])[:-cut], 0) == len(whole)


def test_every_sequence_is_told_once_also_of_many_at_once_and_of_partial_snapshots():
    reader, told = SnapshotReader(), []
    ticks = pack([codec.encode(m.Tick(n, n & 0xFF, 0, m.State.ACTIVE, 3, n & 0xFF)) for n in range(500)])
    at = 0
    while at < len(ticks):
        at = reader.read(ticks, at)
        told += reader.sequences
    assert told == [n & 0xFF for n in range(500)]
    assert reader.read(pack([codec.encode(m.Encoders(1, 2, 3, 4))]), 0) > 0
    assert list(reader.sequences) == []
