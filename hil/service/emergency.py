"""An emergency stop, from the order to the robot's confirmation. Pure."""

import math

from firmware_protocol.generated.messages import State as RobotState


class EmergencyStop:
    """An e-stop is owed from ``request`` until the robot's feedback confirms it; it cannot be cleared before.

    It is sent for at least ``repeat_s``, because feedback under way may show an earlier ESTOP.

    Attributes:
        owed: whether the robot has yet to confirm it.
    """

    def __init__(self, repeat_s: float) -> None:
        self._repeat_s = repeat_s
        self._requested_s = -math.inf
        self._clear_next = False
        self.owed = False

    def request(self, t_s: float) -> None:
        """Start to owe an e-stop; an earlier request to clear it is dropped."""
        self.owed, self._requested_s, self._clear_next = True, t_s, False

    def may_clear(self) -> bool:
        """Return whether it may be cleared now. If not, the request is kept, and ``pop_clear`` returns it later."""
        self._clear_next = self.owed
        return not self.owed

    def keep(self) -> None:
        """Drop a request to clear."""
        self._clear_next = False

    def is_sent(self, robot: RobotState, t_s: float) -> bool:
        """Return whether to go on sending it to a robot whose feedback has this state."""
        if self.owed and robot is RobotState.ESTOP and t_s >= self._requested_s + self._repeat_s:
            self.owed = False
        return self.owed

    def pop_clear(self) -> bool:
        """Return True once when a request to clear that came while the e-stop was owed can be carried out."""
        clear, self._clear_next = self._clear_next and not self.owed, False
        return clear
