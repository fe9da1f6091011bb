"""Pins, watchdog, flash and stack of the STM32F405: what the linked firmware does with them, executed by Unicorn."""

import struct

import pytest

from firmware_protocol import codec
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameters, stored_parameters
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, flash_image

pytest.importorskip("unicorn", reason="no Unicorn: pip install unicorn")
pytest.importorskip("elftools", reason="no pyelftools: pip install pyelftools")

from unicorn import UcError

from tests.support.arm_firmwares import firmware
from tests.support.arm_machine import FLASH, GPIO, RAM, RCC_CR, USARTS
from tests.support.arm_robot import GPIO_END, IWDG_KR, IWDG_RLR, SCRATCH, bits_of, machine, with_motors

MODER = 0x00
RCC_AHB1ENR = 0x4002_3830
PWR_CR, PWR_CSR, EXTI_IMR, EXTI_RTSR = 0x4000_7000, 0x4000_7004, 0x4001_3C00, 0x4001_3C08
RCC_PLLCFGR, FLASH_ACR = 0x4002_3804, 0x4002_3C00
TIM8_BDTR = 0x4001_0444
FLASH_KEYR, FLASH_CR = 0x4002_3C04, 0x4002_3C10
SCB_VTOR, NVIC_ISER = 0xE000_ED08, 0xE000_E100


@pytest.mark.parametrize("link", ["serial", "can"])
@pytest.mark.parametrize("variant", ["hil", "hil-emulated"])
def test_a_hardware_in_the_loop_build_configures_its_lines_pins_and_no_other(variant, link):
    own = machine(variant, "hil_f405", link)
    start = {GPIO: 0xA800_0000, GPIO + 0x400: 0x0000_0280}  # MODER after reset: the debugger's pins
    for address, value in start.items():
        own.poke(address, value)
    own.boot()
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


def test_only_ticks_feed_the_watchdog():
    own = with_motors("f405_drivers")
    before = [address for address, _ in own.writes[: own.writes.index((IWDG_KR, 0xCCCC))]]
    assert all(GPIO <= address <= RCC_AHB1ENR for address in before), (
        "the enable pin; then it runs, before anything can hang"
    )
    assert [value for address, value in own.writes if address == IWDG_RLR] == [4000, 30]
    own.wake(5)  # the tick that was due
    own.writes.clear()
    own.wake(50)
    assert (IWDG_KR, 0xAAAA) not in own.writes, "it runs, but no tick is due"
    own.run(10)
    assert own.writes.count((IWDG_KR, 0xAAAA)) in (9, 10)  # once a tick; the last one may not have come to it


def test_nothing_starts_before_the_supply_is_there_and_one_that_sinks_is_a_fault():
    own = machine("motors", "f405_drivers")
    own.poke(PWR_CSR, 1 << 2)
    own.boot()
    assert RCC_CR not in dict(own.writes)
    assert own.peek(PWR_CR) == 1 << 4 | 6 << 5, "2.8 V"
    feeds = [value for address, value in own.writes if address == IWDG_KR]
    assert feeds == [0xCCCC, 0x5555, 0xAAAA], "and the watchdog starts anew what waits too long"
    own = with_motors("f405_drivers")
    assert own.peek(EXTI_IMR) == own.peek(EXTI_RTSR) == 1 << 16
    assert (NVIC_ISER, 1 << 1) in own.system_writes
    assert own.peek(FLASH + 4 * (16 + 1)) & ~1 == own.symbols["fault"]


def test_the_vector_table_is_the_firmwares_also_behind_a_boot_loader():
    own = machine("motors", "f405_drivers")
    own.poke(SCB_VTOR, 0x1FFF_0000)
    own.boot()
    assert own.peek(SCB_VTOR) == FLASH


def test_reserved_oscillator_bits_stay_and_the_flash_slows_before_the_clock_rises():
    own = machine("motors", "f405_drivers")
    own.poke(RCC_PLLCFGR, 0x2400_3010)
    own.boot()
    assert own.peek(RCC_PLLCFGR) & 0xF0BC_8000 == 0x2000_0000
    own = machine("motors", "f405_drivers")
    own.answers[FLASH_ACR] = lambda: 0
    own.boot()
    assert RCC_PLLCFGR not in dict(own.writes)


def test_a_stack_that_leaves_the_ram_stops_the_core_and_the_fault_needs_none_of_it():
    own = with_motors("f405_drivers")
    own.write(SCRATCH, struct.pack("<4f", 0.1, 0.1, 0.1, 0.1))
    own.call("pwm_drive", SCRATCH)
    assert own.peek(TIM8_BDTR) & 1 << 15
    with pytest.raises(UcError, match="UC_ERR_WRITE_UNMAPPED"):
        own.call("robot_serve", own.symbols["own"], stack=RAM + 32)
    own.jump("fault")  # with the stack pointer where it was then
    assert not own.peek(TIM8_BDTR) & 1 << 15


