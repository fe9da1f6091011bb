"""What all peripherals have in common: registers by offset, interrupt lines, time."""

from collections.abc import Callable, Iterable, Mapping

IrqLine = Callable[[bool], None]
"""An interrupt line: called with whether it is high."""

WORD = 0xFFFF_FFFF


class MachineError(Exception):
    """The firmware did what this machine cannot do, or what no STM32F405 can; the message says what and where."""


class Peripheral:
    """A block of 32-bit registers that remember what is written to them.

    ``reset`` gives every register by its offset, with its reset value. A peripheral that does more than remember
    overrides ``read`` and ``write``. Raises MachineError for an offset that is not in the table: the firmware relies
    on something that is not modelled.
    """

    def __init__(self, name: str, reset: Mapping[int, int]) -> None:
        self.name = name
        self._reset = dict(reset)
        self._register = dict(reset)

    def read(self, offset: int) -> int:
        """Return the register at ``offset``."""
        try:
            return self._register[offset]
        except KeyError:
            raise self._unknown(offset) from None

    def write(self, offset: int, value: int) -> None:
        """Write the register at ``offset``."""
        if offset not in self._register:
            raise self._unknown(offset)
        self._register[offset] = value & WORD

    def reset(self) -> None:
        """Go back to the reset values."""
        self._register = dict(self._reset)

    def advance(self, cycles: int) -> None:
        """Let so many cycles of the core clock pass."""

    def _unknown(self, offset: int) -> MachineError:
        return MachineError(f"{self.name} has no register at offset {offset:#05x} in this machine")


def not_connected(_high: bool) -> None:
    """An interrupt line that leads nowhere."""


def bits(numbers: Iterable[int]) -> int:
    """Return a word with these bits set.

    >>> hex(bits([0, 4]))
    '0x11'
    """
    return sum(1 << number for number in numbers)
