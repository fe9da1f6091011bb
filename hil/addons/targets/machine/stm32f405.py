"""The chip: addresses and interrupt lines of the peripherals (RM0090, tables 1 and 62)."""

import bisect
import struct
from pathlib import Path
from typing import Self

from firmware_protocol.arm_image import read_elf
from hil.addons.targets.machine import flash
from hil.addons.targets.machine.can import Can
from hil.addons.targets.machine.core import Core
from hil.addons.targets.machine.nvic import Nvic
from hil.addons.targets.machine.peripherals import (
    CycleCounter,
    Gpio,
    IrqLine,
    MachineError,
    Peripheral,
    Rcc,
    Timer,
    Usart,
    Watchdog,
)

CORE_HZ = 168_000_000
CAN_HZ = 42_000_000

_RAM = [(0x2000_0000, 0x2_0000), (0x1000_0000, 0x1_0000)]  # SRAM, core-coupled memory
_SCS = 0xE000_E000
_FORCED = 1 << 30  # HFSR: another fault that became a hard one
_USART = {1: (0x4001_1000, 37), 2: (0x4000_4400, 38), 3: (0x4000_4800, 39), 6: (0x4001_1400, 71)}
_TIMER = {  # address, line of the update interrupt, width, divider of the core's clock
    1: (0x4001_0000, 25, 16, 1),
    2: (0x4000_0000, 28, 32, 2),
    3: (0x4000_0400, 29, 16, 2),
    4: (0x4000_0800, 30, 16, 2),
    5: (0x4000_0C00, 50, 32, 2),
    6: (0x4000_1000, 54, 16, 2),
    7: (0x4000_1400, 55, 16, 2),
    8: (0x4001_0400, 44, 16, 1),
}
_CAN, _CAN_TX, _CAN_RX, _CAN_ERROR = 0x4000_6400, 19, (20, 21), 22
_PLAIN = {  # blocks that only remember, with their reset values
    0x4000_7000: ("PWR", {0x0: 0xC000, 0x4: 0x4000}),  # the regulator is always ready
    0x4001_3800: ("SYSCFG", dict.fromkeys(range(0, 0x24, 4), 0)),
    0x4001_3C00: ("EXTI", dict.fromkeys(range(0, 0x18, 4), 0)),
}


