"""bxCAN (RM0090, chapter 32): mailboxes, FIFOs, filters, error states; a bus without bit times.

A frame that is requested is on the bus at once, unless the controller is off it. Classic frames with 11 or 29 bits.
"""

from typing import NamedTuple

from hil.addons.targets.machine.peripherals import WORD, IrqLine, MachineError, Peripheral, not_connected

MCR, MSR, TSR, RF0R, RF1R, IER, ESR, BTR = range(0x00, 0x20, 4)
TX_MAILBOX, RX_FIFO = 0x180, 0x1B0
FMR, FM1R, FS1R, FFA1R, FA1R, FILTERS = 0x200, 0x204, 0x20C, 0x214, 0x21C, 0x240

_BANKS = 28
_DEPTH = 3
_INRQ, _SLEEP, _RFLM, _ABOM, _SOFT_RESET = 1 << 0, 1 << 1, 1 << 3, 1 << 6, 1 << 15
_INAK, _SLAK, _ERRI = 1 << 0, 1 << 1, 1 << 2
_TXRQ = 1 << 0
_FULL, _OVERRUN, _RELEASE = 1 << 3, 1 << 4, 1 << 5
_TMEIE, _ERRIE = 1 << 0, 1 << 15
_WARNING, _PASSIVE, _BUS_OFF = 1 << 0, 1 << 1, 1 << 2
_RECOVERY_BITS = 128 * 11

_OFFSETS = (
    *range(0x00, 0x20, 4),
    *range(TX_MAILBOX, 0x1D0, 4),
    *(FMR, FM1R, FS1R, FFA1R, FA1R),
    *range(FILTERS, FILTERS + 8 * _BANKS, 4),
)
_RESET = {MCR: 0x0001_0002, MSR: 0x0000_0C02, TSR: 0x1C00_0000, BTR: 0x0123_0000, FMR: 0x2A1C_0E01}


class CanFrame(NamedTuple):
    """A data frame of classic CAN."""

    id: int
    data: bytes
    is_extended: bool = False


