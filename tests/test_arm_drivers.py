"""What the STM32F405's drivers write to its registers: the linked firmware, executed by Unicorn."""

import itertools
import shutil
import struct

import pytest

from firmware_protocol.arm_build import Target, build
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, flash_image
from tests.protocol_cases import DBC

pytest.importorskip("unicorn", reason="no Unicorn: pip install unicorn")
pytest.importorskip("elftools", reason="no pyelftools: pip install pyelftools")

from tests.arm_machine import FLASH, RAM, Machine

BOOT = 3_000_000  # instructions, most of them in search of parameters in the flash
GPIO, GPIO_END = 0x4002_0000, 0x4002_2400
MODER, BSRR = 0x00, 0x18
TIM1, TIM8 = 0x4001_0000, 0x4001_0400
ENCODER_TIMERS = {2: 0x4000_0000, 3: 0x4000_0400, 4: 0x4000_0800, 5: 0x4000_0C00}
CR1, EGR, SMCR, CCER, CNT, ARR, CCR1, BDTR = 0x00, 0x14, 0x08, 0x20, 0x24, 0x2C, 0x34, 0x44
MOE = 1 << 15
IWDG_KR, IWDG_RLR = 0x4000_3000, 0x4000_3008
CAN = 0x4000_6400
TSR, RF0R, ESR, BTR, MAILBOX, FIFO, FR = 0x08, 0x0C, 0x18, 0x1C, 0x180, 0x1B0, 0x240
FLASH_KEYR, FLASH_CR = 0x4002_3C04, 0x4002_3C10
ADC_SR, ADC_CR2 = 0x4001_2000, 0x4001_2008
RAW_ZERO = round(1.6667 / 3.3 * 4095)  # of a current sensor
ROUND = [RAW_ZERO] * 4 + [2700] + [930] * 4  # currents, battery of 24 V, temperatures of 25 degC
SCRATCH = RAM + 0x1_8000  # beyond all variables
DRIVERS, BRIDGES = ("f405_drivers", "A8"), ("f405_bridges", "C5")  # boards, and the pin that enables their bridges
by_board = pytest.mark.parametrize(("board", "enable"), [DRIVERS, BRIDGES])


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """Makes a machine with a firmware of these names, in reset."""
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no arm-none-eabi-gcc: install gcc-arm-none-eabi")
    folder = tmp_path_factory.mktemp("stm32f4")
    made = {}

    def make(variant: str, board: str, link: str = "serial") -> Machine:
        target = Target(variant, board, link)
        if target not in made:
            made[target] = build(target, folder)
        own = Machine(made[target].elf)
        own.stack_bound = made[target].stack.total
        return own

    return make


def with_motors(machine, board: str, link: str = "serial") -> Machine:
    """A robot with motors that stands there in IDLE; on CAN, with the second mailbox free."""
    if (board, link) not in _booted:
        own = machine("motors", board, link)
        own.reactions[ADC_CR2] = lambda _: own.write(own.symbols["analog"], struct.pack("<288H", *ROUND * 32))  # by DMA
        own.poke(CAN + TSR, 1 << 27)
        own.boot(BOOT)
        _booted[board, link] = own, own.save()
    own, state = _booted[board, link]
    own.restore(state)
    return own


_booted: dict[tuple[str, str], tuple] = {}


def bits_of(name: str) -> tuple[int, int]:
    """Return the base address of a pin's port, and its number."""
    return GPIO + 0x400 * "ABCDE".index(name[0]), int(name[1:])


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


@pytest.mark.parametrize("link", ["serial", "can"])
@pytest.mark.parametrize("variant", ["hil", "hil-emulated"])
def test_a_hardware_in_the_loop_build_configures_its_lines_pins_and_no_other(machine, variant, link):
    own = machine(variant, "hil_f405", link)
    start = {GPIO: 0xA800_0000, GPIO + 0x400: 0x0000_0280}  # MODER after reset: the debugger's pins
    for address, value in start.items():
        own.poke(address, value)
    own.boot(BOOT)
    touched = [(address, value) for address, value in own.writes if GPIO <= address < GPIO_END]
    assert touched
    pins = {"A2", "A3"} | ({"A9", "A10"} if link == "serial" else {"B8", "B9"})
    allowed = {}
    for base, number in map(bits_of, pins):
        for offset, bits in ((MODER, 2), (0x08, 2), (0x0C, 2)):
            allowed[base + offset] = allowed.get(base + offset, 0) | (2**bits - 1) << number * bits
        afr = base + 0x20 + number // 8 * 4
        allowed[afr] = allowed.get(afr, 0) | 0xF << number % 8 * 4
    for address, value in touched:
        assert (value ^ start.get(address, 0)) & ~allowed.get(address, 0) == 0, f"{address:x} = {value:x}"


