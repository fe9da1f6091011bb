"""Registers of the emulated chip as firmware reads them back: what RM0090 and ARMv7-M say of values, flags and keys."""

import pytest

from hil.addons.targets.machine import flash, nvic
from hil.addons.targets.machine.peripherals import (
    READ_CYCLES,
    CycleCounter,
    Gpio,
    MachineError,
    Peripheral,
    Rcc,
    SysTick,
    Timer,
    Usart,
    Watchdog,
)

KEYS = (0x45670123, 0xCDEF89AB)


def test_a_register_keeps_32_bits_until_a_reset_and_one_that_is_not_there_is_named():
    block = Peripheral("SPI1", {0x4: 7})
    assert block.read(0x4) == 7
    block.write(0x4, 0x1_2345_6789)
    assert block.read(0x4) == 0x2345_6789
    block.reset()
    assert block.read(0x4) == 7
    for use in (lambda: block.read(0x20), lambda: block.write(0x20, 1)):
        with pytest.raises(MachineError, match=r"^SPI1 has no register at offset 0x020 in this machine$"):
            use()


@pytest.mark.parametrize(
    ("name", "modes", "pulls"),
    [("GPIOA", 0xA800_0000, 0x6400_0000), ("GPIOB", 0x0000_0280, 0x0000_0100), ("GPIOC", 0, 0)],
)
def test_pins_begin_as_the_manual_says_and_only_outputs_read_as_written(name: str, modes: int, pulls: int):
    port = Gpio(name)
    assert (port.read(Gpio.MODER), port.read(Gpio.PUPDR), port.read(Gpio.ODR)) == (modes, pulls, 0)
    port.write(Gpio.MODER, 0b11_10_01_00 | 0b01 << 30)
    assert [port.mode(pin) for pin in (0, 1, 2, 3, 4, 15)] == [0, 1, 2, 3, 0, 1]
    port.write(Gpio.ODR, 0xFFFF)
    assert port.read(Gpio.IDR) == 1 << 1 | 1 << 15


def test_oscillators_are_ready_when_they_are_on_and_a_reset_s_cause_stays_until_it_is_removed():
    clocks = Rcc()
    assert (clocks.read(Rcc.CR), clocks.read(Rcc.CSR), clocks.read(Rcc.PLLCFGR)) == (0x83, 0x0C00_0000, 0x2400_3010)
    for bit in (0, 16, 24, 26):
        clocks.write(Rcc.CR, 1 << bit)
        assert clocks.read(Rcc.CR) == 3 << bit
        clocks.write(Rcc.CR, 2 << bit)
        assert clocks.read(Rcc.CR) == 0, "a ready flag cannot be written"
    clocks.write(Rcc.CFGR, 0xFC01)
    assert clocks.read(Rcc.CFGR) == 0xFC05
    clocks.write(Rcc.BDCR, 0x8101)
    assert clocks.read(Rcc.BDCR) == 0x8103
    clocks.write(Rcc.CSR, 1)
    assert clocks.read(Rcc.CSR) == 0x0C00_0003
    for by_watchdog, cause in ((True, 1 << 29), (False, 1 << 28)):
        clocks.record_reset(0x8000_0003, by_watchdog=by_watchdog)
        assert clocks.read(Rcc.CSR) == 0x8000_0000 | 1 << 26 | cause
    clocks.write(Rcc.CSR, 1 << 24)
    assert clocks.read(Rcc.CSR) == 0


@pytest.mark.parametrize(("prescaler", "divider"), [(0, 4), (3, 32), (5, 128), (6, 256), (7, 256)])
def test_the_watchdog_counts_by_its_prescaler_and_needs_its_key_for_each_change(prescaler: int, divider: int):
    dog = Watchdog(168_000_000)
    assert (dog.read(Watchdog.RLR), dog.timeout_s()) == (0xFFF, 0x1000 * 4 / 32_000)
    dog.write(Watchdog.KR, 0x5555)
    dog.write(Watchdog.PR, prescaler)
    dog.write(Watchdog.RLR, 99)
    assert dog.timeout_s() == pytest.approx(100 * divider / 32_000)
    dog.write(Watchdog.KR, 0xAAAA)
    dog.write(Watchdog.RLR, 5)
    assert (dog.read(Watchdog.RLR), dog.is_running) == (99, False)
    dog.write(Watchdog.KR, 0xCCCC)
    assert dog.is_running
    dog.reset()
    assert (dog.is_running, dog.has_expired, dog.read(Watchdog.RLR)) == (False, False, 0xFFF)


