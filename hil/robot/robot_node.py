"""A firmware in front of its plant, as a virtual robot has it: the host library, or an emulated board."""

from typing import Protocol

from firmware_protocol.host import View
from hil.wire.robot_end import Node


class RobotNode(Node, Protocol):
    """What ``HostNode`` and the boards of ``hil.robot.targets`` have in common."""

    def run(self, ticks: int) -> None:
        """Let so many 1 ms ticks pass."""

    def stored(self) -> bytes | None:
        """Return what the robot keeps across a reset: the newest STORE, or None."""

    def look(self) -> View:
        """Return the firmware's inner state, as far as it is known."""