def test_only_the_hosts_messages_pass_the_can_filters(machine):
    own = machine("hil", "hil_f405", "can")
    own.boot(BOOT)
    words = [own.peek(CAN + FR + 4 * i) for i in range(2 * 3)]
    halves = list(itertools.chain.from_iterable((word & 0xFFFF, word >> 16) for word in words))
    assert all(half & 0x1F == 0 for half in halves), "standard data frames"
    assert {half >> 5 for half in halves} == {m.frame_id for m in DBC.values() if "HOST" in m.senders}


def test_a_can_bit_is_14_quanta_of_3_clocks(machine):
    own = machine("hil", "hil_f405", "can")
    own.boot(BOOT)
    assert own.peek(CAN + BTR) == 2 | (10 - 1) << 16 | (3 - 1) << 20


def test_a_can_frame_goes_out_as_it_is(machine):
    own = with_motors(machine, "f405_drivers", "can")
    own.write(SCRATCH, struct.pack("<HB", 0x123, 5) + bytes([1, 2, 3, 4, 5, 99, 99, 99]))
    own.writes.clear()
    own.call("host_link_send", SCRATCH)
    box = CAN + MAILBOX + 16
    assert own.writes == [(box + 4, 5), (box + 8, 0x0403_0201), (box + 12, 5), (box, 0x123 << 21 | 1)]


@pytest.mark.parametrize("length", [0, 3, 8])
def test_a_can_frame_comes_in_as_it_is(machine, length):
    own = with_motors(machine, "f405_drivers", "can")
    own.reactions[CAN + RF0R] = lambda _: own.poke(CAN + RF0R, 0)
    for at, value in ((RF0R, 1), (FIFO, 0x040 << 21), (FIFO + 4, length), (FIFO + 8, 0x0403_0201), (FIFO + 12, 5)):
        own.poke(CAN + at, value)
    own.call("can1_receive_interrupt")
    assert (CAN + RF0R, 1 << 5) in own.writes, "released"
    assert own.call("host_link_receive", SCRATCH) & 0xFF == 1
    assert struct.unpack("<HB", own.read(SCRATCH, 3)) == (0x040, length)
    assert own.read(SCRATCH + 3, length) == bytes([1, 2, 3, 4, 5, 0, 0, 0])[:length]


def test_a_can_length_code_above_8_is_dropped_and_counted(machine):
    own = with_motors(machine, "f405_drivers", "can")
    own.reactions[CAN + RF0R] = lambda _: own.poke(CAN + RF0R, 0)
    own.poke(CAN + RF0R, 1)
    own.poke(CAN + FIFO + 4, 9)
    own.call("can1_receive_interrupt")
    assert own.call("host_link_receive", SCRATCH) & 0xFF == 0
    assert counters(own)["length"] == 1


def counters(own: Machine) -> dict[str, int]:
    own.write(SCRATCH, bytes(32))
    own.call("host_link_counters", SCRATCH)
    names = ("cobs", "crc", "length", "unknown_id", "overrun", "serial_lost", "can_errors", "bus_off")
    return dict(zip(names, struct.unpack("<8I", own.read(SCRATCH, 32)), strict=True))


def test_bus_off_is_counted_once_and_stops_what_was_armed(machine):
    own = with_motors(machine, "f405_drivers", "can")
    state = own.symbols["own"] + own.member("wheel_node", "state")
    assert own.read(state, 1) == b"\x01", "IDLE"
    own.write(state, b"\x03")
    own.poke(CAN + ESR, 1 << 2)
    own.writes.clear()
    own.call("can1_status_interrupt")
    own.call("can1_status_interrupt")
    assert (CAN + TSR, 0x0080_8080) in own.writes, "what waits in the mailboxes is given up"
    assert counters(own)["bus_off"] == 1
    own.call("robot_serve", own.symbols["own"])
    assert own.read(state, 1) == b"\x04", "STOPPING"
    own.poke(CAN + ESR, 0)
    own.call("robot_serve", own.symbols["own"])
    own.poke(CAN + ESR, 1 << 2)
    own.call("can1_status_interrupt")
    assert counters(own)["bus_off"] == 2


