"""Yahboom Rosmaster: what the maker's library sends, and what the emulated board does.

The bytes are those that Rosmaster_Lib 3.3.9 writes. It is in no package registry, so it was run by hand, before
`hil device --driver rosmaster` on a pseudo-terminal: every function named here, and what it reads back.
"""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from tests.dialect_testbed import Rig, assert_near

GET_VERSION = "fffc05505100a6"
GET_CAR_TYPE = "fffc055015006a"
GET_MOTION_PID = "fffc0550130169"
GET_UART_SERVO = "fffc0550200176"
SET_PID_TWICE = "fffc0a1340067800f40100d0"  # kp 1.6, ki 0.12, kd 0.5
SET_MOTOR_30 = "fffc07101e1e1e1e8f"
SET_MOTOR_SIDEWAYS = "fffc0710649c649c17"  # 100, -100, 100, -100
SET_MOTOR_KEEPS_M1 = "fffc07107f9c006496"  # 127, -100, 0, 100
RUN_FORWARD_30 = "fffc071101011e0038"
RUN_BACK_30 = "fffc071101021e0039"
RUN_LEFT_30 = "fffc071101031e003a"
SPIN_LEFT_20 = "fffc07110105140032"
RUN_STOP = "fffc07110100000019"
RUN_BRAKE = "fffc07110107000020"
RESET_STATE = "fffc040f5f72"
RESET_FLASH = "fffc04a05f03"
REPORTS_OFF, REPORTS_ON = "fffc0501000006", "fffc0501010007"
SET_X3_PLUS = "fffc0515025f7b"
NO_MOTION = {  # by the library's name
    "set_beep": "fffc0502320039",
    "set_colorful_effect": "fffc06060105ff11",
    "set_pwm_servo": "fffc0503015a63",
    "set_uart_servo_torque": "fffc04220127",
}
RIM_M = 0.204203 / math.tau


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


def rims_mm_s(board: Rig) -> list[float]:
    return [speed * RIM_M * 1000.0 for speed in board.speeds()]


def test_questions_are_answered_and_what_is_not_there_is_not(board: Rig) -> None:
    assert answer(board, GET_VERSION) == (0x51, bytes((3, 5)))
    assert answer(board, GET_CAR_TYPE)[1][0] == 1
    assert answer(board, GET_MOTION_PID) == (0x13, struct.pack("<B3H", 1, 800, 60, 500))
    board.node.take_frames()
    write(board, GET_UART_SERVO)
    assert all(0x0A <= frame.id <= 0x0E for frame in board.node.take_frames())


def test_gains_are_told_as_they_were_set_and_stiffen_the_loops(board: Rig) -> None:
    slowly = Frame(0x12, struct.pack("<B3h", 1, 10, 0, 0))
    board.node.execute(slowly)
    board.node.run(1)
    soft = board.node.torque_n_m[0]
    stiff = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
    write(stiff, SET_PID_TWICE)
    assert answer(stiff, GET_MOTION_PID) == (0x13, struct.pack("<B3H", 1, 1600, 120, 500))
    stiff.node.execute(slowly)
    stiff.node.run(1)
    assert stiff.node.torque_n_m[0] == pytest.approx(2.0 * soft)
    write(stiff, RESET_FLASH)
    assert not stiff.node.is_driving
    assert answer(stiff, GET_MOTION_PID)[1] == struct.pack("<B3H", 1, 800, 60, 500)


@pytest.mark.parametrize(
    ("command", "rims"),
    [
        (RUN_FORWARD_30, (300.0, 300.0, 300.0, 300.0)),
        (RUN_BACK_30, (-300.0, -300.0, -300.0, -300.0)),
        (RUN_LEFT_30, (-300.0, 300.0, -300.0, 300.0)),
        (SPIN_LEFT_20, (-164.6, 164.6, 164.6, -164.6)),
    ],
)
def test_set_car_run_goes_each_way_and_on_until_it_is_stopped(
    board: Rig, command: str, rims: tuple[float, float, float, float]
) -> None:
    write(board, command)
    board.node.run(1500)
    assert_near(rims_mm_s(board), rims, 5.0)
    board.node.run(2000)
    assert_near(rims_mm_s(board), rims, 5.0)
    write(board, RUN_BRAKE)
    board.node.run(1500)
    assert max(map(abs, rims_mm_s(board))) < 0.5 * max(map(abs, rims))


