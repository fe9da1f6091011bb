"""Bridges, encoders and inputs of the STM32F405: what the linked firmware writes to their registers."""

import struct

import pytest

pytest.importorskip("unicorn", reason="no Unicorn: pip install unicorn")
pytest.importorskip("elftools", reason="no pyelftools: pip install pyelftools")

from tests.support.arm_machine import FLASH, GPIO, RCC_CR, Machine
from tests.support.arm_robot import (
    ADC_SR,
    DMA_NDTR,
    IWDG_KR,
    RAW_ZERO,
    ROUND,
    ROUNDS,
    SCRATCH,
    bits_of,
    machine,
    with_motors,
)

ODR, BSRR = 0x14, 0x18
TIM1, TIM8 = 0x4001_0000, 0x4001_0400
ENCODER_TIMERS = {2: 0x4000_0000, 3: 0x4000_0400, 4: 0x4000_0800, 5: 0x4000_0C00}
CR1, EGR, SMCR, CCMR1, CCER, CNT, ARR, CCR1, BDTR = 0x00, 0x14, 0x08, 0x18, 0x20, 0x24, 0x2C, 0x34, 0x44
SR, BIF = 0x10, 1 << 7
MOE = 1 << 15
RCC_AHB1ENR = 0x4002_3830
DRIVERS, BRIDGES = ("f405_drivers", "A8"), ("f405_bridges", "C5")  # boards, and the pin that enables their bridges
by_board = pytest.mark.parametrize(("board", "enable"), [DRIVERS, BRIDGES])


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


@by_board
def test_bridges_stay_off_until_something_drives(board, enable):
    own = with_motors(board)
    assert not [value for address, value in own.writes if address in (TIM1 + BDTR, TIM8 + BDTR) and value & MOE]
    base, number = bits_of(enable)
    assert (base + BSRR, 1 << number) not in own.writes
    assert (base + BSRR, 1 << number + 16) in own.writes
    assert own.peek(base) >> 2 * number & 3 == 1, "an output"


@by_board
def test_the_first_thing_after_a_reset_is_an_enable_pin_that_is_low(board, enable):
    own = with_motors(board)
    base, number = bits_of(enable)
    clock, low, output = own.writes[:3]
    assert clock == (RCC_AHB1ENR, 1 << "ABC".index(enable[0]))
    assert low == (base + BSRR, 1 << number + 16), "before it is an output"
    assert output == (base, 1 << 2 * number)


@by_board
def test_a_failing_crystal_switches_the_outputs_off_and_that_is_locked(board, enable):
    own = with_motors(board)
    for timer in (TIM1, TIM8):
        first = next(value for address, value in own.writes if address == timer + BDTR)
        assert first & (3 << 12 | 3 << 8) == 3 << 12 | 1 << 8, (
            "break and lock with the first write, the only one that locks"
        )
    assert own.peek(RCC_CR) & 1 << 19, "the clock security system"
    nmi = own.peek(FLASH + 4 * 2) & ~1
    assert nmi == own.symbols["fault"]


@by_board
def test_pins_go_to_the_timers_when_these_hold_them_low(board, enable):
    own = with_motors(board)
    base, number = bits_of("C6")  # an output of timer 8 on both boards
    addresses = [address for address, _ in own.writes]
    handed_over = next(i for i, (a, v) in enumerate(own.writes) if a == base and v >> 2 * number & 3 == 2)
    for timer in (TIM1, TIM8):
        assert (timer + BDTR) in addresses[:handed_over]
        assert own.peek(timer + BDTR) & 1 << 10, "idle outputs are driven low"
    assert own.peek(base + 0x0C) >> 2 * number & 3 == 2, "pulled down"


def drive(own: Machine, *duty: float) -> list[tuple[int, int]]:
    own.writes.clear()
    own.write(SCRATCH, floats(*duty))
    own.call("pwm_drive", SCRATCH)
    return own.writes


def test_sign_and_magnitude():
    own = with_motors("f405_drivers")
    drive(own, 0.5, 0.25, -1.0, -0.125)  # FR and RR are reversed
    period = own.peek(TIM8 + ARR)
    assert period == 168_000_000 // 40_000
    assert [own.peek(TIM8 + CCR1 + 4 * i) / period for i in range(4)] == [0.5, 0.25, 1.0, 0.125]
    signs = own.peek(GPIO + 0x400 + ODR) >> 12
    assert signs == 0b0101, "FL and, as it is reversed, RR"


