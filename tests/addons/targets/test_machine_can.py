"""The emulated CAN controller beyond plain frames: mailboxes that wait, FIFOs, filter indices, errors, interrupts."""

import pytest

from hil.addons.targets.machine import can
from hil.addons.targets.machine.peripherals import MachineError
from tests.addons.targets.test_machine_peripherals import CORE_HZ, Line, open_can, send


def everything() -> can.Can:
    return open_can((0, 0), listed=False)


def test_it_begins_asleep_as_the_manual_says_and_again_after_a_reset_by_software():
    controller = can.Can(42_000_000, CORE_HZ)
    names = (can.MCR, can.MSR, can.TSR, can.BTR, can.FMR)
    first = [0x0001_0002, 0x0000_0C02, 0x1C00_0000, 0x0123_0000, 0x2A1C_0E01]
    assert [controller.read(name) for name in names] == first
    assert not controller.is_on_bus
    controller.write(can.MCR, 1 << 1)
    assert (controller.read(can.MSR) & 3, controller.is_on_bus) == (2, False)
    controller.write(can.MCR, 1 << 1 | 1)
    assert controller.read(can.MSR) & 3 == 1, "initialisation comes before sleep"
    controller.write(can.MCR, 0)
    assert (controller.read(can.MSR) & 3, controller.is_on_bus) == (0, True)
    controller.write(can.MCR, 1 << 15)
    assert [controller.read(name) for name in names] == first


def test_what_nobody_acknowledges_waits_in_its_mailbox_and_can_be_aborted():
    controller = everything()
    controller.acknowledge(False)
    for mailbox, identifier in ((0, 0x11), (1, 0x22), (2, 0x33)):
        assert controller.read(can.TSR) >> 24 & 3 == mailbox, "the next that is empty"
        send(controller, mailbox, identifier, b"abc")
    assert (controller.sent, controller.read(can.TSR) >> 26) == ([], 0)
    controller.write(can.TSR, 1 << 15)
    assert controller.read(can.TSR) >> 24 == 1 | 2 << 2
    assert controller.read(can.TSR) >> 8 & 0xFF == 1, "done, and not sent"
    controller.write(can.TSR, 1 << 8)
    assert controller.read(can.TSR) >> 8 & 0xFF == 0
    controller.acknowledge(True)
    assert controller.sent == [can.CanFrame(0x11, b"abc"), can.CanFrame(0x33, b"abc")]
    assert controller.read(can.TSR) == 7 << 26 | 3 | 3 << 16
    assert controller.read(can.TX_MAILBOX) == 0x11 << 21


def test_frames_of_29_bits_are_sent_and_remote_frames_are_not_known():
    controller = everything()
    controller.write(can.TX_MAILBOX + 4, 15)
    controller.write(can.TX_MAILBOX + 8, 0x44332211)
    controller.write(can.TX_MAILBOX + 12, 0x88776655)
    controller.write(can.TX_MAILBOX, 0x1ABCDEF << 3 | 4 | 1)
    assert controller.sent == [can.CanFrame(0x1ABCDEF, b"\x11\x22\x33\x44\x55\x66\x77\x88", is_extended=True)]
    with pytest.raises(MachineError, match=r"^CAN1: the firmware sends a remote frame, which the protocol"):
        controller.write(can.TX_MAILBOX + 0x10, 5 << 21 | 2 | 1)


def test_a_frame_goes_to_the_fifo_of_its_filter_with_the_filter_s_index():
    controller = can.Can(42_000_000, CORE_HZ)
    controller.write(can.MCR, 0)
    controller.write(can.FMR, 1)
    controller.write(can.FFA1R, 0b1010)  # banks 1 and 3 belong to the second FIFO
    controller.write(can.FS1R, 0b0011)  # the first two are of 32 bits
    controller.write(can.FM1R, 0b0101)  # 0 and 2 are lists
    rows = (
        (0x10 << 21, 0x11 << 21), (0x200 << 21, 0x700 << 21),
        (0x20 << 5 | 0x21 << 21, 0x22 << 5 | 0x23 << 21), (0x500 << 5 | 0x700 << 21, 0x613 << 5 | 0x7F3 << 21),
    )  # fmt: skip
    for bank, (one, two) in enumerate(rows):
        controller.write(can.FILTERS + 8 * bank, one)
        controller.write(can.FILTERS + 8 * bank + 4, two)
    controller.write(can.FA1R, 0b1111)
    assert not controller.receive(can.CanFrame(0x10, b"")), "filters are being initialised"
    controller.write(can.FMR, 0)
    # In its FIFO: a list of 32 bits has two numbers, a mask one; a list of 16 bits has four, masks two.
    for identifier, fifo, index in (
        (0x10, 0, 0), (0x11, 0, 1), (0x234, 1, 0), (0x20, 0, 2), (0x21, 0, 3), (0x22, 0, 4), (0x23, 0, 5),
        (0x5AB, 1, 1), (0x61F, 1, 2),
    ):  # fmt: skip
        data = bytes(range(1, 1 + identifier % 9))
        assert controller.receive(can.CanFrame(identifier, data)), hex(identifier)
        status, at = can.RF0R + 4 * fifo, can.RX_FIFO + 0x10 * fifo
        assert [controller.read(one) & 3 for one in (can.RF0R, can.RF1R)] == [1 - fifo, fifo]
        assert controller.read(at) == identifier << 21
        assert controller.read(at + 4) == len(data) | index << 8
        words = controller.read(at + 8) | controller.read(at + 12) << 32
        assert words == int.from_bytes(data, "little")
        controller.write(at, 0)
        assert controller.read(at) == identifier << 21, "it is read only"
        controller.write(status, 1 << 5)
    for identifier in (0x12, 0x24, 0x300, 0x623):
        assert not controller.receive(can.CanFrame(identifier, b""))
    controller.write(can.FA1R, 0b1110)
    assert not controller.receive(can.CanFrame(0x10, b""))
    controller.write(can.FILTERS, 0x15 << 21)  # a bank that is off
    controller.write(can.FA1R, 0b1111)
    assert controller.receive(can.CanFrame(0x15, b""))


