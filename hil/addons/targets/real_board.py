"""The virtual robot with a real board in place of the host library: a line to its plant port is all that is here."""

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from firmware_protocol.host import View
from firmware_protocol.plant_port import BAUD, Drive, Sense
from hil.addons.targets.emulated_board import EmulatedBoard
from hil.core.errors import BadInputError, DeviceError
from hil.robot.boards import Board
from hil.robot.faults import RobotFaults
from hil.robot.virtual import VirtualRobot, VirtualStm32
from hil.wire.link import LinkUrl


class BoardOnALine(EmulatedBoard):
    """A board whose plant port arrives as bytes: ``feed`` takes them, ``take_bytes`` gives the plant's answers.

    The board is switched on and reset by hand, and its host's line goes to another process. So its count of ticks has
    nothing to do with the plant's: ``faults.ahead`` is kept at the difference.
    """

    def __init__(self, faults: RobotFaults) -> None:
        super().__init__(faults.exchange_address, faults.context_address)
        self._faults = faults
        self._began = 0  # plant_ticks when the plant was last put to its start
        self._answers = b""

    def begin_anew(self) -> None:
        """Take note that the plant was put to its start; the board was not."""
        self._began = self.plant_ticks
        self._take_time()

    def _exchange_with_plant(self, drive: Drive | None) -> Sense:
        sense = super()._exchange_with_plant(drive)
        self._take_time()
        return sense

    def _take_time(self) -> None:
        if self._drive is not None:
            self._faults.ahead = self._drive.tick + 1 - (self.plant_ticks - self._began)

    def feed(self, data: bytes) -> None:
        """Take bytes that the board has sent to its plant."""
        self._answers += self.feed_plant(data)

    def take_bytes(self) -> bytes:
        """Return the plant's answers."""
        answers, self._answers = self._answers, b""
        return answers

    def receive(self, frame: Frame) -> None:
        """Raise DeviceError: a plant port is a serial line."""
        self.take_frames()

    def take_frames(self) -> list[Frame]:
        """Raise DeviceError: a plant port is a serial line."""
        raise DeviceError("a board's plant port is a serial line, and no bus")

    def look(self) -> View:
        """Return what the newest set points say: ACTIVE while the drives are on, else IDLE."""
        is_on = self._drive is not None and self._drive.enabled
        return super().look()._replace(state=State.ACTIVE if is_on else State.IDLE)

    def stored(self) -> bytes | None:
        """Return None: the board keeps its parameters itself."""
        return None

    def close(self) -> None:
        """Nothing to release."""


class BoardRobot(VirtualStm32):
    """A virtual robot whose firmware runs on a real board. A power cycle puts the plant alone to its start."""

    def __init__(self, made_of: VirtualRobot) -> None:
        self._board: BoardOnALine | None = None
        super().__init__(made_of)
        self.faults.has_switch = False

    def _power_on(self) -> BoardOnALine:
        if self._board is None:
            self._board = BoardOnALine(self.faults)
        else:
            self._board.begin_anew()
        return self._board


def open_board(made_of: VirtualRobot, url: LinkUrl) -> BoardRobot:
    """Make the robot for ``--target board``; ``url`` is the line. Raises BadInputError for a bus or no line at all."""
    if url.wire != "serial":
        raise BadInputError(
            f"--link {url} with --target board: expected the board's second serial line, as serial:/dev/ttyUSB1"
        )
    return BoardRobot(made_of)


BOARD = Board(open_board, plant_baud=BAUD)
