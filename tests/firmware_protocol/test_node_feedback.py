"""What the robot tells: time, counts over wraps, the parts it has sensors for, limits, and counters."""

import math
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.capabilities import Capability
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from tests.support.bare_node import ALL, BareNode
from tests.support.wheel_rig import PARAMETERS, WheelRig

WRAP = 1 << 32
time_us = st.sampled_from([0, 1, WRAP - 1, WRAP - 70_000]) | st.integers(0, WRAP - 1)


@pytest.mark.proves("R-TIME-3", "R-TIME-4")
@given(received=time_us, held=st.integers(0, 200_000), sequence=st.integers(0, 255))
def test_time_sync_stamps_arrival_and_waiting_across_the_wrap(received: int, held: int, sequence: int) -> None:
    node = BareNode()
    node.heard()
    node.send(m.TimeSyncRequest(sequence), received)
    assert node.heard(received + held) == [m.TimeSyncResponse(received, min(held, 0xFFFF), sequence)]


@pytest.mark.proves("R-TIME-3")
@given(requests=st.lists(st.tuples(time_us, st.integers(0, 255)), max_size=8), sent=time_us)
def test_each_of_several_time_syncs_that_wait_tells_its_own_waiting(requests: list[tuple[int, int]], sent: int) -> None:
    node = BareNode()
    node.heard()
    for received, sequence in requests:
        node.send(m.TimeSyncRequest(sequence), received)
    expected = [m.TimeSyncResponse(at, min((sent - at) % WRAP, 0xFFFF), sequence) for at, sequence in requests]
    assert node.heard(sent) == expected


@pytest.mark.proves("R-GEN-3")
def test_time_sync_is_answered_in_every_state_and_feeds_no_watchdog() -> None:
    rig = WheelRig()
    rig.activate()
    for n in range(60):
        rig.node.set_clock(rig.node.look().tick * 1000 + 250)
        rig.heard()
        rig.send(m.TimeSyncRequest(n))
        assert m.TimeSyncResponse(n * 1000 + 250, 0, n) in rig.heard()
        rig.run(1)
    assert rig.state is m.State.STOPPING


@pytest.mark.proves("R-ABS-1")
@given(turns=st.lists(st.lists(st.integers(-32768, 32767), min_size=4, max_size=4), max_size=20))
def test_absolute_counts_follow_the_wrapping_ones(turns: list[list[int]]) -> None:
    """From zero at the beginning, whatever the encoders said then; up to half a circle in a tick."""
    node = BareNode()
    node.sense.count = [0, 1, 0x7FFF, 0xFFFF]
    node.lib.wheel_node_sense(node.node, node.sense)
    total = [0] * 4
    for turned in turns:
        total = [a + b for a, b in zip(total, turned, strict=True)]
        node.sense.count = [(c + b) & 0xFFFF for c, b in zip(node.sense.count, turned, strict=True)]
        node.lib.wheel_node_drive(node.node, node.drive)
        node.lib.wheel_node_sense(node.node, node.sense)
    assert list(node.node.absolute_count) == [t & 0xFFFF_FFFF for t in total]


@pytest.mark.proves("R-ABS-1")
def test_absolute_counts_are_told_once_a_second_wheel_by_wheel() -> None:
    rig = WheelRig()
    rig.speed_rad_s = [90.0, -90.0, 30.0, 0.0]
    heard = []
    for _ in range(60):
        rig.run(50)
        heard += rig.heard()
    fronts = [x for x in heard if isinstance(x, m.AbsoluteFront)]
    rears = [x for x in heard if isinstance(x, m.AbsoluteRear)]
    assert len(fronts) == len(rears) == 4, "at 0, 1, 2 and 3 s"
    counts = [round(v * 3.0 / math.tau * 4096) for v in (90.0, -90.0, 30.0, 0.0)]
    assert counts[0] > 2 * 65536
    told = [*fronts[-1], *rears[-1]]
    assert [(t - c + 2) & 0xFFFF_FFFF for t, c in zip(told, counts, strict=True)] == pytest.approx([2] * 4, abs=2)


SLOW = {Capability.CURRENTS: m.Currents, Capability.ACCELEROMETER: m.Accelerometer, Capability.GYRO: m.Gyro}
BITS = {m.Currents: 4, m.Accelerometer: 8, m.Gyro: 16}
TENTH = {Capability.POWER: m.Power, Capability.TEMPERATURES: m.Temperatures}


