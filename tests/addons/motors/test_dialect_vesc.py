"""VESC over CAN and UART: worked frames, the driver before its emulated device, and what is wrong on either side."""

import math
import struct
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.vesc.vesc_channel import Channel
from hil.addons.motors.vesc.vesc_frames import SerialFraming, repeated_past_packet
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode
from hil.robot.driver import EXTENDED, Wire
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, assert_position_follows, assert_told, ramp_to

FORWARD = (8.0, 8.0, 8.0, 8.0)
WIRES: tuple[Wire, ...] = ("can", "serial")
ODD: Mapping[str, Any] = {"ids": [7, 0, 254, 30], "pole_pairs": 15, "gear_ratio": 2.5, "serial_id": 30}


def rig_of(wire: Wire, settings: Mapping[str, Any] | None = None, mode: CommandMode = CommandMode.SPEED) -> Rig:
    return Rig("vesc", settings, mode=mode, wire=wire)


def ready(wire: Wire, settings: Mapping[str, Any] | None = None, mode: CommandMode = CommandMode.SPEED) -> Rig:
    """Return a rig that is armed."""
    rig = rig_of(wire, settings, mode)
    rig.greet()
    rig.arm()
    return rig


def test_speeds_and_torques_are_electrical_speeds_and_currents() -> None:
    rig = rig_of("can", {"pole_pairs": 15, "gear_ratio": 2.0})
    one_turn_a_second = (math.tau, -math.tau, 0.0, 0.0)
    frames = rig.driver.command(one_turn_a_second, STILL, 0)[:4]
    assert [struct.unpack(">i", frame.payload)[0] for frame in frames] == [1800, -1800, 0, 0]
    rig = rig_of("can", mode=CommandMode.TORQUE)
    frames = rig.driver.command(STILL, (rig.facts.torque_constant_n_m_a, -1e-6, 0.0, 0.0), 0)[:4]
    assert frames[:2] == [Frame(EXTENDED | 0x101, struct.pack(">i", 1000)), Frame(EXTENDED | 0x102, bytes(4))]


def test_worked_status_messages_are_read() -> None:
    """4200 ERPM backwards at 12.5 A that drive, 40.5 degrees, 3.1 A and 36.1 V in, tachometer round its wrap."""
    rig = rig_of("can", {"pole_pairs": 7, "gear_ratio": 1.0})
    for vesc in (1, 2, 3, 4):
        for stamp, steps in enumerate(("7ffffffe", "80000004")):
            rig.driver.feed(Frame(EXTENDED | 0x1B00 | vesc, bytes.fromhex(steps + "01690000")), stamp)
        rig.driver.feed(Frame(EXTENDED | 0x0900 | vesc, bytes.fromhex("ffffef98007dfe0c")), 10 + vesc)
        rig.driver.feed(Frame(EXTENDED | 0x1000 | vesc, bytes.fromhex("01950000001f0000")), 20)
    sample = rig.driver.sample
    assert sample is not None
    assert sample.stamp_ns == 11
    assert_near(sample.speed_rad_s, (-600.0 * math.tau / 60.0,) * 4, 1e-9)
    assert_near(sample.position_rad, (math.tau / 7.0,) * 4, math.tau / 42.0)  # six steps are one electrical turn
    assert_near(sample.current_a, (-12.5,) * 4, 1e-9)
    assert_near(sample.temperature_degc, (40.5,) * 4, 1e-9)
    assert_near([sample.battery_v, sample.battery_a], [36.1, 12.4], 1e-9)


