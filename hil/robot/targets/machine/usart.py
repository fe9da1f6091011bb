"""USART (RM0090, chapter 30), by interrupts: bytes without bit times.

The other side is patient: bytes wait until the firmware takes them, so that nothing is overrun. What the firmware sends
has left at once.
"""

from collections import deque

from hil.robot.targets.machine.registers import IrqLine, Peripheral, not_connected

SR, DR, BRR, CR1, CR2, CR3, GTPR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18

_RXNE, _TC, _TXE, _IDLE = 1 << 5, 1 << 6, 1 << 7, 1 << 4
_ENABLED, _RECEIVER, _TRANSMITTER = 1 << 13, 1 << 2, 1 << 3
_INTERRUPTS = _RXNE | _TC | _TXE | _IDLE  # the enables in CR1 are at the places of the flags in SR


class Usart(Peripheral):
    """One serial line. ``sent`` collects what the firmware has sent, ``missed`` counts bytes that found it off."""

    def __init__(self, name: str) -> None:
        super().__init__(name, dict.fromkeys((BRR, CR1, CR2, CR3, GTPR), 0))
        self.irq: IrqLine = not_connected
        self.sent = bytearray()
        self.missed = 0
        self._clear()

    def reset(self) -> None:
        super().reset()
        self._clear()

    def _clear(self) -> None:
        self.sent.clear()
        self._status = _TC | _TXE
        self._data = 0
        self._received: deque[int] = deque()
        self._idle_seen = False
        self._is_high = False
        self.irq(False)

    def receive(self, data: bytes) -> bool:
        """Let bytes arrive; return False when the receiver is off, and they are lost."""
        if not self._is_on(_RECEIVER):
            self.missed += len(data)
            return False
        if data:
            self._received += data
            self._status |= _RXNE
            self._drive_line()
        return True

    def read(self, offset: int) -> int:
        if offset == SR:
            self._idle_seen = self._status & _IDLE != 0
            return self._status
        if offset == DR:
            return self._pop()
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == DR:
            if self._is_on(_TRANSMITTER):
                self.sent.append(value & 0xFF)
        elif offset != SR:  # whose flags are cleared by reading; TC by 0 would be set again at once
            super().write(offset, value)
            self._drive_line()

    def _pop(self) -> int:
        if self._idle_seen:
            self._status &= ~_IDLE
            self._idle_seen = False
            self._drive_line()
        if self._received:
            self._data = self._received.popleft()
            if not self._received:
                self._status = self._status & ~_RXNE | _IDLE
                self._drive_line()
        return self._data

    def _is_on(self, direction: int) -> bool:
        return self._register[CR1] & (_ENABLED | direction) == _ENABLED | direction

    def _drive_line(self) -> None:
        control = self._register[CR1]
        is_high = bool(control & _ENABLED and control & self._status & _INTERRUPTS)
        if is_high is not self._is_high:
            self._is_high = is_high
            self.irq(is_high)