@pytest.mark.parametrize(("width", "largest"), [(16, 0xFFFF), (32, 0xFFFF_FFFF)])
def test_a_timer_tells_its_update_until_the_flag_is_cleared(width: int, largest: int):
    timer, levels = Timer("TIM2", width, 2), []
    timer.irq = levels.append
    assert timer.read(Timer.ARR) == largest
    timer.write(Timer.ARR, largest)
    timer.write(Timer.CNT, largest + 5 & 0xFFFF_FFFF)
    assert timer.read(Timer.ARR) == largest
    assert timer.read(Timer.CNT) == 4, "it is not enabled, so that it does not count"
    timer.write(Timer.ARR, 9)
    timer.write(Timer.CNT, 0)
    timer.write(Timer.CR1, 1)
    timer.advance(19)
    assert (timer.read(Timer.SR), levels[-1]) == (0, False)
    timer.advance(1)
    assert (timer.read(Timer.SR), levels[-1]) == (1, False)
    timer.write(Timer.DIER, 1)
    assert levels[-1]
    timer.write(Timer.SR, 0xFFFF)
    assert timer.read(Timer.SR) == 1, "a flag is not set by writing 1"
    timer.write(Timer.SR, 0)
    assert (timer.read(Timer.SR), levels[-1]) == (0, False)
    timer.advance(7)
    timer.write(Timer.EGR, 1)
    assert (timer.read(Timer.SR), timer.read(Timer.EGR), levels[-1]) == (1, 0, True)
    assert timer.read(Timer.CNT) == READ_CYCLES // 2
    timer.write(Timer.EGR, 0)
    assert timer.read(Timer.CNT) == READ_CYCLES % 10
    with pytest.raises(MachineError, match="TIM2: slave modes"):
        timer.write(Timer.SMCR, 4)
    timer.write(Timer.SMCR, 8)


def test_a_serial_line_interrupts_for_what_is_enabled():
    line, levels = Usart("USART2"), []
    line.irq = levels.append
    assert line.read(Usart.SR) == 0xC0, "all is sent"
    for enabled, is_high in ((1 << 7, True), (1 << 6, True), (1 << 5, False), (1 << 4, False)):
        line.write(Usart.CR1, 1 << 13 | enabled)
        assert levels[-1] is is_high
        line.write(Usart.CR1, enabled)
        assert levels[-1] is False, "the whole is off"
    line.write(Usart.CR1, 1 << 13 | 1 << 3)
    line.write(Usart.DR, 0x1FF)
    assert (line.sent, line.receive(b"a"), line.missed) == (b"\xff", False, 1)
    line.write(Usart.CR1, 1 << 13 | 1 << 2 | 1 << 4)
    line.write(Usart.DR, 1)
    assert (line.sent, line.receive(b""), line.read(Usart.SR)) == (b"\xff", True, 0xC0)
    line.receive(b"ab")
    assert [line.read(Usart.DR), line.read(Usart.DR), line.read(Usart.DR)] == [ord("a"), ord("b"), ord("b")]
    assert (line.read(Usart.SR), levels[-1]) == (0xD0, True)
    line.write(Usart.SR, 0)
    assert line.read(Usart.SR) == 0xD0
    line.read(Usart.DR)
    assert (line.read(Usart.SR), levels[-1]) == (0xC0, False)
    line.reset()
    assert (line.sent, line.missed, line.read(Usart.CR1)) == (b"", 1, 0)


def test_systick_tells_once_that_it_has_counted_and_holds_24_bits():
    tick, levels = SysTick(), []
    tick.irq = levels.append
    tick.advance(1000)
    tick.write(SysTick.RVR, 0x1FF_FFFF)
    assert tick.read(SysTick.RVR) == 0xFF_FFFF
    tick.write(SysTick.RVR, 99)
    tick.write(SysTick.CSR, 0xFFFF_FFF9)
    tick.advance(99)
    assert tick.read(SysTick.CSR) == 1
    tick.advance(1)
    assert (tick.read(SysTick.CSR), tick.read(SysTick.CSR), levels) == (0x1_0001, 1, [])
    assert tick.read(SysTick.CVR) == 100 - READ_CYCLES
    tick.write(SysTick.CSR, 7)
    tick.advance(250)
    assert levels == [True]
    assert tick.read(SysTick.CVR) == (100 - READ_CYCLES - 250 - READ_CYCLES) % 100
    tick.write(SysTick.CVR, 55)
    assert tick.read(SysTick.CSR) == 7, "writing it clears it and the flag"
    assert tick.read(SysTick.CVR) == 100 - READ_CYCLES


def test_cycles_are_counted_once_that_is_switched_on():
    counter = CycleCounter()
    counter.advance(5)
    assert counter.read(CycleCounter.CYCCNT) == 0
    counter.write(CycleCounter.CTRL, 0xFF)
    assert counter.read(CycleCounter.CTRL) == 1
    counter.advance(0xFFFF_FFFF)
    assert counter.read(CycleCounter.CYCCNT) == READ_CYCLES - 1
    counter.write(CycleCounter.CYCCNT, 7)
    assert counter.read(CycleCounter.CYCCNT) == 7 + READ_CYCLES


