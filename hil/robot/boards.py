"""Where a virtual robot's firmware runs: in this process, or on a board of the entry point group ``hil.boards``."""

from collections.abc import Callable
from dataclasses import dataclass

from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.robot.virtual import VirtualRobot, VirtualStm32
from hil.robot.virtual_server import VirtualServer
from hil.wire.link import LinkUrl

HOST = "host"
"""The name of this process."""

_EXTENSIONS = Extensions("hil.boards", (HOST,))


@dataclass(frozen=True)
class Board:
    """A board that runs the firmware in front of the plant, emulated or real. Another package registers its own.

    Attributes:
        open: makes the robot for the link of ``--link``. Raises BadInputError for a link or a mode that the board
            lacks, and for tools that are not here.
        make_server: the class that connects the robot to its end of the link.
        plant_baud: if the link is the line to the board's plant port, its bit rate; None if it is the host's.
    """

    open: Callable[[VirtualRobot, LinkUrl], VirtualStm32]
    make_server: type[VirtualServer] = VirtualServer
    plant_baud: int | None = None


_HERE = Board(lambda made_of, _url: VirtualStm32(made_of))


def find_board(name: str) -> Board:
    """Return the board of ``hil device --target``. Raises BadInputError for one that is unknown or unusable."""
    where = f"--target {name!r}"
    if name == HOST:
        return _HERE
    if name not in _EXTENSIONS:
        raise BadInputError(f"{where}: {_EXTENSIONS.unknown(name, 'there is no such target')}")
    board = _EXTENSIONS.load(name, where)
    if not isinstance(board, Board):
        raise BadInputError(f"{where}: {board!r} is no hil.robot.boards.Board")
    return board
