"""VESC: what the makers' tools send to one, and what the emulated one answers.

The packets of the serial line are those that pyvesc writes (its fork pyvesc-fix 1.0.3, run by hand before the emulated
device on a pseudo-terminal; as packaged it cannot be imported, so it is no dependency here). The frames of CAN are the
example of the maker's page and its table of commands.
"""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.drivers.port import EXTENDED
from hil.drivers.vesc.emulated_controller import first_packet, packet
from tests.dialect_testbed import Rig

GET_VALUES = bytes.fromhex("02010440 8403")
SET_DUTY_A_TENTH = bytes.fromhex("020505 00002710 ae1703")
SET_RPM_420 = bytes.fromhex("020508 000001a4 c47203")
SET_CURRENT_BACKWARDS_2_5_A = bytes.fromhex("020506 fffff63c 07fd03")
SET_CURRENT_BRAKE_2_5_A = bytes.fromhex("020507 000009c4 448403")
ALIVE = bytes.fromhex("02011e f3ff03")
ERPM = 7 * 60.0 / 6.283185307179586  # of 1 rad/s, with 7 pole pairs and no gear


@pytest.fixture
def line() -> Rig:
    return Rig("vesc", wire="serial")


@pytest.fixture
def bus() -> Rig:
    return Rig("vesc", wire="can")


def answer(rig: Rig) -> bytes:
    """Return the one message that has come over the line."""
    data = rig.node.take_bytes()
    size, message = first_packet(data)
    assert size == len(data)
    return message


def values(rig: Rig) -> tuple[Any, ...]:
    """Ask for all values; the layout is that of firmware 6.05, commands.c."""
    rig.node.feed(GET_VALUES)
    message = answer(rig)
    assert message[0] == 4
    return struct.unpack(">hhiiiihihiiiiiiBiBhhhiiB", message[1:])


def test_all_values_come_in_the_order_of_the_firmware(line: Rig) -> None:
    line.node.feed(SET_DUTY_A_TENTH)
    line.node.run(900)
    (
        fet, motor, motor_a, input_a, d_a, q_a, duty, erpm, volts, drawn_ah, given_ah, drawn_wh, given_wh, steps,
        steps_abs, fault, position, number, *fets, d_v, q_v, status,
    ) = values(line)  # fmt: skip
    near = line.node.vescs[0]
    assert (fet, motor, *fets) == (int(near.degc * 10),) * 5
    assert (motor_a, q_a, d_a) == (int(near.current_a * 100), int(near.current_a * 100), 0)
    assert input_a == int(line.node.battery_a / 4.0 * 100)
    assert duty == pytest.approx(100, abs=1)
    assert erpm == pytest.approx(line.speeds()[0] * ERPM, abs=5)
    assert erpm > 100
    assert volts == int(line.node.battery_v * 10)
    assert (given_ah, given_wh, position, d_v) == (0, 0, 0, 0)
    assert 0 <= drawn_ah <= drawn_wh
    assert steps == steps_abs > 0
    assert (fault, number, status) == (0, 1, 0)
    assert q_v == pytest.approx(0.1 * line.node.battery_v * 1000, abs=20)


def test_the_charge_that_was_drawn_is_counted(line: Rig) -> None:
    near = line.node.vescs[0]
    near.input_a, near.input_v = 36.0, 20.0
    for _ in range(1000):
        near.measure(line.node.shafts[0], 1.0)
    near.input_a = -18.0
    for _ in range(1000):
        near.measure(line.node.shafts[0], 1.0)
    assert values(line)[9:13] == pytest.approx((100, 50, 2000, 1000), abs=1)  # 36 A for 1 s are 0.01 Ah


@pytest.mark.parametrize("command", [SET_DUTY_A_TENTH, SET_RPM_420, SET_CURRENT_BACKWARDS_2_5_A])
def test_every_command_of_the_line_ends_with_the_timeout(line: Rig, command: bytes) -> None:
    line.node.feed(command)
    line.node.run(500)
    assert line.node.is_driving
    assert abs(line.speeds()[0]) > 1.0
    line.node.run(510)
    assert not line.node.is_driving
    assert values(line)[-1] == 1


def test_alive_keeps_a_command_alive_and_brings_none_back(line: Rig) -> None:
    line.node.feed(SET_RPM_420)
    for _ in range(4):
        line.node.run(900)
        line.node.feed(ALIVE)
    assert line.node.is_driving
    assert line.speeds()[0] * ERPM == pytest.approx(420, abs=5)
    line.node.run(1010)
    line.node.feed(ALIVE)
    line.node.run(10)
    assert not line.node.is_driving


def test_brake_and_a_duty_of_zero_bring_a_wheel_to_rest_sooner_than_rolling(line: Rig) -> None:
    left = []
    for stop in (SET_CURRENT_BRAKE_2_5_A, packet(b"\x05" + bytes(4)), packet(b"\x06" + bytes(4))):
        rig = Rig("vesc", wire="serial")
        rig.node.feed(SET_RPM_420)
        rig.node.run(800)
        rig.node.feed(stop)
        rig.node.run(150)
        left.append(rig.speeds()[0])
    braked, shorted, rolled = left
    assert max(abs(braked), abs(shorted)) < 0.5 * rolled


