"""Feedback commits as one snapshot a tick, or not at all."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from hil.core.types import WHEEL_NAMES, Wheels
from hil.core.wheel_map import WheelMap
from tests.support.client_rig import feed, feedback, new_client, take

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


def test_a_whole_snapshot_commits_once():
    (feedback,) = feed(new_client(), snapshot(7))
    assert feedback.encoder_count == (7, 2, 3, 4)
    assert feedback.speed_rad_s == Wheels(7.0, 2.0, 3.0, 4.0)
    assert feedback.acceleration_m_s2 == (0.25, -0.5, 9.75)
    assert feedback.yaw_rate_rad_s == 0.5


@pytest.mark.proves("R-SNAP-5", "R-SNAP-6", "R-SNAP-7")
@given(keep=st.lists(st.lists(st.booleans(), min_size=6, max_size=6), min_size=1, max_size=20))
def test_whole_snapshots_commit_and_others_do_not(keep):
    """Frames lost anywhere: what commits has its encoders and its gyro from the same sampling instant."""
    client = new_client()
    stream, whole = [], []
    for number, kept in enumerate(keep):
        stream += [message for message, k in zip(snapshot(number), kept, strict=True) if k]
        if all(kept):
            whole.append(number)
    heard = [f.command_sequence for f in feed(client, stream)]
    assert set(whole) <= set(heard)
    assert all(keep[number][0] for number in heard), "none without its own TICK"
    lost_inside = [n for n, kept in enumerate(keep) if kept[0] and not all(kept)]
    if all(kept[0] for kept in keep):
        assert not set(heard) & set(lost_inside), "none with a part missing"


@pytest.mark.proves("R-SNAP-5", "R-SNAP-8")
def test_a_part_of_another_instant_is_not_mixed_in():
    client = new_client()
    assert feed(client, [*snapshot(1)[:4], *snapshot(2)[4:]]) == []
    assert feed(client, [*snapshot(3)[:2], *snapshot(4)[1:]]) == []
    for place in (4, 5):
        assert feed(client, [*snapshot(5)[:place], snapshot(4)[place], *snapshot(5)[place + 1 :]]) == []
    assert [f.encoder_count[0] for f in feed(client, snapshot(6))] == [6]
    assert client.view.incomplete == 4


def test_slow_parts_hold_their_value():
    client = new_client()
    feed(client, snapshot(1))
    (feedback,) = feed(client, snapshot(2, parts=3))
    assert feedback.current_a == Wheels(1.0, 2.0, 3.0, 4.0)


@pytest.mark.proves("R-SNAP-10")
def test_time_is_unwrapped():
    client = new_client()
    a, b = feed(client, snapshot(0, time_us=0xFFFF_FFF0) + snapshot(1, time_us=0x10))
    assert b.robot_time_ns - a.robot_time_ns == 0x20 * 1000


@pytest.mark.proves("R-SNAP-9")
def test_gaps_are_counted():
    client = new_client()
    feed(client, [*snapshot(1), *snapshot(4)[:2], *snapshot(5)])
    assert (client.view.lost, client.view.incomplete) == (2, 1)


@given(order=st.permutations(WHEEL_NAMES), reversed_wheels=st.sets(st.sampled_from(WHEEL_NAMES)))
def test_wheel_map_is_undone_by_its_inverse(order, reversed_wheels):
    wheel_map = WheelMap(order, sorted(reversed_wheels))
    value = Wheels(1.0, 2.0, 3.0, 4.0)
    assert wheel_map.from_wire(wheel_map.to_wire(value)) == value
    channel = list(order).index("rl")
    assert wheel_map.to_wire(value)[channel] == (-4.0 if "rl" in reversed_wheels else 4.0)


def test_a_burst_joining_two_instants_is_told_by_inertial_parts_or_counted_as_lost():
    """PROTOCOL.md, "Feedback": all from ENCODERS to the next TICK is lost, and its parts follow."""
    client = new_client()
    assert feed(client, [snapshot(1)[0], *snapshot(2)[1:], *snapshot(3)]) == feed(new_client(), snapshot(3))
    assert (client.view.incomplete, client.view.lost) == (1, 1)
    blind = new_client()
    joined, _ = feed(blind, [snapshot(1, 3)[0], *snapshot(2, 3)[1:], *snapshot(3, 3)])
    assert (joined.robot_time_ns, joined.encoder_count[0]) == (5_000_000, 2)
    assert (blind.view.incomplete, blind.view.lost) == (0, 1)


PARTS = (m.Tick, m.Encoders, m.WheelSpeeds, m.Currents, m.Accelerometer, m.Gyro)


@pytest.mark.proves("R-SNAP-6")
@pytest.mark.parametrize("kind", [*PARTS, m.StepDone])
def test_an_invalid_message_is_counted_and_breaks_the_snapshot_that_lacks_it(kind):
    client = new_client()
    feed(client, snapshot(1))
    whole = [codec.encode(message) for message in [*snapshot(2), m.StepDone(10), *snapshot(3)]]
    place = next(place for place, frame in enumerate(whole) if frame.id == kind.ID)
    whole[place] = Frame(kind.ID, whole[place].payload[:-1])
    assert take(client, whole) == []
    assert (client.view.out_of_range, client.view.received) == (1, len(whole) + len(snapshot(1)) - 1)
    if kind is m.StepDone:
        assert (client.view.incomplete, client.view.lost) == (0, 0)
    else:
        assert (client.view.incomplete, client.view.lost) == ((0, 1) if kind is m.Tick else (1, 0))
    assert client.view.command_sequence == 3


@pytest.mark.proves("R-SNAP-7")
def test_it_begins_anew_with_another_robot():
    client = new_client()
    (before,) = feed(client, snapshot(200, time_us=0xFFFF_0000))
    client.begin(2)
    assert feedback(client) is None
    assert feed(client, snapshot(1)[1:]) == []
    (newest,) = feed(client, snapshot(3, parts=3, time_us=5))
    assert (newest.robot_time_ns, client.view.lost, client.view.incomplete) == (5_000, 0, 0)
    assert newest.current_a == before.current_a, "what comes slowly holds its value"


@given(data=st.binary(max_size=60), begin=st.integers(0, 70), frame=st.sampled_from(snapshot(1)), cut=st.integers(1, 8))
def test_packed_bytes_are_not_read_beyond_their_end(data, begin, frame, cut):
    client = new_client()
    assert begin <= client.take(data, begin, 0) <= max(begin, len(data))
    client = new_client()
    whole = pack([codec.encode(message) for message in snapshot(1)[:-1]])
    packed = (whole + pack([codec.encode(frame)]))[:-cut]
    assert client.take(packed, 0, 0) == len(packed)
    assert client.view.received == len(snapshot(1)) - 1


def test_each_command_has_one_round_trip_also_when_many_ticks_come_at_once():
    client = new_client()
    for number in range(500):
        assert client.command((0.0,) * 4, (0.0,) * 4, number) == (number + 1) & 0xFF
        client.sent()
        if number % 100 == 99:
            ticks = [
                codec.encode(m.Tick(n, n + 1 & 0xFF, 0, m.State.ACTIVE, 3, n & 0xFF))
                for n in range(number - 99, number + 1)
            ]
            take(client, ticks * 2, 1000)
            for begin in (0, 44, 45, 240, number - 60, number, number + 1):
                kept = range(max(begin, number + 1 - 256), number + 1)
                assert client.round_trips_ns(begin) == [1000 - one for one in kept]
    assert client.view.round_trips == 500
    assert client.view.round_trip_ns == 1000 - 499


def reports(*sequences):
    """Return TICKs without parts that report these commands in force."""
    return pack([codec.encode(m.Tick(0, sequence & 0xFF, 0, m.State.ACTIVE, 0, 0)) for sequence in sequences])


def test_a_round_trip_ends_with_the_first_report_of_a_command_that_was_sent():
    client, every = new_client(), reports(*range(256))
    client.take(every, 0, 5)
    assert client.view.round_trips == 0, "none was sent"
    client = new_client()
    for _ in range(256):
        client.command((0.0,) * 4, (0.0,) * 4, 1)
        client.sent()
    client.take(reports(0), 0, 7)
    assert (client.view.round_trips, client.view.round_trip_ns) == (1, 6)
    for _ in range(256):
        client.command((0.0,) * 4, (0.0,) * 4, 8)
        client.sent()
    client.take(reports(0, 0), 0, 9)
    assert client.view.round_trips == 1, "the robot still reports the one of before"
    client.begin(2)
    client.take(every, 0, 10)
    assert client.view.round_trips == 1, "what was sent to another robot is forgotten"


@pytest.mark.parametrize("forget", [lambda client: client.hash_log(), lambda client: log_anew(client)])
def test_round_trips_are_due_to_be_read_when_half_of_their_room_is_taken(forget):
    client, sequence = new_client(), 0
    for turn in range(3):
        for count in range(1, 129):
            assert not client.view.log_is_due, (turn, count)
            sequence = client.command((0.0,) * 4, (0.0,) * 4, 0)
            client.sent()
            client.take(reports(sequence), 0, 1)
        assert client.view.log_is_due
        forget(client)


def log_anew(client):
    logs = [library()[0].new("uint8_t[]", 1 << 15) for _ in range(2)]
    library()[1].wheel_client_log(client.handle, *logs, 1 << 15)
    client.logs = logs


def test_without_a_log_nothing_is_due_to_be_read():
    ffi, lib = library()
    memory = ffi.new("uint64_t[]", lib.wheel_client_size() // 8)
    client = ffi.cast("wheel_client *", memory)
    lib.wheel_client_init(client, m.Mode.SPEED, 0x5A, 1)
    for _ in range(300):
        packed = reports(lib.wheel_client_command(client, (0.0,) * 4, (0.0,) * 4, 0))
        lib.wheel_client_sent(client)
        lib.wheel_client_take(client, packed, 0, len(packed), 1)
    view = lib.wheel_client_view(client)
    assert (view.round_trips, view.log_is_due) == (300, False)


def test_a_snapshot_is_as_old_as_its_last_part_and_one_that_is_incomplete_has_no_age() -> None:
    client = new_client()
    *first, last = map(codec.encode, snapshot(1))
    take(client, first, 10)
    take(client, [last], 20)
    assert client.view.feedback_ns == 20
    take(client, first[:-1], 30)
    take(client, [codec.encode(m.Tick(10000, 2, 0, m.State.ACTIVE, 0, 2))], 40)
    assert client.view.feedback_ns == 20
