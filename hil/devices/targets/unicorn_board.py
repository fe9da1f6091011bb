"""The board in Unicorn: an STM32F405 of the package ``machine``, with its plant behind USART2."""

from pathlib import Path
from types import TracebackType
from typing import Self

from firmware_protocol.framing import Deframer, Frame
from firmware_protocol.host import View
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, flash_image
from hil.devices.targets.machine.can import CanFrame
from hil.devices.targets.machine.registers import MachineError
from hil.devices.targets.machine.stm32f405 import CORE_HZ, Stm32f405
from hil.devices.targets.onlooker import Onlooker
from hil.devices.targets.plant_line import PlantLine
from hil.errors import DeviceError

HOST_USART, PLANT_USART = 1, 2
_TICK_CYCLES = CORE_HZ // 1000
_BURST = 64  # bytes of the host's line at a time: less than what the firmware's buffer holds


class UnicornBoard:
    """A ``hil-emulated`` firmware, powered on, in this thread; the same calls as ``HostNode`` has.

    Each call returns when the firmware waits for more. Robot time passes by STEP only; with each tick the chip's own
    clocks move on by a millisecond. ``stored`` is what the core stored in an earlier life (``HostNode.stored``).

    Raises DeviceError, here and in every call, when the firmware crashes or touches what the machine has not.
    """

    def __init__(self, elf: Path, exchange_address: int, context_address: int, stored: bytes | None) -> None:
        kept = ((PARAMETER_ADDRESS, flash_image(stored)),) if stored is not None else ()
        self._elf = elf
        self._passed = 0  # ticks that the chip's clocks have not seen yet
        self._plant = PlantLine(exchange_address, context_address, self._pass_tick)
        self._onlooker = Onlooker()
        self._deframer = Deframer()
        self.machine = Stm32f405(elf, kept)
        try:
            self._settle()
        except DeviceError:
            self.machine.close()
            raise

    def feed(self, data: bytes) -> None:
        """Take bytes of the host's serial line."""
        line = self.machine.usart[HOST_USART]
        for start in range(0, len(data), _BURST):
            line.receive(data[start : start + _BURST])
            self._settle()

    def receive(self, frame: Frame) -> None:
        """Take one CAN frame."""
        self.machine.can.receive(CanFrame(frame.id, frame.payload))
        self._settle()

    def take_bytes(self) -> bytes:
        """Return what the board has sent on its serial line."""
        line = self.machine.usart[HOST_USART]
        data = bytes(line.sent)
        line.sent.clear()
        for frame in self._deframer.feed(data):
            self._onlooker.hear(frame)
        return data

    def take_frames(self) -> list[Frame]:
        """Return what the board has sent on its CAN bus."""
        frames = [Frame(frame.id, frame.data) for frame in self.machine.can.sent]
        self.machine.can.sent.clear()
        for frame in frames:
            self._onlooker.hear(frame)
        return frames

    def look(self) -> View:
        """Return what is known of the firmware's state, as of what was taken from it."""
        return self._onlooker.view(self._plant.drive, plant_failed=self._plant.has_failed)

    def close(self) -> None:
        """Release the machine. Closing twice is allowed."""
        self.machine.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _pass_tick(self) -> None:
        self._passed += 1

    def _settle(self) -> None:
        """Let the firmware run until neither host nor plant has anything for it."""
        machine, line = self.machine, self.machine.usart[PLANT_USART]
        try:
            machine.run()
            while line.sent:
                asked = bytes(line.sent)
                line.sent.clear()
                answer = self._plant.feed(asked)
                if self._passed:
                    machine.advance(self._passed * _TICK_CYCLES)
                    self._passed = 0
                line.receive(answer)
                machine.run()
        except MachineError as error:
            raise DeviceError(f"the emulated board stopped: {error} (firmware {self._elf.name})") from error
