"""The peripherals of the emulated chip, each by itself: what RM0090 says of their registers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.targets.machine import can, flash, nvic
from hil.addons.targets.machine.peripherals import (
    READ_CYCLES,
    Gpio,
    MachineError,
    Rcc,
    SysTick,
    Timer,
    Usart,
    Watchdog,
)

CORE_HZ = 168_000_000
IDS = st.integers(0, 0x7FF)


class Line:
    """An interrupt line that remembers its level."""

    def __init__(self) -> None:
        self.high = False

    def __call__(self, high: bool) -> None:
        self.high = high


# CAN


def open_can(*filters: tuple[int, int], listed: bool = True) -> can.Can:
    """A controller on the bus at 1 Mbit/s, with one 32-bit filter bank a row: two identifiers, or one and a mask."""
    controller = can.Can(42_000_000, CORE_HZ)
    controller.write(can.MCR, 1)
    controller.write(can.BTR, 2 | 9 << 16 | 2 << 20)
    controller.write(can.FMR, controller.read(can.FMR) | 1)
    controller.write(can.FS1R, (1 << len(filters)) - 1)
    controller.write(can.FM1R, (1 << len(filters)) - 1 if listed else 0)
    for bank, (one, two) in enumerate(filters):
        controller.write(can.FILTERS + 8 * bank, one)
        controller.write(can.FILTERS + 8 * bank + 4, two)
    controller.write(can.FA1R, (1 << len(filters)) - 1)
    controller.write(can.FMR, controller.read(can.FMR) & ~1)
    controller.write(can.MCR, 0)
    return controller


def send(controller: can.Can, mailbox: int, identifier: int, data: bytes) -> None:
    at = can.TX_MAILBOX + 0x10 * mailbox
    words = data.ljust(8, b"\0")
    controller.write(at + 4, len(data))
    controller.write(at + 8, int.from_bytes(words[:4], "little"))
    controller.write(at + 12, int.from_bytes(words[4:], "little"))
    controller.write(at, identifier << 21 | 1)


@given(st.lists(st.tuples(IDS, IDS), min_size=1, max_size=6), IDS)
def test_a_list_filter_takes_its_identifiers_and_no_other(rows: list[tuple[int, int]], identifier: int):
    controller = open_can(*((one << 21, two << 21) for one, two in rows))
    wanted = {number for row in rows for number in row}
    for number in {identifier, *wanted}:
        taken = controller.receive(can.CanFrame(number, b""))
        assert taken == (number in wanted)
        if taken:
            assert controller.read(can.RX_FIFO) >> 21 == number
            controller.write(can.RF0R, 1 << 5)


@given(IDS, IDS, IDS)
def test_a_mask_filter_compares_the_bits_of_its_mask(wanted: int, mask: int, identifier: int):
    controller = open_can((wanted << 21, mask << 21), listed=False)
    assert controller.receive(can.CanFrame(identifier, b"")) == (identifier & mask == wanted & mask)


@given(st.lists(IDS, min_size=4, max_size=4), IDS)
def test_a_narrow_bank_lists_four_identifiers(four: list[int], identifier: int):
    controller = open_can((0, 0))
    controller.write(can.FMR, 1)
    controller.write(can.FS1R, 0)
    controller.write(can.FILTERS, four[0] << 5 | four[1] << 21)
    controller.write(can.FILTERS + 4, four[2] << 5 | four[3] << 21)
    controller.write(can.FMR, 0)
    assert controller.receive(can.CanFrame(identifier, b"")) == (identifier in four)


def test_frames_of_29_bits_pass_no_filter_of_11():
    controller = open_can((5 << 21, 5 << 21))
    assert not controller.receive(can.CanFrame(5 << 18, b"", is_extended=True))
    assert controller.receive(can.CanFrame(5, b""))


@given(IDS, st.binary(max_size=8))
def test_what_is_received_is_what_was_sent(identifier: int, data: bytes):
    sender, receiver = open_can((0, 0)), open_can((0, 0), listed=False)
    send(sender, 0, identifier, data)
    assert sender.sent == [can.CanFrame(identifier, data)]
    assert receiver.receive(sender.sent[0])
    low, high = receiver.read(can.RX_FIFO + 8), receiver.read(can.RX_FIFO + 12)
    length = receiver.read(can.RX_FIFO + 4) & 0xF
    assert (low | high << 32).to_bytes(8, "little")[:length] == data


def test_the_fourth_frame_overruns_the_third_unless_the_fifo_is_locked():
    for locked, newest in ((False, 4), (True, 3)):
        controller = open_can((0, 0), listed=False)
        controller.write(can.MCR, 1 << 3 if locked else 0)
        taken = [controller.receive(can.CanFrame(number, b"")) for number in range(1, 5)]
        assert taken == [True, True, True, False]
        assert controller.read(can.RF0R) & 0x1F == 3 | 1 << 3 | 1 << 4
        seen = []
        while controller.read(can.RF0R) & 3:
            seen.append(controller.read(can.RX_FIFO) >> 21)
            controller.write(can.RF0R, 1 << 5)
        assert seen == [1, 2, newest]


def test_a_frame_that_is_stored_after_an_overrun_is_told_as_stored():
    """The overrun's flag stays until the firmware clears it; it says nothing of the frames that follow."""
    controller = open_can((0, 0), listed=False)
    for number in range(1, 5):
        controller.receive(can.CanFrame(number, b""))
    controller.write(can.RF0R, 1 << 5)
    assert controller.receive(can.CanFrame(5, b""))
    assert controller.read(can.RF0R) & (3 | 1 << 4) == 3 | 1 << 4
    assert controller.missed == 1