@given(st.integers(-3000, 3000), st.floats(0.0, 6.0))
def test_the_position_goes_evenly_from_step_to_step_of_the_tachometer(erpm: int, start: float) -> None:
    """At a steady speed, with status messages at 50 Hz; after a second it advances within a step of the shaft."""
    channel = Channel()
    before = 0.0
    for n in range(100):
        before = channel.position
        steps = start + erpm / 60.0 * 6.0 * n * 0.02
        channel.feed_status(9, struct.pack(">ihh", erpm, 0, 0), n * 20_000_000)
        channel.feed_status(27, struct.pack(">ihh", math.floor(steps), 0, 0), n * 20_000_000)
        assert abs(channel.position - channel.turned) <= 1.0
        if n > 50:
            assert channel.position - before == pytest.approx(erpm / 60.0 * 6.0 * 0.02, abs=1.0)
    assert channel.turned == math.floor(steps) - math.floor(start)


def test_speeds_move_the_position_to_a_step_of_the_tachometer_and_no_further() -> None:
    channel = Channel()
    channel.feed_status(27, struct.pack(">ihh", 500, 0, 0), 0)
    for stamp_ms, erpm, position in (
        (0, 30, 0.0),
        (100, 60, 0.45),
        (400, -40, 0.75),
        (899, -40, -1.246),
        (1399, 0, -1.246),
    ):
        channel.feed_status(9, struct.pack(">ihh", erpm, 0, 0), stamp_ms * 1_000_000)  # six steps are a turn
        assert channel.position == pytest.approx(position)
    for stamp_ms, erpm, position in ((1400, -900, -1.0), (1450, 900, 1.0)):
        channel.feed_status(9, struct.pack(">ihh", erpm, 0, 0), stamp_ms * 1_000_000)
        channel.feed_status(9, struct.pack(">ihh", erpm, 0, 0), (stamp_ms + 40) * 1_000_000)
        channel.feed_status(27, struct.pack(">ihh", 500, 0, 0), stamp_ms * 1_000_000)
        assert channel.position == position, "the tachometer is right to within a step"


def test_the_longest_message_is_read_in_pieces_and_a_longer_one_is_not_sent() -> None:
    """512 bytes, and 6 around them: begin, two of length, two of checksum, end."""
    framing, longest = SerialFraming(), Frame(17, bytes(range(256)) + bytes(255))
    data = framing.encode(longest)
    assert len(data) == 518
    assert [frame for at in range(0, 518, 100) for frame in framing.feed(data[at : at + 100])] == [longest]
    with pytest.raises(ValueError, match="message 17 of 513 bytes: expected at most 512"):
        framing.encode(Frame(17, bytes(512)))


@pytest.mark.parametrize("payloads", [(8,), (4, 5, 4, 5), (9, 22)])
def test_a_last_stop_is_repeated_until_it_is_longer_than_any_packet(payloads: tuple[int, ...]) -> None:
    framing, commands = SerialFraming(), [Frame(7, bytes(length)) for length in payloads]
    size = sum(len(framing.encode(frame)) for frame in commands)
    repeated = list(repeated_past_packet(commands))
    times = len(repeated) // len(commands)
    assert repeated == commands * times
    assert (times - 1) * size <= 518 < times * size


def test_a_frame_of_nobody_here_is_told_as_foreign_and_an_answer_to_the_host_is_not() -> None:
    driver = rig_of("can").driver
    status = bytes(8)
    told = [driver.feed(Frame(number, status), 0) for number in (0x01, 0xFD, EXTENDED | 0x0905, EXTENDED | 0x0901)]
    assert told == ["", None, "", None]
    assert driver.feed(Frame(EXTENDED | 0x0901, bytes(7)), 0) == "7 bytes, expected 8"
    assert driver.feed(Frame(EXTENDED | 0x7701, status), 0) == ""


@pytest.mark.parametrize("settings", [{}, ODD])
@pytest.mark.parametrize("wire", WIRES)
def test_wheels_reach_their_speeds_and_the_position_follows(wire: Wire, settings: Mapping[str, Any]) -> None:
    rig = ready(wire, settings)
    assert rig.is_still()
    rig.drive(1.5, ramp_to(FORWARD))
    sample = assert_told(rig, FORWARD, 0.2)
    assert sample.stamp_ns > rig.now_ns - 25_000_000
    assert sample.battery_v == pytest.approx(rig.node.battery_v, abs=0.11)
    assert_position_follows(rig, FORWARD, 0.35)


