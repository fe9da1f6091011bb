"""Stopping motors that do not know our states: the ramp down, and the stop that is owed until the wheels rest."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.core.errors import HilError, LinkError
from hil.core.guard import Brake
from hil.core.types import CommandMode, FourWheels, Wheels
from hil.drivers.port import Driver, DriverError, four

REST: FourWheels = (0.0, 0.0, 0.0, 0.0)
REPEAT_NS = 50_000_000
_TIMES_AT_REST = 2  # one may be lost, and wheels at rest may still be under control
_AT_REST_RAD_S = 0.2  # PROTOCOL.md, "States"
_ROLLS_OUT_NS = 1_000_000_000
_LOST_NS = 1_000_000_000


class Terms(NamedTuple):
    """What a session with a maker's motors takes from the scenario.

    ``ramp_s`` is the time in which a stop in mode SPEED goes to rest. In mode TORQUE ``brake`` holds against the
    wheels' speeds, while feedback is younger than ``stale_s``. ``rearm``: the loop arms again a robot that comes back.
    ``advance`` lets so many ticks of 1 ms pass for an emulated robot in this process (lockstep); else None.
    """

    mode: CommandMode
    ramp_s: float
    stale_s: float
    brake: Brake
    counts_per_revolution: int
    allow_motion: bool
    rearm: bool
    advance: Callable[[int], None] | None


class Line(Protocol):
    """The part of ``MotorLine`` that a stop needs."""

    def send(self, frames: Sequence[Frame]) -> None: ...

    def flush(self) -> None: ...


class MotorStop:
    """Sends the stop; times are of the run's clock.

    Attributes:
        is_sent: whether all frames of the newest stop were sent, or nothing was ever armed.
        problem: why the newest stop was not sent whole; None if it was.
    """

    def __init__(self, driver: Driver, terms: Terms, line: Line) -> None:
        self._driver = driver
        self._terms = terms
        self._line = line
        self._ramp: tuple[int, FourWheels] | None = None  # when it began, and from which speeds
        self._owed_since_ns: int | None = None
        self._sent_at_rest = 0
        self._wait_ns = _ROLLS_OUT_NS
        self._is_latched = False
        self._repeat_at_ns = 0
        self.is_sent = True
        self.problem: str | None = None
        self._failing_since_ns: int | None = None

    @property
    def is_ramping(self) -> bool:
        """Whether ``go_on`` still commands."""
        return self._ramp is not None

    @property
    def is_owed(self) -> bool:
        """Whether a stop has begun that still has to be repeated."""
        return self._owed_since_ns is not None

    @property
    def is_needed(self) -> bool:
        """Whether the motors were armed from here, and have not been stopped and seen at rest since."""
        return self.is_owed or not self.is_sent

    def raise_lost(self, now_ns: int) -> None:
        """Raise LinkError if no stop could be sent for a second: the link then has to be reopened."""
        if self._failing_since_ns is not None and now_ns > self._failing_since_ns + _LOST_NS:
            self._failing_since_ns = None
            raise LinkError(f"no stop went out for a second ({self.problem}), and the link was opened anew")

    def armed(self) -> None:
        """Forget the stop that is owed: the motors are armed again."""
        self._ramp = self._owed_since_ns = self.problem = None
        self._is_latched = False
        self.is_sent = False

    def ramp_down(self, now_ns: int, speed_rad_s: FourWheels) -> None:
        """Begin the ramp from these speeds to rest; ``go_on`` commands it."""
        self._ramp = (now_ns, speed_rad_s)

    def go_on(self, now_ns: int) -> bool:
        """Command the next step of the ramp (in mode TORQUE: brake), at its end leave closed loop.

        Return True once the stop was sent whole and the wheels rest, or 1 s after it. Raises LinkError when the link
        is lost.
        """
        if self._ramp is None:
            return self.is_sent and (self._owed_since_ns is None or now_ns > self._owed_since_ns + self._wait_ns)
        begin_ns, speed = self._ramp
        left = 1.0 - (now_ns - begin_ns) * 1e-9 / self._terms.ramp_s
        if self._terms.mode is CommandMode.SPEED and left > 0.0:
            self._line.send(self._driver.command(four(left * one for one in speed), REST, now_ns))
        elif self._terms.mode is CommandMode.TORQUE and not self._is_over(now_ns, begin_ns):
            self._line.send(self._driver.command(REST, self._brake(now_ns), now_ns))
        else:
            self.leave_loop(now_ns)
        return False

    def leave_loop(self, now_ns: int, *, latched: bool = False) -> None:
        """Stop at once, at best effort; with ``latched`` by the e-stop. The stop is owed from now on."""
        self._ramp = None
        self._owed_since_ns = now_ns
        self._wait_ns = _ROLLS_OUT_NS
        self._sent_at_rest = 0
        self._is_latched = latched or self._is_latched
        self._send(now_ns)

    def wait_no_longer_than(self, wait_ns: int) -> None:
        """Limit the time that ``go_on`` waits for the wheels to rest after the newest stop, which stays owed."""
        self._wait_ns = wait_ns

    def clear(self) -> None:
        """Let the next stop be an ordinary one: the e-stop is no longer latched."""
        self._is_latched = False

    def repeat(self, now_ns: int) -> None:
        """Repeat a stop that is owed, every 50 ms, until it was sent whole twice after the wheels were seen at rest.

        The frames may depend on what the controllers report, so that a stop counts only after their report of rest.
        """
        if self._owed_since_ns is None or now_ns < self._repeat_at_ns:
            return
        self._send(now_ns)
        self._sent_at_rest += self._rests_since(self._owed_since_ns) and self.is_sent
        if self._sent_at_rest >= _TIMES_AT_REST:
            self._owed_since_ns = None

    def _is_over(self, now_ns: int, begin_ns: int) -> bool:
        return self._rests_since(begin_ns) or now_ns > begin_ns + _ROLLS_OUT_NS

    def _brake(self, now_ns: int) -> FourWheels:
        """Return torques against the wheels' speeds, zero if the speeds are too old."""
        sample, terms = self._driver.sample, self._terms
        if sample is None or now_ns - sample.stamp_ns > terms.stale_s * 1e9:
            return REST
        command, _ = terms.brake.command(Wheels(*sample.speed_rad_s))
        return command.torque_n_m

    def _rests_since(self, t_ns: int) -> bool:
        """Return whether all wheels were measured at rest after ``t_ns``."""
        sample = self._driver.sample
        if sample is None or sample.stamp_ns <= t_ns:
            return False
        return all(abs(speed) < _AT_REST_RAD_S for speed in sample.speed_rad_s)

    def _send(self, now_ns: int) -> None:
        """Send the stop, each frame even if the one before failed."""
        self._repeat_at_ns = now_ns + REPEAT_NS
        self.is_sent, self.problem = False, None
        interrupt: KeyboardInterrupt | None = None
        frames: Sequence[Frame] = ()
        try:
            frames = self._driver.estop() if self._is_latched else self._driver.disarm()
        except DriverError as error:
            self.problem = str(error)
        steps: list[Callable[[], None]] = [
            *(functools.partial(self._line.send, [frame]) for frame in frames),
            self._line.flush,
        ]
        while steps:
            try:
                steps[0]()
            except HilError as error:
                self.problem = str(error)
            except KeyboardInterrupt as pressed:  # Ctrl-C takes effect once the stop was sent
                interrupt = pressed
                continue
            steps.pop(0)
        self.is_sent = self.problem is None
        if self.is_sent:
            self._failing_since_ns = None
        elif self._failing_since_ns is None:
            self._failing_since_ns = now_ns
        if interrupt is not None:
            raise interrupt
