"""An STM32F405's core and memory with registers that only remember, for looking at what drivers write there.

Only serial lines answer: bytes arrive with an interrupt while the firmware sleeps, and leave at once. A millisecond is
so many basic blocks, or the rest of it asleep, unless a test lets time stand still. Unicorn executes the firmware.
"""

import functools
import io
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

FLASH, FLASH_BYTES = 0x0800_0000, 1 << 20
RAM, RAM_BYTES = 0x2000_0000, 128 << 10
PERIPHERALS, PERIPHERAL_BYTES = 0x4000_0000, 0x8_0000
SYSTEM, SYSTEM_BYTES = 0xE000_0000, 0x10_0000
_REGIONS = ((FLASH, FLASH_BYTES), (RAM, RAM_BYTES), (PERIPHERALS, PERIPHERAL_BYTES), (SYSTEM, SYSTEM_BYTES))
GPIO = 0x4002_0000
RCC_CR, RCC_CFGR = 0x4002_3800, 0x4002_3808
USARTS = (0x4001_1000, 0x4000_4400, 0x4000_4800, 0x4000_4C00, 0x4000_5000, 0x4001_1400)
CAN_MCR, CAN_MSR = 0x4000_6400, 0x4000_6404
_RETURN = 0x0800_0000 + (512 << 10)  # where a called function returns to: erased flash
_USART_EMPTY, _RXNE = 0xC0, 0x20  # TXE and TC
_BLOCKS_A_MS = 20_000  # of about 8 cycles each


