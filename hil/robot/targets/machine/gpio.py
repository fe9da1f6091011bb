"""General-purpose ports (RM0090, chapter 8): what the pins are set to; nothing is connected to them."""

from hil.robot.targets.machine.registers import Peripheral

MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFRL, AFRH = range(0x00, 0x28, 4)

_RESET_OF = {"GPIOA": {MODER: 0xA800_0000, PUPDR: 0x6400_0000}, "GPIOB": {MODER: 0x0000_0280, PUPDR: 0x0000_0100}}
_OUTPUT = 1


class Gpio(Peripheral):
    """A port of 16 pins. A pin that is an output reads as what is written to it, any other as low."""

    def __init__(self, name: str) -> None:
        super().__init__(name, {**dict.fromkeys(range(0x00, 0x28, 4), 0), **_RESET_OF.get(name, {})})

    def mode(self, pin: int) -> int:
        """Return 0 for an input, 1 an output, 2 an alternate function, 3 analogue."""
        return self._register[MODER] >> 2 * pin & 3

    def read(self, offset: int) -> int:
        if offset == IDR:
            return sum(self._register[ODR] & 1 << pin for pin in range(16) if self.mode(pin) == _OUTPUT)
        return super().read(offset)

    def write(self, offset: int, value: int) -> None:
        if offset == BSRR:  # setting has priority over resetting
            self._register[ODR] = (self._register[ODR] & ~(value >> 16) | value) & 0xFFFF
        else:
            super().write(offset, value)
