"""Yahboom Rosmaster: bytes that Rosmaster_Lib 3.3.9 writes, and the emulated board's response."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from tests.support.dialect_testbed import Rig

GET_VERSION = "fffc05505100a6"
GET_CAR_TYPE = "fffc055015006a"
RESET_STATE = "fffc040f5f72"
NO_MOTION = {  # by the library's name
    "set_beep": "fffc0502320039",
    "set_colorful_effect": "fffc06060105ff11",
    "set_pwm_servo": "fffc0503015a63",
    "set_uart_servo_torque": "fffc04220127",
    "set_motor": "fffc07101e1e1e1e8f",
    "set_car_run": "fffc071101011e0038",
}


@pytest.fixture
def board() -> Rig:
    return Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})


def write(board: Rig, *frames: str) -> None:
    """Write frames as the library does, 2 ms apart."""
    for one in frames:
        board.node.feed(bytes.fromhex(one))
        board.node.run(2)


def reports(board: Rig, ticks: int = 45) -> dict[int, bytes]:
    """Listen so long, and return the newest data of each function."""
    board.node.take_frames()
    board.node.run(ticks)
    return {frame.id: frame.payload for frame in board.node.take_frames()}


def answer(board: Rig, question: str) -> tuple[int, bytes]:
    """Ask, and return what comes that is no report."""
    write(board, question)
    [frame] = [frame for frame in board.node.take_frames() if not 0x0A <= frame.id <= 0x0E]
    return frame.id, frame.payload


def test_version_and_car_are_answered(board: Rig) -> None:
    assert answer(board, GET_VERSION) == (0x51, bytes((3, 5)))
    assert answer(board, GET_CAR_TYPE)[1][0] == 1


def test_reports_have_the_attitude(board: Rig) -> None:
    board.node.execute(Frame(0x12, struct.pack("<B3h", 1, 0, 0, 1000)))
    board.node.run(2000)
    told = reports(board)
    assert set(told) == {0x0A, 0x0C, 0x0D, 0x0E}
    _, _, yaw = struct.unpack("<3h", told[0x0C])
    board.node.run(400)
    _, _, later = struct.unpack("<3h", reports(board)[0x0C])
    turned = math.remainder((later - yaw) / 10000.0, math.tau)
    assert turned == pytest.approx(board.node.gyro_rad_s[2] * 0.445, rel=0.15)
    write(board, RESET_STATE)
    assert not board.node.is_driving


@pytest.mark.parametrize("name", NO_MOTION)
def test_other_functions_are_passed_over(board: Rig, name: str) -> None:
    write(board, NO_MOTION[name])
    board.node.run(5)
    assert not board.node.is_driving
    assert all(0x0A <= frame.id <= 0x0E for frame in board.node.take_frames())


@given(st.integers(0, 255), st.binary(max_size=12))
def test_no_other_function_and_none_of_another_size_moves_a_wheel(function: int, data: bytes) -> None:
    if function == 0x12 and len(data) == 7:
        data += b"\0"
    QUIET.node.execute(Frame(function, data))
    assert not QUIET.node.is_driving
    QUIET.node.take_frames()


@given(st.binary(min_size=7, max_size=7))
def test_no_numbers_make_more_than_the_limits(data: bytes) -> None:
    node = DRIVEN.node
    node.execute(Frame(0x12, data))
    node.run(1)
    limit = node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    assert all(abs(torque) <= limit for torque in node.torque_n_m)
    assert all(abs(target) <= 1000 for target in node._targets_mm_s or ())
    node.execute(Frame(0x0F, b"\x5f"))
    node.take_frames()


QUIET = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
DRIVEN = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
