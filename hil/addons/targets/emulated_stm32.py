"""The virtual robot with an emulated board in place of the host library: its firmware, its emulator, its server."""

import functools
import os
import time
from collections.abc import Callable
from pathlib import Path

from platformdirs import user_cache_path

from firmware_protocol.arm_build import TARGETS as FIRMWARES
from firmware_protocol.arm_build import build
from firmware_protocol.built import BuildError
from firmware_protocol.host import stored_parameters
from firmware_protocol.stm32_flash import HIL_BOARD
from hil.addons.targets.emulated_board import EmulatedBoard
from hil.addons.targets.qemu_board import QemuBoard
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.scratch import scratch_folder
from hil.robot.boards import Board
from hil.robot.virtual import VirtualRobot, VirtualStm32
from hil.robot.virtual_server import VirtualServer
from hil.wire.link import LinkUrl

BoardMaker = Callable[[Path, int, int, bytes | None], EmulatedBoard]


class EmulatedStm32(VirtualStm32):
    """A virtual robot whose firmware is an ARM binary that runs in an emulator. The constructor compiles it.

    The parameters are put into the emulated flash before power-on. Raises BadInputError when the emulator or cross
    compiler is missing, and in the cases that ``VirtualStm32`` lists.
    """

    def __init__(self, made_of: VirtualRobot, make_board: BoardMaker, link: str) -> None:
        self._make_board = make_board
        self._board: EmulatedBoard | None = None
        self._name, self._elf = _build(link)
        super().__init__(made_of)

    def _power_on(self) -> EmulatedBoard:
        try:
            stored = self._stored or stored_parameters(self._made_of.firmware, HIL_BOARD)
        except (ValueError, BuildError) as error:
            raise BadInputError(f"the virtual robot cannot start: {error}") from error
        faults = self.faults
        # The file exists only while the board reads it, so a process that is killed later leaves none behind.
        with scratch_folder("firmware") as folder:
            elf = folder / self._name
            elf.write_bytes(self._elf)
            self._board = self._make_board(elf, faults.exchange_address, faults.context_address, stored)
        return self._board

    def _power_off(self) -> None:
        if self._board is not None:
            self._stored = self._board.stored()  # the board's flash survives the power cycle
            self._board.close()  # otherwise QEMU would go on stepping the plant
            self._board = None

    def close(self) -> None:
        """Power the board off and free the plant."""
        self._power_off()
        super().close()


class QemuServer(VirtualServer):
    """Serves a board in QEMU: passes bytes between host and board, in each direction as soon as they come."""

    def service(self, timeout_ns: int) -> None:
        """Do what is due, waiting at most ``timeout_ns`` for bytes of the host."""
        self._handle_requests()
        board = self._robot.node
        assert isinstance(board, QemuBoard)
        board.on_output = self._forward
        if self._wire.receive_into(board, timeout_ns):
            self._received_ns = time.monotonic_ns()
        board.check()
        self._robot.awake()

    def _forward(self) -> None:
        self._publish()
        if not self._robot.faults.is_off:
            self._wire.send_from(self._robot.node)


def _check_mode(target: str, made_of: VirtualRobot) -> None:
    if not made_of.lockstep:
        raise BadInputError(f"--target {target} has no real time: its robot time comes from STEP; add --mode lockstep")


def _open_qemu(made_of: VirtualRobot, url: LinkUrl) -> EmulatedStm32:
    _check_mode("qemu", made_of)
    if url.is_bus:
        raise BadInputError("--target qemu has no CAN controller; use --link serial:..., or --target unicorn")
    return EmulatedStm32(made_of, QemuBoard, "serial")


def _open_unicorn(made_of: VirtualRobot, url: LinkUrl) -> EmulatedStm32:
    _check_mode("unicorn", made_of)
    need("targets", "--target unicorn")
    from hil.addons.targets.unicorn_board import UnicornBoard

    return EmulatedStm32(made_of, UnicornBoard, "can" if url.is_bus else "serial")


QEMU = Board(_open_qemu, QemuServer)
UNICORN = Board(_open_unicorn)


@functools.cache
def _build(link: str) -> tuple[str, bytes]:
    """Return name and content of the ELF file for an emulated board with this link."""
    firmware = next(f for f in FIRMWARES if f.variant == "hil-emulated" and f.link == link)
    try:
        with scratch_folder("firmware") as folder:
            return f"{firmware.name}.elf", build(firmware, Path(folder), _objects()).elf.read_bytes()
    except BuildError as error:
        raise BadInputError(f"the firmware for the emulated target was not built: {error}") from error


def _objects() -> Path | None:
    """Return the user's folder of object files, which makes later starts quicker; None where it cannot be written."""
    folder = user_cache_path("mecanum-hil") / "stm32f4"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None