@pytest.mark.parametrize("wire", WIRES)
def test_torques_are_those_of_the_command(wire: Wire) -> None:
    rig = ready(wire, mode=CommandMode.TORQUE)
    rig.drive(0.1, lambda _t: (STILL, (0.5, -0.5, 0.25, 0.0)))
    assert_near(rig.node.torque_n_m, (0.5, -0.5, 0.25, 0.0), 0.002)


@pytest.mark.parametrize("wire", WIRES)
def test_motors_are_let_go_a_second_after_the_last_command(wire: Wire) -> None:
    rig = ready(wire)
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(ticks=990)
    assert rig.node.is_driving
    rig.step(ticks=15)
    assert not rig.node.is_driving


@pytest.mark.parametrize("wire", WIRES)
def test_an_estop_brakes_to_standstill(wire: Wire) -> None:
    rig, rolling = ready(wire), ready(wire)
    for each in (rig, rolling):
        each.drive(1.0, ramp_to(FORWARD))
    rig.step(rig.driver.estop(), ticks=300)
    rolling.step(rolling.driver.disarm(), ticks=300)
    assert not rig.driver.is_armed
    assert not rolling.node.is_driving
    assert all(abs(braked) < 0.1 * rolled for braked, rolled in zip(rig.speeds(), rolling.speeds(), strict=True))


@pytest.mark.parametrize("wire", WIRES)
def test_a_fault_is_told_by_its_wheel_ends_being_armed_and_passes(wire: Wire) -> None:
    rig = ready(wire)
    rig.node.vescs[2].fail(4)
    rig.drive(0.05, lambda _t: (STILL, STILL))
    assert not rig.driver.is_armed
    assert rig.driver.errors == ["VESC 3 of wheel rr has the fault 4: absolute over current"]
    for _ in range(20):  # it holds for half a second, and arming goes on asking
        rig.step(rig.driver.arm(rig.now_ns))
        assert not rig.driver.is_armed
    rig.step(ticks=500)
    assert rig.driver.errors != []  # nobody has asked since
    rig.step(rig.driver.clear())
    assert rig.driver.errors == []
    assert rig.driver.identity is not None
    rig.arm()


@pytest.mark.parametrize("wire", WIRES)
def test_a_fault_that_lasts_is_told_again_after_it_was_cleared(wire: Wire) -> None:
    rig = ready(wire)
    rig.node.vescs[1].fail(5)
    rig.drive(0.05, lambda _t: (STILL, STILL))
    rig.step(rig.driver.clear())
    for _ in range(8):
        rig.step(rig.driver.arm(rig.now_ns))
        assert not rig.driver.is_armed
    assert rig.driver.errors == ["VESC 2 of wheel fr has the fault 5: over temperature of the MOSFETs"]


@pytest.mark.parametrize("wire", WIRES)
def test_nobody_is_energised_while_one_is_in_fault(wire: Wire) -> None:
    rig = rig_of(wire)
    rig.node.vescs[3].fail(1)
    rig.greet()
    for _ in range(10):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    assert not rig.node.is_driving


@pytest.mark.parametrize("wire", WIRES)
def test_one_that_was_fit_long_ago_says_so_anew_before_anything_is_energised(wire: Wire) -> None:
    rig = ready(wire)
    rig.step(rig.driver.disarm(), ticks=1000)
    rig.node.vescs[1].fail(5)
    for _ in range(8):
        rig.step(rig.driver.arm(rig.now_ns))
        assert not rig.driver.is_armed
        assert not rig.node.is_driving
    assert rig.driver.errors == ["VESC 2 of wheel fr has the fault 5: over temperature of the MOSFETs"]


