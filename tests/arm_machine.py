"""An STM32F405's core and memory with registers that only remember, for looking at what drivers write there.

Nothing answers: no interrupt comes, and time passes where a test says so. Unicorn executes the linked firmware.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

FLASH, FLASH_BYTES = 0x0800_0000, 1 << 20
RAM, RAM_BYTES = 0x2000_0000, 128 << 10
PERIPHERALS, PERIPHERAL_BYTES = 0x4000_0000, 0x8_0000
SYSTEM, SYSTEM_BYTES = 0xE000_0000, 0x10_0000
RCC_CR, RCC_CFGR = 0x4002_3800, 0x4002_3808
USARTS = (0x4001_1000, 0x4000_4400, 0x4000_4800, 0x4000_4C00, 0x4000_5000, 0x4001_1400)
CAN_MCR, CAN_MSR = 0x4000_6400, 0x4000_6404
_RETURN = 0x0800_0000 + (512 << 10)  # where a called function returns to: erased flash
_USART_EMPTY = 0xC0  # TXE, TC
_BLOCKS_A_MS = 2000


class Machine:
    """``writes`` are (address, value) of each write to a peripheral, in their order."""

    def __init__(self, elf: Path) -> None:
        with elf.open("rb") as file:
            parsed = ELFFile(file)
            segments = [(s["p_paddr"], s.data()) for s in parsed.iter_segments("PT_LOAD") if s["p_filesz"]]
            self.symbols = {s.name: s["st_value"] for s in parsed.get_section_by_name(".symtab").iter_symbols()}
        self.writes: list[tuple[int, int]] = []
        self.least_sp = RAM + RAM_BYTES
        self._blocks = 0
        self._uc = uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        uc.mem_map(FLASH, FLASH_BYTES)
        uc.mem_write(FLASH, b"\xff" * FLASH_BYTES)
        uc.mem_map(RAM, RAM_BYTES)
        uc.mem_map(PERIPHERALS, PERIPHERAL_BYTES)
        uc.mem_map(SYSTEM, SYSTEM_BYTES)
        for address, data in segments:
            uc.mem_write(address, data)
        for base in USARTS:
            self.poke(base, _USART_EMPTY)
        uc.hook_add(unicorn.UC_HOOK_MEM_WRITE, self._on_write, begin=PERIPHERALS, end=PERIPHERALS + PERIPHERAL_BYTES)
        uc.hook_add(unicorn.UC_HOOK_BLOCK, self._on_block)
        self.on_block: Callable[[], None] = lambda: None

    def _on_write(self, _uc, _access, address, _size, value, _data) -> None:
        self.writes.append((address, value))
        if address == RCC_CR:  # each oscillator that is on is ready
            value |= value << 1 & (1 << 17 | 1 << 25)
        elif address == RCC_CFGR:
            value |= (value & 3) << 2
        elif address == CAN_MCR:
            self.poke(CAN_MSR, value & 1)
        else:
            return
        self._later = (address, value)

    _later: tuple[int, int] | None = None

    def _on_block(self, _uc, _address, _size, _data) -> None:
        if self._later is not None:
            self.poke(*self._later)
            self._later = None
        self.least_sp = min(self.least_sp, self._uc.reg_read(arm.UC_ARM_REG_SP))
        self._blocks += 1
        if self._blocks % _BLOCKS_A_MS == 0:
            self.poke(self.symbols["milliseconds"], self._blocks // _BLOCKS_A_MS)
        self.on_block()

    def peek(self, address: int) -> int:
        """Return the 32 bits at an address."""
        return int.from_bytes(self._uc.mem_read(address, 4), "little")

    def poke(self, address: int, value: int) -> None:
        """Write 32 bits to an address."""
        self._uc.mem_write(address, (value & 0xFFFF_FFFF).to_bytes(4, "little"))

    def write(self, address: int, data: bytes) -> None:
        """Write bytes."""
        self._uc.mem_write(address, data)

    def read(self, address: int, length: int) -> bytes:
        """Read bytes."""
        return bytes(self._uc.mem_read(address, length))

    def boot(self, instructions: int) -> None:
        """Come out of reset and execute so many instructions; the chip sleeps and wakes among them."""
        stack, start = struct.unpack("<II", self.read(FLASH, 8))
        self._uc.reg_write(arm.UC_ARM_REG_SP, stack)
        pc, left = start, instructions
        while left > 0:  # a sleeping chip ends the emulation: wake it up
            self._uc.emu_start(pc | 1, 0, count=min(left, 20_000))
            pc = self._uc.reg_read(arm.UC_ARM_REG_PC)
            left -= 20_000

    def call(self, name: str, *arguments: int) -> int:
        """Call a function of the firmware with up to four words and return its result."""
        registers = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)
        for register, argument in zip(registers, arguments, strict=False):
            self._uc.reg_write(register, argument)
        self._uc.reg_write(arm.UC_ARM_REG_SP, RAM + 4096)
        self._uc.reg_write(arm.UC_ARM_REG_LR, _RETURN | 1)
        self._uc.emu_start(self.symbols[name] | 1, _RETURN, count=1_000_000)
        assert self._uc.reg_read(arm.UC_ARM_REG_PC) == _RETURN, f"{name} did not return"
        return self._uc.reg_read(arm.UC_ARM_REG_R0)

    def jump(self, name: str, instructions: int = 1000) -> None:
        """Execute from a function that does not return."""
        self._uc.emu_start(self.symbols[name] | 1, 0, count=instructions)