@pytest.mark.proves("R-SNAP-3", "R-POW-1", "R-HELLO-5")
@given(has=st.sets(st.sampled_from([*SLOW, *TENTH])))
def test_only_parts_with_a_sensor_are_sent_and_announced(has: set[Capability]) -> None:
    capabilities = Capability(sum(has)) | Capability.SPEED | Capability.TORQUE
    node = BareNode(capabilities=capabilities)
    heard = listen(node, 100)
    kinds = Counter(type(x) for x in heard)
    for capability, kind in SLOW.items():
        assert kinds[kind] == (20 if capability in has else 0)
    for capability, kind in TENTH.items():
        assert kinds[kind] == (1 if capability in has else 0)
    announced = {x.parts for x in heard if isinstance(x, m.Tick)}
    assert announced == {3 | sum(BITS[kind] for c, kind in SLOW.items() if c in has)}


@pytest.mark.proves("R-SNAP-2")
@pytest.mark.parametrize(
    ("period_s", "fast", "slow"), [(0.001, 100, 20), (0.004, 25, 5), (0.005, 20, 20), (0.007, 15, 15), (0.2, 1, 1)]
)
def test_slow_parts_come_at_200_hz_at_most(period_s: float, fast: int, slow: int) -> None:
    """Four does not divide five: the slow parts then come with the snapshots that fall on their ticks."""
    rig = WheelRig(feedback_period_s=period_s)
    rig.run(99)
    kinds = Counter(type(x) for x in rig.heard())
    assert kinds[m.Tick] == kinds[m.Encoders] == kinds[m.WheelSpeeds] == fast
    assert kinds[m.Currents] == kinds[m.Gyro] == kinds[m.Accelerometer] == slow


@pytest.mark.proves("R-MEAN-2")
def test_what_the_sensors_say_arrives() -> None:
    node = BareNode()
    node.sense.current_a = [1.0, -2.0, 3.0, 40.0]
    node.sense.gyro_rad_s = [0.5, -0.25, 50.0]
    node.sense.acceleration_m_s2 = [1.0, -200.0, 9.75]
    node.sense.battery_v, node.sense.battery_a = 25.5, -300.0
    node.sense.temperature_degc = [20.0, 30.0, -40.0, 100.0]
    node.sense.count = [1, 2, 3, 4]
    node.lib.wheel_node_sense(node.node, node.sense)
    heard = node.heard()
    assert m.Encoders(1, 2, 3, 4) in heard
    assert m.Currents(1.0, -2.0, 3.0, 31.9990234375) in heard, "what is beyond the message's range is its end"
    assert m.Gyro(0.5, -0.25, 31.9990234375, 0) in heard
    assert m.Accelerometer(1.0, -127.99609375, 9.75, 0) in heard
    assert m.Power(25.5, -255.9921875) in heard
    assert m.Temperatures(20.0, 30.0, -40.0, 100.0) in heard


@pytest.mark.parametrize("push", [150.0, -150.0])
def test_a_speed_beyond_its_message_is_told_as_its_end(push: float) -> None:
    rig = WheelRig()
    rig.speed_rad_s[2] = push
    rig.run(200)
    speeds = [x for x in rig.heard() if isinstance(x, m.WheelSpeeds)][-1]
    assert speeds.rr_rad_s == math.copysign(127.99609375, push)


@pytest.mark.proves("R-SNAP-11")
def test_the_age_of_the_command_stays_at_its_end() -> None:
    rig = WheelRig(watchdog_s=0.1)
    rig.activate()
    rig.run(98)
    ages = [x.command_age_ms for x in rig.heard() if isinstance(x, m.Tick)]
    assert ages == [255, *range(5, 96, 5)], "255 before the first command"
    rig.run(400)
    assert [x.command_age_ms for x in rig.heard() if isinstance(x, m.Tick)][-1] == 255


@pytest.mark.proves("R-HELLO-1", "R-HELLO-3", "R-HELLO-5")
def test_hello_tells_the_identity() -> None:
    node = BareNode()
    node.heard()
    node.send(m.HelloRequest(1))
    identity, firmware, *others = node.heard()
    assert identity == m.HelloIdentity(2, 2 + len(others), int(ALL), m.SCHEMA_HASH)
    assert [page.ID for page in others] == [*range(firmware.ID + 1, firmware.ID + 1 + len(others))]
    assert firmware == m.HelloFirmware(1, 2, 3, 0, 7)


