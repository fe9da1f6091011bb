"""Boards as data: what their files say fits the chip (data sheet DS8626, tables 9 and 23) and the protocol."""

import re
import shutil
import subprocess
from itertools import chain

import cffi
import pytest

from firmware_protocol.arm_build import PORT, TARGETS
from firmware_protocol.built import FIRMWARE_FLAGS, HERE
from firmware_protocol.host import parameters

BOARDS = sorted({target.board for target in TARGETS})
WITH_MOTORS = sorted({target.board for target in TARGETS if target.variant == "motors"})
APB1_HZ, APB2_HZ = 42e6, 84e6
# (port, pin, alternate function): the chip's function there, for the pins that the boards use.
ALTERNATES = {
    "A0 2": "TIM5_CH1",
    "A1 2": "TIM5_CH2",
    "A2 7": "USART2_TX",
    "A3 7": "USART2_RX",
    "A7 3": "TIM8_CH1N",
    "A8 1": "TIM1_CH1",
    "A9 7": "USART1_TX",
    "A10 7": "USART1_RX",
    "A15 1": "TIM2_CH1",
    "B3 1": "TIM2_CH2",
    "B4 2": "TIM3_CH1",
    "B5 2": "TIM3_CH2",
    "B6 2": "TIM4_CH1",
    "B7 2": "TIM4_CH2",
    "B8 9": "CAN1_RX",
    "B9 9": "CAN1_TX",
    "B10 7": "USART3_TX",
    "B11 7": "USART3_RX",
    "B13 1": "TIM1_CH1N",
    "B14 3": "TIM8_CH2N",
    "B15 3": "TIM8_CH3N",
    "C6 3": "TIM8_CH1",
    "C7 3": "TIM8_CH2",
    "C8 3": "TIM8_CH3",
    "C9 3": "TIM8_CH4",
}
ANALOG = [*(f"A{i}" for i in range(8)), "B0", "B1", *(f"C{i}" for i in range(6))]  # ADC 1, channels 0 to 15


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """Every board's (ffi, library), compiled for this machine."""
    cc = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if cc is None:
        pytest.skip("no C compiler on this machine: install gcc or clang")
    ffi = cffi.FFI()
    headers = (
        HERE / "generated" / "wheel_parameters.h",
        HERE / "firmware" / "parameters.h",
        PORT / "board.h",
        PORT / "motor_board.h",
    )
    sections = (re.findall(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", h.read_text(), re.DOTALL) for h in headers)
    types = "".join(chain.from_iterable(sections)).replace("WHEEL_COUNT", "4")
    ffi.cdef(types.replace("extern const ", "extern "))  # cffi reads variables, not constants
    folder = tmp_path_factory.mktemp("boards")
    made = {}
    for name in BOARDS:
        library = folder / f"{name}.so"
        command = [cc, *FIRMWARE_FLAGS, "-shared", "-fPIC", "-o", library, PORT / "boards" / f"{name}.c"]
        subprocess.run(list(map(str, command)), check=True)
        made[name] = (ffi, ffi.dlopen(str(library)))
    return made


def name_of(pin) -> str:
    return f"{'ABCDE'[pin.port]}{pin.number}"


def function_of(pin) -> str:
    return ALTERNATES[f"{name_of(pin)} {pin.alternate}"]


def serial_lines(lib, board: str) -> list:
    return [lib.BOARD.host_serial, *([] if board in WITH_MOTORS else [lib.PLANT_LINE])]


@pytest.mark.parametrize("board", BOARDS)
def test_lines_are_on_pins_that_the_chip_has_for_them(boards, board):
    _, lib = boards[board]
    for line in serial_lines(lib, board):
        assert function_of(line.transmit) == f"USART{line.usart}_TX"
        assert function_of(line.receive) == f"USART{line.usart}_RX"
    assert function_of(lib.BOARD.host_can.transmit) == "CAN1_TX"
    assert function_of(lib.BOARD.host_can.receive) == "CAN1_RX"


@pytest.mark.proves("R-SER-1")
@pytest.mark.parametrize("board", BOARDS)
def test_serial_rates_are_met_within_a_hundredth(boards, board):
    _, lib = boards[board]
    for line in serial_lines(lib, board):
        bus_hz = APB2_HZ if line.usart in (1, 6) else APB1_HZ
        assert abs(bus_hz / round(bus_hz / line.baud) / line.baud - 1) < 0.01


@pytest.mark.proves("R-CAN-1")
@pytest.mark.parametrize("board", BOARDS)
def test_a_can_bit_takes_a_microsecond_and_is_sampled_at_three_quarters_or_later(boards, board):
    can = boards[board][1].BOARD.host_can
    quanta = 1 + can.bs1 + can.bs2
    assert APB1_HZ / (can.prescaler * quanta) == 1e6
    assert 0.75 <= (1 + can.bs1) / quanta <= 0.88
    assert 1 <= can.sjw <= min(4, can.bs2)
    assert 1 <= can.bs1 <= 16
    assert 1 <= can.bs2 <= 8


@pytest.mark.parametrize("board", BOARDS)
def test_a_crystal_of_8_mhz_gives_168_mhz(boards, board):
    oscillator = boards[board][1].BOARD.oscillator
    assert 8e6 / oscillator.divider * oscillator.multiplier / 2 == 168e6
    assert 0.95e6 <= 8e6 / oscillator.divider <= 2.1e6  # RM0090, 7.3.2


@pytest.mark.parametrize("board", BOARDS)
def test_built_in_parameters_are_within_their_ranges(boards, board):
    own = boards[board][1].BOARD.parameters
    for parameter in parameters():
        assert parameter.minimum <= getattr(own, parameter.name) <= parameter.maximum, parameter.name
        if board in WITH_MOTORS:
            most = getattr(boards[board][1].BOARD.maximum, parameter.name)
            assert getattr(own, parameter.name) <= most, "or the robot starts with a fault"
    assert (board in WITH_MOTORS) == (boards[board][1].BOARD.maximum != boards[board][0].NULL)


def test_boards_have_numbers_of_their_own(boards):
    numbers = [lib.BOARD.number for _, lib in boards.values()]
    assert len(set(numbers)) == len(BOARDS)
    assert 0 not in numbers, "0 is the host library"


@pytest.mark.parametrize("board", WITH_MOTORS)
def test_no_pin_does_two_things(boards, board):
    _, lib = boards[board]
    motors = lib.MOTORS
    pins = [motors.enable, motors.battery.input]
    pins += [pin for m in motors.motor for pin in (m.first, m.second)]
    pins += [pin for e in motors.encoder for pin in (e.a, e.b)]
    pins += [a.input for a in (*motors.current, *(motors.temperature if motors.has_temperatures else ()))]
    pins += [pin for line in (lib.BOARD.host_serial, lib.BOARD.host_can) for pin in (line.transmit, line.receive)]
    names = [name_of(pin) for pin in pins]
    assert sorted(names) == sorted(set(names))
    assert not {"A13", "A14"} & set(names), "the debugger's"


@pytest.mark.parametrize("board", WITH_MOTORS)
@pytest.mark.parametrize("other", sorted(set(BOARDS) - set(WITH_MOTORS)))
def test_a_firmware_without_motors_touches_no_motor_pin_even_on_the_wrong_board(boards, board, other):
    motors, without = boards[board][1].MOTORS, boards[other][1]
    of_motors = {name_of(pin) for pin in (motors.enable, *(p for m in motors.motor for p in (m.first, m.second)))}
    lines = (*serial_lines(without, other), without.BOARD.host_can)
    assert not of_motors & {name_of(pin) for line in lines for pin in (line.transmit, line.receive)}


@pytest.mark.parametrize("board", WITH_MOTORS)
def test_motors_encoders_and_inputs_are_where_the_chip_has_them(boards, board):
    _, lib = boards[board]
    motors = lib.MOTORS
    for motor in motors.motor:
        output = f"TIM{motor.timer}_CH{motor.channel}"
        assert motor.timer in (1, 8)
        assert function_of(motor.first) == output
        if motors.kind == lib.MOTOR_COMPLEMENTARY:
            assert function_of(motor.second) == f"{output}N"
    for encoder in motors.encoder:
        assert function_of(encoder.a) == f"TIM{encoder.timer}_CH1"
        assert function_of(encoder.b) == f"TIM{encoder.timer}_CH2"
    assert len({encoder.timer for encoder in motors.encoder}) == 4
    for analog in (*motors.current, motors.battery, *(motors.temperature if motors.has_temperatures else ())):
        assert ANALOG[analog.channel] == name_of(analog.input)


@pytest.mark.parametrize("board", WITH_MOTORS)
def test_bridges_and_current_sensors_suit_the_limits(boards, board):
    _, lib = boards[board]
    motors, own = lib.MOTORS, lib.BOARD.parameters
    for analog in (*motors.current, motors.battery, *(motors.temperature if motors.has_temperatures else ())):
        assert 0.0 <= analog.least_v < analog.most_v < 3.3, "an input that is torn off is at one of the ends"
    assert 1000 <= 168e6 / (2 * motors.pwm_hz) <= 65535  # resolution, and the timer's 16 bits
    assert motors.dead_time <= 127
    assert 0.8 <= motors.duty_limit <= 1.0
    assert motors.kind != lib.MOTOR_COMPLEMENTARY or motors.dead_time > 0
    if motors.kind == lib.MOTOR_COMPLEMENTARY:
        low_s = (1 - motors.duty_limit) / 2 / motors.pwm_hz - motors.dead_time / 168e6
        assert low_s >= 1e-6, "a bootstrap capacitor is charged in each period"
    for current in motors.current:
        reach_a = min(current.zero_v - current.least_v, current.most_v - current.zero_v) * abs(current.per_v)
        assert reach_a > 1.5 * lib.BOARD.maximum.current_limit_a, "an overcurrent is a fault only if it can be measured"
        assert own.current_limit_a <= lib.BOARD.maximum.current_limit_a
