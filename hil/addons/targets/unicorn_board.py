"""The board in Unicorn: an STM32F405 of the package ``machine``, with its plant behind USART2."""

from pathlib import Path

from firmware_protocol.framing import Frame
from firmware_protocol.host import View, stored_size
from firmware_protocol.host_line import HostLine
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, SECTOR_BYTES, flash_image, newest_stored
from hil.addons.targets.emulated_board import EmulatedBoard
from hil.addons.targets.machine.can import CanFrame
from hil.addons.targets.machine.peripherals import MachineError
from hil.addons.targets.machine.stm32f405 import CORE_HZ, Stm32f405
from hil.core.errors import DeviceError

HOST_USART, PLANT_USART = 1, 2
_TICK_CYCLES = CORE_HZ // 1000
_BURST = 64  # bytes of the host's line at a time: less than what the firmware's buffer holds


class UnicornBoard(EmulatedBoard):
    """A ``hil-emulated`` firmware, powered on, that runs in the caller's thread.

    Each call returns when the firmware waits for more. Robot time passes by STEP only; with each tick the chip's own
    clocks advance by a millisecond. ``stored`` are parameters that the firmware stored before (``HostNode.stored``).

    Raises DeviceError, here and in every call, when the firmware crashes or uses something that the machine lacks.
    """

    def __init__(self, elf: Path, exchange_address: int, context_address: int, stored: bytes | None) -> None:
        kept = ((PARAMETER_ADDRESS, flash_image(stored)),) if stored is not None else ()
        self._elf = elf
        super().__init__(exchange_address, context_address)
        self._line = HostLine()
        self._bytes = bytearray()
        self._frames: list[Frame] = []
        self.machine = Stm32f405(elf, kept)
        try:
            self._settle()
        except BaseException:
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
        data = bytes(self._bytes)
        self._bytes.clear()
        return data

    def take_frames(self) -> list[Frame]:
        """Return what the board has sent on its CAN bus."""
        frames, self._frames = self._frames, []
        return frames

    def stored(self) -> bytes | None:
        """Return the newest record of parameters in the flash, which survives a reset, or None."""
        return newest_stored(self.machine.flash.read(PARAMETER_ADDRESS, 2 * SECTOR_BYTES), stored_size())

    def look(self) -> View:
        """Return what is known of the firmware's state.

        ``rejected`` also has ``missed``: bytes and CAN frames that came while the chip's receiver was off, as after a
        reset, or its FIFO was full.
        """
        view = super().look()
        lines = (self.machine.can, self.machine.usart[HOST_USART], self.machine.usart[PLANT_USART])
        return view._replace(rejected=view.rejected | {"missed": sum(line.missed for line in lines)})

    def close(self) -> None:
        """Release the machine. Closing twice is allowed."""
        self.machine.close()

    def _settle(self) -> None:
        """Let the firmware run until neither host nor plant has anything for it; take what it has sent to its host."""
        machine, line = self.machine, self.machine.usart[PLANT_USART]
        try:
            machine.run()
            while line.sent:
                request = bytes(line.sent)
                line.sent.clear()
                before = self.plant_ticks
                answer = self.feed_plant(request)
                machine.advance((self.plant_ticks - before) * _TICK_CYCLES)
                line.receive(answer)
                machine.run()
        except MachineError as error:
            raise DeviceError(f"the emulated board stopped: {error} (firmware {self._elf.name})") from error
        data = bytes(machine.usart[HOST_USART].sent)
        machine.usart[HOST_USART].sent.clear()
        frames = [Frame(frame.id, frame.data) for frame in machine.can.sent]
        machine.can.sent.clear()
        self._bytes += data
        self._frames += frames
        for frame in (*self._line.feed(data), *frames):
            self.observe(frame)