@pytest.mark.proves("R-HELLO-11")
@pytest.mark.parametrize(("watchdog_s", "period_s", "told"), [(0.0204, 0.0014, (20, 1)), (0.0206, 0.0016, (21, 2))])
def test_hello_rounds_periods_to_whole_milliseconds(watchdog_s: float, period_s: float, told: tuple[int, int]) -> None:
    node = BareNode(changes={"watchdog_s": watchdog_s, "feedback_period_s": period_s})
    node.send(m.HelloRequest(m.PROTOCOL_VERSION))
    (held,) = (x for x in node.heard() if isinstance(x, m.HelloParameters))
    assert (held.watchdog_ms, held.feedback_period_ms) == told


def listen(node: BareNode, ticks: int) -> list[object]:
    """Let time pass on a line that takes everything at once."""
    heard: list[object] = []
    for _ in range(ticks):
        node.tick()
        heard += node.heard()
    return heard


@pytest.mark.proves("R-CNT-1", "R-CNT-12")
def test_every_cause_of_a_port_is_told_in_its_place() -> None:
    node = BareNode()
    for place, name in enumerate(
        ("cobs", "crc", "length", "unknown_id", "overrun", "serial_lost", "can_errors", "bus_off"), start=1
    ):
        setattr(node.node.transport, name, 256 + place)
    node.node.rejections.length, node.node.rejections.unknown_id = 10, 20
    node.node.rejections.feedforward_unmatched, node.node.transmit_overruns = 30, 40
    heard = listen(node, 101)
    link = [x for x in heard if isinstance(x, m.LinkCounters)][-1]
    port = [x for x in heard if isinstance(x, m.PortCounters)][-1]
    assert (link.cobs, link.crc, link.length, link.unknown_id) == (1, 2, 13, 24)
    assert port == m.PortCounters(5, 30, 40, 6, 7, 8)


@pytest.mark.proves("R-CNT-3", "R-CNT-4", "R-CNT-5", "R-SER-3")
def test_the_line_is_counted_by_cause_and_by_loss() -> None:
    rig = WheelRig()
    framer = Framer()
    hello = Frame(m.HelloRequest.ID, b"\1")
    good = framer.encode(hello)
    wrong_crc = bytearray(good)
    wrong_crc[-2] ^= 0x40
    rig.node.feed(good + b"\1\1\1\0" + b"\x05\1\0" + bytes(wrong_crc))
    for _ in range(3):
        framer.encode(hello)
    rig.node.feed(framer.encode(hello))
    rig.run(100)
    heard = rig.heard()
    link = [x for x in heard if isinstance(x, m.LinkCounters)][-1]
    port = [x for x in heard if isinstance(x, m.PortCounters)][-1]
    assert (link.cobs, link.length, link.crc, port.serial_lost) == (1, 1, 1, 3)


def test_what_does_not_fit_the_queue_is_counted_and_told() -> None:
    node = BareNode()
    node.tick(300)
    lost, other = int(node.node.transmit_overruns), BareNode()
    assert lost == len(other.heard()) + len(listen(other, 300)) - 32
    first = node.heard()
    assert len(first) == 32, "the oldest are kept"
    told = [x for x in listen(node, 101) if isinstance(x, m.PortCounters)]
    assert told[-1].transmit_overrun == lost & 0xFF


@pytest.mark.proves("R-CNT-4", "R-CNT-6", "R-TRN-1")
def test_a_message_of_a_wrong_length_or_direction_is_counted() -> None:
    rig = WheelRig()
    for frame in (Frame(m.Estop.ID, b"\0"), Frame(m.Estop.ID, b"\0\0\0"), Frame(m.Estop.ID, b"")):
        rig.node.receive(frame)
    rig.node.receive(Frame(m.Tick.ID, bytes(8)))
    rig.node.receive(Frame(0x123, b""))
    rejected = rig.node.look().rejected
    assert (rejected["length"], rejected["unknown_id"], rig.state) == (3, 2, m.State.IDLE)


def in_torque_mode(**changes: float) -> WheelRig:
    rig = WheelRig(**changes)
    rig.activate(m.Mode.TORQUE)
    rig.send(m.TorqueCommand(4.0, -2.0, 1.0, 0.0, 1, rig.nonce & 0xF))
    return rig


def limited(rig: WheelRig) -> int:
    rig.heard()
    rig.run(100)
    return [x for x in rig.heard() if isinstance(x, m.Status)][-1].limited


