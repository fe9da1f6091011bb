"""Which exception is due: interrupt lines, enables, priorities (ARMv7-M manual, B1.5 and B3.2 to B3.4)."""

from hil.addons.targets.machine.peripherals import WORD, Peripheral, SysTick

HARD_FAULT, SVC, PEND_SV, SYS_TICK, FIRST_IRQ = 3, 11, 14, 15, 16

_IRQS = 96  # the STM32F405 has 82, and the registers come in words
_PRIORITY_BITS = 0xF0  # four are implemented
_THREAD = 256  # priority of code that handles no exception: below every other
_SYSTICK = range(0x010, 0x020)
_BANKS = range(0x100, 0x380)  # set enable, clear enable, set pending, clear pending, active
_IPR = range(0x400, 0x400 + _IRQS)
_SHPR = range(0xD18, 0xD24)
_CPUID, _ICSR, _VTOR, _AIRCR = 0xD00, 0xD04, 0xD08, 0xD0C
_CFSR, _HFSR, _MMFAR, _BFAR = 0xD28, 0xD2C, 0xD34, 0xD38
# Registers that only remember: CCR, SHCSR, fault status and addresses, CPACR, FPCCR, DEMCR.
_PLAIN = (0xD10, 0xD14, 0xD24, _CFSR, _HFSR, 0xD30, _MMFAR, _BFAR, 0xD3C, 0xD88, 0xDFC, 0xF34)
# Cortex-M4 r0p1; vectors at address 0, which is an alias of the flash.
_RESET_VALUES = dict.fromkeys(_PLAIN, 0) | {_CPUID: 0x410F_C241, _VTOR: 0x0800_0000, _AIRCR: 0xFA05_0000}
_RESET_KEY = 0x05FA


class Nvic(Peripheral):
    """The system control space at 0xE000E000.

    Lines are levels: one that is still high when its handler ends is pending again. ``active`` are the exceptions that
    are being handled, the newest last; ``pending`` those that are enabled and wait.
    """

    def __init__(self) -> None:
        self.systick = SysTick()
        self.systick.irq = lambda _high: self.pending.add(SYS_TICK)
        super().__init__("the system control space", _RESET_VALUES)

    def reset(self) -> None:
        super().reset()
        self.systick.reset()
        self.reset_requested = False
        self.active: list[int] = []
        self.pending: set[int] = set()
        self._latched = self._lines = self._enabled = 0
        self._priority = bytearray(FIRST_IRQ + _IRQS)

    def advance(self, cycles: int) -> None:
        self.systick.advance(cycles)

    def line(self, irq: int, high: bool) -> None:
        """Set the interrupt line of a peripheral."""
        mask = 1 << irq
        if not high:
            self._lines &= ~mask
            return
        self._lines |= mask
        if FIRST_IRQ + irq not in self.active:
            self._latched |= mask
            self._refresh()

    def due(self, *, primask: bool = False, basepri: int = 0) -> int | None:
        """Return the exception to take now, or None."""
        if not self.pending or primask:
            return None
        number = self._most_urgent()
        limit = min((self._priority[n] for n in self.active), default=_THREAD)
        if basepri & _PRIORITY_BITS:
            limit = min(limit, basepri & _PRIORITY_BITS)
        return number if self._priority[number] < limit else None

    def enter(self, number: int) -> int:
        """Begin handling an exception; return the address of its vector."""
        self.active.append(number)
        if number >= FIRST_IRQ:
            self._latched &= ~(1 << number - FIRST_IRQ)
        self.pending.discard(number)
        return self._register[_VTOR] + 4 * number

    def leave(self) -> None:
        """End the handling that began last."""
        number = self.active.pop()
        if number >= FIRST_IRQ:
            self._latched |= self._lines & 1 << number - FIRST_IRQ
            self._refresh()

    def record_fault(self, cfsr: int, hfsr: int, mmfar: int, bfar: int) -> None:
        """Set the fault status and address registers."""
        self._register |= {_CFSR: cfsr, _HFSR: hfsr, _MMFAR: mmfar, _BFAR: bfar}

    def read(self, offset: int) -> int:
        if offset in _BANKS:
            active = sum(1 << n - FIRST_IRQ for n in self.active if n >= FIRST_IRQ)
            bank = (self._enabled, self._enabled, self._latched, self._latched, active)[offset - 0x100 >> 7]
            return bank >> 8 * (offset & 0x7C) & WORD
        if offset in _IPR or offset in _SHPR:
            first = _first_priority(offset)
            return int.from_bytes(self._priority[first : first + 4], "little")
        if offset in _SYSTICK:
            return self.systick.read(offset - _SYSTICK.start)
        if offset == _ICSR:  # active and pending exception
            return (self.active[-1] if self.active else 0) | (self._most_urgent() if self.pending else 0) << 12
        return super().read(offset)

    def write(self, offset: int, value: int, size: int = 4) -> None:
        """Write ``size`` bytes at ``offset``."""
        if offset in _BANKS:
            self._write_bank(offset - 0x100 >> 7, value << 8 * (offset & 0x7C))
        elif offset in _IPR or offset in _SHPR:
            first = _first_priority(offset)
            masked = bytes(byte & _PRIORITY_BITS for byte in value.to_bytes(size, "little"))
            self._priority[first : first + size] = masked
        elif offset in _SYSTICK:
            self.systick.write(offset - _SYSTICK.start, value)
        elif offset == _ICSR:
            for number, set_bit, clear_bit in ((PEND_SV, 28, 27), (SYS_TICK, 26, 25)):
                if value >> set_bit & 1:
                    self.pending.add(number)
                elif value >> clear_bit & 1:
                    self.pending.discard(number)
        elif offset == _AIRCR:
            self.reset_requested |= value >> 16 == _RESET_KEY and bool(value & 4)
        else:
            super().write(offset, value & 0xFFFF_FF80 if offset == _VTOR else value)

    def _write_bank(self, bank: int, mask: int) -> None:
        if bank == 0:
            self._enabled |= mask
        elif bank == 1:
            self._enabled &= ~mask
        elif bank == 2:
            self._latched |= mask
        elif bank == 3:
            # A line that is high makes its interrupt pending again at once.
            self._latched &= ~mask | self._lines
        self._refresh()

    def _most_urgent(self) -> int:
        return min(self.pending, key=lambda number: (self._priority[number], number))

    def _refresh(self) -> None:
        """Work out which interrupts wait. SysTick and PendSV cannot be disabled and stay as they are."""
        self.pending = {number for number in self.pending if number < FIRST_IRQ}
        waiting = self._latched & self._enabled
        while waiting:
            lowest = waiting & -waiting
            self.pending.add(FIRST_IRQ - 1 + lowest.bit_length())
            waiting ^= lowest


def _first_priority(offset: int) -> int:
    return FIRST_IRQ + offset - _IPR.start if offset in _IPR else 4 + offset - _SHPR.start
