"""QEMU as a process: its machine netduinoplus2, whose first two serial lines are connections to this process."""

import contextlib
import shutil
import socket
import tempfile
import threading
import time
from pathlib import Path

from firmware_protocol.stm32_flash import PARAMETER_ADDRESS
from hil.errors import BadInputError, DeviceError
from hil.plant.process import ChildProcess

QEMU = "qemu-system-arm"
MACHINE = "netduinoplus2"

_HOST = "127.0.0.1"
_CONNECTED_S = 20.0
_POLL_S = 0.1
_END_S = 1.0


class QemuProcess:
    """An ELF file in QEMU, with ``parameters`` in the flash sectors that the firmware keeps for them.

    ``host`` and ``plant`` are sockets to USART1 and USART2; they end when the process does, which never outlives this
    one. Raises BadInputError when QEMU is not installed, DeviceError when it does not start.
    """

    def __init__(self, elf: Path, parameters: bytes) -> None:
        program = shutil.which(QEMU)
        if program is None:
            raise BadInputError(
                f"--target qemu needs {QEMU}, which is not installed; on Debian and Ubuntu: apt-get install {QEMU}"
            )
        with contextlib.ExitStack() as resources:
            # The process has read the file when its machine runs, which is before the firmware says anything.
            self._folder = tempfile.TemporaryDirectory(prefix="hil_qemu_", ignore_cleanup_errors=True)
            resources.enter_context(self._folder)
            flash = Path(self._folder.name) / "parameters.bin"
            flash.write_bytes(parameters)
            with contextlib.ExitStack() as doors:
                listeners = [doors.enter_context(socket.create_server((_HOST, 0))) for _ in range(2)]
                self._child = ChildProcess("hil.devices.targets.leash", Path(self._folder.name))
                resources.callback(self._child.close, _END_S)
                ports = [listener.getsockname()[1] for listener in listeners]
                self._child.tell({"command": _command(program, elf, flash, ports)})
                self._ended = threading.Event()
                threading.Thread(target=self._wait_for_end, name="qemu end", daemon=True).start()
                self.host, self.plant = (resources.enter_context(self._accept(listener)) for listener in listeners)
            self._resources = resources.pop_all()

    def forget_file(self) -> None:
        """Remove the file of parameters: call it once the firmware has said something."""
        self._folder.cleanup()

    def kill(self) -> None:
        """End the process at once."""
        self._child.kill()

    def ending(self) -> str:
        """Return how the process ended, in words; it is ended if it has not."""
        return self._child.ending() + self._child.last_words()

    def close(self) -> None:
        """End the process, and close what led to it. Closing twice is allowed."""
        self._resources.close()

    def _wait_for_end(self) -> None:
        self._child.hear()  # it says nothing: this returns when it has ended
        self._ended.set()

    def _accept(self, listener: socket.socket) -> socket.socket:
        listener.settimeout(_POLL_S)
        deadline = time.monotonic() + _CONNECTED_S
        while not self._ended.is_set() and time.monotonic() < deadline:
            with contextlib.suppress(TimeoutError):
                connection, _ = listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.settimeout(None)
                return connection
        if not self._ended.is_set():
            self.kill()
        raise DeviceError(f"QEMU did not start: {self.ending()}")


def _command(program: str, elf: Path, flash: Path, ports: list[int]) -> list[str]:
    lines = []
    for name, port in zip(("host", "plant"), ports, strict=True):
        lines += ["-chardev", f"socket,id={name},host={_HOST},port={port},nodelay=on", "-serial", f"chardev:{name}"]
    loader = f"loader,file={_escaped(flash)},addr={PARAMETER_ADDRESS:#x},force-raw=on"
    quiet = ["-display", "none", "-monitor", "none", "-nodefaults"]
    return [program, "-M", MACHINE, *quiet, *lines, "-kernel", str(elf), "-device", loader]


def _escaped(path: Path) -> str:
    """Return a path as QEMU's options take it: a comma twice."""
    return str(path).replace(",", ",,")
