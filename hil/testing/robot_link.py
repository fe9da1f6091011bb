"""A host's end of a robot's link, held by a test: frames in and out, with no controller in between."""

import time
from collections import deque
from typing import TypeVar

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import Message
from hil.core.errors import DeviceError
from hil.testing.robot_process import RobotProcess
from hil.wire.opening import open_host
from hil.wire.url import parse_link

Answer = TypeVar("Answer", bound=Message)


class RobotLink:
    """An open link to a virtual robot. What is sent is a message of wheel.dbc, or any frame made by hand.

    In lockstep the robot's time stands still until it is sent a Step. Raises LinkError when the link cannot be opened.

    Attributes:
        robot: the robot at the other end.
    """

    def __init__(self, robot: RobotProcess) -> None:
        self.robot = robot
        self._link = open_host(parse_link(robot.link))
        self._waiting: deque[Frame] = deque()

    def send(self, what: Message | Frame) -> None:
        """Send a message or a frame.

        Raises ValueError when a message holds what its fields cannot carry, or when the serial framing has no such
        frame (an id or a length that wheel.dbc does not know); LinkError when the link is lost.
        """
        self._link.send(what if isinstance(what, Frame) else codec.encode(what))

    def receive(self, timeout_s: float = 1.0) -> Frame | None:
        """Return the next valid frame, or None after ``timeout_s``. Raises LinkError when the link is lost."""
        if not self._waiting:
            received = self._link.receive(round(timeout_s * 1e9))
            self._waiting.extend(() if received is None else received.frames)
        return self._waiting.popleft() if self._waiting else None

    def ask(self, what: Message | Frame, answer: type[Answer], timeout_s: float = 2.0) -> Answer:
        """Send, and return the first message of the type ``answer`` that comes then; others are passed over.

        Raises DeviceError when there is none within ``timeout_s``, and as ``send``.
        """
        self.send(what)
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self.receive(left_s)
            message = None if frame is None else codec.decode(frame)
            if isinstance(message, answer):
                return message
        raise DeviceError(f"the robot sent no {answer.__name__} within {timeout_s:g} s")

    def rejected(self) -> dict[str, int]:
        """Return how many frames of the robot were dropped on this side so far, by cause."""
        return self._link.rejected()

    def close(self) -> None:
        """Release the link. Closing twice is allowed."""
        self._link.close()
