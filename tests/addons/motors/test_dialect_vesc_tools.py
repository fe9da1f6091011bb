"""VESC: frames of the makers' tools, and the emulated controller's answers.

The packets of the serial line are those that pyvesc writes (its fork pyvesc-fix 1.0.3, run by hand before the emulated
device on a pseudo-terminal; as packaged it cannot be imported, so it is no dependency here). The frames of CAN are the
example of the maker's page and its table of commands.
"""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.vesc.vesc_frames import SerialFraming
from hil.robot.driver import EXTENDED
from tests.support.dialect_testbed import Rig

SET_RPM_420 = bytes.fromhex("020508 000001a4 c47203")
SET_CURRENT_BACKWARDS_2_5_A = bytes.fromhex("020506 fffff63c 07fd03")
SET_CURRENT_0_A = bytes.fromhex("020506 00000000 cd8503")
SET_CURRENT_BRAKE_2_5_A = bytes.fromhex("020507 000009c4 448403")
ERPM = 7 * 60.0 / 6.283185307179586  # of 1 rad/s, with 7 pole pairs and no gear


@pytest.fixture
def line() -> Rig:
    return Rig("vesc", wire="serial")


@pytest.fixture
def bus() -> Rig:
    return Rig("vesc", wire="can")


@pytest.mark.parametrize("command", [SET_RPM_420, SET_CURRENT_BACKWARDS_2_5_A])
def test_every_command_of_the_line_ends_with_the_timeout(line: Rig, command: bytes) -> None:
    line.node.feed(command)
    line.node.run(500)
    assert line.node.is_driving
    assert abs(line.speeds()[0]) > 1.0
    line.node.run(510)
    assert not line.node.is_driving


def test_a_speed_is_reached_and_a_brake_brings_a_wheel_to_rest_sooner_than_rolling() -> None:
    left = []
    for stop in (SET_CURRENT_BRAKE_2_5_A, SET_CURRENT_0_A):
        rig = Rig("vesc", wire="serial")
        rig.node.feed(SET_RPM_420)
        rig.node.run(800)
        assert rig.speeds()[0] * ERPM == pytest.approx(420, abs=5)
        rig.node.feed(stop)
        rig.node.run(150)
        left.append(rig.speeds()[0])
    braked, rolled = left
    assert abs(braked) < 0.5 * rolled


def test_the_example_of_the_makers_page_asks_for_51_a_of_the_vesc_23() -> None:
    rig = Rig("vesc", {"ids": [23, 2, 3, 4]}, wire="can")
    rig.node.receive(Frame(EXTENDED | 0x0117, bytes.fromhex("0000c738")))
    rig.node.run(1)
    constant, limit = rig.node.values["torque_constant_n_m_a"], rig.node.values["torque_limit_n_m"]
    assert rig.node.torque_n_m[0] == pytest.approx(min(51 * constant, limit))
    assert rig.node.torque_n_m[1:] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("command", "raw"), [(1, 2500), (3, 420)])
def test_every_command_of_the_bus_ends_with_the_timeout(bus: Rig, command: int, raw: int) -> None:
    bus.node.receive(Frame(EXTENDED | command << 8 | 255, struct.pack(">i", raw)))
    bus.node.run(500)
    assert min(bus.speeds()) > 1.0
    bus.node.run(510)
    assert not bus.node.is_driving


def test_a_current_with_a_delay_moves_nothing(bus: Rig) -> None:
    bus.node.receive(Frame(EXTENDED | 0x0101, struct.pack(">ih", 5000, 100)))
    bus.node.run(1)
    assert not bus.node.is_driving


COMMANDS = {6, 7, 8}
CAN_COMMANDS = {1, 2, 3}


@given(st.integers(0, 255), st.binary(max_size=12))
def test_no_other_message_and_none_that_is_cut_short_moves_a_wheel(code: int, data: bytes) -> None:
    near = QUIET.node.vescs[0]
    near.process(bytes((code,)) + (data[:3] if code in COMMANDS else data), lambda _message: None)
    QUIET.node.feed(SerialFraming().encode(Frame(code, data))[:-1] + b"\x00")  # without its end
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
