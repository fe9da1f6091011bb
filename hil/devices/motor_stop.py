"""Stopping motors that know no session of ours: the ramp down, and the stop that is owed until the wheels rest."""

import contextlib
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.brake import Brake
from hil.dialects.port import Driver
from hil.errors import HilError
from hil.types import CommandMode, FourWheels, Wheels

REST: FourWheels = (0.0, 0.0, 0.0, 0.0)
_REPEAT_NS = 50_000_000
_AT_REST_RAD_S = 0.2  # PROTOCOL.md, "States"
_ROLLS_OUT_NS = 1_000_000_000


class StopTerms(NamedTuple):
    """``brake`` holds against the wheels' speeds in mode TORQUE, while feedback is younger than ``stale_s``."""

    mode: CommandMode
    ramp_s: float
    stale_s: float
    brake: Brake


class Line(Protocol):
    """The part of a link that a stop needs."""

    def flush(self) -> None: ...


class MotorStop:
    """Sends what stops the motors, by ``send``; times are those of the run's clock.

    Attributes:
        is_told: whether the newest stop went out whole, or nothing was ever armed.
    """

    def __init__(self, driver: Driver, terms: StopTerms, line: Line, send: Callable[[Sequence[Frame]], None]) -> None:
        self._driver = driver
        self._terms = terms
        self._line = line
        self._send = send
        self._ramp: tuple[int, FourWheels] | None = None  # when it began, and from which speeds
        self._owed_since_ns: int | None = None
        self._is_latched = False
        self._tell_again_ns = 0
        self.is_told = True

    def armed(self) -> None:
        """Nothing is owed any more: somebody arms the motors anew."""
        self._ramp = self._owed_since_ns = None
        self._is_latched = False
        self.is_told = False

    def ramp_down(self, now_ns: int, speed_rad_s: FourWheels) -> None:
        """Begin to go from these speeds to rest; ``go_on`` does it."""
        self._ramp = (now_ns, speed_rad_s)

    def go_on(self, now_ns: int) -> bool:
        """Go on with the ramp, in mode TORQUE brake; then leave closed loop. True when the wheels rest, or rolled 1 s.

        Raises LinkError when the link is lost.
        """
        if self._ramp is None:
            return self._owed_since_ns is None or now_ns > self._owed_since_ns + _ROLLS_OUT_NS
        begin_ns, speed = self._ramp
        left = 1.0 - (now_ns - begin_ns) * 1e-9 / self._terms.ramp_s
        if self._terms.mode is CommandMode.SPEED and left > 0.0:
            fl, fr, rr, rl = (left * one for one in speed)
            self._send(self._driver.command((fl, fr, rr, rl), REST, now_ns))
        elif self._terms.mode is CommandMode.TORQUE and not self._is_over(now_ns, begin_ns):
            self._send(self._driver.command(REST, self._brake(now_ns), now_ns))
        else:
            self.leave_loop(now_ns)
        return False

    def leave_loop(self, now_ns: int, *, latched: bool = False) -> None:
        """Stop at once, by the e-stop where that is to be ``latched``, at best effort; it is owed from now on."""
        self._ramp = None
        self._owed_since_ns = now_ns
        self._is_latched = latched or self._is_latched
        self._tell(now_ns)

    def clear(self) -> None:
        """What is latched may be left."""
        self._is_latched = False

    def repeat(self, now_ns: int) -> None:
        """Send again a stop that is owed; it is no more when it went out whole and all wheels were seen at rest."""
        if self._owed_since_ns is None or now_ns < self._tell_again_ns:
            return
        if self.is_told and self._rests_since(self._owed_since_ns):
            self._owed_since_ns = None
        else:
            self._tell(now_ns)

    def _is_over(self, now_ns: int, begin_ns: int) -> bool:
        return self._rests_since(begin_ns) or now_ns > begin_ns + _ROLLS_OUT_NS

    def _brake(self, now_ns: int) -> FourWheels:
        """Return torques against the wheels' speeds; none by a speed that is too old."""
        sample, terms = self._driver.sample, self._terms
        if sample is None or now_ns - sample.stamp_ns > terms.stale_s * 1e9:
            return REST
        command, _ = terms.brake.command(Wheels(*sample.speed_rad_s))
        return command.torque_n_m

    def _rests_since(self, t_ns: int) -> bool:
        """Tell whether all wheels were seen at rest after an instant."""
        sample = self._driver.sample
        if sample is None or sample.stamp_ns <= t_ns:
            return False
        return all(abs(speed) < _AT_REST_RAD_S for speed in sample.speed_rad_s)

    def _tell(self, now_ns: int) -> None:
        """Send the stop, each frame of it whatever became of the one before."""
        frames = self._driver.estop() if self._is_latched else self._driver.disarm()
        done = 0
        for frame in frames:
            with contextlib.suppress(HilError):
                self._send([frame])
                done += 1
        with contextlib.suppress(HilError):
            self._line.flush()
            done += 1
        self.is_told = done == len(frames) + 1
        self._tell_again_ns = now_ns + _REPEAT_NS
