"""The Cortex-M4 itself: Unicorn executes instructions; this takes and leaves exceptions, which Unicorn does not.

An interrupt is taken before the next register access, after an instruction that unmasks it, at WFI, and when a handler
returns: always at the same instruction for the same input. (A stop inside a register access makes Unicorn execute that
instruction again from its beginning, so an access is either not begun or done once.)
"""

import re
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import unicorn
from unicorn import arm_const as arm

from hil.addons.targets.machine.nvic import HARD_FAULT, Nvic
from hil.addons.targets.machine.peripherals import MachineError

RUNAWAY_S = 5.0
"""For how long the firmware may run without waiting; wall-clock time, as it only ends what would never end."""

_PERIPHERALS = ((0x4000_0000, 0x8_0000), (0xE000_0000, 0x10_0000))
_NOWHERE = 0xFFFF_FFF0  # an end that execution never reaches: it ends by WFI or by a stop
_THUMB = 1
_XPSR_THUMB = 1 << 24
_RETURN_TO_HANDLER, _RETURN_TO_THREAD = 0xFFFF_FFE1, 0xFFFF_FFE9  # main stack, with floating-point context
_FRAME_BYTES = 26 * 4
_FRAME = (  # what an exception stacks, lowest address first; the floating-point registers follow
    *(arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3, arm.UC_ARM_REG_R12),
    *(arm.UC_ARM_REG_LR, arm.UC_ARM_REG_PC, arm.UC_ARM_REG_XPSR),
)

# Unicorn's numbers of exceptions are QEMU's EXCP_*.
_EXCEPTION_EXIT = 8
_FAULTS = {1: "an undefined instruction", 2: "SVC", 3: "a prefetch abort", 4: "a data abort", 7: "a breakpoint"}

# What can make an interrupt due without touching a register: cpsie, MSR to PRIMASK, BASEPRI or BASEPRI_MAX.
_UNMASKING = re.compile(rb"(?=([\x62\x63]\xb6|[\x80-\x8f]\xf3[\x10-\x12]\x88))", re.DOTALL)


