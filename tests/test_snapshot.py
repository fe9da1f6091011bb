"""Feedback commits as one snapshot a tick, or not at all."""

from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.generated import messages as m
from hil.devices.snapshot import SnapshotAssembler
from hil.devices.wheel_map import WheelMap
from hil.types import WHEEL_NAMES, Wheels

ALL = 31


def snapshot(number, parts=ALL, time_us=None):
    tick = m.Tick(number * 5000 if time_us is None else time_us, number & 0xFF, 0, m.State.ACTIVE, parts, number & 0xFF)
    rest = [m.Encoders(number & 0xFFFF, 2, 3, 4), m.WheelSpeeds(float(number % 100), 2.0, 3.0, 4.0)]
    if parts == ALL:
        at = tick.time_us // 1000 & 0xFFFF
        rest += [m.Currents(1.0, 2.0, 3.0, 4.0), m.Accelerometer(0.25, -0.5, 9.75, at), m.Gyro(0.0, 0.0, 0.5, at)]
    return [tick, *rest]


def feed(assembler, messages):
    return [f for message in messages if (f := assembler.feed(message)) is not None]


def test_a_whole_snapshot_commits_once():
    (feedback,) = feed(SnapshotAssembler(), snapshot(7))
    assert feedback.encoder_count == (7, 2, 3, 4)
    assert feedback.speed_rad_s == Wheels(7.0, 2.0, 3.0, 4.0)
    assert feedback.acceleration_m_s2 == (0.25, -0.5, 9.75)
    assert feedback.yaw_rate_rad_s == 0.5


@given(keep=st.lists(st.lists(st.booleans(), min_size=6, max_size=6), min_size=1, max_size=20))
def test_whole_snapshots_commit_and_others_do_not(keep):
    """Frames lost anywhere: what commits has its encoders and its gyro from the same sampling instant."""
    assembler = SnapshotAssembler()
    stream, whole = [], []
    for number, kept in enumerate(keep):
        stream += [message for message, k in zip(snapshot(number), kept, strict=True) if k]
        if all(kept):
            whole.append(number)
    heard = [f.command_sequence for f in feed(assembler, stream)]
    assert set(whole) <= set(heard)
    assert all(keep[number][0] for number in heard), "none without its own TICK"
    lost_inside = [n for n, kept in enumerate(keep) if kept[0] and not all(kept)]
    if all(kept[0] for kept in keep):
        assert not set(heard) & set(lost_inside), "none with a part missing"


def test_a_part_of_another_instant_is_not_mixed_in():
    assembler = SnapshotAssembler()
    assert feed(assembler, [*snapshot(1)[:4], *snapshot(2)[4:]]) == []
    assert feed(assembler, [*snapshot(3)[:2], *snapshot(4)[1:]]) == []
    assert [f.encoder_count[0] for f in feed(assembler, snapshot(5))] == [5]
    assert assembler.incomplete == 2


def test_slow_parts_hold_their_value():
    assembler = SnapshotAssembler()
    feed(assembler, snapshot(1))
    (feedback,) = feed(assembler, snapshot(2, parts=3))
    assert feedback.current_a == Wheels(1.0, 2.0, 3.0, 4.0)


def test_time_is_unwrapped():
    assembler = SnapshotAssembler()
    a, b = feed(assembler, snapshot(0, time_us=0xFFFF_FFF0) + snapshot(1, time_us=0x10))
    assert b.robot_time_ns - a.robot_time_ns == 0x20 * 1000


def test_gaps_are_counted():
    assembler = SnapshotAssembler()
    feed(assembler, [*snapshot(1), *snapshot(4)[:2], *snapshot(5)])
    assert (assembler.lost, assembler.incomplete) == (2, 1)


@given(order=st.permutations(WHEEL_NAMES), reversed_wheels=st.sets(st.sampled_from(WHEEL_NAMES)))
def test_wheel_map_is_undone_by_its_inverse(order, reversed_wheels):
    wheel_map = WheelMap(order, sorted(reversed_wheels))
    value = Wheels(1.0, 2.0, 3.0, 4.0)
    assert wheel_map.from_wire(wheel_map.to_wire(value)) == value
    channel = list(order).index("rl")
    assert wheel_map.to_wire(value)[channel] == (-4.0 if "rl" in reversed_wheels else 4.0)


def test_a_burst_that_joins_two_instants_is_told_by_the_inertial_parts_or_counted_as_lost():
    """PROTOCOL.md, "Feedback": all from ENCODERS to the next TICK is lost, and its parts follow."""
    assembler = SnapshotAssembler()
    assert feed(assembler, [snapshot(1)[0], *snapshot(2)[1:], *snapshot(3)]) == feed(SnapshotAssembler(), snapshot(3))
    assert (assembler.incomplete, assembler.lost) == (1, 1)
    blind = SnapshotAssembler()
    joined, _ = feed(blind, [snapshot(1, 3)[0], *snapshot(2, 3)[1:], *snapshot(3, 3)])
    assert (joined.robot_time_ns, joined.encoder_count[0]) == (5_000_000, 2)
    assert (blind.incomplete, blind.lost) == (0, 1)
