"""The virtual robot with an emulated board instead of the host library: its firmware, its emulator, its server."""

import importlib.util
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from firmware_protocol.arm_build import TARGETS as FIRMWARES
from firmware_protocol.arm_build import build
from firmware_protocol.built import BuildError
from firmware_protocol.host import stored_parameters
from firmware_protocol.stm32_flash import HIL_BOARD
from hil.core.errors import BadInputError, nearest
from hil.robot.targets.qemu_board import QemuBoard
from hil.robot.virtual import RobotNode, VirtualRobot, VirtualStm32
from hil.robot.virtual_server import TruthSink, VirtualServer
from hil.wire.link import LinkUrl
from hil.wire.robot_end import Wire

TARGETS: Mapping[str, str] = {
    "host": "the firmware as a library of this machine",
    "qemu": "the firmware as an ARM binary in QEMU, over a serial line, in lockstep",
    "unicorn": "the firmware as an ARM binary in Unicorn, over a serial line or CAN, in lockstep",
}
"""What ``hil device --target`` takes, with what it is."""


class Board(RobotNode, Protocol):
    """An emulated board that is powered on."""

    def close(self) -> None:
        """Power it off. Closing twice is allowed."""


BoardMaker = Callable[[Path, int, int, bytes | None], Board]


class EmulatedStm32(VirtualStm32):
    """A robot on this machine whose firmware is an ARM binary, built for the occasion.

    The board finds its parameters in its flash, as if they had been stored. Raises BadInputError when the emulator or
    the cross compiler is missing, and as ``VirtualStm32`` does.
    """

    def __init__(self, made_of: VirtualRobot, make_board: BoardMaker, link: str) -> None:
        self._make_board = make_board
        self._board: Board | None = None
        self._name, self._elf = _build(link)
        super().__init__(made_of)

    def _power_on(self) -> Board:
        try:
            stored = self._stored or stored_parameters(self._made_of.firmware, HIL_BOARD)
        except (ValueError, BuildError) as error:
            raise BadInputError(f"the virtual robot cannot start: {error}") from error
        faults = self.faults
        # A file only for as long as the board takes it in: a process that is killed later leaves none behind.
        with tempfile.TemporaryDirectory(prefix="hil_firmware_", ignore_cleanup_errors=True) as folder:
            elf = Path(folder) / self._name
            elf.write_bytes(self._elf)
            self._board = self._make_board(elf, faults.exchange_address, faults.context_address, stored)
        return self._board

    def _power_off(self) -> None:
        if self._board is not None:
            self._stored = self._board.stored()  # in the board's flash, over a power cycle
            self._board.close()  # in QEMU it steps the plant by itself
            self._board = None

    def close(self) -> None:
        """Power the board off and free the plant."""
        if self._board is not None:
            self._board.close()
            self._board = None
        super().close()


class QemuServer(VirtualServer):
    """Serves a board in QEMU: what the host sends goes there, and what comes from there, when it comes, to the host."""

    def __init__(self, robot: EmulatedStm32, wire: Wire, truth: TruthSink) -> None:
        super().__init__(robot, wire, truth, lockstep=True)

    def service(self, timeout_ns: int) -> None:
        """Do what is due, waiting at most ``timeout_ns`` for something to come."""
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


def open_target(target: str, made_of: VirtualRobot, url: LinkUrl) -> VirtualStm32:
    """Make the robot for ``--target``.

    Raises BadInputError when there is no such target, when it cannot speak over this link or in this mode, or when
    what it needs is not installed.
    """
    if target not in TARGETS:
        raise BadInputError(f"--target {target!r} is none{nearest(target, TARGETS)}")
    if target == "host":
        return VirtualStm32(made_of)
    if not made_of.lockstep:
        raise BadInputError(f"--target {target} has no real time: its robot time comes from STEP; add --mode lockstep")
    link = "can" if url.is_bus else "serial"
    if target == "qemu":
        if link == "can":
            raise BadInputError("--target qemu has no CAN controller; use --link serial:..., or --target unicorn")
        return EmulatedStm32(made_of, QemuBoard, link)
    if importlib.util.find_spec("unicorn") is None:
        raise BadInputError("--target unicorn needs the package unicorn; run: pip install 'mecanum-hil[targets]'")
    from hil.robot.targets.unicorn_board import UnicornBoard

    return EmulatedStm32(made_of, UnicornBoard, link)


def open_server(robot: VirtualStm32, wire: Wire, truth: TruthSink, *, lockstep: bool) -> VirtualServer:
    """Make what serves a robot of ``open_target`` on its end of a link."""
    if isinstance(robot.node, QemuBoard) and isinstance(robot, EmulatedStm32):
        return QemuServer(robot, wire, truth)
    return VirtualServer(robot, wire, truth, lockstep=lockstep)


def _build(link: str) -> tuple[str, bytes]:
    """Return name and content of the ELF file for an emulated board with this link."""
    firmware = next(f for f in FIRMWARES if f.variant == "hil-emulated" and f.link == link)
    try:
        with tempfile.TemporaryDirectory(prefix="hil_firmware_", ignore_cleanup_errors=True) as folder:
            return f"{firmware.name}.elf", build(firmware, Path(folder)).elf.read_bytes()
    except BuildError as error:
        raise BadInputError(f"the firmware for the emulated target was not built: {error}") from error
