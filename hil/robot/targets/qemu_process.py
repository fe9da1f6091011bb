"""QEMU as a process: its machine netduinoplus2, whose first two serial lines are socket pairs to this process."""

import contextlib
import shutil
import socket
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from firmware_protocol.stm32_flash import PARAMETER_ADDRESS
from hil.core.errors import BadInputError
from hil.plant.process import ChildProcess

QEMU = "qemu-system-arm"
MACHINE = "netduinoplus2"

_SEND_BUFFER = 1 << 14  # bytes: little, so that a line of which nothing is taken is noticed soon
_END_S = 1.0


class QemuProcess:
    """An ELF file in QEMU, with ``parameters`` in the flash sectors that the firmware keeps for them.

    ``host`` and ``plant`` are sockets to USART1 and USART2, which no other process can reach; they end when the process
    does, which never outlives this one. Raises BadInputError when QEMU is not installed, DeviceError when no process
    can be started. A file that QEMU refuses shows in its early end.
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
            # The process has read the file when its machine runs, which is before the firmware says anything.
            self._folder = tempfile.TemporaryDirectory(prefix="hil_qemu_", ignore_cleanup_errors=True)
            resources.enter_context(self._folder)
            flash = Path(self._folder.name) / "parameters.bin"
            flash.write_bytes(parameters)
            with contextlib.ExitStack() as theirs:
                ours, lines = zip(*(socket.socketpair() for _ in range(2)), strict=True)
                self.host, self.plant = (resources.enter_context(line) for line in ours)
                numbers = [theirs.enter_context(line).fileno() for line in lines]
                self._child = ChildProcess("hil.robot.targets.leash", Path(self._folder.name), numbers)
            resources.callback(self._child.close, _END_S)
            for line in ours:
                line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._child.send({"command": _command(program, elf, flash, numbers), "inherited": numbers})
            self._resources = resources.pop_all()

    def forget_file(self) -> None:
        """Remove the file of parameters: call it once the firmware has said something."""
        self._folder.cleanup()

    def ending(self) -> str:
        """Return how the process ended, in words; it is ended if it has not."""
        return self._child.ending() + self._child.last_words()

    def close(self) -> None:
        """End the process, and close what led to it. Closing twice is allowed."""
        self._resources.close()


def _command(program: str, elf: Path, flash: Path, lines: Sequence[int]) -> list[str]:
    serial = []
    for name, descriptor in zip(("host", "plant"), lines, strict=True):
        serial += ["-chardev", f"socket,id={name},fd={descriptor}", "-serial", f"chardev:{name}"]
    loader = f"loader,file={_escaped(flash)},addr={PARAMETER_ADDRESS:#x},force-raw=on"
    quiet = ["-display", "none", "-monitor", "none", "-nodefaults"]
    return [program, "-M", MACHINE, *quiet, *serial, "-kernel", str(elf), "-device", loader]


def _escaped(path: Path) -> str:
    """Return a path as QEMU's options take it: a comma twice."""
    return str(path).replace(",", ",,")
