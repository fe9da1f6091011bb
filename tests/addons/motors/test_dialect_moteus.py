"""moteus: the maker's package as oracle, the driver before its emulated device, and what is wrong on either side."""

import io
import math
import struct

import moteus
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import multiplex, protocol

from firmware_protocol.framing import Frame
from hil.addons.motors.moteus import moteus_frames
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode
from hil.robot.driver import EXTENDED
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, assert_position_follows, assert_told, ramp_to

FORWARD = (8.0, 8.0, 8.0, 8.0)
TURNS = 1.0 / math.tau
IDS = {"ids": [9, 2, 126, 4]}


def ready(settings: dict[str, object] | None = None, mode: CommandMode = CommandMode.SPEED) -> Rig:
    """Return a rig that is armed."""
    rig = Rig("moteus", settings, mode=mode)
    rig.greet()
    rig.arm()
    return rig


def test_the_worked_frame_of_the_facts_is_written_and_parsed_as_the_maker_does() -> None:
    """Velocity 2 rev/s and a query: 01000a 0e20 NaN 2.0 1100 1f01 130d."""
    payload = (
        moteus_frames.write_mode(10)
        + moteus_frames.write_floats(0x20, math.nan, 2.0)
        + moteus_frames.read(moteus_frames.INT8, 0x00)
        + moteus_frames.read(moteus_frames.FLOAT, 0x01, 3)
        + moteus_frames.read(moteus_frames.INT8, 0x0D, 3)
    )
    assert payload.hex() == "01000a0e200000c07f0000004011001f01130d"
    maker = moteus.Controller(id=1).make_position(position=math.nan, velocity=2.0, query=True)
    assert maker.data == payload


def test_the_worked_reply_of_the_maker_is_read() -> None:
    """Mode 10, 0.008 turns, 0.064 turns/s, -1.44 N·m (int16); 12 V, 20 °C, no fault (int8)."""
    values = moteus_frames.parse_reply(bytes.fromhex("2404000a005000000170ff230d181400"))
    assert values is not None
    assert values[0x00] == 10
    assert_near([values[r] for r in (0x01, 0x02, 0x0D, 0x0E)], [0.008, 0.064, 12.0, 20.0], 1e-12)
    assert values[0x0F] == 0


def test_a_command_says_to_the_makers_parser_what_was_meant() -> None:
    rig = Rig("moteus", {**IDS, "can_prefix": 3, "gear_ratio": 2.0})
    frames = rig.driver.command((math.pi, -1.0, 0.0, 2.0), (0.5, 0.0, -0.25, 0.0), 0)
    assert [frame.id for frame in frames] == [EXTENDED | 3 << 16 | 0x8000 | number for number in (9, 2, 126, 4)]
    assert {len(frame.payload) for frame in frames} == {48}
    said = protocol.parse_registers(frames[0].payload)
    assert said.command.pop(0x20) != said.command.get(0x20)  # NaN
    limit, watchdog = rig.facts.torque_limit_n_m / 2.0, rig.facts.watchdog_s
    assert said.command == pytest.approx({0x00: 10, 0x21: 1.0, 0x22: 0.25, 0x25: limit, 0x27: watchdog})
    assert {0x00, 0x01, 0x02, 0x04, 0x0D, 0x0E, 0x0F} <= {register for register, _ in said.query}


def test_a_torque_leaves_nothing_of_the_position_loop() -> None:
    rig = Rig("moteus", mode=CommandMode.TORQUE)
    [frame, *_] = rig.driver.command(STILL, (0.5, 0.0, 0.0, 0.0), 0)
    said = protocol.parse_registers(frame.payload).command
    assert (said[0x21], said[0x22], said[0x23], said[0x24], said[0x2B]) == (0.0, 0.5, 0.0, 0.0, 0.0)
    assert said[0x27] == pytest.approx(rig.facts.watchdog_s)


def test_after_torques_the_brake_as_delivered_does_nothing_and_the_driver_warns() -> None:
    rig = ready(mode=CommandMode.TORQUE)
    assert "servo.timeout_mode is 15" in " ".join(rig.driver.warnings)
    assert not Rig("moteus").driver.warnings
    rig.drive(0.5, lambda _t_s: (STILL, (1.0,) * 4))
    rig.step(ticks=1500)
    assert not rig.is_still()


READ = (0x00, 0x01, 0x02, 0x04, 0x0D, 0x0E, 0x27)


