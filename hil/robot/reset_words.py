"""Why a robot was reset, in words for a person (PROTOCOL.md, "Resets")."""

from typing import NamedTuple

from firmware_protocol.generated.messages import ResetCause

_WORDS = {
    ResetCause.UNKNOWN: "it does not know why",
    ResetCause.POWER_ON: "its power came on",
    ResetCause.BROWN_OUT: "its supply sank below what the chip works with",
    ResetCause.PIN: "its reset pin was pulled",
    ResetCause.SOFTWARE: "its firmware or a debugger asked for it",
    ResetCause.WATCHDOG: "its watchdog reset it, as the firmware did not go on",
    ResetCause.LOW_POWER: "it was told to sleep",
    ResetCause.PROCESSOR_FAULT: "its processor met a fault",
}
_TROUBLE = (ResetCause.BROWN_OUT, ResetCause.WATCHDOG, ResetCause.LOW_POWER, ResetCause.PROCESSOR_FAULT)

# ARMv7-M architecture reference manual, B3.2.15.
_CFSR = {
    0: "instruction fetched where none may be",
    1: "data access where none may be",
    3: "memory management fault on leaving an exception",
    4: "memory management fault on entering an exception: has the stack overflowed?",
    5: "memory management fault while floating-point registers were saved",
    8: "bus fault on fetching an instruction",
    9: "bus fault on reading or writing",
    10: "bus fault on a write some instructions before",
    11: "bus fault on leaving an exception",
    12: "bus fault on entering an exception: has the stack overflowed?",
    13: "bus fault while floating-point registers were saved",
    16: "undefined instruction",
    17: "instruction set state that the processor does not have",
    18: "wrong return from an exception",
    19: "coprocessor that is off or not there",
    24: "unaligned access",
    25: "division by zero",
}
_MMFAR_HOLDS, _BFAR_HOLDS = 1 << 7, 1 << 15


class ProcessorFault(NamedTuple):
    """The record of the processor fault that reset a robot; all zero when none did."""

    cfsr: int = 0
    hfsr: int = 0
    pc: int = 0
    lr: int = 0
    mmfar: int = 0
    bfar: int = 0

    def describe(self) -> str:
        """Return it in words; an address is one to look up in the ELF file of this build (addr2line)."""
        kinds = [words for bit, words in _CFSR.items() if self.cfsr >> bit & 1]
        where = [f"at {self.pc:#010x}, called from {self.lr:#010x}"] if self.pc or self.lr else []
        where += [f"for address {self.mmfar:#010x}"] if self.cfsr & _MMFAR_HOLDS else []
        where += [f"for address {self.bfar:#010x}"] if self.cfsr & _BFAR_HOLDS else []
        registers = f"(CFSR {self.cfsr:08x}, HFSR {self.hfsr:08x})"
        return " ".join([" and ".join(kinds) or "a fault without a cause in CFSR", *where, registers])


NO_FAULT = ProcessorFault()


def reset_words(cause: ResetCause, fault: ProcessorFault = NO_FAULT) -> str:
    """Return the cause of a reset in words, with the fault where it is one."""
    return _WORDS[cause] + (f": {fault.describe()}" if fault != NO_FAULT else "")


def reset_warning(cause: ResetCause, fault: ProcessorFault) -> str | None:
    """Return the sentence to be said of a robot whose last reset came of trouble; None where it did not."""
    if cause not in _TROUBLE:
        return None
    return f"the robot began anew since its power came on ({cause.name}): {reset_words(cause, fault)}; find out why"