def test_a_new_sign_never_meets_the_old_magnitude():
    own = with_motors("f405_drivers")
    drive(own, 0.5, 0.5, 0.5, 0.5)
    writes = drive(own, -0.25, 0.5, 0.5, 0.5)
    sign = (GPIO + 0x400 + BSRR, 1 << 12 + 16)
    about = [write for write in writes if write[0] in (TIM8 + CCMR1, TIM8 + CCR1) or write == sign]
    preload, period = 1 << 3, own.peek(TIM8 + ARR)
    assert [address for address, _ in about] == [TIM8 + CCMR1, TIM8 + CCR1, sign[0], TIM8 + CCMR1, TIM8 + CCR1]
    assert about[0][1] == about[3][1] ^ preload, "without preload the next is at once"
    assert not about[0][1] & preload
    assert about[1][1] == 0
    assert about[4][1] == period // 4
    assert not [address for address, _ in writes if address == TIM8 + CCMR1 + 4], "RR and RL go on"


def test_complementary_outputs_are_half_on_for_zero_volt():
    own = with_motors("f405_bridges")
    drive(own, 0.5, 0.25, -1.0, 0.0)
    period = own.peek(TIM8 + ARR)
    outputs = [own.peek(TIM8 + CCR1 + 4 * i) / period for i in range(3)] + [own.peek(TIM1 + CCR1) / period]
    assert outputs == [0.75, 0.375, 0.95, 0.5], "FR and RR are reversed; 0.9 is the board's limit"
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == pytest.approx((0.5, 0.25, -0.9, 0.0)), "told to the caller"
    assert own.peek(TIM8 + CCER) == 0x555
    assert own.peek(TIM1 + CCER) == 0x5
    assert own.peek(TIM1 + BDTR) & 0xFF == own.peek(TIM8 + BDTR) & 0xFF == 84, "dead time"


@by_board
@pytest.mark.parametrize("duty", [float("nan"), float("inf"), -float("inf"), 1.5, -3e38])
def test_no_duty_is_beyond_the_period(board, enable, duty):
    own = with_motors(board)
    drive(own, duty, duty, duty, duty)
    for timer in (TIM1, TIM8):
        for i in range(4):
            assert own.peek(timer + CCR1 + 4 * i) <= own.peek(timer + ARR)


@by_board
def test_bridges_come_on_with_the_first_duties_and_go_off_at_once(board, enable):
    own = with_motors(board)
    base, number = bits_of(enable)
    writes = drive(own, 0.1, 0.1, 0.1, 0.1)
    on = (base + BSRR, 1 << number)
    assert writes.index((TIM8 + EGR, 1)) < writes.index((TIM8 + BDTR, own.peek(TIM8 + BDTR))) < writes.index(on)
    assert own.peek(TIM1 + BDTR) & own.peek(TIM8 + BDTR) & MOE
    own.writes.clear()
    own.call("plant_off")
    assert not (own.peek(TIM1 + BDTR) | own.peek(TIM8 + BDTR)) & MOE
    assert [address for address, _ in own.writes[:2]] == [TIM1 + BDTR, TIM8 + BDTR], "first the outputs"
    assert (base + BSRR, 1 << number + 16) in own.writes


@by_board
def test_a_fault_switches_the_bridges_off_and_feeds_no_watchdog(board, enable):
    own = with_motors(board)
    drive(own, 0.1, 0.1, 0.1, 0.1)
    own.writes.clear()
    own.jump("fault")
    assert not (own.peek(TIM1 + BDTR) | own.peek(TIM8 + BDTR)) & MOE
    base, number = bits_of(enable)
    assert (base + BSRR, 1 << number + 16) in own.writes
    assert all(address != IWDG_KR for address, _ in own.writes)