class Can(Peripheral):
    """CAN1. ``sent`` collects the frames that it put on the bus.

    ``missed`` counts frames that arrived while it was off the bus or its FIFO was full. Interrupt lines: ``irq_tx``,
    ``irq_rx`` of both FIFOs, ``irq_error``.
    """

    def __init__(self, clock_hz: int, core_hz: int) -> None:
        self.irq_tx: IrqLine = not_connected
        self.irq_rx: list[IrqLine] = [not_connected, not_connected]
        self.irq_error: IrqLine = not_connected
        self.missed = 0
        self._is_acknowledged = True
        self._core_cycles_of_clock = core_hz // clock_hz
        super().__init__("CAN1", dict.fromkeys(_OFFSETS, 0) | _RESET)

    def reset(self) -> None:
        super().reset()
        self.sent: list[CanFrame] = []
        self._fifo: tuple[list[tuple[CanFrame, int]], ...] = ([], [])
        self._recovery_cycles = 0

    @property
    def is_on_bus(self) -> bool:
        """Whether frames are sent and received: neither initialising nor asleep nor bus-off."""
        return not self._register[MSR] & (_INAK | _SLAK) and not self._register[ESR] & _BUS_OFF

    def receive(self, frame: CanFrame) -> bool:
        """Let a frame arrive; return whether a filter took it and there was room."""
        if not self.is_on_bus:
            self.missed += 1
            return False
        found = self._match(frame)
        if found is None:
            return False
        number, index = found
        fifo, status = self._fifo[number], RF0R + 4 * number
        has_room = len(fifo) < _DEPTH
        if not has_room:
            self.missed += 1
            self._register[status] |= _OVERRUN
        if has_room or not self._register[MCR] & _RFLM:
            fifo[_DEPTH - 1 :] = []  # an overrun replaces the newest
            fifo.append((frame, index))
        self._show_fifo(number)
        return has_room

    def fail(self, transmit_errors: int) -> None:
        """Set the transmit error counter, as errors on the bus do: 96 warns, 128 is passive, beyond 255 bus-off."""
        state = (
            (_WARNING if transmit_errors >= 96 else 0)
            | (_PASSIVE if transmit_errors >= 128 else 0)
            | (_BUS_OFF if transmit_errors > 255 else 0)
        )
        self._register[ESR] = min(transmit_errors, 255) << 16 | 3 << 4 | state  # last error: no acknowledgement
        if state & _BUS_OFF and self._register[MCR] & _ABOM:
            self._begin_recovery()
        self._register[MSR] |= _ERRI
        self._interrupts()

    def acknowledge(self, peer_is_there: bool) -> None:
        """Set whether another node acknowledges what is sent; without one a frame stays in its mailbox."""
        self._is_acknowledged = peer_is_there
        self._transmit_all()
        self._interrupts()

    def advance(self, cycles: int) -> None:
        """Let the bus be idle for so long: 128 times 11 recessive bits end bus-off once recovery has begun."""
        if self._recovery_cycles:
            self._recovery_cycles = max(0, self._recovery_cycles - cycles)
            if not self._recovery_cycles:
                self._register[ESR] = 0
                self._transmit_all()
                self._interrupts()

    def write(self, offset: int, value: int) -> None:
        if offset == MCR:
            self._control(value)
        elif offset == MSR:
            self._register[MSR] &= ~(value & 0x1C)  # ERRI, WKUI, SLAKI
        elif offset == TSR:
            self._transmit_status(value)
        elif offset in (RF0R, RF1R):
            self._receive_status((offset - RF0R) // 4, value)
        elif offset == ESR:
            self._register[ESR] = self._register[ESR] & ~0x70 | value & 0x70
        elif offset == BTR:
            self._needs(bool(self._register[MSR] & _INAK), "BTR", "initialisation mode")
            self._register[BTR] = value
        elif RX_FIFO <= offset < RX_FIFO + 0x20:
            pass  # read only
        elif offset in (FM1R, FS1R, FFA1R) or offset >= FILTERS:
            bank = (offset - FILTERS) // 8
            is_idle = offset >= FILTERS and not self._register[FA1R] >> bank & 1
            self._needs(is_idle or bool(self._register[FMR] & 1), "a filter", "filter initialisation or a bank off")
            super().write(offset, value)
        elif TX_MAILBOX <= offset < RX_FIFO and (offset - TX_MAILBOX) % 0x10 == 0 and value & _TXRQ:
            super().write(offset, value)
            self._transmit((offset - TX_MAILBOX) // 0x10)
        else:
            super().write(offset, value)
        self._interrupts()

    # Modes

    def _control(self, value: int) -> None:
        if value & _SOFT_RESET:
            self.reset()
            return
        left_initialisation = self._register[MCR] & _INRQ and not value & _INRQ
        self._register[MCR] = value
        # Initialisation has priority over sleep; both are acknowledged at once.
        mode = _INAK if value & _INRQ else _SLAK if value & _SLEEP else 0
        self._register[MSR] = self._register[MSR] & ~(_INAK | _SLAK) | mode
        if left_initialisation:
            if self._register[ESR] & _BUS_OFF:
                self._begin_recovery()
            self._transmit_all()

    def _begin_recovery(self) -> None:
        self._recovery_cycles = round(_RECOVERY_BITS * self.clocks_per_bit() * self._core_cycles_of_clock)

    def clocks_per_bit(self) -> int:
        """Return how many clocks of the peripheral a bit lasts, from BTR."""
        timing = self._register[BTR]
        return ((timing & 0x3FF) + 1) * (1 + (timing >> 16 & 0xF) + 1 + (timing >> 20 & 7) + 1)

    @staticmethod
    def _needs(condition: bool, what: str, mode: str) -> None:
        if not condition:
            raise MachineError(f"CAN1: {what} was written outside {mode}, which has no effect on a board")

    # Transmission

    def _transmit_all(self) -> None:
        for mailbox in range(3):
            self._transmit(mailbox)

    def _transmit(self, mailbox: int) -> None:
        at = TX_MAILBOX + 0x10 * mailbox
        identifier = self._register[at]
        if not identifier & _TXRQ:
            return
        self._register[TSR] &= ~(1 << 26 + mailbox)
        self._show_next_mailbox()
        if not self.is_on_bus or not self._is_acknowledged:
            return  # stays pending
        length = min(self._register[at + 4] & 0xF, 8)
        data = (self._register[at + 8] | self._register[at + 12] << 32).to_bytes(8, "little")[:length]
        if identifier & 2:
            raise MachineError("CAN1: the firmware sends a remote frame, which the protocol does not have")
        extended = bool(identifier & 4)
        self.sent.append(CanFrame(identifier >> 3 if extended else identifier >> 21, data, extended))
        self._register[at] = identifier & ~_TXRQ
        self._register[TSR] |= 3 << 8 * mailbox | 1 << 26 + mailbox  # completed, without error; empty
        self._show_next_mailbox()

    def _transmit_status(self, value: int) -> None:
        for mailbox in range(3):
            flags = value >> 8 * mailbox
            if flags & 1:  # completed: cleared together with what it says
                self._register[TSR] &= ~(0xF << 8 * mailbox)
            if flags & 0x80:  # abort
                self._register[TX_MAILBOX + 0x10 * mailbox] &= ~_TXRQ
                self._register[TSR] |= 1 << 8 * mailbox | 1 << 26 + mailbox
        self._show_next_mailbox()

    def _show_next_mailbox(self) -> None:
        empty = self._register[TSR] >> 26 & 7
        code = (empty & -empty).bit_length() - 1 if empty else 0
        self._register[TSR] = self._register[TSR] & ~(3 << 24) | code << 24

    # Reception

    def _match(self, frame: CanFrame) -> tuple[int, int] | None:
        """Return FIFO and filter match index of the first filter that takes a frame."""
        word = _identifier_word(frame)
        half = frame.id >> 18 << 5 | 8 | frame.id >> 15 & 7 if frame.is_extended else frame.id << 5
        index = [0, 0]
        for bank in range(_BANKS):
            fifo = self._register[FFA1R] >> bank & 1
            wide, listed = self._register[FS1R] >> bank & 1, self._register[FM1R] >> bank & 1
            one, two = (self._register[FILTERS + 8 * bank + 4 * n] for n in range(2))
            rows = _wide(one, two, listed) if wide else _narrow(one, two, listed)
            if self._register[FA1R] >> bank & 1 and not self._register[FMR] & 1:
                for n, (expected, mask) in enumerate(rows):
                    if not ((word if wide else half) ^ expected) & mask:
                        return fifo, index[fifo] + n
            index[fifo] += len(rows)
        return None

    def _receive_status(self, number: int, value: int) -> None:
        status = RF0R + 4 * number
        self._register[status] &= ~(value & (_FULL | _OVERRUN))
        if value & _RELEASE and self._fifo[number]:
            self._fifo[number].pop(0)
        self._show_fifo(number)

    def _show_fifo(self, number: int) -> None:
        fifo, status = self._fifo[number], RF0R + 4 * number
        full = _FULL if len(fifo) == _DEPTH else 0
        self._register[status] = self._register[status] & ~(3 | _FULL) | len(fifo) | full
        if fifo:
            frame, index = fifo[0]
            data = int.from_bytes(frame.data, "little")
            words = (_identifier_word(frame), len(frame.data) | index << 8, data & WORD, data >> 32)
            self._register |= zip(range(RX_FIFO + 0x10 * number, RX_FIFO + 0x10 * number + 0x10, 4), words, strict=True)
        self._interrupts()

    def _interrupts(self) -> None:
        register = self._register
        enabled = register[IER]
        self.irq_tx(bool(enabled & _TMEIE and register[TSR] & 0x0001_0101))
        for number, irq in enumerate(self.irq_rx):
            status, mask = register[RF0R + 4 * number], enabled >> 1 + 3 * number
            irq(bool((mask & 1 and status & 3) or (mask & 2 and status & _FULL) or (mask & 4 and status & _OVERRUN)))
        causes = register[ESR] & enabled >> 8 & 7 or (enabled >> 11 & 1 and register[ESR] & 0x70)
        self.irq_error(bool(enabled & _ERRIE and register[MSR] & _ERRI and causes))


def _identifier_word(frame: CanFrame) -> int:
    return frame.id << 3 | 4 if frame.is_extended else frame.id << 21


def _wide(one: int, two: int, listed: int) -> list[tuple[int, int]]:
    """Return (identifier, mask) of a bank with 32-bit filters."""
    return [(one, WORD & ~1), (two, WORD & ~1)] if listed else [(one, two & ~1)]


def _narrow(one: int, two: int, listed: int) -> list[tuple[int, int]]:
    """Return (identifier, mask) of a bank with 16-bit filters."""
    halves = [one & 0xFFFF, one >> 16, two & 0xFFFF, two >> 16]
    if listed:
        return [(half, 0xFFFF) for half in halves]
    return [(halves[0], halves[1]), (halves[2], halves[3])]
