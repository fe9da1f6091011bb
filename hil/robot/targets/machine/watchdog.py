"""The independent watchdog (RM0090, chapter 21): once started, only a reset stops it."""

from hil.robot.targets.machine.registers import Peripheral

KR, PR, RLR, SR = 0x00, 0x04, 0x08, 0x0C

_START, _RELOAD, _UNLOCK = 0xCCCC, 0xAAAA, 0x5555
_CLOCK_HZ = 32_000  # of the low-speed oscillator, which is only this exact here


class Watchdog(Peripheral):
    """``has_expired``: the firmware did not reload it in time, and the machine has to be reset."""

    def __init__(self, core_hz: int) -> None:
        super().__init__("IWDG", {KR: 0, PR: 0, RLR: 0xFFF, SR: 0})
        self._core_hz = core_hz
        self._clear()

    def reset(self) -> None:
        super().reset()
        self._clear()

    def _clear(self) -> None:
        self.is_running = False
        self.has_expired = False
        self._unlocked = False
        self._elapsed_cycles = 0

    def timeout_s(self) -> float:
        """Return after which time without a reload the watchdog resets the machine."""
        return (self._register[RLR] + 1) * 4 * (1 << min(self._register[PR] & 7, 6)) / _CLOCK_HZ

    def advance(self, cycles: int) -> None:
        if self.is_running:
            self._elapsed_cycles += cycles
            self.has_expired = self._elapsed_cycles >= self.timeout_s() * self._core_hz

    def write(self, offset: int, value: int) -> None:
        if offset == KR:
            self._unlocked = value == _UNLOCK
            if value in (_START, _RELOAD):
                self._elapsed_cycles = 0
                self.is_running = self.is_running or value == _START
        elif self._unlocked:
            super().write(offset, value)