def test_can_errors_are_counted(machine):
    own = with_motors(machine, "f405_drivers", "can")
    for code in (0, 1, 3, 6, 7):  # none, stuff, acknowledgement, CRC, none since the last look
        own.poke(CAN + ESR, code << 4)
        own.call("can1_status_interrupt")
    assert counters(own)["can_errors"] == 3


@by_board
def test_bridges_stay_off_until_something_drives(machine, board, enable):
    own = with_motors(machine, board)
    assert not [value for address, value in own.writes if address in (TIM1 + BDTR, TIM8 + BDTR) and value & MOE]
    base, number = bits_of(enable)
    assert (base + BSRR, 1 << number) not in own.writes
    assert (base + BSRR, 1 << number + 16) in own.writes
    assert own.peek(base) >> 2 * number & 3 == 1, "an output"


@by_board
def test_pins_go_to_the_timers_when_these_hold_them_low(machine, board, enable):
    own = with_motors(machine, board)
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


def test_sign_and_magnitude(machine):
    own = with_motors(machine, "f405_drivers")
    writes = drive(own, 0.5, 0.25, -1.0, -0.125)  # FR and RR are reversed
    period = own.peek(TIM8 + ARR)
    assert period == 168_000_000 // 40_000
    assert [own.peek(TIM8 + CCR1 + 4 * i) / period for i in range(4)] == [0.5, 0.25, 1.0, 0.125]
    forward = [
        (GPIO + 0x400 + BSRR, 1 << pin + (0 if high else 16)) in writes
        for pin, high in ((12, True), (13, False), (14, True), (15, False))
    ]
    assert all(forward)


def test_complementary_outputs_are_half_on_for_zero_volt(machine):
    own = with_motors(machine, "f405_bridges")
    drive(own, 0.5, 0.25, -1.0, 0.0)
    period = own.peek(TIM1 + ARR)
    outputs = [own.peek(TIM1 + CCR1 + 4 * i) / period for i in range(3)] + [own.peek(TIM8 + CCR1) / period]
    assert outputs == [0.75, 0.375, 1.0, 0.5]
    assert own.peek(TIM1 + CCER) == 0x555
    assert own.peek(TIM8 + CCER) == 0x5
    assert own.peek(TIM1 + BDTR) & 0xFF == own.peek(TIM8 + BDTR) & 0xFF == 84, "dead time"


@by_board
@pytest.mark.parametrize("duty", [float("nan"), float("inf"), -float("inf"), 1.5, -3e38])
def test_no_duty_is_beyond_the_period(machine, board, enable, duty):
    own = with_motors(machine, board)
    drive(own, duty, duty, duty, duty)
    for timer in (TIM1, TIM8):
        for i in range(4):
            assert own.peek(timer + CCR1 + 4 * i) <= own.peek(timer + ARR)


@by_board
def test_bridges_come_on_with_the_first_duties_and_go_off_at_once(machine, board, enable):
    own = with_motors(machine, board)
    base, number = bits_of(enable)
    writes = drive(own, 0.1, 0.1, 0.1, 0.1)
    on = (base + BSRR, 1 << number)
    assert writes.index((TIM8 + EGR, 1)) < writes.index((TIM8 + BDTR, own.peek(TIM8 + BDTR))) < writes.index(on)
    assert own.peek(TIM1 + BDTR) & own.peek(TIM8 + BDTR) & MOE
    own.call("plant_off")
    assert not (own.peek(TIM1 + BDTR) | own.peek(TIM8 + BDTR)) & MOE
    assert own.writes[-1] == (base + BSRR, 1 << number + 16)


@by_board
def test_a_fault_switches_the_bridges_off_and_feeds_no_watchdog(machine, board, enable):
    own = with_motors(machine, board)
    drive(own, 0.1, 0.1, 0.1, 0.1)
    own.writes.clear()
    own.jump("fault")
    assert not (own.peek(TIM1 + BDTR) | own.peek(TIM8 + BDTR)) & MOE
    base, number = bits_of(enable)
    assert (base + BSRR, 1 << number + 16) in own.writes
    assert all(address != IWDG_KR for address, _ in own.writes)


def test_a_dead_current_sensor_is_a_fault(machine):
    own = machine("motors", "f405_drivers")
    own.boot(BOOT)  # all inputs read 0 V
    assert own.read(own.symbols["own"] + own.member("wheel_node", "state"), 1) == b"\x05", "FAULT"


