"""An emergency stop, from the one who asks for it to the robot that confirms it. Pure."""

import math

from firmware_protocol.generated.messages import State as RobotState


class EmergencyStop:
    """Owed to the robot from ``ask`` until its feedback confirms it; only then may it be cleared.

    ``repeat_s`` is for how long it is sent at least: feedback on its way may tell of an ESTOP before this one.

    Attributes:
        owed: whether the robot has not confirmed it yet.
    """

    def __init__(self, repeat_s: float) -> None:
        self._repeat_s = repeat_s
        self._asked_s = -math.inf
        self._clear_next = False
        self.owed = False

    def ask(self, t_s: float) -> None:
        """Be owed from here on; what was to be cleared before is not."""
        self.owed, self._asked_s, self._clear_next = True, t_s, False

    def may_clear(self) -> bool:
        """Whether it may be cleared now; where it may not yet, ``take_clear`` tells when."""
        self._clear_next = self.owed
        return not self.owed

    def keep(self) -> None:
        """Do not clear it, whatever was asked for."""
        self._clear_next = False

    def is_sent(self, robot: RobotState, t_s: float) -> bool:
        """Whether it is still to be sent to a robot that says to be in this state."""
        if self.owed and robot is RobotState.ESTOP and t_s >= self._asked_s + self._repeat_s:
            self.owed = False
        return self.owed

    def take_clear(self) -> bool:
        """Whether it is to be cleared now, as was asked for while it was owed; says so once."""
        clear, self._clear_next = self._clear_next and not self.owed, False
        return clear