def test_a_battery_that_is_gone_is_the_makers_fault_of_under_voltage() -> None:
    rig = ready("can")
    rig.node.battery_v = 7.0
    rig.node.tick()
    for _ in range(8):
        rig.step(rig.driver.ask())
    assert [error.split(": ")[1] for error in rig.driver.errors] == ["under voltage"] * 4


@pytest.mark.parametrize("wire", WIRES)
def test_a_kill_switch_is_told_and_ends_being_armed(wire: Wire) -> None:
    rig = ready(wire)
    rig.node.vescs[0].kill_switch = True
    rig.drive(0.05, lambda _t: (STILL, STILL))
    assert not rig.driver.is_armed
    assert rig.driver.errors == ["VESC 1 of wheel fl is stopped by its kill switch"]


def test_status_messages_that_ceased_are_not_taken_for_news() -> None:
    """STATUS 1 alone goes on, at 50 Hz: after five periods temperature and battery are not known, the stamp stays."""
    rig = ready("can")
    begin_ns = rig.now_ns
    for late_ns in (50_000_000, 150_000_000, 200_000_000):
        for vesc in (1, 2, 3, 4):
            rig.driver.feed(Frame(EXTENDED | 0x0900 | vesc, bytes(8)), begin_ns + late_ns)
        sample = rig.driver.sample
        assert sample is not None
        known = [not math.isnan(one) for one in (*sample.temperature_degc, sample.battery_v, sample.battery_a)]
        assert known == [late_ns < 100_000_000] * 6
        assert sample.stamp_ns - begin_ns <= min(late_ns, 100_000_000)


def test_who_does_not_say_what_fault_it_has_is_told_of() -> None:
    rig = ready("can")
    begin_ns = rig.now_ns
    for milliseconds in range(0, 1100, 5):  # asked in vain, while nobody is heard
        assert not rig.driver.errors or milliseconds > 1000
        rig.driver.command(STILL, STILL, begin_ns + milliseconds * 1_000_000)
    assert len(rig.driver.errors) == 4
    assert rig.driver.errors[0] == "VESC 1 of wheel fl has not answered for a second which fault it has"
    rig.driver.disarm()
    assert rig.driver.errors == [], "who is asked nothing owes no answer"


@pytest.mark.parametrize("wire", WIRES)
def test_the_identity_has_each_ones_hardware_and_firmware(wire: Wire) -> None:
    rig = rig_of(wire, ODD)
    rig.node.vescs[2].version = (5, 3)
    assert rig.greet() == (
        "four VESCs with the ids 7 (60_MK6, firmware 6.05), 0 (60_MK6, firmware 6.05), 254 (60_MK6, firmware 5.03), "
        "30 (60_MK6, firmware 6.05)"
    )
    assert not rig.node.is_driving


@pytest.mark.parametrize("wire", WIRES)
def test_an_old_firmware_is_refused_with_what_to_do(wire: Wire) -> None:
    rig = rig_of(wire)
    rig.node.vescs[3].version = (3, 62)
    with pytest.raises(BadInputError, match=r"VESC 4 has the firmware 3\.62, .* update it in VESC Tool"):
        rig.greet()


@pytest.mark.parametrize("wire", WIRES)
def test_who_does_not_answer_is_named_and_the_others_are_heard(wire: Wire) -> None:
    rig = Rig("vesc", {"ids": [1, 9, 3, 4]}, emulated_settings={"ids": [1, 2, 3, 4]}, wire=wire)
    for _ in range(60):
        rig.step(rig.driver.ask())
    assert rig.driver.identity is None
    rate = "bit rate" if wire == "can" else "baud= in the link, 115200 as delivered"
    assert rig.driver.missing == (
        f"no answer from the VESC 9; check power, wiring and {rate}, and in VESC Tool App Settings > General: VESC ID "
        "(device.motors.ids) and CAN Mode VESC"
    )


