"""What motor controllers of other makers say of themselves, as far as it is not feedback."""

from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.devices.makers_feedback import MotorFeedback
from hil.devices.robot_report import Health


class MotorsInfo(NamedTuple):
    """What the controllers said of themselves."""

    words: str
    has_power_stage: bool = True

    def describe(self) -> str:
        """Return the same in words."""
        return self.words


class MakersReport:
    """What the controllers tell beside the feedback."""

    def __init__(self, feedback: MotorFeedback) -> None:
        self._feedback = feedback
        self.why: str | None = None  # they stopped, None where nothing but the host did
        self.trouble: str | None = None

    @property
    def health(self) -> Health:
        """What they say of the battery and the motors."""
        return self._feedback.health

    def stop_reason(self) -> str:
        """Return why the robot last stopped."""
        return self.why or "no error that it tells"

    def explains(self, state: State) -> bool:
        """They tell their errors before they are stopped for them."""
        return state is not State.FAULT or self.why is not None

    @property
    def knows_no_reason(self) -> bool:
        """Whether nothing has stopped them."""
        return False