@given(
    st.lists(
        st.tuples(st.sampled_from(READ), st.sampled_from((0, 1, 2, 3)), st.integers(-(2**31), 2**31 - 1)), max_size=8
    )
)
def test_replies_are_read_as_the_maker_reads_them(registers: list[tuple[int, int, int]]) -> None:
    buffer = io.BytesIO()
    for register, kind, raw in registers:
        if kind == multiplex.F32:
            buffer.write(bytes((0x2D, register or 0x01)) + multiplex.TYPES[kind].pack(raw * 1e-3))
            continue
        bits = 8 << kind
        value = (raw + (1 << bits - 1)) % (1 << bits) - (1 << bits - 1)
        buffer.write(bytes((0x21 | kind << 2, register)) + multiplex.TYPES[kind].pack(value))
    expected = protocol.parse_reply(buffer.getvalue())
    assert moteus_frames.parse_reply(moteus_frames.padded(buffer.getvalue())) == pytest.approx(expected, nan_ok=True)


def test_the_unreadable_and_unwritable_is_passed_over_and_what_is_no_number_refused() -> None:
    assert moteus_frames.parse_reply(bytes.fromhex("302b01318a020121000a")) == {0x00: 10}
    for register in (0x00, 0x0F):
        for raw in ("0000c07f", "0000807f"):  # NaN, infinity
            assert moteus_frames.parse_reply(bytes.fromhex(f"2d{register:02x}{raw}")) is None


@pytest.mark.parametrize(
    ("kind", "bits"), [(moteus_frames.INT8, 8), (moteus_frames.INT16, 16), (moteus_frames.INT32, 32)]
)
def test_a_quantity_is_saturated_to_its_type_and_the_lowest_number_means_none(kind: int, bits: int) -> None:
    """As in the maker's reference: the lowest whole number stands for NaN."""
    most = 2 ** (bits - 1) - 1
    raws = [moteus_frames.raw_of(0x01, kind, value) for value in (1e9, -1e9, math.nan, math.inf, 0.0)]
    assert raws == [most, -most, -most - 1, -most - 1, 0]
    read = [moteus_frames.physical(0x01, kind, raw) for raw in raws]
    maker = protocol.parse_reply
    for raw, value in zip(raws, read, strict=True):
        told = maker(bytes((0x21 | kind << 2, 0x01)) + multiplex.TYPES[kind].pack(raw))
        assert value == pytest.approx(told[0x01], nan_ok=True)
        assert moteus_frames.pack(kind, raw) == multiplex.TYPES[kind].pack(raw)
    assert math.isnan(read[2])
    assert moteus_frames.physical(0x00, kind, -most - 1) == -most - 1, "a mode is a plain number"


def test_a_float_is_saturated_to_single_precision_and_what_is_not_finite_stays() -> None:
    largest = struct.unpack("<f", bytes.fromhex("ffff7f7f"))[0]
    values = (1e300, -1e300, 1.5, math.inf, -math.inf)
    raws = [moteus_frames.raw_of(0x01, moteus_frames.FLOAT, value) for value in values]
    assert raws == [largest, -largest, 1.5, math.inf, -math.inf]
    assert math.isnan(moteus_frames.raw_of(0x01, moteus_frames.FLOAT, math.nan))


@given(st.integers(0, 2**32 - 1))
def test_numbers_of_7_bits_a_byte_are_written_as_the_maker_does(value: int) -> None:
    buffer = io.BytesIO()
    multiplex.WriteFrame(buffer).write_varuint(value)
    assert moteus_frames.varuint(value) == buffer.getvalue()


@given(st.binary(max_size=64))
def test_no_payload_is_too_strange(payload: bytes) -> None:
    STRANGE.driver.feed(Frame(0x100, payload), 0)
    STRANGE.node.receive(Frame(EXTENDED | 0x8001, payload))
    assert STRANGE.driver.identity is None
    assert all(frame.id == 0x100 and len(frame.payload) <= 64 for frame in STRANGE.node.take_frames())


@given(st.integers(0, 2**32 - 1))
def test_no_identifier_is_too_strange(number: int) -> None:
    STRANGE.driver.feed(Frame(number, b"\x21\x00\x0a"), 0)
    assert STRANGE.driver.sample is None


STRANGE = Rig("moteus")


@pytest.mark.parametrize("settings", [{}, {**IDS, "can_prefix": 0x1FFF, "gear_ratio": 3.0}])
def test_wheels_reach_their_speeds_and_the_position_follows(settings: dict[str, object]) -> None:
    rig = ready(settings)
    assert rig.is_still()
    rig.drive(1.5, ramp_to(FORWARD))
    sample = assert_told(rig, FORWARD, 0.2)
    assert sample.stamp_ns > rig.now_ns - 6_000_000
    assert sample.battery_v == pytest.approx(rig.node.battery_v, abs=0.06)
    assert_position_follows(rig, FORWARD, 0.05)