def test_frames_of_29_bits_pass_filters_of_32_and_of_16_bits():
    identifier = 0x12345678
    wide = open_can((identifier << 3 | 4, 0))
    assert wide.receive(can.CanFrame(identifier, b"", is_extended=True))
    assert wide.read(can.RX_FIFO) == identifier << 3 | 4
    narrow = everything()
    narrow.write(can.FMR, 1)
    narrow.write(can.FS1R, 0)
    narrow.write(can.FM1R, 1)
    narrow.write(can.FILTERS, (identifier >> 18) << 5 | 1 << 3 | identifier >> 15 & 7)
    narrow.write(can.FMR, 0)
    assert narrow.receive(can.CanFrame(identifier, b"", is_extended=True))
    assert not narrow.receive(can.CanFrame(identifier ^ 1 << 15, b"", is_extended=True))
    assert narrow.receive(can.CanFrame(identifier ^ 1 << 14, b"", is_extended=True)), "these bits are not compared"


@pytest.mark.parametrize(
    ("errors", "state", "is_on_bus"), [(95, 0, True), (96, 1, True), (127, 1, True), (128, 3, True), (255, 3, True),
                                       (256, 7, False)]
)  # fmt: skip
def test_errors_warn_then_are_passive_then_end_it(errors: int, state: int, is_on_bus: bool):
    controller, line = everything(), Line()
    controller.irq_error = line
    controller.write(can.IER, 1 << 15 | 1 << 9)
    controller.fail(errors)
    assert controller.read(can.ESR) == min(errors, 255) << 16 | 3 << 4 | state
    assert controller.is_on_bus is is_on_bus
    assert line.high is (errors >= 128), "of being passive it is told"
    controller.write(can.IER, 1 << 15 | 1 << 11)
    assert line.high, "of the last error it is told"
    controller.write(can.ESR, 0)
    assert controller.read(can.ESR) == min(errors, 255) << 16 | state
    assert not line.high
    controller.write(can.ESR, 7 << 4)
    controller.write(can.MSR, 1 << 2)
    assert not line.high
    assert controller.read(can.MSR) & 0x1C == 0


def test_each_fifo_interrupts_for_a_frame_a_full_one_and_an_overrun():
    for number, fifo in ((0, can.RF0R), (1, can.RF1R)):
        controller, lines = everything(), (Line(), Line())
        controller.irq_rx = list(lines)
        controller.write(can.FMR, 1)
        controller.write(can.FFA1R, number)
        controller.write(can.FMR, 0)
        for bit, at in ((1, 1), (2, 3), (3, 4)):  # a frame waits, it is full, one was lost
            controller.write(can.IER, 1 << bit + 3 * number)
            for count in range(1, 5):
                controller.receive(can.CanFrame(count, b""))
                assert (lines[number].high, lines[1 - number].high) == (count >= at, False), (bit, count)
            controller.write(fifo, 1 << 4 | 1 << 3)
            assert lines[number].high is (bit < 3), "it is full as long as three wait"
            for _ in range(4):
                controller.write(fifo, 1 << 5)
            assert (controller.read(fifo), lines[number].high) == (0, False)


def test_bus_off_lasts_128_times_11_bits_of_the_timing_that_was_set():
    controller = everything()
    assert controller.clocks_per_bit() == 3 * (1 + 10 + 3)
    controller.write(can.MCR, 1)
    controller.write(can.BTR, 0x3FF | 15 << 16 | 7 << 20)
    assert controller.clocks_per_bit() == 1024 * (1 + 16 + 8)
    controller.write(can.MCR, 0)
    controller.fail(256)
    controller.write(can.MCR, 1)
    controller.write(can.MCR, 0)
    cycles = 128 * 11 * 1024 * 25 * 4
    controller.advance(cycles - 1)
    assert not controller.is_on_bus
    controller.advance(1)
    assert (controller.is_on_bus, controller.read(can.ESR)) == (True, 0)