def test_who_sends_no_status_messages_is_told_where_to_switch_them_on() -> None:
    rig = rig_of("can", {"status_hz": 1.0})
    for _ in range(12):
        rig.step(rig.driver.ask())
    assert rig.driver.missing.startswith(
        "no status messages 1, 4 and 5 from the VESC 2, 3, 4; switch them on in VESC Tool"
    )


def test_feedback_over_the_line_is_as_slow_as_it_is() -> None:
    assert rig_of("serial").driver.capabilities.feedback_hz == pytest.approx(200.0 / 3.0)
    assert rig_of("serial", {"serial_id": 99}).driver.capabilities.feedback_hz == pytest.approx(50.0)
    assert rig_of("can").driver.capabilities.feedback_hz == 50.0


def test_a_restart_forgets_all() -> None:
    rig = ready("can")
    rig.driver.restart()
    assert not rig.driver.is_armed
    assert rig.driver.identity is None
    assert rig.driver.sample is None


@given(st.integers(0, 2**32 - 1) | st.sampled_from([EXTENDED | c << 8 | 253 for c in range(30)]), st.binary(max_size=8))
def test_no_frame_is_too_strange(number: int, payload: bytes) -> None:
    for rig in STRANGE:
        rig.driver.feed(Frame(number, payload), 0)
        assert rig.driver.identity is None
        rig.node.receive(Frame(number, payload))
        rig.node.take_frames()


@given(st.integers(0, 255), st.binary(max_size=80))
def test_no_message_is_too_strange(code: int, payload: bytes) -> None:
    _, line = STRANGE
    line.driver.feed(Frame(code, payload), 0)
    line.node.feed(SerialFraming().encode(Frame(code, payload)))
    line.node.feed(payload)
    line.node.take_bytes()


STRANGE = rig_of("can"), rig_of("serial")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"ids": [1, 2, 3, 255]}, "expected four different ones, each 0 to 254"),
        ({"ids": [1, 2, 3]}, "expected four different ones"),
        ({"ids": [1, 2, 3, 4.0]}, "ids.4 = 4.0; expected a whole number"),
        ({"ids": "1234"}, "expected an array, each item a whole number"),
        ({"ids": [1, 2, 3, 253]}, "253 is the id of this computer on the bus"),
        ({"serial_id": 255}, "from 0 to 254"),
        ({"pole_pairs": 0}, "at least 1"),
        ({"gear_ratio": -1.0}, "greater than 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        build(dialect("vesc").settings, settings, "device.motors")


@pytest.mark.parametrize(
    ("wire", "motors"),
    [("can", {"ids": [0, 7, 30, 254]}), ("serial", None)],
)
def test_a_probe_finds_the_ids_and_moves_nothing(wire: Wire, motors: dict[str, object] | None) -> None:
    rig = rig_of(wire, ODD)
    made = dialect("vesc").serial_probe if wire == "serial" else dialect("vesc").probe
    assert made is not None
    probe = made()
    assert probe.found() is None
    for ticks in (1, 3000):  # to look for others takes one at a line 10 ms for each id
        rig.step(probe.ask(), ticks=ticks)
        for frame in rig.heard:
            probe.feed(frame)
    found = probe.found()
    assert found is not None
    assert found.motors == motors
    assert "device.motors.pole_pairs" in found.unknown
    assert not rig.node.is_driving


def test_a_probe_passes_over_batteries_and_what_others_have_asked_for() -> None:
    made = dialect("vesc").probe
    assert made is not None
    probe = made()
    probe.feed(Frame(EXTENDED | 0x12FD, b"\x05\x01"))  # a battery's manager
    probe.feed(Frame(EXTENDED | 0x1203, b"\x06\x00"))  # an answer to another's ping
    probe.feed(Frame(0x12FD, b"\x07\x00"))
    assert probe.found() is None
    probe.feed(Frame(EXTENDED | 0x12FD, b"\x08\x00"))
    found = probe.found()
    assert found is not None
    assert found.motors is None