@pytest.mark.proves("R-LIM-1", "R-LIM-6", "R-LIM-7")
@pytest.mark.parametrize(
    ("changes", "hottest_degc", "largest_n_m"),
    [
        ({}, 25.0, 4.0),
        ({"torque_limit_n_m": 2.0}, 25.0, 2.0),
        ({"current_limit_a": 2.0}, 25.0, 2.5),
        ({"current_limit_a": 2.0}, 105.0, 2.5),
        ({"current_limit_a": 2.0}, 112.5, 1.25),
        ({"current_limit_a": 2.0}, 119.875, 2.5 / 120),
        ({"torque_limit_n_m": 0.0}, 25.0, 0.0),
    ],
    ids=["none", "torque", "current", "still cool", "half hot", "nearly too hot", "nothing allowed"],
)
def test_all_four_are_scaled_by_one_factor_at_each_limit(
    changes: dict[str, float], hottest_degc: float, largest_n_m: float
) -> None:
    for hot in range(4):
        rig = in_torque_mode(**changes)
        rig.temperature_degc[hot] = hottest_degc
        rig.run(2)
        factor = largest_n_m / 4.0
        assert rig.torque_n_m == pytest.approx([4.0 * factor, -2.0 * factor, factor, 0.0], rel=1e-4, abs=1e-9)
    assert rig.node.look().state is m.State.ACTIVE
    assert (limited(rig) > 0) == (factor < 1.0)


@pytest.mark.proves("R-LIM-6")
@pytest.mark.parametrize("temperature_degc", [120.0, 120.125, 150.0, 1e6])
def test_nothing_is_allowed_beyond_the_temperature_limit(temperature_degc: float) -> None:
    node = BareNode()
    assert node.lib.wheel_node_torque_limit(node.node) == 5.0
    node.node.sense.temperature_degc[2] = temperature_degc
    assert node.lib.wheel_node_torque_limit(node.node) == 0.0


@pytest.mark.proves("R-LIM-6", "R-LIM-7")
def test_the_speed_loop_is_limited_too_and_counted() -> None:
    rig = WheelRig()
    rig.activate()
    rig.held = [True] * 4
    rig.drive(60.0, 50)
    assert rig.torque_n_m == [PARAMETERS["torque_limit_n_m"]] * 4
    assert limited(rig) >= 50


@pytest.mark.proves("R-DRIVE-1")
def test_the_duties_drive_the_torques_through_real_windings() -> None:
    node = BareNode()
    node.activate(m.Mode.TORQUE)
    node.send(m.TorqueCommand(4.0, -2.0, 1.0, 0.0, 1, 1))
    p = PARAMETERS
    decay = math.exp(-p["motor_resistance_ohm"] * 1e-3 / p["motor_inductance_h"])
    for _ in range(30):
        node.lib.wheel_node_drive(node.node, node.drive)
        for i in range(4):
            settled_a = node.drive.duty[i] * 24.0 / p["motor_resistance_ohm"]
            node.sense.current_a[i] = settled_a + (node.sense.current_a[i] - settled_a) * decay
        node.lib.wheel_node_sense(node.node, node.sense)
    torque_n_m = [i * p["torque_constant_n_m_a"] for i in node.sense.current_a]
    assert torque_n_m == pytest.approx([4.0, -2.0, 1.0, 0.0], abs=1e-3)
    node.sense.battery_v = 0.0
    node.tick(2)
    assert list(node.drive.duty) == [0.0] * 4
    assert list(node.drive.torque_n_m) == [4.0, -2.0, 1.0, 0.0], "a drive with a current loop of its own goes on"


@pytest.mark.proves("R-SES-2")
def test_a_current_loop_begins_anew_with_each_session() -> None:
    node = BareNode()
    node.activate(m.Mode.TORQUE)
    node.send(m.TorqueCommand(4.0, 4.0, 4.0, 4.0, 1, 1))
    node.tick(10)
    assert min(node.node.current_loop.integral_v) > 0.0
    node.send(m.Estop(0, 0))
    node.tick(1500)
    assert list(node.node.current_loop.integral_v) == [0.0] * 4


@pytest.mark.proves("R-LIM-7")
def test_nothing_is_limited_while_the_drives_are_off() -> None:
    rig = WheelRig()
    rig.run(100)
    rig.send(m.Estop(0, 0))
    rig.run(100)
    assert {x.limited for x in rig.heard() if isinstance(x, m.Status)} == {0}


@pytest.mark.proves("R-STEP-5")
def test_a_step_that_was_answered_is_not_pending_any_more() -> None:
    node = BareNode(capabilities=ALL | Capability.LOCKSTEP)
    ticks = node.ffi.new("uint32_t *")
    node.send(m.Step(0, 5))
    assert (node.lib.wheel_node_step_pending(node.node, ticks), ticks[0]) == (True, 5)
    node.lib.wheel_node_step_done(node.node)
    assert not node.lib.wheel_node_step_pending(node.node, ticks)