@by_board
@pytest.mark.parametrize("timer", [TIM1, TIM8])
def test_a_break_of_either_timer_stops_all_motors_and_is_not_armed_again(board, enable, timer):
    own = with_motors(board)
    drive(own, 0.1, 0.1, 0.1, 0.1)
    own.poke(timer + BDTR, own.peek(timer + BDTR) & ~MOE)  # as the hardware does
    own.poke(timer + SR, BIF)
    for _ in range(2):
        writes = drive(own, 0.2, 0.2, 0.2, 0.2)
        assert not (own.peek(TIM1 + BDTR) | own.peek(TIM8 + BDTR)) & MOE
        assert not [value for address, value in writes if address in (TIM1 + BDTR, TIM8 + BDTR) and value & MOE]
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == (0.0,) * 4, "told to the caller"
    base, number = bits_of(enable)
    assert (base + BSRR, 1 << number + 16) in writes
    assert own.call("plant_sense", 0, SCRATCH) == 2, "the firmware takes it for a fault"


@by_board
@pytest.mark.parametrize("timer", [TIM1, TIM8])
def test_outputs_that_are_off_at_one_timer_alone_come_on_at_both(board, enable, timer):
    own = with_motors(board)
    drive(own, 0.1, 0.1, 0.1, 0.1)
    own.poke(timer + BDTR, own.peek(timer + BDTR) & ~MOE)
    drive(own, 0.1, 0.1, 0.1, 0.1)
    assert own.peek(TIM1 + BDTR) & own.peek(TIM8 + BDTR) & MOE


def test_a_dead_current_sensor_is_a_fault():
    own = machine("motors", "f405_drivers")
    own.boot()  # all inputs read 0 V
    assert own.read(own.symbols["own"] + own.member("wheel_node", "state"), 1) == b"\x05", "FAULT"


def test_encoders_count_all_edges_in_16_bits():
    own = with_motors("f405_drivers")
    for number, timer in ENCODER_TIMERS.items():
        assert own.peek(timer + SMCR) == 3
        assert own.peek(timer + ARR) == 0xFFFF
        assert own.peek(timer + CCER) == (2 if number in (3, 4) else 0), "FR and RR are reversed"
        assert own.peek(timer + CR1) == 1
        own.poke(timer + CNT, 1000 * number)
    own.call("encoders_read", SCRATCH)
    assert struct.unpack("<4H", own.read(SCRATCH, 8)) == (2000, 3000, 4000, 5000)


def test_currents_are_means_with_the_zero_of_the_start_and_the_sign_of_the_wheel():
    own = with_motors("f405_drivers")
    ampere = 3.3 / 4095 * 22.727  # of one step of the converter
    rounds = []
    for step in (80, 60, 100, 60, 100, 60, 100):
        rounds += [RAW_ZERO + step] * 4 + [2700] + [2000, 1000, 900, 930]
    own.write(own.symbols["analog"], struct.pack("<63H", *rounds))
    own.call("analog_currents", SCRATCH)
    expected = [80 * ampere * sign for sign in (1, -1, -1, 1)]
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == pytest.approx(expected, rel=1e-4)
    own.call("analog_temperatures", SCRATCH)
    degc = [(raw / 4095 * 3.3 - 0.5) * 100 for raw in (2000, 1000, 900, 930)]
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == pytest.approx(degc, rel=1e-4)


def test_a_converter_that_stands_still_is_a_failure_of_the_body():
    own = with_motors("f405_drivers")
    ready, failed = 0, 2
    own.answers[DMA_NDTR] = lambda: 17
    answers = [own.call("plant_sense", tick, SCRATCH) & 0xFF for tick in range(4)]
    assert answers == [ready, ready, ready, failed], "seen at the same place by chance is no failure"


@pytest.mark.parametrize("raw", [0, 4095])
@pytest.mark.parametrize("which", [0, 3, 4, 8])  # current of FL and RL, battery, temperature of RL
def test_a_sensor_that_is_torn_off_is_a_failure_of_the_body(which, raw):
    own = with_motors("f405_drivers")
    rounds = list(ROUND)
    rounds[which] = raw
    own.write(own.symbols["analog"], struct.pack("<63H", *rounds * ROUNDS))
    expected = 0 if (which, raw) == (4, 0) else 2  # a battery may be switched off
    assert own.call("plant_sense", 1, SCRATCH) & 0xFF == expected


def test_conversions_that_were_lost_are_a_failure_of_the_body():
    own = with_motors("f405_drivers")
    ready, failed = 0, 2
    assert own.call("plant_sense", 1, SCRATCH) & 0xFF == ready
    own.poke(ADC_SR, 1 << 5)
    assert own.call("plant_sense", 2, SCRATCH) & 0xFF == failed