def test_a_store_unlocks_programs_and_locks_the_flash():
    own = with_motors("f405_drivers")
    data = bytes(range(96))
    own.write(SCRATCH, data)
    own.writes.clear()
    assert own.call("parameter_log_append", SCRATCH) & 0xFF == 1
    assert own.read(PARAMETER_ADDRESS, 128) == flash_image(data)
    controls = [(a, v) for a, v in own.writes if a in (FLASH_KEYR, FLASH_CR)]
    once = [(FLASH_KEYR, 0x4567_0123), (FLASH_KEYR, 0xCDEF_89AB), (FLASH_CR, 1 | 2 << 8), (FLASH_CR, 1 << 31)]
    assert controls == once * 2, "the record, then its mark"


@pytest.mark.parametrize("is_full", [False, True])
def test_the_watchdog_waits_for_the_erasure_that_a_full_log_needs(is_full):
    own = with_motors("f405_drivers")
    if is_full:
        own.write(own.symbols["state"], struct.pack("<IIIB", 0, 1024, 7, 0))  # parameter_log.c
    own.writes.clear()
    own.arrived[USARTS[0]] += Framer().encode(codec.encode(m.ParameterRequest(0, m.Operation.STORE, 1, 0)))
    own.run(5)
    limits = [value for address, value in own.writes if address == IWDG_RLR]
    assert limits == ([4000, 30] if is_full else [])
    place = PARAMETER_ADDRESS + (128 << 10) * is_full
    assert own.read(place, 4) != b"\xff" * 4, "in the other sector where the first one is full"


def current_limit_a(own) -> float:
    at = own.symbols["own"] + own.member("wheel_node", "parameters") + own.member("wheel_parameters", "current_limit_a")
    return struct.unpack("<f", own.read(at, 4))[0]


@pytest.mark.parametrize(("recorded_by", "limit_a"), [(1, 12.0), (2, 5.0)])  # the hil board, and this one
def test_only_its_own_boards_record_is_in_force_after_a_reset(recorded_by, limit_a):
    values = {p.name: p.minimum for p in parameters()} | {"current_limit_a": 5.0}
    own = machine("motors", "f405_drivers")
    own.write(PARAMETER_ADDRESS, flash_image(stored_parameters(values, recorded_by)))
    own.boot()
    assert current_limit_a(own) == limit_a


@pytest.mark.parametrize(("wish_a", "result"), [(16.0, m.Result.OK), (16.5, m.Result.RANGE), (21.0, m.Result.RANGE)])
def test_no_host_sets_more_than_the_boards_hardware_stands(wish_a, result):
    own = with_motors("f405_drivers")
    index = [p.name for p in parameters()].index("current_limit_a")
    bits = struct.unpack("<I", struct.pack("<f", wish_a))[0]
    own.sent[USARTS[0]].clear()
    own.arrived[USARTS[0]] += Framer().encode(codec.encode(m.ParameterRequest(index, m.Operation.WRITE, 1, bits)))
    own.run(5)
    heard = [codec.decode(frame) for frame in Deframer().feed(b"\0" + bytes(own.sent[USARTS[0]]))]
    assert [one.result for one in heard if isinstance(one, m.ParameterResponse)] == [result]
    assert current_limit_a(own) == (wish_a if result is m.Result.OK else 12.0)


def test_an_erase_is_of_the_parameters_sectors():
    own = with_motors("f405_drivers")
    for sector in (0, 1):
        own.writes.clear()
        own.call("flash_erase", sector)
        controls = [value for address, value in own.writes if address == FLASH_CR]
        serial = 2 | (6 + sector) << 3 | 2 << 8
        assert controls == [serial, serial | 1 << 16, 1 << 31]
    assert own.symbols["stack_top"] == RAM + 4096
    assert PARAMETER_ADDRESS - FLASH == 256 * 1024, "where sector 6 begins, and the linker script's code ends"


@pytest.mark.parametrize(("variant", "board"), [("motors", "f405_drivers"), ("hil", "hil_f405")])
def test_the_stack_really_used_is_within_its_bound(variant, board):
    own = with_motors(board) if variant == "motors" else machine(variant, board)
    if variant == "hil":
        own.boot()
    used = own.symbols["stack_top"] - own.least_sp
    assert 100 < used <= firmware(variant, board, "serial").stack.total
