"""USART (RM0090, chapter 30), by interrupts: bytes without bit times.

The other side is patient: bytes wait until the firmware takes them, so that nothing is overrun. What the firmware sends
has left at once.
"""

from hil.devices.targets.machine.registers import IrqLine, Peripheral, not_connected

SR, DR, BRR, CR1, CR2, CR3, GTPR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18

_RXNE, _TC, _TXE, _IDLE = 1 << 5, 1 << 6, 1 << 7, 1 << 4
_ENABLED, _RECEIVER, _TRANSMITTER = 1 << 13, 1 << 2, 1 << 3
_INTERRUPTS = _RXNE | _TC | _TXE | _IDLE  # the enables in CR1 are at the places of the flags in SR


class Usart(Peripheral):
    """One serial line. ``sent`` collects what the firmware has sent."""

    def __init__(self, name: str) -> None:
        super().__init__(name, {SR: _TC | _TXE, DR: 0, BRR: 0, CR1: 0, CR2: 0, CR3: 0, GTPR: 0})
        self.irq: IrqLine = not_connected
        self.sent = bytearray()
        self._received = bytearray()
        self._taken = 0
        self._idle_seen = False

    def reset(self) -> None:
        super().reset()
        self.sent.clear()
        self._received.clear()
        self._taken = 0
        self._idle_seen = False

    def receive(self, data: bytes) -> bool:
        """Let bytes arrive; return False when the receiver is off, and they are lost."""
        if not self._is_on(_RECEIVER):
            return False
        self._received += data
        self._flag()
        return True

    def read(self, offset: int) -> int:
        if offset == SR:
            self._idle_seen = bool(self._register[SR] & _IDLE)
        elif offset == DR:
            return self._take()
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == DR:
            if self._is_on(_TRANSMITTER):
                self.sent.append(value & 0xFF)
            return
        if offset == SR:
            return  # flags are cleared by reading; TC by 0 would be set again at once
        super().write(offset, value)
        self._flag()

    def _take(self) -> int:
        if self._idle_seen:
            self._register[SR] &= ~_IDLE
            self._idle_seen = False
        if self._taken < len(self._received):
            self._register[DR] = self._received[self._taken]
            self._taken += 1
            if self._taken == len(self._received):
                self._received.clear()
                self._taken = 0
                self._register[SR] |= _IDLE
        self._flag()
        return self._register[DR]

    def _is_on(self, direction: int) -> bool:
        return self._register[CR1] & (_ENABLED | direction) == _ENABLED | direction

    def _flag(self) -> None:
        status = self._register[SR] & ~_RXNE
        if self._received:
            status |= _RXNE
        self._register[SR] = status
        control = self._register[CR1]
        self.irq(bool(control & _ENABLED and control & status & _INTERRUPTS))
