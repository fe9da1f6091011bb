"""What motor controllers of other makers say of themselves, as far as it is not feedback."""

from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.drivers.makers_feedback import MotorFeedback
from hil.drivers.port import Sample
from hil.drivers.unasked import UnaskedMotion
from hil.robot.robot_report import Health


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
        self._unasked = UnaskedMotion()

    def look(self, stop_problem: str | None, sample: Sample | None) -> None:
        """Find out what a person has to know now, by why a stop did not go out, and a sample of who should stand."""
        is_unasked = self._unasked.lasts(sample)
        self.trouble = None
        if stop_problem is not None:
            self.trouble = f"the stop could not be sent: {stop_problem}"
        elif is_unasked:
            self.trouble = "the wheels turn, and not by us: an e-stop stops them"

    @property
    def health(self) -> Health:
        """What they say of the battery and the motors."""
        return self._feedback.health

    def stop_reason(self) -> str:
        """Return why the robot last stopped, in words that follow on "because of"."""
        return f"this: {self.why}" if self.why else "no error that it tells"

    def explains(self, state: State) -> bool:
        """They tell their errors before they are stopped for them."""
        return state is not State.FAULT or self.why is not None

    @property
    def last_reset(self) -> str:
        """Empty: they do not tell."""
        return ""

    @property
    def knows_no_reason(self) -> bool:
        """Whether nothing has stopped them."""
        return False
