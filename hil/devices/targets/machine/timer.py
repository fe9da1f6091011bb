"""Timers TIM1 to TIM14 (RM0090, chapters 17 to 20): counting, update interrupts, encoder mode, compare registers."""

from hil.devices.targets.machine.core_clock import READ_CYCLES
from hil.devices.targets.machine.registers import IrqLine, Peripheral, not_connected

CR1, CR2, SMCR, DIER, SR, EGR, CNT, PSC, ARR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x24, 0x28, 0x2C
CCMR1, CCMR2, CCER, CCR1, CCR2, CCR3, CCR4, BDTR = 0x18, 0x1C, 0x20, 0x34, 0x38, 0x3C, 0x40, 0x44

_ENABLED, _UPDATE = 1, 1
_ENCODER_MODES = (1, 2, 3)


class Timer(Peripheral):
    """A timer whose clock is the core's divided by ``divider``. ``width`` is 16 or 32 bits.

    In encoder mode time does not count; ``turn`` does.
    """

    def __init__(self, name: str, width: int, divider: int) -> None:
        self._mask = (1 << width) - 1
        super().__init__(name, {**dict.fromkeys(range(0x00, 0x54, 4), 0), ARR: self._mask})
        self.irq: IrqLine = not_connected
        self._divider = divider
        self._rest = 0

    def reset(self) -> None:
        super().reset()
        self._rest = 0

    @property
    def is_encoder(self) -> bool:
        """Whether the counter follows an encoder."""
        return self._register[SMCR] & 7 in _ENCODER_MODES

    def turn(self, counts: int) -> None:
        """Turn the encoder by so many counts."""
        if self.is_encoder and self._register[CR1] & _ENABLED:
            self._register[CNT] = (self._register[CNT] + counts) % (self._register[ARR] + 1)

    def duty(self, channel: int) -> float:
        """Return the part of the time that the output of a channel (1 to 4) is active; 0 while it is off."""
        is_on = self._register[CCER] >> 4 * (channel - 1) & 1 and self._register[CR1] & _ENABLED
        if not is_on:
            return 0.0
        return min(1.0, self._register[CCR1 + 4 * (channel - 1)] / (self._register[ARR] + 1))

    def advance(self, cycles: int) -> None:
        if not self._register[CR1] & _ENABLED or self.is_encoder:
            return
        clocks, self._rest = divmod(self._rest + cycles, self._divider * (self._register[PSC] + 1))
        turns, self._register[CNT] = divmod(self._register[CNT] + clocks, self._register[ARR] + 1)
        if turns:
            self._register[SR] |= _UPDATE
            self._flag()

    def read(self, offset: int) -> int:
        if offset == CNT:
            self.advance(READ_CYCLES)
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == SR:
            value &= self._register[SR]  # a flag is cleared by writing 0
        elif offset == EGR:
            if value & _UPDATE:
                self._register[CNT] = 0
                self._rest = 0
                self._register[SR] |= _UPDATE
            value = 0
        elif offset in (CNT, ARR):
            value &= self._mask
        super().write(offset, value)
        self._flag()

    def _flag(self) -> None:
        self.irq(bool(self._register[SR] & self._register[DIER] & _UPDATE))