class Stm32f405:
    """A chip with the ELF file ``elf`` in its flash, just reset; a context manager.

    ``stored`` are further (address, bytes) of the flash, such as parameters that were stored before. ``run`` executes
    until the firmware waits. The watchdog, or a reset that the firmware requests, restarts it: ``resets`` counts them.

    Raises OSError or ValueError when the file is no ELF for ARM, MachineError when it does not fit into the flash.
    """

    def __init__(self, elf: Path, stored: tuple[tuple[int, bytes], ...] = ()) -> None:
        image = read_elf(elf)
        self.flash = flash.FlashMemory()
        for address, data in (*image.segments, *stored):
            self.flash.load(address, data)
        self.nvic = Nvic()
        self.rcc = Rcc()
        self.usart = {n: Usart(f"USART{n}") for n in _USART}
        self.can = Can(CAN_HZ, CORE_HZ)
        self.watchdog = Watchdog(CORE_HZ)
        self.timer = {n: Timer(f"TIM{n}", width, divider) for n, (_, _, width, divider) in _TIMER.items()}
        self.gpio = [Gpio(f"GPIO{letter}") for letter in "ABCDEFGHI"]
        self.resets = 0
        used = {sector for address, data in image.segments for sector in flash.sectors_of(address, len(data))}
        self._flash_interface = flash.FlashInterface(self.flash, used)
        self._peripherals = self._by_address()
        # The base address and the peripheral of each kilobyte; the system control space has four.
        self._blocks = {address >> 10: (address, peripheral) for address, peripheral in self._peripherals.items()}
        self._blocks |= {(_SCS >> 10) + n: (_SCS, self.nvic) for n in range(4)}
        self._connect_interrupts()
        regions = [(sector in used, *flash.region(sector)) for sector in range(len(flash.SECTORS))]
        self._core = Core(
            self.nvic,
            self.read,
            self.write,
            Symbols(elf).where,
            rom=[(start, self.flash.read(start, size)) for is_used, start, size in regions if is_used],
            ram=_RAM,
            mapped=[(start, size) for is_used, start, size in regions if not is_used],
        )
        self._begin()

    def run(self) -> None:
        """Execute until the firmware waits and nothing is due.

        Raises MachineError when it crashes, never waits, or touches what this machine has not.
        """
        self._core.run()
        while self.nvic.reset_requested:
            self._reset(by_watchdog=False)
            self._core.run()

    def advance(self, cycles: int) -> None:
        """Let cycles of the core's clock pass while the core waits; ``run`` then handles due interrupts."""
        for peripheral in self._peripherals.values():
            peripheral.advance(cycles)
        if self.watchdog.has_expired:
            self._reset(by_watchdog=True)

    def hard_fault(self, cfsr: int, *, mmfar: int = 0, bfar: int = 0, stacked: bool = True) -> int:
        """Let the core take a hard fault where it waits, and return that address; ``run`` then executes the handler.

        ``cfsr`` is the cause. A fault that the firmware itself causes ends ``run`` with a MachineError instead.
        """
        self.nvic.record_fault(cfsr, _FORCED, mmfar, bfar)
        return self._core.hard_fault(stacked=stacked)

    def memory(self, address: int, size: int) -> bytes:
        """Return bytes of the memory."""
        return self._core.read(address, size)

    def close(self) -> None:
        """Release the core. Closing twice is allowed."""
        self._core.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The bus

    def read(self, address: int, size: int) -> int:
        """Return what a load instruction gets from a register. Raises MachineError where there is none."""
        if address >> 10 in self._blocks:
            base, block = self._blocks[address >> 10]
            word = block.read(address - base & ~3)
            return word >> 8 * (address & 3) & (1 << 8 * size) - 1
        if flash.BASE <= address < flash.BASE + flash.SIZE:
            return int.from_bytes(self.flash.read(address, size), "little")
        raise MachineError(f"the firmware read {address:#010x}, which this machine does not model")

    def write(self, address: int, size: int, value: int) -> None:
        """Do what a store instruction does to a register. Raises MachineError where there is none."""
        base, block = self._blocks.get(address >> 10, (0, None))
        if block is self.nvic:
            self.nvic.write(address - base, value, size)
        elif flash.BASE <= address < flash.BASE + flash.SIZE:
            self._flash_interface.program(address, size, value)
        elif address & 3:
            raise MachineError(f"the firmware wrote {size} bytes at {address:#010x}; registers are written as words")
        elif block is not None:
            block.write(address - base, value)
        else:
            raise MachineError(f"the firmware wrote {address:#010x}, which this machine does not model")

    # Construction and reset

    def _by_address(self) -> dict[int, Peripheral]:
        return {
            0x4000_3000: self.watchdog,
            _CAN: self.can,
            0x4002_3800: self.rcc,
            0x4002_3C00: self._flash_interface,
            0xE000_1000: CycleCounter(),
            _SCS: self.nvic,
            **{address: Peripheral(*name_and_values) for address, name_and_values in _PLAIN.items()},
            **{address: self.usart[n] for n, (address, _) in _USART.items()},
            **{row[0]: self.timer[n] for n, row in _TIMER.items()},
            **{0x4002_0000 + 0x400 * n: port for n, port in enumerate(self.gpio)},
        }

    def _connect_interrupts(self) -> None:
        for n, (_, irq) in _USART.items():
            self.usart[n].irq = self._line(irq)
        for n, (_, irq, _, _) in _TIMER.items():
            self.timer[n].irq = self._line(irq)
        self.can.irq_tx, self.can.irq_error = self._line(_CAN_TX), self._line(_CAN_ERROR)
        self.can.irq_rx = [self._line(irq) for irq in _CAN_RX]

    def _line(self, irq: int) -> IrqLine:
        return lambda high: self.nvic.line(irq, high)

    def _reset(self, *, by_watchdog: bool) -> None:
        self.resets += 1
        flags = self.rcc.read(Rcc.CSR)
        for peripheral in self._peripherals.values():
            peripheral.reset()
        self.rcc.record_reset(flags, by_watchdog=by_watchdog)
        self._begin()

    def _begin(self) -> None:
        stack_pointer, entry = (int.from_bytes(self.flash.read(flash.BASE + at, 4), "little") for at in (0, 4))
        self._core.reset(stack_pointer, entry)


_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION = struct.Struct("<10I")
_SYMBOL = struct.Struct("<IIIBBH")
_SYMBOL_TABLE, _FUNCTION = 2, 2


class Symbols:
    """The functions of a 32-bit little-endian ELF file; a stripped one has none."""

    def __init__(self, path: Path) -> None:
        elf = path.read_bytes()
        head = _HEADER.unpack_from(elf)
        sections = [_SECTION.unpack_from(elf, head[6] + i * _SECTION.size) for i in range(head[12])]
        functions = []
        for _, kind, _, _, offset, size, names, _, _, _ in sections:
            if kind != _SYMBOL_TABLE:
                continue
            names_at = sections[names][4]
            for name_at, value, _, info, _, _ in _SYMBOL.iter_unpack(elf[offset : offset + size]):
                start = names_at + name_at
                if info & 0xF == _FUNCTION:
                    name = elf[start : elf.index(b"\0", start)].decode("ascii", "replace")
                    functions.append((value & ~1, name))  # bit 0 says Thumb
        self._functions = sorted(functions)

    def where(self, address: int) -> str:
        """Return an address with the function that it is in, as far as known: ``0x08000123 (main + 0x12)``."""
        at = bisect.bisect_right(self._functions, address, key=lambda row: row[0]) - 1
        if at < 0:
            return f"{address:#010x}"
        start, name = self._functions[at]
        return f"{address:#010x} ({name} + {address - start:#x})"