def test_a_duty_is_cut_at_the_largest_and_its_current_at_the_limit(line: Rig) -> None:
    line.node.feed(packet(b"\x05" + struct.pack(">i", 2**31 - 1)))
    line.node.run(1)
    assert line.node.torque_n_m[0] == line.node.values["torque_limit_n_m"]
    for _ in range(8):
        line.node.run(500)
        line.node.feed(ALIVE)
    assert line.node.vescs[0].duty == pytest.approx(0.95, abs=0.01)


def test_the_example_of_the_makers_page_asks_for_51_a_of_the_vesc_23() -> None:
    rig = Rig("vesc", {"ids": [23, 2, 3, 4]}, wire="can")
    rig.node.receive(Frame(EXTENDED | 0x0117, bytes.fromhex("0000c738")))
    rig.node.run(1)
    constant, limit = rig.node.values["torque_constant_n_m_a"], rig.node.values["torque_limit_n_m"]
    assert rig.node.torque_n_m[0] == pytest.approx(min(51 * constant, limit))
    assert rig.node.torque_n_m[1:] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("command", "raw"), [(0, 10_000), (1, 2500), (3, 420), (10, 30_000)])
def test_every_command_of_the_bus_ends_with_the_timeout(bus: Rig, command: int, raw: int) -> None:
    bus.node.receive(Frame(EXTENDED | command << 8 | 255, struct.pack(">i", raw)))
    bus.node.run(500)
    assert min(bus.speeds()) > 1.0
    bus.node.run(510)
    assert not bus.node.is_driving


def test_a_share_is_of_the_largest_current(bus: Rig) -> None:
    bus.node.receive(Frame(EXTENDED | 10 << 8 | 2, struct.pack(">i", -25_000)))
    bus.node.receive(Frame(EXTENDED | 10 << 8 | 3, struct.pack(">i", 10_000_000)))
    bus.node.run(1)
    limit = bus.node.values["torque_limit_n_m"]
    assert bus.node.torque_n_m == pytest.approx((0.0, -0.25 * limit, limit, 0.0))


def test_the_status_messages_are_those_that_are_switched_on(bus: Rig) -> None:
    for vesc in bus.node.vescs:
        vesc.enabled_statuses = (1, 2, 3, 4, 5)
    bus.node.receive(Frame(EXTENDED | 0x0001, struct.pack(">i", 10_000)))
    bus.node.run(900)
    bus.node.take_frames()
    bus.node.run(20)
    told = {frame.id: frame.payload for frame in bus.node.take_frames()}
    assert {number & ~EXTENDED for number in told} == {c << 8 | n for c in (9, 14, 15, 16, 27) for n in (1, 2, 3, 4)}
    erpm, current, duty = struct.unpack(">ihh", told[EXTENDED | 0x0901])
    assert erpm == pytest.approx(bus.speeds()[0] * ERPM, abs=10)
    assert current == int(bus.node.vescs[0].motor_a * 10)
    assert duty == pytest.approx(100, abs=1)
    assert all(struct.unpack(">ii", told[EXTENDED | c << 8 | 1])[1] == 0 for c in (14, 15)), "nothing was given back"


def test_a_message_on_the_bus_that_wants_no_answer_has_none_and_is_done(bus: Rig) -> None:
    bus.node.receive(Frame(EXTENDED | 0x0801, b"\xfd\x02\x05" + struct.pack(">i", 10_000)))
    bus.node.receive(Frame(EXTENDED | 0x0801, b"\xfd\x02\x04"))
    assert bus.node.take_frames() == []
    assert bus.node.is_driving


def test_a_current_with_a_delay_moves_nothing(bus: Rig) -> None:
    bus.node.receive(Frame(EXTENDED | 0x0101, struct.pack(">ih", 5000, 100)))
    bus.node.run(1)
    assert not bus.node.is_driving


COMMANDS = {5, 6, 7, 8, 30}
CAN_COMMANDS = {0, 1, 2, 3, 10, 11}


@given(st.integers(0, 255), st.binary(max_size=12))
def test_no_other_message_and_none_that_is_cut_short_moves_a_wheel(code: int, data: bytes) -> None:
    near = QUIET.node.vescs[0]
    near.process(bytes((code,)) + (data[:3] if code in COMMANDS else data), lambda _message: None)
    QUIET.node.feed(packet(bytes((code,)) + data)[:-1] + b"\x00")  # without its end
    assert not QUIET.node.is_driving


@given(st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8))
def test_no_other_frame_and_none_that_is_cut_short_moves_a_wheel(number: int, data: bytes) -> None:
    command = number >> 8
    if command in CAN_COMMANDS:
        data = data[:3]
    elif command == 8 and len(data) > 2 and data[2] in COMMANDS:
        data = data[:6]
    QUIET.node.receive(Frame(EXTENDED | number & ~0xFF | 1, data))
    QUIET.node.take_frames()
    assert not QUIET.node.is_driving


QUIET = Rig("vesc", wire="serial")
