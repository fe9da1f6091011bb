"""Which exception is due: interrupt lines, enables, priorities (ARMv7-M manual, B1.5 and B3.2 to B3.4)."""

from hil.robot.targets.machine.core_clock import SysTick
from hil.robot.targets.machine.registers import WORD, MachineError

HARD_FAULT, SVC, PEND_SV, SYS_TICK, FIRST_IRQ = 3, 11, 14, 15, 16

_IRQS = 96  # the STM32F405 has 82, and the registers come in words
_PRIORITY_BITS = 0xF0  # four are implemented
_THREAD = 256  # priority of code that handles no exception: below every other
_RESET_KEY = 0x05FA
_BANKS = range(0x100, 0x380)  # set enable, clear enable, set pending, clear pending, active
_IPR = range(0x400, 0x400 + _IRQS)
_SHPR = range(0xD18, 0xD24)
# Registers that only remember: CCR, SHCSR, fault status and addresses, CPACR, FPCCR, DEMCR.
_PLAIN = (0xD10, 0xD14, 0xD24, 0xD28, 0xD2C, 0xD30, 0xD34, 0xD38, 0xD3C, 0xD88, 0xDFC, 0xF34)


class Nvic:
    """The system control space at 0xE000E000.

    Lines are levels: one that is still high when its handler ends is pending again. ``active`` are the exceptions that
    are being handled, the newest last; ``pending`` those that are enabled and wait.
    """

    def __init__(self) -> None:
        self.systick = SysTick()
        self.systick.irq = lambda _high: self.pending.add(SYS_TICK)
        self.reset()

    def reset(self) -> None:
        """Go to the state after reset: everything disabled, vectors at address 0."""
        self.systick.reset()
        self.vector_table = 0
        self.reset_requested = False
        self.active: list[int] = []
        self.pending: set[int] = set()
        self._latched = 0
        self._lines = 0
        self._enabled = 0
        self._priority = bytearray(FIRST_IRQ + _IRQS)
        self._plain = dict.fromkeys(_PLAIN, 0)

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
        number = min(self.pending, key=lambda n: (self._priority[n], n))
        limit = min((self._priority[n] for n in self.active), default=_THREAD)
        if basepri & _PRIORITY_BITS:
            limit = min(limit, basepri & _PRIORITY_BITS)
        return number if self._priority[number] < limit else None

    def enter(self, number: int) -> int:
        """Begin handling; return the address of the vector."""
        self.active.append(number)
        if number >= FIRST_IRQ:
            self._latched &= ~(1 << number - FIRST_IRQ)
        self.pending.discard(number)
        return self.vector_table + 4 * number

    def leave(self) -> None:
        """End what was begun last."""
        number = self.active.pop()
        if number >= FIRST_IRQ:
            self._latched |= self._lines & 1 << number - FIRST_IRQ
            self._refresh()

    def record_fault(self, cfsr: int, hfsr: int, mmfar: int, bfar: int) -> None:
        """Set the fault status and address registers."""
        self._plain |= {0xD28: cfsr, 0xD2C: hfsr, 0xD34: mmfar, 0xD38: bfar}

    def read(self, offset: int) -> int:
        """Return the register at ``offset`` from 0xE000E000. Raises MachineError where there is none."""
        if offset in self._plain:
            return self._plain[offset]
        if offset in _BANKS:
            active = sum(1 << n - FIRST_IRQ for n in self.active if n >= FIRST_IRQ)
            bank = (self._enabled, self._enabled, self._latched, self._latched, active)[offset - 0x100 >> 7]
            return bank >> 8 * (offset & 0x7C) & WORD
        if offset in _IPR or offset in _SHPR:
            first = self._first_priority(offset)
            return int.from_bytes(self._priority[first : first + 4], "little")
        match offset:
            case 0x010 | 0x014 | 0x018 | 0x01C:
                return self.systick.read(offset - 0x010)
            case 0xD00:
                return 0x410F_C241  # CPUID: Cortex-M4 r0p1
            case 0xD04:  # ICSR: active and pending exception
                waiting = min(self.pending, key=lambda n: (self._priority[n], n), default=0)
                return (self.active[-1] if self.active else 0) | waiting << 12
            case 0xD08:
                return self.vector_table
            case 0xD0C:
                return 0xFA05_0000
        raise _unknown(offset)

    def write(self, offset: int, value: int, size: int = 4) -> None:
        """Write ``size`` bytes at ``offset`` from 0xE000E000. Raises MachineError where there is no register."""
        if offset in self._plain:
            self._plain[offset] = value
        elif offset in _BANKS:
            self._write_bank(offset - 0x100 >> 7, value << 8 * (offset & 0x7C))
        elif offset in _IPR or offset in _SHPR:
            first = self._first_priority(offset)
            masked = bytes(byte & _PRIORITY_BITS for byte in value.to_bytes(size, "little"))
            self._priority[first : first + size] = masked
        elif 0x010 <= offset <= 0x018:
            self.systick.write(offset - 0x010, value)
        elif offset == 0xD04:
            self._write_control_state(value)
        elif offset == 0xD08:
            self.vector_table = value & 0xFFFF_FF80
        elif offset == 0xD0C:
            if value >> 16 == _RESET_KEY and value & 4:
                self.reset_requested = True
        else:
            raise _unknown(offset)

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

    def _write_control_state(self, value: int) -> None:
        for number, set_bit, clear_bit in ((PEND_SV, 28, 27), (SYS_TICK, 26, 25)):
            if value >> set_bit & 1:
                self.pending.add(number)
            elif value >> clear_bit & 1:
                self.pending.discard(number)

    @staticmethod
    def _first_priority(offset: int) -> int:
        return FIRST_IRQ + offset - _IPR.start if offset in _IPR else 4 + offset - _SHPR.start

    def _refresh(self) -> None:
        """Work out which interrupts wait. SysTick and PendSV cannot be disabled and stay as they are."""
        self.pending = {number for number in self.pending if number < FIRST_IRQ}
        waiting = self._latched & self._enabled
        while waiting:
            lowest = waiting & -waiting
            self.pending.add(FIRST_IRQ - 1 + lowest.bit_length())
            waiting ^= lowest


def _unknown(offset: int) -> MachineError:
    return MachineError(f"the system control space has no register at offset {offset:#05x} in this machine")