def test_a_stop_of_set_car_run_lets_go_and_its_brake_brakes(board: Rig) -> None:
    other = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
    for one, stop in ((board, RUN_STOP), (other, RUN_BRAKE)):
        write(one, RUN_FORWARD_30)
        one.node.run(1000)
        write(one, stop)
        one.node.run(100)
    assert board.node.torque_n_m == (0.0,) * 4
    assert all(abs(braked) < 0.5 * rolled for braked, rolled in zip(rims_mm_s(other), rims_mm_s(board), strict=True))


def test_set_motor_is_a_voltage_that_goes_on_until_it_is_stopped(board: Rig) -> None:
    write(board, SET_MOTOR_30)
    board.node.run(3000)
    values = board.node.values
    no_load = (2000 + 30 * 16) / 3600 * board.node.battery_v / values["torque_constant_n_m_a"]
    assert all(0.8 * no_load < speed <= no_load for speed in board.speeds())
    write(board, RESET_STATE)
    board.node.run(2500)
    assert board.is_still()


def test_motors_of_set_motor_are_front_and_rear_of_the_left_then_of_the_right(board: Rig) -> None:
    write(board, SET_MOTOR_SIDEWAYS)
    fl, fr, rr, rl = board.node.torque_n_m
    assert fl > 0.0 > rl
    assert fr > 0.0 > rr
    write(board, SET_MOTOR_KEEPS_M1)
    fl, fr, rr, rl = board.node.torque_n_m
    assert fl > 0.0 > rl
    assert (fr, rr > 0.0) == (pytest.approx(0.0, abs=0.01), True)


def test_loops_that_drive_go_on_driving_whatever_set_motor_says(board: Rig) -> None:
    write(board, RUN_FORWARD_30)
    board.node.run(1000)
    write(board, SET_MOTOR_SIDEWAYS)
    board.node.run(500)
    assert_near(rims_mm_s(board), (300.0,) * 4, 5.0)


def test_reports_have_the_attitude_and_go_off_and_on(board: Rig) -> None:
    write(board, SPIN_LEFT_20)
    board.node.run(2000)
    told = reports(board)
    assert set(told) == {0x0A, 0x0C, 0x0D, 0x0E}
    _, _, yaw = struct.unpack("<3h", told[0x0C])
    board.node.run(400)
    _, _, later = struct.unpack("<3h", reports(board)[0x0C])
    turned = math.remainder((later - yaw) / 10000.0, math.tau)
    assert turned == pytest.approx(board.node.gyro_rad_s[2] * 0.445, rel=0.15)
    write(board, REPORTS_OFF)
    assert reports(board) == {}
    write(board, REPORTS_ON)
    assert len(reports(board)) == 4


def test_a_car_that_is_set_is_told_and_has_its_limit_and_no_speed_of_before(board: Rig) -> None:
    """Its encoders have other counts: between those of before and these no speed is to be taken."""
    write(board, SPIN_LEFT_20)
    board.node.run(3000)
    write(board, SET_X3_PLUS)
    board.node.run(8)
    assert max(abs(speed) for speed in board.node._speeds_mm_s) < 500.0
    assert answer(board, GET_CAR_TYPE)[1][0] == 2
    board.node.execute(Frame(0x11, struct.pack("<BBH", 2, 1, 100)))
    assert board.node._targets_mm_s == (700, 700, 700, 700)


@pytest.mark.parametrize("name", NO_MOTION)
def test_lamps_beeper_and_servos_are_passed_over(board: Rig, name: str) -> None:
    write(board, NO_MOTION[name])
    board.node.run(5)
    assert not board.node.is_driving
    assert all(0x0A <= frame.id <= 0x0E for frame in board.node.take_frames())


SIZES = {0x10: 4, 0x11: 4, 0x12: 7}


@given(st.integers(0, 255), st.binary(max_size=12))
def test_no_other_function_and_none_of_another_size_moves_a_wheel(function: int, data: bytes) -> None:
    if len(data) == SIZES.get(function):
        data += b"\0"
    QUIET.node.execute(Frame(function, data))
    assert not QUIET.node.is_driving
    QUIET.node.take_frames()


@given(st.sampled_from(sorted(SIZES)), st.binary(min_size=7, max_size=7))
def test_no_numbers_make_more_than_the_limits(function: int, data: bytes) -> None:
    node = DRIVEN.node
    node.execute(Frame(function, data[: SIZES[function]]))
    node.run(1)
    limit = node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    assert all(abs(torque) <= limit for torque in node.torque_n_m)
    assert all(abs(target) <= 1000 for target in node._targets_mm_s or ())
    node.execute(Frame(0x0F, b"\x5f"))
    node.take_frames()


QUIET = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
DRIVEN = Rig("rosmaster", **{"plant.start.battery_voltage_v": 12.0})
