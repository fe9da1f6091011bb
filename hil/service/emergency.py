"""An emergency stop, from the order to the robot's confirmation. Pure."""

import math

from firmware_protocol.generated.messages import State as RobotState

_REPEAT_S = 0.3


class EmergencyStop:
    """An e-stop is pending from ``request`` until the robot's feedback confirms it; it cannot be cleared before.

    It is sent for at least 0.3 s, because feedback under way may show an earlier ESTOP.

    Attributes:
        pending: whether the robot has yet to confirm it.
    """

    def __init__(self) -> None:
        self._requested_s = -math.inf
        self._clear_next = False
        self.pending = False

    def request(self, t_s: float) -> None:
        """Order an e-stop; an earlier request to clear it is dropped."""
        self.pending, self._requested_s, self._clear_next = True, t_s, False

    def may_clear(self) -> bool:
        """Return whether it may be cleared now. If not, the request is kept, and ``pop_clear`` returns it later."""
        self._clear_next = self.pending
        return not self.pending

    def drop_clear(self) -> None:
        """Drop a request to clear."""
        self._clear_next = False

    def must_send(self, robot: RobotState, t_s: float) -> bool:
        """Return whether to send it again to a robot whose feedback has this state."""
        if robot is RobotState.ESTOP and t_s >= self._requested_s + _REPEAT_S:
            self.pending = False
        return self.pending

    def pop_clear(self) -> bool:
        """Return True once when a request to clear that came while the e-stop was pending can be carried out."""
        clear, self._clear_next = self._clear_next and not self.pending, False
        return clear