def test_encoders_count_all_edges_in_16_bits(machine):
    own = with_motors(machine, "f405_drivers")
    for number, timer in ENCODER_TIMERS.items():
        assert own.peek(timer + SMCR) == 3
        assert own.peek(timer + ARR) == 0xFFFF
        assert own.peek(timer + CCER) == (2 if number in (3, 4) else 0), "FR and RR are reversed"
        assert own.peek(timer + CR1) == 1
        own.poke(timer + CNT, 1000 * number)
    own.call("encoders_read", SCRATCH)
    assert struct.unpack("<4H", own.read(SCRATCH, 8)) == (2000, 3000, 4000, 5000)


def test_currents_are_means_with_the_zero_of_the_start_and_the_sign_of_the_wheel(machine):
    own = with_motors(machine, "f405_drivers")
    ampere = 3.3 / 4095 * 22.727  # of one step of the converter
    rounds = []
    for i in range(32):
        step = 100 if i % 2 else 60
        rounds += [RAW_ZERO + step] * 4 + [2700] + [2000, 1000, 900, 930]
    own.write(own.symbols["analog"], struct.pack("<288H", *rounds))
    own.call("analog_currents", SCRATCH)
    expected = [80 * ampere * sign for sign in (1, -1, -1, 1)]
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == pytest.approx(expected, rel=1e-4)
    own.call("analog_temperatures", SCRATCH)
    degc = [(raw / 4095 * 3.3 - 0.5) * 100 for raw in (2000, 1000, 900, 930)]
    assert struct.unpack("<4f", own.read(SCRATCH, 16)) == pytest.approx(degc, rel=1e-4)


def test_conversions_that_were_lost_are_a_failure_of_the_body(machine):
    own = with_motors(machine, "f405_drivers")
    ready, failed = 0, 2
    assert own.call("plant_sense", 1, SCRATCH) & 0xFF == ready
    own.poke(ADC_SR, 1 << 5)
    assert own.call("plant_sense", 2, SCRATCH) & 0xFF == failed


def test_only_ticks_feed_the_watchdog(machine):
    own = with_motors(machine, "f405_drivers")
    assert own.writes[0] == (IWDG_KR, 0xCCCC), "it runs before anything can hang"
    assert [value for address, value in own.writes if address == IWDG_RLR] == [4000, 30]
    own.writes.clear()
    own.time_passes = False
    own.run(200_000)
    settled = own.writes.count((IWDG_KR, 0xAAAA))
    own.run(200_000)
    assert own.writes.count((IWDG_KR, 0xAAAA)) == settled <= 1
    own.time_passes = True
    own.run(400_000)
    assert own.writes.count((IWDG_KR, 0xAAAA)) > settled


def test_a_store_unlocks_programs_and_locks_the_flash(machine):
    own = with_motors(machine, "f405_drivers")
    data = bytes(range(92))
    own.write(SCRATCH, data)
    own.writes.clear()
    assert own.call("parameter_log_append", SCRATCH) & 0xFF == 1
    assert own.read(PARAMETER_ADDRESS, 128) == flash_image(data)
    controls = [(a, v) for a, v in own.writes if a in (FLASH_KEYR, FLASH_CR)]
    once = [(FLASH_KEYR, 0x4567_0123), (FLASH_KEYR, 0xCDEF_89AB), (FLASH_CR, 1 | 2 << 8), (FLASH_CR, 1 << 31)]
    assert controls == once * 2, "the record, then its mark"


def test_an_erase_is_of_the_parameters_sectors(machine):
    own = with_motors(machine, "f405_drivers")
    for sector in (0, 1):
        own.writes.clear()
        own.call("flash_erase", sector)
        controls = [value for address, value in own.writes if address == FLASH_CR]
        serial = 2 | (6 + sector) << 3 | 2 << 8
        assert controls == [serial, serial | 1 << 16, 1 << 31]
    assert own.symbols["stack_top"] == RAM + 4096
    assert PARAMETER_ADDRESS - FLASH == 256 * 1024, "where sector 6 begins, and the linker script's code ends"


@pytest.mark.parametrize(("variant", "board"), [("motors", "f405_drivers"), ("hil", "hil_f405")])
def test_the_stack_really_used_is_within_its_bound(machine, variant, board):
    own = with_motors(machine, board) if variant == "motors" else machine(variant, board)
    if variant == "hil":
        own.boot(BOOT)
    used = own.symbols["stack_top"] - own.least_sp
    assert 100 < used <= own.stack_bound
