"""Reset and clock control (RM0090, chapter 7): an oscillator that is switched on is ready at once."""

from hil.robot.targets.machine.registers import Peripheral, bits

CR, PLLCFGR, CFGR, BDCR, CSR = 0x00, 0x04, 0x08, 0x70, 0x74

_RESET = {
    **dict.fromkeys(range(0x00, 0x90, 4), 0),
    CR: 0x0000_0083,
    PLLCFGR: 0x2400_3010,
    CSR: 0x0C00_0000,
    0x30: 0x0010_0000,  # AHB1ENR
    0x50: 0x7E67_91FF,  # AHB1LPENR
}
_READY_FOLLOWS_ON = (0, 16, 24, 26)  # HSI, HSE, PLL, PLLI2S: the ready flag is the next bit
_RESET_FLAGS = 0xFE00_0000
_WATCHDOG_RESET, _SOFTWARE_RESET, _PIN_RESET = 1 << 29, 1 << 28, 1 << 26


class Rcc(Peripheral):
    """Clock tree and reset flags. The core runs at the speed that the firmware believes in: there is no wall clock."""

    def __init__(self) -> None:
        super().__init__("RCC", _RESET)

    def write(self, offset: int, value: int) -> None:
        if offset == CR:
            value &= ~bits(bit + 1 for bit in _READY_FOLLOWS_ON)
            value |= sum((value >> bit & 1) << bit + 1 for bit in _READY_FOLLOWS_ON)
        elif offset == CFGR:
            value = value & ~0xC | (value & 3) << 2  # SWS follows SW
        elif offset == BDCR:
            value = value & ~2 | (value & 1) << 1
        elif offset == CSR:
            kept = 0 if value >> 24 & 1 else self._register[CSR] & _RESET_FLAGS  # RMVF
            value = kept | (value & 1) * 3
        super().write(offset, value)

    def reset(self) -> None:
        flags = self._register[CSR] & _RESET_FLAGS
        super().reset()
        self._register[CSR] = flags

    def record_reset(self, *, by_watchdog: bool) -> None:
        """Record why the machine was reset; the flags stay until the firmware removes them."""
        self._register[CSR] |= _PIN_RESET | (_WATCHDOG_RESET if by_watchdog else _SOFTWARE_RESET)