def reply(position_rev: float, velocity_rev_s: float, current_a: float) -> bytes:
    return struct.pack("<3sBB2fBBf", b"\x21\x00\x0a", 0x2E, 0x01, position_rev, velocity_rev_s, 0x2D, 0x04, current_a)


def test_a_sample_is_as_old_as_the_oldest_of_its_speeds_and_has_each_in_its_place() -> None:
    rig = Rig("moteus")
    for place, stamp in enumerate((30, 10, 40, 20)):
        rig.driver.feed(Frame(place + 1 << 8, reply(place, -place, 10.0 * place)), stamp)
    rig.driver.feed(Frame(0x200, reply(9.0, math.nan, 10.0)), 50)
    rig.driver.feed(Frame(0x200, reply(math.inf, 9.0, 10.0)), 50)
    sample = rig.driver.sample
    assert sample is not None
    assert sample.stamp_ns == 10
    assert_near([angle * TURNS for angle in sample.position_rad], (0.0, 1.0, 2.0, 3.0), 1e-6)
    assert_near([speed * TURNS for speed in sample.speed_rad_s], (0.0, -1.0, -2.0, -3.0), 1e-6)
    assert sample.current_a == (0.0, 10.0, 20.0, 30.0)


def test_torques_are_those_of_the_command() -> None:
    rig = ready({"gear_ratio": 2.0}, CommandMode.TORQUE)
    rig.drive(0.1, lambda _t: (STILL, (0.5, -0.5, 0.25, 0.0)))
    assert_near(rig.node.torque_n_m, (0.5, -0.5, 0.25, 0.0), 1e-6)


@pytest.mark.parametrize("resolution", [multiplex.INT8, multiplex.INT16, multiplex.INT32, multiplex.F32])
def test_the_emulated_one_obeys_the_makers_package_in_every_resolution(resolution: int) -> None:
    rig = Rig("moteus")
    position = moteus.PositionResolution()
    position.position = position.velocity = position.watchdog_timeout = resolution
    query = moteus.QueryResolution()
    query.position = query.velocity = query.torque = query.voltage = resolution
    maker = moteus.Controller(id=1, position_resolution=position, query_resolution=query)
    command = maker.make_position(position=math.nan, velocity=1.0, watchdog_timeout=0.05, query=True)
    for _ in range(100):
        rig.step([Frame(EXTENDED | 0x8001, command.data)])
    values = protocol.parse_reply(rig.heard[-1].payload)
    assert values[moteus.Register.MODE] == moteus.Mode.POSITION
    assert values[moteus.Register.VELOCITY] == pytest.approx(rig.speeds()[0] * TURNS, abs=0.12)
    assert values[moteus.Register.VOLTAGE] == pytest.approx(rig.node.battery_v, abs=0.51)
    rig.step(ticks=60)
    rig.step([Frame(EXTENDED | 0x8001, command.data)])
    assert protocol.parse_reply(rig.heard[-1].payload)[moteus.Register.MODE] == moteus.Mode.TIMEOUT


def test_arming_reads_the_watchdog_back_before_it_is_armed() -> None:
    rig = Rig("moteus")
    rig.greet()
    rig.arm()
    answers = [moteus_frames.parse_reply(frame.payload) for frame in rig.heard[-4:]]
    assert all(answer is not None and answer[0x27] == pytest.approx(rig.facts.watchdog_s) for answer in answers)
    other = Rig("moteus")
    other.greet()
    other.driver.arm(0)
    for number in (1, 2, 3, 4):  # in the right mode, with a watchdog of another's
        other.driver.feed(Frame(number << 8, bytes.fromhex("21000a2d2700004040")), 1)
    other.driver.arm(1)
    assert not other.driver.is_armed
    rig.driver.disarm()
    rig.driver.arm(rig.now_ns)  # what was read back before is of no use now
    assert not rig.driver.is_armed


def test_nobody_is_energised_while_one_is_in_fault() -> None:
    rig = Rig("moteus")
    rig.greet()
    rig.node.servos[3].fail(35)
    rig.step(rig.driver.ask())
    for _ in range(10):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    assert all(servo.mode in (0, 1) for servo in rig.node.servos)


def test_wheels_stop_when_commands_end_and_stay_stopped_until_cleared() -> None:
    rig = ready()
    rig.drive(1.0, ramp_to(FORWARD))
    rig.step(ticks=1500)
    assert rig.is_still()
    rig.step(rig.driver.ask())
    assert not rig.driver.is_armed
    assert rig.driver.errors[0].startswith("moteus 1 of wheel fl is in mode 11, position timeout")
    for _ in range(20):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    rig.step(rig.driver.clear())
    assert rig.driver.errors == []
    rig.arm()