# Flash


def opened(protected: set[int] | None = None) -> tuple[flash.FlashMemory, flash.FlashInterface]:
    memory = flash.FlashMemory()
    interface = flash.FlashInterface(memory, protected or set())
    assert interface.read(flash.CR) == 1 << 31
    for key in KEYS:
        interface.write(flash.KEYR, key)
    assert interface.read(flash.CR) == 0
    return memory, interface


@pytest.mark.parametrize(("size", "parallelism"), [(1, 0), (2, 1), (4, 2), (8, 3)])
def test_programming_clears_bits_in_the_size_that_was_chosen(size: int, parallelism: int):
    memory, interface = opened()
    at = flash.BASE + 0x4008
    interface.program(at, size, 0)
    assert (interface.read(flash.SR), memory.read(at, 8)) == (1 << 7, b"\xff" * 8), "PG is not set"
    interface.write(flash.SR, 1 << 7)
    interface.write(flash.CR, 1 | parallelism << 8)
    interface.program(at, 4 if size != 4 else 2, 0)
    assert (interface.read(flash.SR), memory.read(at, 8)) == (1 << 6, b"\xff" * 8)
    interface.write(flash.SR, 0xFFFF)
    assert interface.read(flash.SR) == 0
    first, second = bytes(range(0xF0, 0xF0 + size)), bytes([0x5A]) * size
    for data in (first, second):
        interface.program(at, size, int.from_bytes(data, "little"))
    assert memory.read(at - 1, size + 2) == b"\xff" + bytes(a & b for a, b in zip(first, second, strict=True)) + b"\xff"
    assert interface.read(flash.SR) == 1
    interface.write(flash.CR, 1 << 31)
    interface.program(at, size, 0)
    assert interface.read(flash.SR) == 1 | 1 << 7, "it is locked"


def test_one_sector_is_erased_and_no_other():
    memory, interface = opened({0})
    for sector in (4, 5, 6):
        start, size = flash.region(sector)
        memory.load(start, bytes(size))
    interface.write(flash.CR, 2 | 5 << 3)
    assert not any(memory.read(*flash.region(5))), "it was not started"
    interface.write(flash.CR, 2 | 5 << 3 | 1 << 16)
    assert [set(memory.read(*flash.region(sector))) for sector in (4, 5, 6)] == [{0}, {0xFF}, {0}]
    assert (interface.read(flash.SR), interface.read(flash.CR)) == (1, 2 | 5 << 3)
    for control in (1 << 16, 2 | 4 | 1 << 16, 2 | 12 << 3 | 1 << 16):
        with pytest.raises(MachineError, match=f"^FLASH_CR = {control:#010x} does not erase one sector"):
            interface.write(flash.CR, control)
    interface.write(flash.CR, 2 | 11 << 3 | 1 << 16)
    assert interface.read(flash.SR) == 1


def test_an_image_fits_into_the_flash_or_is_refused():
    memory = flash.FlashMemory()
    memory.load(flash.BASE + flash.SIZE - 2, b"ab")
    assert memory.read(flash.BASE + flash.SIZE - 3, 3) == b"\xffab"
    for address in (flash.BASE - 1, flash.BASE + flash.SIZE - 1):
        with pytest.raises(MachineError, match=rf"^2 bytes at {address:#010x} are not within the flash of 1024 KiB$"):
            memory.load(address, b"ab")
    assert flash.region(4) == (0x0801_0000, 0x1_0000)
    assert flash.region(11) == (0x080E_0000, 0x2_0000)
    assert flash.sectors_of(0x0800_4000, 0x4000) == {1}
    assert flash.sectors_of(0x0800_3FFF, 2) == {0, 1}
    assert flash.sectors_of(0x0800_C000, 0x1_4001) == {3, 4, 5}


# The interrupt controller


def test_what_is_enabled_pending_and_active_can_be_read_and_written():
    controller = nvic.Nvic()
    controller.write(0x104, 1 << 5 | 1 << 6)
    assert (controller.read(0x104), controller.read(0x184), controller.read(0x100)) == (0x60, 0x60, 0)
    controller.write(0x184, 1 << 6)
    assert controller.read(0x104) == 0x20
    controller.write(0x204, 1 << 5 | 1 << 7)
    assert (controller.read(0x204), controller.read(0x284)) == (0xA0, 0xA0)
    assert controller.pending == {16 + 37}
    controller.write(0x284, 1 << 7)
    assert controller.read(0x204) == 0x20
    assert controller.read(0xD04) == (16 + 37) << 12
    assert controller.enter(16 + 37) == 0x0800_0000 + 4 * (16 + 37)
    assert (controller.read(0x304), controller.read(0x204), controller.read(0xD04)) == (0x20, 0, 16 + 37)
    controller.leave()
    assert (controller.active, controller.read(0x304), controller.read(0xD04)) == ([], 0, 0)
    controller.line(37, True)
    controller.write(0x284, 1 << 5)
    assert controller.read(0x204) == 0x20, "its line is high"
    controller.line(37, False)
    assert controller.due() == 16 + 37, "it stays pending"
    controller.write(0x284, 1 << 5)
    assert controller.due() is None


