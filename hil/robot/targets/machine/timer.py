"""Timers TIM1 to TIM8 (RM0090, chapters 17 to 20): counting up, and the update interrupt."""

from hil.robot.targets.machine.core_clock import READ_CYCLES
from hil.robot.targets.machine.registers import IrqLine, MachineError, Peripheral, not_connected

CR1, SMCR, DIER, SR, EGR, CNT, PSC, ARR = 0x00, 0x08, 0x0C, 0x10, 0x14, 0x24, 0x28, 0x2C

_ENABLED, _UPDATE, _SLAVE_MODE = 1, 1, 7


class Timer(Peripheral):
    """A timer whose clock is the core's divided by ``divider``. ``width`` is 16 or 32 bits.

    Channels only remember: nothing is connected to the pins. ``irq`` is the line of the update interrupt.
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

    def advance(self, cycles: int) -> None:
        if not self._register[CR1] & _ENABLED:
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
        if offset == SMCR and value & _SLAVE_MODE:
            raise MachineError(f"{self.name}: slave modes, such as that of an encoder, are not modelled")
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
