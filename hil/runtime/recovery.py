"""Bringing a robot back that was lost or stopped: reopen the link, shake hands, arm anew. One step a tick."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.core.errors import HilError, LinkError, RobotStoppedError
from hil.core.ports import Clock
from hil.robot.port import Device
from hil.wire.reopening import BackOff

_GREETING_LIMIT_NS = 2_000_000_000
_ARMING_LIMIT_NS = 4_000_000_000
# In lockstep time stands still without the robot; by the wall clock this is how long one is waited for.
_STANDSTILL_LIMIT_NS = 60_000_000_000


class Recovered(NamedTuple):
    """A loss that was recovered from: scenario time of the loss and of ACTIVE again [s], and the cause."""

    lost_s: float
    armed_s: float
    why: str


class Warned:
    """Passes on the warnings of a device: each once, and what is new after it came back.

    Warnings in ``said`` were passed on before.
    """

    def __init__(self, device: Device, say: Callable[[str], None], said: Sequence[str] = ()) -> None:
        self._device = device
        self._say = say
        self._said = said

    def __call__(self) -> None:
        """Pass on what is new, after the device has answered."""
        warnings = tuple(self._device.warnings)
        for sentence in warnings:
            if sentence not in self._said:
                self._say(sentence)
        self._said = warnings


class Recovery:
    """The steps back to ACTIVE, one a tick, for a loop whose time goes on meanwhile. Nothing is commanded.

    A lost link is closed and opened, after 0.1 s first and twice as long each time up to 2 s, by the loop's clock. The
    handshake is repeated, the parameters are compared again, and the robot is armed with a new nonce. When a step
    fails, it all begins again from the link.

    ``why`` is what was lost at ``lost_s`` of the scenario's time. ``warned`` is called after each handshake, before
    the robot is armed, and at the end. Without ``arm`` the first feedback after the handshake is the end.
    """

    def __init__(
        self, device: Device, clock: Clock, why: HilError, lost_s: float, warned: Warned, *, arm: bool = True
    ) -> None:
        self._device = device
        self._warned = warned
        self._clock = clock
        self.why = str(why)
        self.lost_s = lost_s
        self.problem = self.why
        self._waits = BackOff()
        self._due_ns = 0
        self._standstill_ns: int | None = None  # wall-clock time since which time stands still
        self._step: Callable[[], bool] = self._reopen
        self._last_step = self._arm if arm else self._hear
        device.leave()
        if isinstance(why, LinkError):
            self._back_off()
        else:
            self._step = self._begin

    def advance(self) -> bool:
        """Take the step that is due; return whether the robot is ACTIVE again, or heard where it is not to arm.

        Raises DeviceError when it refuses to arm or has latched FAULT or ESTOP, BadInputError when it is another robot.
        """
        self._standstill_ns = None
        try:
            return self._step()
        except (LinkError, RobotStoppedError) as error:
            self.fail(error)
            return False

    def begin_now(self) -> None:
        """Lockstep: shake hands at once. No time passes until the robot's tick is known.

        That is so after a lost link too: what carries STEP is still there, or it would have failed itself.
        """
        self._step = self._begin
        self.advance()

    def fail(self, error: HilError) -> None:
        """Begin again from the link."""
        self.problem = str(error)
        self._device.leave()
        self._back_off()

    def revive(self) -> None:
        """Lockstep: bring back, by the wall clock, a robot without which time stands still.

        Raises LinkError when that takes more than 60 s.
        """
        if self._standstill_ns is None:
            self._standstill_ns = time.monotonic_ns()
        while time.monotonic_ns() < self._standstill_ns + _STANDSTILL_LIMIT_NS:
            time.sleep(self._waits.wait_ns * 1e-9)
            try:
                self._device.reopen()
                self._begin()
            except (LinkError, RobotStoppedError) as error:
                self.fail(error)
            else:
                return
        raise LinkError(f"the robot did not come back within 60 s: {self.problem}")

    def _back_off(self) -> None:
        self._step = self._reopen
        self._due_ns = self._clock.now_ns() + self._waits.take_ns()

    def _reopen(self) -> bool:
        if self._clock.now_ns() >= self._due_ns:
            self._device.reopen()
            self._begin()
        return False

    def _begin(self) -> bool:
        self._device.begin_again()
        self._due_ns = self._clock.now_ns() + _GREETING_LIMIT_NS
        self._step = self._greet
        return False

    def _greet(self) -> bool:
        if self._device.greeted():
            self._warned()
            self._due_ns = self._clock.now_ns() + _ARMING_LIMIT_NS
            self._step = self._last_step
        elif self._clock.now_ns() > self._due_ns:
            raise RobotStoppedError("the robot did not answer within 2 s")
        return False

    def _arm(self) -> bool:
        if self._device.armed():
            self._warned()  # by now the cause of its reset is known
            return True
        if self._clock.now_ns() > self._due_ns:
            raise RobotStoppedError(self._device.why_not_active())
        return False

    def _hear(self) -> bool:
        if self._device.poll() is not None:
            self._warned()
            return True
        if self._clock.now_ns() > self._due_ns:
            raise RobotStoppedError(self._device.why_not_active())
        return False