def test_a_handler_is_interrupted_by_what_is_more_urgent_and_not_held_back():
    controller = nvic.Nvic()
    controller.write(0x100, 0b111)
    controller.write(0x400, 0x7F_8A_95, 4)
    assert controller.read(0x400) == 0x70_80_90, "four bits are implemented"
    controller.line(1, True)
    assert controller.due(basepri=0x80) is None
    assert controller.due(basepri=0x8F) is None
    assert controller.due(basepri=0x90) == 17
    assert controller.due(basepri=0x0F) == 17
    controller.enter(17)
    controller.line(0, True)
    assert controller.due() is None
    controller.line(2, True)
    assert controller.due() == 18
    controller.enter(18)
    assert controller.due() is None
    controller.line(2, False)
    controller.leave()
    assert controller.due() is None
    controller.leave()
    assert controller.due() == 17, "its line is still high"


def test_the_core_s_own_exceptions_are_pended_and_have_priorities():
    controller = nvic.Nvic()
    controller.write(0xD20, 0xA0_B0_00_00, 4)
    assert controller.read(0xD20) == 0xA0_B0_00_00
    controller.write(0xD18, 0x1F, 1)
    controller.write(0xD23, 0xAF, 1)  # as CMSIS writes the priority of SysTick
    assert [controller.read(offset) for offset in (0xD18, 0xD1C, 0xD20)] == [0x10, 0, 0xA0_B0_00_00]
    controller.write(0x400, 0x3F, 1)
    controller.write(0x45F, 0x5F, 1)
    assert [controller.read(offset) for offset in (0x400, 0x45C)] == [0x30, 0x50_00_00_00]
    controller.write(0xD04, 1 << 28 | 1 << 26)
    assert controller.pending == {14, 15}
    assert controller.due() == 15, "SysTick is the more urgent here"
    controller.write(0xD04, 1 << 25)
    assert controller.due() == 14
    controller.write(0xD04, 1 << 27)
    assert controller.due() is None
    controller.write(0x014, 9)
    controller.write(0x010, 3)
    controller.advance(10)
    assert controller.due() == 15
    assert controller.enter(15) == 0x0800_0000 + 60
    controller.write(0xD08, 0x0800_41FF)
    assert controller.read(0xD08) == 0x0800_4180
    assert controller.enter(14) == 0x0800_4180 + 56


def test_a_reset_is_asked_for_with_its_key_and_faults_are_recorded():
    controller = nvic.Nvic()
    for value, is_asked in ((4, False), (0x05FA_0000, False), (0x05FB_0004, False), (0x05FA_0004, True)):
        controller.write(0xD0C, value)
        assert controller.reset_requested is is_asked
    assert (controller.read(0xD00), controller.read(0xD0C)) == (0x410F_C241, 0xFA05_0000)
    controller.record_fault(1, 2, 3, 4)
    assert [controller.read(offset) for offset in (0xD28, 0xD2C, 0xD34, 0xD38)] == [1, 2, 3, 4]
    controller.line(3, True)
    controller.write(0x100, 8)
    controller.reset()
    assert (controller.reset_requested, controller.pending, controller.read(0x100), controller.read(0x200)) == (
        False, set(), 0, 0
    )  # fmt: skip


def test_of_the_system_control_block_these_registers_keep_what_is_written():
    """SCR, CCR, SHCSR, the fault registers, CPACR, DEMCR and FPCCR (ARMv7-M manual, B3.2.2)."""
    controller = nvic.Nvic()
    kept = (0xD10, 0xD14, 0xD24, 0xD28, 0xD2C, 0xD30, 0xD34, 0xD38, 0xD3C, 0xD88, 0xDFC, 0xF34)
    for number, offset in enumerate(kept, start=3):
        assert controller.read(offset) == 0
        controller.write(offset, number)
    assert [controller.read(offset) for offset in kept] == list(range(3, 15))
    for offset in (0xD40, 0xD84, 0xD8C, 0xDF8, 0xF30, 0xF38):
        with pytest.raises(MachineError, match=f"has no register at offset {offset:#05x}"):
            controller.read(offset)
