"""What counts the core's clock: SysTick and the cycle counter (ARMv7-M manual, B3.3 and C1.8)."""

from hil.robot.targets.machine.registers import WORD, IrqLine, MachineError, not_connected

READ_CYCLES = 16
"""What it costs to read a clock: a loop that waits for time to pass comes to its end."""

_ENABLE, _INTERRUPT, _COUNTED = 1, 2, 1 << 16


class SysTick:
    """The 24-bit timer of the core. ``irq`` is called with True each time that it reaches zero."""

    def __init__(self) -> None:
        self.irq: IrqLine = not_connected
        self.reset()

    def reset(self) -> None:
        """Stop, with all registers zero."""
        self._control = 0
        self._reload = 0
        self._value = 0

    def read(self, offset: int) -> int:
        """Return CSR, RVR, CVR or CALIB, at 0x0, 0x4, 0x8 and 0xC."""
        if offset == 0x0:
            value = self._control
            self._control &= ~_COUNTED
            return value
        if offset == 0x4:
            return self._reload
        if offset == 0x8:
            self.advance(READ_CYCLES)
            return self._value
        return 0

    def write(self, offset: int, value: int) -> None:
        """Write CSR, RVR or CVR."""
        if offset == 0x0:
            self._control = value & 7 | self._control & _COUNTED
        elif offset == 0x4:
            self._reload = value & 0xFF_FFFF
        elif offset == 0x8:
            self._value = 0
            self._control &= ~_COUNTED

    def advance(self, cycles: int) -> None:
        """Count down. However often zero is reached, one exception is pending, as in the core."""
        if not self._control & _ENABLE or not self._reload:
            return
        left = self._value or self._reload + 1
        if cycles < left:
            self._value = left - cycles
            return
        self._value = self._reload + 1 - (cycles - left) % (self._reload + 1)
        if self._value == self._reload + 1:
            self._value = 0  # the reload comes with the next cycle
        self._control |= _COUNTED
        if self._control & _INTERRUPT:
            self.irq(True)


class CycleCounter:
    """CYCCNT of the data watchpoint and trace unit."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Stop at zero."""
        self._on = False
        self._count = 0

    def read(self, offset: int) -> int:
        """Return DWT_CTRL or DWT_CYCCNT. Raises MachineError elsewhere."""
        if offset == 0x0:
            return int(self._on)
        if offset == 0x4:
            self.advance(READ_CYCLES)
            return self._count
        raise MachineError(f"the DWT has no register at offset {offset:#05x} in this machine")

    def write(self, offset: int, value: int) -> None:
        """Write DWT_CTRL or DWT_CYCCNT. Raises MachineError elsewhere."""
        if offset == 0x0:
            self._on = bool(value & 1)
        elif offset == 0x4:
            self._count = value
        else:
            raise MachineError(f"the DWT has no register at offset {offset:#05x} in this machine")

    def advance(self, cycles: int) -> None:
        """Count up, if on."""
        if self._on:
            self._count = self._count + cycles & WORD
