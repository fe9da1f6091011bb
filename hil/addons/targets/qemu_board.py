"""The board in QEMU, a process of its own with two serial lines."""

import contextlib
import select
import shutil
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, SECTOR_BYTES, flash_image
from hil.addons.targets.emulated_board import EmulatedBoard
from hil.core.errors import BadInputError, DeviceError
from hil.core.scratch import scratch_folder
from hil.plant.process import ChildProcess

SILENCE_S = 2.0
"""Longest time without a byte from QEMU during a STEP."""

ACCEPT_S = 10.0
"""Longest time in which QEMU takes no byte of a full line. Even when busy it takes a few thousand a second."""

_BOOT_S = 20.0
_POLL_S = 0.05
_CHUNK = 65536


class QemuBoard(EmulatedBoard):
    """A ``hil-emulated`` firmware in QEMU, powered on.

    ``feed`` returns at once. When the firmware has sent something, a thread of this object calls ``on_output``, which
    may call ``take_bytes``; ``check`` raises its exceptions. Robot time passes by STEP only. ``stored`` are the
    parameters that the firmware stored before (``HostNode.stored``).

    Raises BadInputError when QEMU is not installed, DeviceError when it does not run the firmware.
    """

    def __init__(self, elf: Path, exchange_address: int, context_address: int, stored: bytes | None) -> None:
        self.on_output: Callable[[], None] = lambda: None
        super().__init__(exchange_address, context_address)
        self._from_host, self._from_board = HostLine(), HostLine()
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
                line.settimeout(ACCEPT_S)
            self._boot()
        except BaseException:
            self._process.close()
            raise
        self._thread = threading.Thread(target=self._relay, name="qemu", daemon=True)
        self._thread.start()

    def feed(self, data: bytes) -> None:
        """Take bytes of the host's serial line. Raises DeviceError when the process has ended or takes none."""
        if any(frame.id == m.Step.ID for frame in self._from_host.feed(data)):
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
        self.take_frames()

    def take_frames(self) -> list[Frame]:
        """Raise DeviceError: the machine has no CAN controller."""
        raise DeviceError("QEMU's netduinoplus2 has no CAN controller; use a serial link, or --target unicorn")

    def stored(self) -> bytes | None:
        """Return None: QEMU's flash cannot be programmed, so a STORE fails."""
        return None

    def check(self) -> None:
        """Raise DeviceError when QEMU ended or is stuck; raise an exception of ``on_output`` again."""
        if self._failure is not None:
            raise self._failure
        if self._step_is_open and not self.plant_failed and time.monotonic() - self._alive_at_s > SILENCE_S:
            raise DeviceError(f"QEMU has been silent for {SILENCE_S:g} s in the middle of a STEP; start it again")

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        self._closing = True
        self._thread.join()
        self._process.close()

    # In the thread of this object; during the boot in the thread that makes it

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
        """Wait briefly for bytes of the firmware and process them; return the lines on which some came."""
        readable, _, _ = select.select((self._process.host, self._process.plant), [], [], _POLL_S)
        for line in readable:
            try:
                data = line.recv(_CHUNK)
                if line is self._process.plant:
                    _send(line, self.feed_plant(data))
                else:
                    self._receive(data)
            except OSError:
                data = b""
            if not data:
                raise self._ended()
            self._alive_at_s = time.monotonic()
        return readable

    def _receive(self, data: bytes) -> None:
        for frame in self._from_board.feed(data):
            self.observe(frame)
            if frame.id == m.StepDone.ID:
                self._step_is_open = False
        with self._lock:
            self._output += data

    def _ended(self) -> DeviceError:
        return DeviceError(f"QEMU is gone: {self._process.ending()}")


def _send(line: socket.socket, data: bytes) -> None:
    """Send all bytes. Raises DeviceError when QEMU takes none for ``ACCEPT_S``, OSError when the line has ended."""
    left = memoryview(data)
    try:
        while left:
            left = left[line.send(left) :]
    except TimeoutError:
        raise DeviceError(f"QEMU has taken no byte of a line for {line.gettimeout():g} s; start it again") from None


QEMU = "qemu-system-arm"
MACHINE = "netduinoplus2"

_SEND_BUFFER = 1 << 14  # bytes; small, so that a line that QEMU does not read is noticed soon
_END_S = 1.0


class QemuProcess:
    """An ELF file in QEMU, with ``parameters`` in the flash sectors that the firmware reserves for them.

    ``host`` and ``plant`` are sockets to USART1 and USART2, which no other process can reach. QEMU never outlives this
    process. Raises BadInputError when QEMU is not installed, DeviceError when no process can be started. When QEMU
    refuses the file, its process ends early.
    """

    def __init__(self, elf: Path, parameters: bytes) -> None:
        if sys.platform == "win32":
            raise BadInputError("--target qemu needs a POSIX system; use --target unicorn")
        program = shutil.which(QEMU)
        if program is None:
            raise BadInputError(
                f"--target qemu needs {QEMU}, which is not installed; on Debian and Ubuntu: apt-get install {QEMU}"
            )
        with contextlib.ExitStack() as resources:
            folder = resources.enter_context(scratch_folder("qemu"))
            self._flash = flash = folder / "parameters.bin"
            flash.write_bytes(parameters)
            with contextlib.ExitStack() as theirs:
                ours, lines = zip(*(socket.socketpair() for _ in range(2)), strict=True)
                self.host, self.plant = (resources.enter_context(line) for line in ours)
                numbers = [theirs.enter_context(line).fileno() for line in lines]
                self._child = ChildProcess("hil.addons.targets.deadman", folder, numbers)
            resources.callback(self._child.close, _END_S)
            for line in ours:
                line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._child.send({"command": _command(program, elf, flash, numbers), "inherited": numbers})
            self._resources = resources.pop_all()

    def forget_file(self) -> None:
        """Remove the file of parameters. QEMU has read it when the firmware sends its first byte."""
        self._flash.unlink(missing_ok=True)

    def ending(self) -> str:
        """End the process if it still runs, and return a description of how it ended."""
        return self._child.ending()

    def close(self) -> None:
        """End the process and close its lines. Closing twice is allowed."""
        self._resources.close()


def _command(program: str, elf: Path, flash: Path, lines: Sequence[int]) -> list[str]:
    serial = []
    for name, descriptor in zip(("host", "plant"), lines, strict=True):
        serial += ["-chardev", f"socket,id={name},fd={descriptor}", "-serial", f"chardev:{name}"]
    file = str(flash).replace(",", ",,")  # as QEMU's options take a comma
    loader = f"loader,file={file},addr={PARAMETER_ADDRESS:#x},force-raw=on"
    quiet = ["-display", "none", "-monitor", "none", "-nodefaults"]
    return [program, "-M", MACHINE, *quiet, *serial, "-kernel", str(elf), "-device", loader]
