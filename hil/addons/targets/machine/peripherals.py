"""What every peripheral is, registers by offset, and the smaller peripherals of the chip (RM0090) and of its core."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import ClassVar

IrqLine = Callable[[bool], None]
"""An interrupt line: called with whether it is high."""

WORD = 0xFFFF_FFFF
READ_CYCLES = 16
"""Cycles that reading a clock costs, so that a loop which waits for time to pass ends."""


class MachineError(Exception):
    """The firmware did something that this machine, or every STM32F405, cannot do; the message has the place."""


class Peripheral:
    """A block of 32-bit registers that keep the written values.

    ``reset_values`` has the reset value of each register by its offset. A subclass overrides ``read`` and ``write``
    for registers that do more, and ``reset`` for state that is in no register. ``irq`` is its interrupt line, connected
    to nothing at first. Raises MachineError for an offset without a register: the firmware needs what is not modelled.
    """

    def __init__(self, name: str, reset_values: Mapping[int, int]) -> None:
        self.name = name
        self.irq: IrqLine = not_connected
        self._reset_values = reset_values
        self.reset()

    def read(self, offset: int) -> int:
        """Return the register at ``offset``."""
        try:
            return self._register[offset]
        except KeyError:
            raise MachineError(f"{self.name} has no register at offset {offset:#05x} in this machine") from None

    def write(self, offset: int, value: int) -> None:
        """Write the register at ``offset``."""
        Peripheral.read(self, offset)
        self._register[offset] = value & WORD

    def reset(self) -> None:
        """Go back to the state after a reset."""
        self._register = dict(self._reset_values)

    def advance(self, cycles: int) -> None:
        """Let so many cycles of the core clock pass."""


def not_connected(_high: bool) -> None:
    """An interrupt line that leads nowhere."""


class Gpio(Peripheral):
    """A port of 16 pins (chapter 8). Nothing is connected: an output reads as written, any other pin as low."""

    MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFRL, AFRH = range(0x00, 0x28, 4)

    def __init__(self, name: str) -> None:
        modes, pulls = {"GPIOA": (0xA800_0000, 0x6400_0000), "GPIOB": (0x280, 0x100)}.get(name, (0, 0))  # debug pins
        super().__init__(name, dict.fromkeys(range(0x00, 0x28, 4), 0) | {self.MODER: modes, self.PUPDR: pulls})

    def mode(self, pin: int) -> int:
        """Return 0 for an input, 1 an output, 2 an alternate function, 3 analogue."""
        return self._register[self.MODER] >> 2 * pin & 3

    def read(self, offset: int) -> int:
        if offset == self.IDR:
            return sum(self._register[self.ODR] & 1 << pin for pin in range(16) if self.mode(pin) == 1)
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == self.BSRR:  # setting has priority over resetting
            offset, value = self.ODR, (self._register[self.ODR] & ~(value >> 16) | value) & 0xFFFF
        super().write(offset, value)


class Rcc(Peripheral):
    """Clock tree and reset flags (chapter 7). An oscillator that is switched on is ready at once.

    The core runs at the speed that the firmware believes in: there is no wall clock.
    """

    CR, PLLCFGR, CFGR, AHB1ENR, AHB1LPENR, BDCR, CSR = 0x00, 0x04, 0x08, 0x30, 0x50, 0x70, 0x74
    _ON_BITS = 1 << 0 | 1 << 16 | 1 << 24 | 1 << 26  # HSI, HSE, PLL, PLLI2S: the ready flag is the next bit
    _RESET_FLAGS, _WATCHDOG_RESET, _SOFTWARE_RESET, _PIN_RESET = 0xFE00_0000, 1 << 29, 1 << 28, 1 << 26
    RESET_VALUES: ClassVar[dict[int, int]] = dict.fromkeys(range(0x00, 0x90, 4), 0)
    RESET_VALUES |= {CR: 0x83, PLLCFGR: 0x2400_3010, AHB1ENR: 0x10_0000, AHB1LPENR: 0x7E67_91FF, CSR: 0x0C00_0000}

    def __init__(self) -> None:
        super().__init__("RCC", self.RESET_VALUES)

    def write(self, offset: int, value: int) -> None:
        if offset == self.CR:
            value = value & ~(self._ON_BITS << 1) | (value & self._ON_BITS) << 1
        elif offset == self.CFGR:
            value = value & ~0xC | (value & 3) << 2  # SWS follows SW
        elif offset == self.BDCR:
            value = value & ~2 | (value & 1) << 1
        elif offset == self.CSR:
            kept = 0 if value >> 24 & 1 else self._register[self.CSR] & self._RESET_FLAGS  # RMVF
            value = kept | (value & 1) * 3
        super().write(offset, value)

    def record_reset(self, flags_before: int, *, by_watchdog: bool) -> None:
        """Add the cause of a reset to ``flags_before``, CSR before it. Only the firmware clears these flags."""
        cause = self._WATCHDOG_RESET if by_watchdog else self._SOFTWARE_RESET
        self._register[self.CSR] = flags_before & self._RESET_FLAGS | self._PIN_RESET | cause


class Watchdog(Peripheral):
    """The independent watchdog (chapter 21). Once started, only a reset stops it.

    ``has_expired``: the firmware did not reload it in time, and the machine has to be reset.
    """

    KR, PR, RLR, SR = 0x00, 0x04, 0x08, 0x0C
    _START, _RELOAD, _UNLOCK = 0xCCCC, 0xAAAA, 0x5555
    _CLOCK_HZ = 32_000  # of the low-speed oscillator, which is only this exact here

    def __init__(self, core_hz: int) -> None:
        self._core_hz = core_hz
        super().__init__("IWDG", {self.KR: 0, self.PR: 0, self.RLR: 0xFFF, self.SR: 0})

    def reset(self) -> None:
        super().reset()
        self.is_running = self.has_expired = self._unlocked = False
        self._elapsed_cycles = 0

    def timeout_s(self) -> float:
        """Return after which time without a reload the watchdog resets the machine."""
        return (self._register[self.RLR] + 1) * 4 * (1 << min(self._register[self.PR] & 7, 6)) / self._CLOCK_HZ

    def advance(self, cycles: int) -> None:
        if self.is_running:
            self._elapsed_cycles += cycles
            self.has_expired = self._elapsed_cycles >= self.timeout_s() * self._core_hz

    def write(self, offset: int, value: int) -> None:
        if offset == self.KR:
            self._unlocked = value == self._UNLOCK
            if value in (self._START, self._RELOAD):
                self._elapsed_cycles = 0
                self.is_running = self.is_running or value == self._START
        elif self._unlocked:
            super().write(offset, value)


class Timer(Peripheral):
    """A timer (chapters 17 to 20) that counts the core's clock divided by ``divider`` in 16 or 32 bits (``width``).

    It only counts up, and its ``irq`` is that of the update. The channels are connected to nothing.
    """

    CR1, SMCR, DIER, SR, EGR, CNT, PSC, ARR = 0x00, 0x08, 0x0C, 0x10, 0x14, 0x24, 0x28, 0x2C
    _ENABLED, _UPDATE, _SLAVE_MODE = 1, 1, 7

    def __init__(self, name: str, width: int, divider: int) -> None:
        self._mask = (1 << width) - 1
        self._divider = divider
        super().__init__(name, dict.fromkeys(range(0x00, 0x54, 4), 0) | {self.ARR: self._mask})

    def reset(self) -> None:
        super().reset()
        self._rest = 0  # cycles since the counter last moved

    def advance(self, cycles: int) -> None:
        register = self._register
        if register[self.CR1] & self._ENABLED:
            clocks, self._rest = divmod(self._rest + cycles, self._divider * (register[self.PSC] + 1))
            turns, register[self.CNT] = divmod(register[self.CNT] + clocks, register[self.ARR] + 1)
            if turns:
                register[self.SR] |= self._UPDATE
                self._drive_line()

    def read(self, offset: int) -> int:
        if offset == self.CNT:
            self.advance(READ_CYCLES)
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == self.SMCR and value & self._SLAVE_MODE:
            raise MachineError(f"{self.name}: slave modes, such as that of an encoder, are not modelled")
        if offset == self.SR:
            value &= self._register[self.SR]  # a flag is cleared by writing 0
        elif offset == self.EGR:
            if value & self._UPDATE:
                self._register[self.CNT] = self._rest = 0
                self._register[self.SR] |= self._UPDATE
            value = 0
        elif offset in (self.CNT, self.ARR):
            value &= self._mask
        super().write(offset, value)
        self._drive_line()

    def _drive_line(self) -> None:
        self.irq(bool(self._register[self.SR] & self._register[self.DIER] & self._UPDATE))


class Usart(Peripheral):
    """One serial line (chapter 30), by interrupts: bytes without bit times.

    Received bytes wait until the firmware takes them, so none is overrun. Bytes of the firmware leave at once; ``sent``
    collects them. ``missed`` counts the bytes that arrived while the receiver was off.
    """

    SR, DR, BRR, CR1, CR2, CR3, GTPR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18
    _RXNE, _TC, _TXE, _IDLE = 1 << 5, 1 << 6, 1 << 7, 1 << 4  # flags in SR; in CR1 the enables of their interrupts
    _ENABLED, _RECEIVER, _TRANSMITTER = 1 << 13, 1 << 2, 1 << 3

    def __init__(self, name: str) -> None:
        self.sent = bytearray()
        self.missed = 0
        super().__init__(name, dict.fromkeys((self.BRR, self.CR1, self.CR2, self.CR3, self.GTPR), 0))

    def reset(self) -> None:
        super().reset()
        self.sent.clear()
        self._status = self._TC | self._TXE
        self._data = 0
        self._received: deque[int] = deque()
        self._idle_seen = False

    def receive(self, data: bytes) -> bool:
        """Let bytes arrive; return False when the receiver is off, and they are lost."""
        if not self._is_on(self._RECEIVER):
            self.missed += len(data)
            return False
        self._received += data
        self._set_status(self._RXNE if data else 0)
        return True

    def read(self, offset: int) -> int:
        if offset == self.SR:
            self._idle_seen = self._status & self._IDLE != 0
            return self._status
        if offset != self.DR:
            return super().read(offset)
        if self._idle_seen:
            self._idle_seen = False
            self._set_status(0, self._IDLE)
        if self._received:
            self._data = self._received.popleft()
            if not self._received:
                self._set_status(self._IDLE, self._RXNE)
        return self._data

    def write(self, offset: int, value: int) -> None:
        if offset == self.DR:
            if self._is_on(self._TRANSMITTER):
                self.sent.append(value & 0xFF)
        elif offset != self.SR:  # whose flags are cleared by reading; TC by 0 would be set again at once
            super().write(offset, value)
            self._set_status(0)

    def _is_on(self, direction: int) -> bool:
        return self._register[self.CR1] & (self._ENABLED | direction) == self._ENABLED | direction

    def _set_status(self, on: int, off: int = 0) -> None:
        self._status = self._status & ~off | on
        control, flags = self._register[self.CR1], self._RXNE | self._TC | self._TXE | self._IDLE
        self.irq(bool(control & self._ENABLED and control & self._status & flags))


class SysTick(Peripheral):
    """The 24-bit timer of the core (ARMv7-M manual, B3.3). ``irq`` is called with True when it reaches zero."""

    CSR, RVR, CVR, CALIB = 0x0, 0x4, 0x8, 0xC
    _ENABLE, _INTERRUPT, _COUNTED = 1, 2, 1 << 16

    def __init__(self) -> None:
        super().__init__("SysTick", dict.fromkeys((self.CSR, self.RVR, self.CVR, self.CALIB), 0))

    def read(self, offset: int) -> int:
        if offset == self.CVR:
            self.advance(READ_CYCLES)
        value = super().read(offset)
        if offset == self.CSR:
            self._register[self.CSR] &= ~self._COUNTED
        return value

    def write(self, offset: int, value: int) -> None:
        if offset == self.CSR:
            value = value & 7 | self._register[self.CSR] & self._COUNTED
        elif offset == self.RVR:
            value &= 0xFF_FFFF
        elif offset == self.CVR:
            value = 0
            self._register[self.CSR] &= ~self._COUNTED
        super().write(offset, value)

    def advance(self, cycles: int) -> None:
        """Count down. However often zero is reached, one exception is pending, as in the core."""
        register, period = self._register, self._register[self.RVR] + 1
        if not register[self.CSR] & self._ENABLE or period == 1:
            return
        left = register[self.CVR] or period
        if cycles < left:
            register[self.CVR] = left - cycles
            return
        register[self.CVR] = -(cycles - left) % period  # zero is reloaded with the next cycle
        register[self.CSR] |= self._COUNTED
        if register[self.CSR] & self._INTERRUPT:
            self.irq(True)


class CycleCounter(Peripheral):
    """CYCCNT of the data watchpoint and trace unit (ARMv7-M manual, C1.8)."""

    CTRL, CYCCNT = 0x0, 0x4

    def __init__(self) -> None:
        super().__init__("the DWT", {self.CTRL: 0, self.CYCCNT: 0})

    def read(self, offset: int) -> int:
        if offset == self.CYCCNT:
            self.advance(READ_CYCLES)
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        super().write(offset, value & 1 if offset == self.CTRL else value)

    def advance(self, cycles: int) -> None:
        if self._register[self.CTRL]:
            super().write(self.CYCCNT, self._register[self.CYCCNT] + cycles)