def test_frames_are_missed_while_off_the_bus_but_not_those_that_no_filter_takes():
    controller = open_can((5 << 21, 5 << 21))
    assert not controller.receive(can.CanFrame(6, b""))
    assert controller.missed == 0
    controller.fail(256)
    assert not controller.receive(can.CanFrame(5, b""))
    assert controller.missed == 1


def test_transmission_is_told_and_interrupts_until_it_is_taken_note_of():
    controller, line = open_can((0, 0)), Line()
    controller.irq_tx = line
    controller.write(can.IER, 1)
    send(controller, 1, 0x123, b"x")
    assert controller.read(can.TSR) >> 8 & 3 == 3
    assert line.high
    controller.write(can.TSR, 1 << 8)
    assert not line.high


def test_bus_off_ends_after_128_times_11_bits_and_what_waited_is_sent_then():
    controller, line = open_can((0, 0)), Line()
    controller.irq_error = line
    controller.write(can.IER, 1 << 10 | 1 << 15)
    controller.write(can.MCR, 1 << 6)  # recovers by itself
    controller.fail(256)
    assert line.high
    assert controller.read(can.ESR) & 4
    send(controller, 0, 0x10, b"")
    assert controller.sent == []
    bits = 128 * 11
    controller.advance((bits - 1) * CORE_HZ // 1_000_000)
    assert controller.read(can.ESR) & 4
    controller.advance(CORE_HZ // 1_000_000)
    assert not controller.read(can.ESR) & 4
    assert controller.sent == [can.CanFrame(0x10, b"")]


def test_without_automatic_recovery_bus_off_lasts_until_the_firmware_asks():
    controller = open_can((0, 0))
    controller.fail(256)
    controller.advance(CORE_HZ)
    assert controller.read(can.ESR) & 4
    controller.write(can.MCR, 1)
    controller.write(can.MCR, 0)
    controller.advance(CORE_HZ)
    assert not controller.read(can.ESR) & 4


def test_bit_timing_and_filters_are_refused_where_a_board_would_ignore_them():
    controller = open_can((0, 0))
    with pytest.raises(MachineError, match="BTR was written outside initialisation mode"):
        controller.write(can.BTR, 0)
    with pytest.raises(MachineError, match="filter"):
        controller.write(can.FILTERS, 1)


# USART


def open_usart() -> Usart:
    line = Usart("USART1")
    line.write(Usart.CR1, 1 << 13 | 1 << 3 | 1 << 2)
    return line


@given(st.binary(min_size=1, max_size=40))
def test_every_byte_arrives_once_and_in_order(data: bytes):
    line, irq = open_usart(), Line()
    line.irq = irq
    line.write(Usart.CR1, line.read(Usart.CR1) | 1 << 5)
    assert line.receive(data)
    taken = bytearray()
    while irq.high:
        assert line.read(Usart.SR) & 1 << 5
        taken.append(line.read(Usart.DR))
    assert taken == data
    assert not line.read(Usart.SR) & 1 << 5


def test_an_idle_line_is_flagged_until_status_and_data_are_read():
    line = open_usart()
    line.receive(b"a")
    assert not line.read(Usart.SR) & 1 << 4
    line.read(Usart.DR)
    assert line.read(Usart.SR) & 1 << 4
    line.read(Usart.DR)
    assert not line.read(Usart.SR) & 1 << 4


def test_a_line_that_is_off_neither_sends_nor_receives():
    line = Usart("USART1")
    line.write(Usart.DR, 1)
    assert not line.receive(b"abc")
    assert line.sent == b""
    assert line.missed == 3


# Timers, watchdog, clocks


@given(st.integers(0, 0xFFFF), st.integers(1, 0xFFFF), st.lists(st.integers(0, 10**7), max_size=8))
def test_a_timer_counts_what_its_prescaler_lets_through(prescaler: int, reload: int, steps: list[int]):
    counter = Timer("TIM3", 16, 2)
    counter.write(Timer.PSC, prescaler)
    counter.write(Timer.ARR, reload)
    counter.write(Timer.CR1, 1)
    for step in steps:
        counter.advance(step)
    divider = 2 * (prescaler + 1)
    assert counter.read(Timer.SR) & 1 == (sum(steps) // divider > reload)
    assert counter.read(Timer.CNT) == (sum(steps) + READ_CYCLES) // divider % (reload + 1)


def test_a_timer_refuses_to_be_an_encoder():
    with pytest.raises(MachineError, match=r"^TIM4: slave modes, such as that of an encoder, are not modelled$"):
        Timer("TIM4", 16, 2).write(Timer.SMCR, 3)


def test_the_watchdog_bites_after_its_time_and_not_before():
    dog = Watchdog(CORE_HZ)
    dog.write(Watchdog.PR, 4)  # locked: nothing happens
    assert dog.read(Watchdog.PR) == 0
    for key, register, value in ((0x5555, Watchdog.PR, 1), (0x5555, Watchdog.RLR, 39)):
        dog.write(Watchdog.KR, key)
        dog.write(register, value)
    assert dog.timeout_s() == 0.01
    dog.advance(CORE_HZ)
    assert not dog.has_expired  # it does not run
    dog.write(Watchdog.KR, 0xCCCC)
    for _ in range(3):
        dog.advance(CORE_HZ // 100 - 1)
        assert not dog.has_expired
        dog.write(Watchdog.KR, 0xAAAA)
    dog.advance(CORE_HZ // 100)
    assert dog.has_expired


@given(st.integers(1, 0xFFFFFF), st.lists(st.integers(0, 1 << 25), max_size=12))
def test_systick_is_due_exactly_when_its_period_has_passed(reload: int, steps: list[int]):
    tick, line = SysTick(), Line()
    tick.irq = line
    tick.write(SysTick.RVR, reload)
    tick.write(SysTick.CVR, 0)
    tick.write(SysTick.CSR, 3)
    passed = 0
    for step in steps:
        before = passed // (reload + 1)
        passed += step
        line.high = False
        tick.advance(step)
        assert line.high == (passed // (reload + 1) > before)


def test_ready_flags_follow_what_is_switched_on():
    clocks = Rcc()
    clocks.write(Rcc.CR, 1 << 16 | 1 << 24)
    assert clocks.read(Rcc.CR) & (1 << 17 | 1 << 25 | 2) == 1 << 17 | 1 << 25
    clocks.write(Rcc.CFGR, 2)
    assert clocks.read(Rcc.CFGR) >> 2 & 3 == 2


@given(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFF))
def test_setting_a_pin_has_priority_over_resetting_it(command: int, before: int):
    port = Gpio("GPIOC")
    port.write(Gpio.ODR, before)
    port.write(Gpio.BSRR, command)
    for pin in range(16):
        expected = 1 if command >> pin & 1 else 0 if command >> pin + 16 & 1 else before >> pin & 1
        assert port.read(Gpio.ODR) >> pin & 1 == expected


# Flash, interrupt controller


def test_sectors_cover_the_flash_without_gap():
    end = flash.BASE
    for sector in range(len(flash.SECTORS)):
        start, size = flash.region(sector)
        assert start == end
        end += size
    assert end == flash.BASE + flash.SIZE


def test_a_wrong_key_keeps_the_flash_locked_until_a_reset():
    interface = flash.FlashInterface(flash.FlashMemory(), set())
    keys = (0x45670123, 0xCDEF89AB)
    for key in (keys[0], 0, *keys):
        interface.write(flash.KEYR, key)
    with pytest.raises(MachineError, match=r"^the flash is locked: write the two keys to KEYR before CR$"):
        interface.write(flash.CR, 1)
    interface.reset()
    for key in keys:
        interface.write(flash.KEYR, key)
    interface.write(flash.CR, 1)


def test_the_running_image_cannot_be_erased():
    memory = flash.FlashMemory()
    memory.load(flash.BASE, b"image")
    interface = flash.FlashInterface(memory, flash.sectors_of(flash.BASE, 5))
    for key in (0x45670123, 0xCDEF89AB):
        interface.write(flash.KEYR, key)
    interface.write(flash.CR, 2 | 1 << 16)
    assert interface.read(flash.SR) & 1 << 4
    assert memory.read(flash.BASE, 5) == b"image"


@given(
    st.lists(st.tuples(st.integers(0, 81), st.integers(0, 15)), min_size=1, max_size=8, unique_by=lambda row: row[0])
)
def test_the_most_urgent_interrupt_is_due_and_of_equals_the_first(rows: list[tuple[int, int]]):
    controller = nvic.Nvic()
    for irq, priority in rows:
        controller.write(0x100 + irq // 32 * 4, 1 << irq % 32)
        controller.write(0x400 + irq, priority << 4, 1)
        controller.line(irq, True)
    taken = []
    while (number := controller.due()) is not None:
        assert controller.due(primask=True) is None
        controller.enter(number)
        controller.line(number - nvic.FIRST_IRQ, False)
        controller.leave()
        taken.append(number - nvic.FIRST_IRQ)
    assert taken == [irq for irq, _ in sorted(rows, key=lambda row: (row[1], row[0]))]


@pytest.mark.parametrize("irq", [0, 37, 81])
def test_a_line_that_stays_high_is_pending_again_after_its_handler(irq: int):
    controller = nvic.Nvic()
    controller.write(0x100 + 4 * (irq // 32), 1 << irq % 32)
    controller.line(irq, True)
    controller.enter(controller.due() or 0)
    assert controller.due() is None
    assert controller.read(0x200 + 4 * (irq // 32)) == 0
    assert controller.read(0x300 + 4 * (irq // 32)) == 1 << irq % 32
    controller.leave()
    assert controller.due() == 16 + irq
    controller.enter(16 + irq)
    controller.line(irq, False)
    controller.leave()
    assert controller.due() is None