def test_an_estop_brakes_and_no_command_ends_it() -> None:
    rig, rolling = ready(), ready()
    for each in (rig, rolling):
        each.drive(1.0, ramp_to(FORWARD))
    rig.step(rig.driver.estop(), ticks=300)
    rolling.step(rolling.driver.disarm(), ticks=300)
    assert not rig.driver.is_armed
    assert all(abs(braked) < 0.1 * rolled for braked, rolled in zip(rig.speeds(), rolling.speeds(), strict=True))
    rig.drive(0.5, lambda _t: (FORWARD, STILL))
    assert rig.is_still()


def test_a_fault_of_one_is_told_by_its_wheel_and_ends_being_armed() -> None:
    rig = ready()
    rig.node.servos[2].fail(34)
    rig.drive(0.02, lambda _t: (STILL, STILL))
    assert not rig.driver.is_armed
    assert rig.driver.errors == ["moteus 3 of wheel rr has the fault 34: over voltage"]
    rig.step(rig.driver.disarm())
    rig.step(rig.driver.ask())
    assert len(rig.driver.errors) == 1  # a stop would have cleared it
    assert rig.node.torque_n_m == STILL
    rig.step(rig.driver.clear())
    assert rig.driver.errors == []


def test_a_fault_is_told_in_the_makers_words() -> None:
    rig = Rig("moteus")
    for code, words in (
        (32, "calibration fault: no magnet was seen by the encoder"),
        (36, "motor not configured, run moteus_tool --calibrate"),
        (39, "outside servopos.position_min and position_max, which a wheel should not have"),
        (42, "no valid commutation encoder"),
        (43, "no valid output encoder"),
        (44, "the gate driver could not be enabled"),
        (47, "servo.bemf_feedforward without an acceleration limit"),
        (99, "see the fault codes of register 0x00f in the maker's reference"),
    ):
        rig.node.servos[0].fail(code)
        rig.step(rig.driver.ask(), ticks=1)
        assert rig.driver.errors == [f"moteus 1 of wheel fl has the fault {code}: {words}"]


def test_a_battery_that_is_gone_is_the_makers_fault_of_under_voltage() -> None:
    rig = ready()
    rig.node.battery_v = 3.0
    rig.node.tick()
    rig.step(rig.driver.ask())
    assert [error.split(": ")[1] for error in rig.driver.errors] == ["under voltage"] * 4


def test_disarming_lets_every_motor_go() -> None:
    rig = ready()
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(rig.driver.disarm())
    assert not rig.driver.is_armed
    assert not rig.node.is_driving
    assert rig.driver.errors == []


def test_another_register_map_is_refused_with_what_to_do() -> None:
    rig = Rig("moteus")
    rig.node.servos[1].register_map = 3
    with pytest.raises(BadInputError, match=r"moteus 2 .* has the register map 3, and this driver knows 4 and 5"):
        rig.greet()


def test_who_does_not_answer_is_named() -> None:
    rig = Rig("moteus", {"ids": [1, 2, 3, 7]}, emulated_settings={"ids": [1, 2, 3, 4]})
    rig.step(rig.driver.ask())
    assert rig.driver.identity is None
    assert rig.driver.missing.startswith("no answer from the moteus 7;")


def test_a_restart_forgets_all() -> None:
    rig = ready()
    rig.driver.restart()
    assert not rig.driver.is_armed
    assert rig.driver.identity is None
    assert rig.driver.sample is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"ids": [1, 2, 3, 127]}, "expected four different ones, each 1 to 126"),
        ({"ids": [1, 2, 3, 3]}, "expected four different ones"),
        ({"ids": 4}, "expected an array, each item a whole number"),
        ({"can_prefix": 8192}, "from 0 to 8191"),
        ({"gear_ratio": 0.0}, "greater than 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        build(dialect("moteus").settings, settings, "device.motors")


def test_a_probe_finds_them_by_reading_alone() -> None:
    rig = Rig("moteus", IDS)
    made = dialect("moteus").probe
    assert made is not None
    probe = made()
    assert probe.found() is None
    asked = probe.ask()
    assert all(not protocol.parse_registers(frame.payload).command for frame in asked)
    rig.step(asked)
    for frame in rig.heard:
        probe.feed(frame)
    found = probe.found()
    assert found is not None
    assert found.motors == {"ids": [2, 4, 9, 126]}
    assert not rig.node.is_driving