class Machine:
    """``writes`` are (address, value) of each write to a peripheral, in their order; ``system_writes`` to the core's.

    ``reactions`` are functions of the value written to an address, called at once; ``answers`` give the value read from
    one.
    """

    def __init__(self, elf: Path) -> None:
        parsed = ELFFile(io.BytesIO(elf.read_bytes()))
        segments = [(s["p_paddr"], s.data()) for s in parsed.iter_segments("PT_LOAD") if s["p_filesz"]]
        table = parsed.get_section_by_name(".symtab")
        # Variables within functions carry a number: own.0.
        self.symbols = {s.name.split(".")[0]: s["st_value"] & ~1 for s in table.iter_symbols()}
        self._dwarf = parsed.get_dwarf_info()
        self.writes: list[tuple[int, int]] = []
        self.system_writes: list[tuple[int, int]] = []
        self.least_sp = RAM + RAM_BYTES
        self.time_passes = True
        self.reactions: dict[int, Callable[[int], None]] = {
            RCC_CR: lambda value: self.poke(RCC_CR, value | (value << 1 & (1 << 17 | 1 << 25))),  # on is ready
            RCC_CFGR: lambda value: self.poke(RCC_CFGR, value | (value & 3) << 2),
            CAN_MCR: lambda value: self.poke(CAN_MSR, value & 1),
        }
        self.answers: dict[int, Callable[[], int]] = {}
        for port in range(GPIO, GPIO + 5 * 0x400, 0x400):
            self.reactions[port + 0x18] = functools.partial(self._set_pins, port)
        self._due: list[tuple[Callable[[int], None], int]] = []
        self._blocks = 0
        self._until_ms = 0
        self._uc = uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        for region in _REGIONS:
            uc.mem_map(*region)
        uc.mem_write(FLASH, b"\xff" * FLASH_BYTES)
        for address, data in segments:
            uc.mem_write(address, data)
        self.arrived: dict[int, bytearray] = {base: bytearray() for base in USARTS}
        self.sent: dict[int, bytearray] = {base: bytearray() for base in USARTS}
        for base in USARTS:
            self.reactions[base + 4] = lambda value, base=base: self.sent[base].append(value & 0xFF)
            uc.hook_add(unicorn.UC_HOOK_MEM_READ, self._on_usart_read, base, begin=base, end=base + 7)
        uc.hook_add(unicorn.UC_HOOK_MEM_WRITE, self._on_write, begin=PERIPHERALS, end=PERIPHERALS + PERIPHERAL_BYTES)
        uc.hook_add(unicorn.UC_HOOK_MEM_WRITE, self._on_system_write, begin=SYSTEM, end=SYSTEM + SYSTEM_BYTES)
        uc.hook_add(unicorn.UC_HOOK_MEM_READ, self._on_read, begin=PERIPHERALS, end=PERIPHERALS + PERIPHERAL_BYTES)
        uc.hook_add(unicorn.UC_HOOK_BLOCK, self._on_block)

    def _on_write(self, _uc, _access, address, _size, value, _data) -> None:
        self.writes.append((address, value & 0xFFFF_FFFF))
        if address in self.reactions:
            self._due.append((self.reactions[address], value & 0xFFFF_FFFF))

    def _on_system_write(self, _uc, _access, address, _size, value, _data) -> None:
        self.system_writes.append((address, value))

    def _set_pins(self, port: int, value: int) -> None:
        self.poke(port + 0x14, (self.peek(port + 0x14) & ~(value >> 16) | value) & 0xFFFF)

    def _on_read(self, _uc, _access, address, _size, _value, _data) -> None:
        if address in self.answers:
            self.poke(address, self.answers[address]())

    def _on_usart_read(self, _uc, _access, address, _size, _value, base) -> None:
        waiting = self.arrived[base]
        if address == base:
            self.poke(base, _USART_EMPTY | (_RXNE if waiting else 0))
        elif waiting:
            self.poke(base + 4, waiting.pop(0))

    def _on_block(self, _uc, _address, _size, _data) -> None:
        for react, value in self._due:
            react(value)
        self._due.clear()
        self.least_sp = min(self.least_sp, self._uc.reg_read(arm.UC_ARM_REG_SP))
        if self.time_passes:
            self._pass(1)

    def _pass(self, blocks: int) -> None:
        self._blocks += blocks
        if self._blocks % _BLOCKS_A_MS == 0:
            self.poke(self.symbols["milliseconds"], self.uptime_ms)
            if self.uptime_ms >= self._until_ms:
                self._uc.emu_stop()

    def skip(self, milliseconds: int) -> None:
        """Let so much time pass at once, as when the core stands still."""
        self._blocks += milliseconds * _BLOCKS_A_MS
        self.poke(self.symbols["milliseconds"], self.uptime_ms)

    @property
    def uptime_ms(self) -> int:
        """Milliseconds since the start."""
        return self._blocks // _BLOCKS_A_MS

    def member(self, structure: str, name: str) -> int:
        """Return the offset of a member of a structure, from the debugger's information."""
        for unit in self._dwarf.iter_CUs():
            for die in unit.iter_DIEs():
                named = die.tag == "DW_TAG_typedef" and die.attributes.get("DW_AT_name")
                if named and named.value.decode() == structure:
                    for child in die.get_DIE_from_attribute("DW_AT_type").iter_children():
                        if child.attributes["DW_AT_name"].value.decode() == name:
                            return child.attributes["DW_AT_data_member_location"].value
        raise KeyError(f"{structure}.{name}")

    def save(self) -> tuple:
        """Return the data for ``restore``: memory, registers and written values."""
        memory = [(base, self.read(base, size)) for base, size in _REGIONS]
        return memory, self._uc.context_save(), list(self.writes), self._blocks, self.least_sp

    def restore(self, state: tuple) -> None:
        """Go back to where this machine was."""
        memory, context, writes, self._blocks, self.least_sp = state
        for base, data in memory:
            self.write(base, data)
        self._uc.context_restore(context)
        self.writes = list(writes)
        self.time_passes = True

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

    def boot(self) -> None:
        """Come out of reset and run for 50 ms; most of that goes into the search for parameters in the flash."""
        stack, start = struct.unpack("<II", self.read(FLASH, 8))
        self._uc.reg_write(arm.UC_ARM_REG_SP, stack)
        self._uc.reg_write(arm.UC_ARM_REG_PC, start)
        self.run(50)

    def run(self, milliseconds: int) -> None:
        """Go on for so long."""
        self._until_ms = self.uptime_ms + milliseconds
        while self.uptime_ms < self._until_ms:
            self._to_sleep()
            if self.uptime_ms < self._until_ms and not self._serve_lines():
                self._pass(_BLOCKS_A_MS - self._blocks % _BLOCKS_A_MS)

    def wake(self, times: int) -> None:
        """Wake the sleeping firmware up so many times, without time passing."""
        self.time_passes = False
        for _ in range(times):
            self._to_sleep()
        self.time_passes = True

    def _to_sleep(self) -> None:
        self._uc.emu_start(self._uc.reg_read(arm.UC_ARM_REG_PC) | 1, 0)  # ends with wfi, or when it is time

    def _serve_lines(self) -> bool:
        """Take the interrupts of bytes that arrived; main does nothing between its sleep and letting them in."""
        waiting = [number for number, base in enumerate(USARTS, 1) if self.arrived[base]]
        for number in waiting:
            context = self._uc.context_save()
            self.call(f"usart{number}_interrupt", stack=self._uc.reg_read(arm.UC_ARM_REG_SP) - 112)
            self._uc.context_restore(context)
        return bool(waiting)

    def call(self, name: str, *arguments: int, stack: int = RAM + 4096) -> int:
        """Call a function of the firmware with up to four words and return its result."""
        registers = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)
        for register, argument in zip(registers, arguments, strict=False):
            self._uc.reg_write(register, argument)
        self._uc.reg_write(arm.UC_ARM_REG_SP, stack)
        self._uc.reg_write(arm.UC_ARM_REG_LR, _RETURN | 1)
        until_ms, self._until_ms = self._until_ms, sys.maxsize  # a function is not left in the middle
        self._uc.emu_start(self.symbols[name] | 1, _RETURN, count=1_000_000)
        self._until_ms = until_ms
        assert self._uc.reg_read(arm.UC_ARM_REG_PC) == _RETURN, f"{name} did not return"
        return self._uc.reg_read(arm.UC_ARM_REG_R0)

    def jump(self, name: str, instructions: int = 1000) -> None:
        """Execute from a function that does not return."""
        self._uc.emu_start(self.symbols[name] | 1, 0, count=instructions)
