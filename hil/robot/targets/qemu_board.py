"""The board in QEMU: the same calls as ``HostNode`` has, answered by a process beside this one."""

import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

from firmware_protocol.framing import Deframer, Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import View
from firmware_protocol.stm32_flash import SECTOR_BYTES, flash_image
from hil.core.errors import DeviceError
from hil.robot.targets.onlooker import Onlooker
from hil.robot.targets.plant_line import PlantLine, only_lockstep
from hil.robot.targets.qemu_process import QemuProcess

SILENCE_S = 2.0
"""How long a STEP may stay without any sign of life."""

TAKEN_S = 10.0
"""How long QEMU may take no byte of a line that is full. Busy, it takes a few thousand a second."""

_BOOT_S = 20.0
_POLL_S = 0.05
_CHUNK = 65536


class QemuBoard:
    """A ``hil-emulated`` firmware in QEMU, powered on.

    ``feed`` returns at once. When the firmware has sent something, ``on_output`` is called in a thread of this object,
    and may call ``take_bytes``; what it raises, and that the process ended or fell silent, ``check`` raises. Robot
    time passes by STEP only. ``stored`` is what the core stored in an earlier life (``HostNode.stored``).

    Raises BadInputError when QEMU is not installed, DeviceError when it does not run the firmware.
    """

    def __init__(self, elf: Path, exchange_address: int, context_address: int, stored: bytes | None) -> None:
        self.on_output: Callable[[], None] = _nobody
        self._plant = PlantLine(exchange_address, context_address)
        self._onlooker = Onlooker()
        self._asked, self._said = Deframer(), Deframer()
        self._step_is_open = False
        self._output = bytearray()
        self._lock = threading.Lock()
        self._failure: Exception | None = None
        self._closing = False
        record = flash_image(stored) if stored is not None else b""
        self._process = QemuProcess(elf, record.ljust(2 * SECTOR_BYTES, b"\xff"))
        self._alive_at_s = time.monotonic()
        try:
            for line in (self._process.host, self._process.plant):
                line.settimeout(TAKEN_S)
            self._boot()
        except BaseException:
            self._process.close()
            raise
        self._thread = threading.Thread(target=self._relay, name="qemu", daemon=True)
        self._thread.start()

    def feed(self, data: bytes) -> None:
        """Take bytes of the host's serial line. Raises DeviceError when the process has ended or takes none."""
        if any(frame.id == m.Step.ID for frame in self._asked.feed(data)):
            self._alive_at_s = time.monotonic()
            self._step_is_open = True
        try:
            _send(self._process.host, data)
        except OSError:
            raise self._ended() from None

    def take_bytes(self) -> bytes:
        """Return what the board has sent on its serial line."""
        with self._lock:
            data = bytes(self._output)
            self._output.clear()
        return data

    def receive(self, frame: Frame) -> None:
        """Raise DeviceError: the machine has no CAN controller."""
        raise _no_can()

    def take_frames(self) -> list[Frame]:
        """Raise DeviceError: the machine has no CAN controller."""
        raise _no_can()

    def count_unsent(self, frames: int) -> None:
        """Take note of frames that nobody took; the firmware, like a board's, does not learn of it."""
        self._onlooker.unsent += frames

    def run(self, ticks: int) -> None:
        """Raise DeviceError: robot time comes from STEP."""
        raise only_lockstep()

    def stored(self) -> bytes | None:
        """Return None: QEMU's flash cannot be programmed, and a STORE fails."""
        return None

    def look(self) -> View:
        """Return what is known of the firmware's state."""
        return self._onlooker.view(self._plant.drive, plant_failed=self._plant.has_failed)

    def check(self) -> None:
        """Raise what went wrong: DeviceError when QEMU ended or is stuck, or what ``on_output`` raised."""
        if self._failure is not None:
            raise self._failure
        if self._step_is_open and not self._plant.has_failed and time.monotonic() - self._alive_at_s > SILENCE_S:
            raise DeviceError(f"QEMU has been silent for {SILENCE_S:g} s in the middle of a STEP; start it again")

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        self._closing = True
        self._thread.join()
        self._process.close()

    # In the thread of this object; while the firmware boots, in its maker's

    def _boot(self) -> None:
        """Serve until the firmware has asked its plant what it senses at the start."""
        deadline = time.monotonic() + _BOOT_S
        while self._process.plant not in self._serve():
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"the firmware in QEMU asked nothing of its plant in {_BOOT_S:g} s; expected a hil-emulated build"
                )
        self._process.forget_file()

    def _relay(self) -> None:
        try:
            while not self._closing:
                if self._process.host in self._serve():
                    self.on_output()
        except Exception as error:  # noqa: BLE001 -- check() raises it where it is seen
            self._failure = error

    def _serve(self) -> list[socket.socket]:
        """Wait a little for the firmware to send something, and see to it; return the lines on which it did."""
        readable, _, _ = select.select((self._process.host, self._process.plant), [], [], _POLL_S)
        for line in readable:
            try:
                data = line.recv(_CHUNK)
                if line is self._process.plant:
                    _send(line, self._plant.feed(data))
                else:
                    self._hear(data)
            except OSError:
                data = b""
            if not data:
                raise self._ended()
            self._alive_at_s = time.monotonic()
        return readable

    def _hear(self, data: bytes) -> None:
        for frame in self._said.feed(data):
            self._onlooker.hear(frame)
            if frame.id == m.StepDone.ID:
                self._step_is_open = False
        with self._lock:
            self._output += data

    def _ended(self) -> DeviceError:
        return DeviceError(f"QEMU is gone: {self._process.ending()}")


def _send(line: socket.socket, data: bytes) -> None:
    """Send all, however slowly it is taken. Raises DeviceError when nothing is, OSError when the line has ended."""
    left = memoryview(data)
    try:
        while left:
            left = left[line.send(left) :]
    except TimeoutError:
        raise DeviceError(f"QEMU has taken no byte of a line for {line.gettimeout():g} s; start it again") from None


def _nobody() -> None:
    """Nobody listens yet."""


def _no_can() -> DeviceError:
    return DeviceError("QEMU's netduinoplus2 has no CAN controller; use a serial link, or --target unicorn")
