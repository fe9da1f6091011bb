"""Recovers a robot that was lost or stopped: reopen the link, repeat the handshake, arm again. One step per tick."""

from collections.abc import Callable

from hil.core.errors import HilError, LinkError, RobotStoppedError
from hil.core.ports import Clock
from hil.robot.port import Device
from hil.runtime.loop import Warned
from hil.wire.reopening import BackOff

_GREETING_LIMIT_NS = 2_000_000_000
_ARMING_LIMIT_NS = 4_000_000_000


class Recovery:
    """The steps back to ACTIVE, one per tick, while the loop's time goes on. Nothing is commanded.

    A lost link is closed and reopened after 0.1 s, then after twice as long each time, up to 2 s, by the loop's clock.
    The handshake is repeated, the parameters are compared again, and the robot is armed with a new nonce. When a step
    fails, recovery starts again from the link.

    ``why`` is the error that was raised at scenario time ``lost_s``. ``warned`` is called after each handshake, before
    the robot is armed, and at the end. Without ``arm`` recovery ends with the first feedback after the handshake.
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
        self._step: Callable[[], bool] = self._reopen
        self._last_step = self._arm if arm else self._await_feedback
        device.leave()
        if isinstance(why, LinkError):
            self._back_off()
        else:
            self._step = self._begin

    def advance(self) -> bool:
        """Take the next step if it is due; return whether that was the last: ACTIVE, or without ``arm`` any feedback.

        Raises DeviceError when the robot refuses to arm or is in FAULT or ESTOP, BadInputError for another robot.
        """
        try:
            return self._step()
        except (LinkError, RobotStoppedError) as error:
            self.fail(error)
            return False

    def begin_now(self) -> None:
        """Lockstep: repeat the handshake at once. No time passes until the robot's tick is known.

        It is done after a lost link too: the link that carries STEP still works, or STEP itself would have failed.
        """
        self._step = self._begin
        self.advance()

    def fail(self, error: HilError) -> None:
        self.problem = str(error)
        self._device.leave()
        self._back_off()

    def _back_off(self) -> None:
        self._step = self._reopen
        self._due_ns = self._clock.now_ns() + self._waits.next_ns()

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
            self._warned()  # the cause of its reset is known only now
            return True
        if self._clock.now_ns() > self._due_ns:
            raise RobotStoppedError(self._device.why_not_active())
        return False

    def _await_feedback(self) -> bool:
        if self._device.poll() is not None:
            self._warned()
            return True
        if self._clock.now_ns() > self._due_ns:
            raise RobotStoppedError(self._device.why_not_active())
        return False