class Core:
    """A core with memory: ``rom`` by (address, bytes), ``ram`` by (address, size).

    ``read(address, size)`` and ``write(address, size, value)`` access the peripherals and the ``mapped`` regions; they
    raise MachineError where there is nothing. ``where`` names an address for messages. ``reset`` sets the entry point.
    """

    def __init__(
        self,
        nvic: Nvic,
        read: Callable[[int, int], int],
        write: Callable[[int, int, int], None],
        where: Callable[[int], str],
        *,
        rom: list[tuple[int, bytes]],
        ram: list[tuple[int, int]],
        mapped: list[tuple[int, int]],
    ) -> None:
        self._nvic = nvic
        self._read_bus = read
        self._write_bus = write
        self._name_of = where
        self._uc = uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        for address, data in rom:
            uc.mem_map(address, len(data), unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
            uc.mem_write(address, data)
            self._hook_unmasking(address, data)
        for address, size in ram:
            uc.mem_map(address, size)
        for address, size in (*_PERIPHERALS, *mapped):
            uc.mmio_map(address, size, self._read, address, self._write, address)
        uc.hook_add(unicorn.UC_HOOK_INTR, self._on_exception)
        uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, self._on_bad_access)
        self._power_on = uc.context_save()
        self._below: list[Any] = []  # the core's state under each active handler; kept for use again
        self._stopped = False
        self._returned = False
        self._failure: MachineError | None = None
        self._guard = _Guard(uc)

    def reset(self, stack_pointer: int, entry: int) -> None:
        """Begin at ``entry`` in thread mode. Memory keeps its content, as over a reset of the chip."""
        self._uc.context_restore(self._power_on)
        self._uc.reg_write(arm.UC_ARM_REG_SP, stack_pointer)
        self._uc.reg_write(arm.UC_ARM_REG_LR, 0xFFFF_FFFF)
        self._uc.reg_write(arm.UC_ARM_REG_PC, entry | _THUMB)

    def run(self) -> None:
        """Execute until the core waits and nothing is due, or a reset is requested.

        Raises MachineError when the firmware crashes, never waits, or touches what is not there.
        """
        self._guard.begin()
        try:
            while not self._nvic.reset_requested:
                if (due := self._due()) is not None:
                    self._enter(due)
                self._execute()
                if self._returned:
                    self._leave()
                elif not self._stopped and not self._wakes():
                    return
        finally:
            self._guard.end()

    def hard_fault(self, *, stacked: bool) -> int:
        """Take a hard fault where the core waits, and return that address; ``run`` then executes its handler.

        The frame is on the stack as a processor leaves it, unless it could not be ``stacked``.
        """
        frame = struct.pack("<8I", *(self._uc.reg_read(register) for register in _FRAME))
        self._enter(HARD_FAULT)
        if stacked:
            self._uc.mem_write(self._uc.reg_read(arm.UC_ARM_REG_SP), frame)
        return int.from_bytes(frame[24:28], "little")

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of the memory."""
        return bytes(self._uc.mem_read(address, size))

    def close(self) -> None:
        """Stop the guard. Closing twice is allowed."""
        self._guard.close()

    # Exceptions

    def _due(self) -> int | None:
        if not self._nvic.pending:
            return None
        primask = bool(self._uc.reg_read(arm.UC_ARM_REG_PRIMASK))
        return self._nvic.due(primask=primask, basepri=self._uc.reg_read(arm.UC_ARM_REG_BASEPRI))

    def _wakes(self) -> bool:
        """Return whether WFI returns at once (B1.5.19): PRIMASK does not keep it from that."""
        return self._nvic.due(basepri=self._uc.reg_read(arm.UC_ARM_REG_BASEPRI)) is not None

    def _enter(self, number: int) -> None:
        """Take an exception (ARMv7-M manual, B1.5.6). The state goes to this object, the stack keeps room for it."""
        uc, depth = self._uc, len(self._nvic.active)
        if depth == len(self._below):
            self._below.append(uc.context_save())
        else:
            uc.context_update(self._below[depth])
        stack_pointer = (uc.reg_read(arm.UC_ARM_REG_SP) - _FRAME_BYTES) & ~7
        vector = int.from_bytes(uc.mem_read(self._nvic.enter(number), 4), "little")
        uc.reg_write(arm.UC_ARM_REG_SP, stack_pointer)
        uc.reg_write(arm.UC_ARM_REG_LR, _RETURN_TO_HANDLER if depth else _RETURN_TO_THREAD)
        uc.reg_write(arm.UC_ARM_REG_XPSR, _XPSR_THUMB | number)
        uc.reg_write(arm.UC_ARM_REG_PC, vector)

    def _leave(self) -> None:
        """Return from an exception (B1.5.8); masks that the handler set stay."""
        uc = self._uc
        self._returned = False
        self._nvic.leave()
        masks = [(register, uc.reg_read(register)) for register in (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI)]
        uc.context_restore(self._below[len(self._nvic.active)])
        for register, value in masks:
            uc.reg_write(register, value)

    def _execute(self) -> None:
        """Execute until WFI, a stop or an exception's end."""
        self._stopped = False
        uc = self._uc
        try:
            uc.emu_start(uc.reg_read(arm.UC_ARM_REG_PC) | _THUMB, _NOWHERE)
        except unicorn.UcError as error:
            self._failure = self._failure or MachineError(f"the firmware crashed: {error}")
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise MachineError(f"{failure}; at {self._where()}")
        if self._guard.has_stopped_it:
            raise MachineError(f"the firmware ran for {RUNAWAY_S:g} s without waiting; it is at {self._where()}")

    def _where(self) -> str:
        return self._name_of(self._uc.reg_read(arm.UC_ARM_REG_PC))

    # What Unicorn calls

    def _read(self, _uc: Any, offset: int, size: int, base: int) -> int:
        if self._nvic.pending and self._gives_way():
            return 0
        try:
            return self._read_bus(base + offset, size)
        except MachineError as error:
            self._fail(error)
            return 0

    def _write(self, _uc: Any, offset: int, size: int, value: int, base: int) -> None:
        if self._nvic.pending and self._gives_way():
            return
        try:
            self._write_bus(base + offset, size, value)
        except MachineError as error:
            self._fail(error)
        if self._nvic.reset_requested:
            self._stop()

    def _after_unmasking(self, _uc: Any, _address: int, _size: int, _data: Any) -> None:
        if self._nvic.pending:
            self._gives_way()

    def _gives_way(self) -> bool:
        """Stop before the instruction in hand if an interrupt is due: it comes first."""
        if self._due() is None:
            return False
        self._stop()
        return True

    def _on_exception(self, _uc: Any, number: int, _data: Any) -> None:
        if number == _EXCEPTION_EXIT:
            self._returned = True
            self._stop()
        else:
            self._fail(MachineError(f"the firmware took {_FAULTS.get(number, f'exception {number}')}"))

    def _on_bad_access(self, _uc: Any, access: int, address: int, size: int, _value: int, _data: Any) -> bool:
        kind = "wrote" if access in (unicorn.UC_MEM_WRITE_UNMAPPED, unicorn.UC_MEM_WRITE_PROT) else "read"
        self._failure = MachineError(f"the firmware {kind} {size} bytes at {address:#010x}, where nothing answers")
        return False

    def _fail(self, error: MachineError) -> None:
        self._failure = error
        self._stop()

    def _stop(self) -> None:
        self._stopped = True
        self._uc.emu_stop()

    def _hook_unmasking(self, base: int, code: bytes) -> None:
        for match in _UNMASKING.finditer(code):
            if match.start() % 2 == 0:
                after = base + match.start() + len(match.group(1))
                self._uc.hook_add(unicorn.UC_HOOK_CODE, self._after_unmasking, None, after, after)


class _Guard:
    """Stops a core that runs for too long: a thread that looks now and then."""

    def __init__(self, uc: Any) -> None:
        self._uc = uc
        self._since: float | None = None
        self.has_stopped_it = False
        self._closing = threading.Event()
        threading.Thread(target=self._watch, name="runaway guard", daemon=True).start()

    def begin(self) -> None:
        self.has_stopped_it = False
        self._since = time.monotonic()

    def end(self) -> None:
        self._since = None

    def close(self) -> None:
        self._closing.set()

    def _watch(self) -> None:
        while not self._closing.wait(RUNAWAY_S / 5):
            since = self._since
            if since is not None and time.monotonic() - since > RUNAWAY_S:
                self.has_stopped_it = True
                self._uc.emu_stop()
