"""The frames between a driver and a link; the ramp down of motors, and the stop, repeated until the wheels rest."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.addons.motors.makers_feedback import MotorsInfo
from hil.core.errors import BadInputError, HilError, LinkError
from hil.core.guard import Brake
from hil.core.ports import Clock
from hil.core.types import CommandMode, FourWheels, Wheels
from hil.robot.driver import EXTENDED, REMOTE, Driver, DriverError, four
from hil.robot.handshake import RETRY_NS
from hil.robot.link_times import PollAge
from hil.robot.port import WireHash
from hil.wire.conditions import ConditionedLink

_MOST_A_POLL = 5000  # frames; four controllers at 1 kHz send forty in 10 ms
_ASK_NS = 20_000_000  # controllers that only answer count as lost after 250 ms, and some are asked in turn
REST: FourWheels = (0.0, 0.0, 0.0, 0.0)
REPEAT_NS = 50_000_000
_TIMES_AT_REST = 2  # one may be lost, and wheels at rest may still be under control
_AT_REST_RAD_S = 0.2  # PROTOCOL.md, "States"
_ROLLS_OUT_NS = 1_000_000_000
_LOST_NS = 1_000_000_000
_NEW_NS = 2_000_000_000
_MOST_UNUSED = 64  # identifiers and reasons
_MOST_LISTED = 4


class SessionTerms(NamedTuple):
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


class MotorLine:
    """Passes frames between driver and link, and asks the controllers who they are.

    Every call may raise LinkError when the link is lost.

    Attributes:
        link: as given.
        sent, received: number of frames so far.
        hash: of every frame, both directions, in order.
        info: the controllers' identity; None before all have answered. It stays after ``restart``.
    """

    def __init__(self, link: ConditionedLink, driver: Driver, poll_age: PollAge, *, is_lockstep: bool) -> None:
        self.link, self._driver, self._poll_age, self._is_lockstep = link, driver, poll_age, is_lockstep
        self.hash = WireHash()
        self._is_identified = False
        self._ask_again_ns = 0
        self.info: MotorsInfo | None = None
        self.sent = self.received = 0
        # How many frames of an identifier were not used for a reason, and when the newest came.
        self._unused: dict[tuple[int, str], tuple[int, int]] = {}

    def restart(self, now_ns: int) -> None:
        """Ask for the identity again."""
        self._unused.clear()
        self._is_identified = False
        self._ask_again_ns = now_ns

    def identify(self, now_ns: int) -> bool:
        """Return whether the controllers have reported their identity; ask them when that is due.

        Raises BadInputError when it is not the identity from before ``restart``.
        """
        words = self._driver.identity
        if words is None:
            if now_ns >= self._ask_again_ns:
                self._ask_again_ns = now_ns + RETRY_NS
                self.send(self._driver.ask())
            return False
        if self.info is not None and self.info.words != words:
            raise BadInputError(
                f"another robot answers on the link: {words}; the run began with {self.info.words}; plug in the first "
                "one, or start a new run"
            )
        self.info = MotorsInfo(words)
        self._is_identified = True
        return True

    def ask_state(self, now_ns: int) -> None:
        """Ask identified controllers for their state, when that is due: many send only answers."""
        if self._is_identified and now_ns >= self._ask_again_ns:
            self._ask_again_ns = now_ns + _ASK_NS
            self.send(self._driver.ask())

    def send(self, frames: Sequence[Frame]) -> None:
        """Send frames, in order."""
        for frame in frames:
            self.link.send(frame)
            self.hash.sent(frame)
            self.sent += 1

    def take(self, clock: Clock) -> None:
        """Give the driver the frames that have arrived."""
        count = 0
        while (self._is_lockstep or count < _MOST_A_POLL) and (received := self.link.receive(0)) is not None:
            frames, stamp_ns = received
            for frame in frames:
                self.hash.received(frame)
                why = self._driver.feed(frame, stamp_ns)
                if isinstance(why, str):  # an older driver of another package may return anything
                    self._count_unused(frame.id, why, stamp_ns)
            count += len(frames)
        self.received += count
        if not self._is_lockstep:
            self._poll_age.record_poll(clock.now_ns(), everything=count < _MOST_A_POLL)

    def _count_unused(self, number: int, why: str, stamp_ns: int) -> None:
        count = self._unused.get((number, why), (0,))[0]
        if count or len(self._unused) < (_MOST_UNUSED if why else _MOST_UNUSED // 2):
            self._unused[number, why] = (count + 1, stamp_ns)

    def explain(self, missing: str, now_ns: int) -> str:
        """Return ``missing`` (from ``Driver.missing``) with the cause: recent frames that were not used."""
        found: dict[str, dict[str, int]] = {}
        for (number, why), (count, stamp_ns) in self._unused.items():
            if now_ns - stamp_ns <= _NEW_NS:
                found.setdefault(why, {})[_identifier(number)] = count
        others = found.pop("", {})
        if found:
            what, _, _ = missing.partition(";")
            causes = [f"{why} ({sum(ids.values())} of {_listed([*ids])})" for why, ids in found.items()]
            return (
                f"{what}, but frames that do not fit: {_listed(causes)}; correct the controllers' settings, or "
                "device.motors"
            )
        if others:
            return f"{missing}; other identifiers were received: {_listed([*others])}"
        if rejected := {cause: count for cause, count in self.link.rejected().items() if count}:
            words = ", ".join(f"{cause} {count}" for cause, count in rejected.items())
            return f"{missing}; what arrived is no frame ({words})"
        return missing


def _identifier(number: int) -> str:
    bare = number & ~(EXTENDED | REMOTE)
    return f"{bare:#010x}" if number & EXTENDED else f"{bare:#05x}"


def _listed(words: Sequence[str]) -> str:
    rest = len(words) - _MOST_LISTED
    return ", ".join(words[:_MOST_LISTED]) + (f" and {rest} more" if rest > 0 else "")


class MotorStop:
    """Sends the stop; times are of the run's clock.

    Attributes:
        is_sent: whether all frames of the newest stop were sent, or nothing was ever armed.
        is_latched: whether the stop is the e-stop; set it to False to let the next one be an ordinary stop.
        problem: why the newest stop was not sent whole; None if it was.
        wait_ns: how long ``go_on`` waits at most for the wheels to rest after the newest stop.
    """

    def __init__(self, driver: Driver, terms: SessionTerms, line: MotorLine) -> None:
        self._driver, self._terms, self._line = driver, terms, line
        self._ramp: tuple[int, FourWheels] | None = None  # when it began, and from which speeds
        self._pending_since_ns: int | None = None
        self._sent_at_rest = 0
        self._repeat_at_ns = 0
        self._failing_since_ns: int | None = None
        self.wait_ns = _ROLLS_OUT_NS
        self.is_latched = False
        self.is_sent = True
        self.problem: str | None = None

    @property
    def is_ramping(self) -> bool:
        """Whether ``go_on`` still commands."""
        return self._ramp is not None

    @property
    def is_pending(self) -> bool:
        """Whether a stop has begun that still has to be repeated."""
        return self._pending_since_ns is not None

    @property
    def is_needed(self) -> bool:
        """Whether the motors were armed from here, and have not been stopped and seen at rest since."""
        return self.is_pending or not self.is_sent

    def raise_lost(self, now_ns: int) -> None:
        """Raise LinkError if no stop could be sent for a second: the link then has to be reopened."""
        if self._failing_since_ns is not None and now_ns > self._failing_since_ns + _LOST_NS:
            self._failing_since_ns = None
            raise LinkError(f"no stop went out for a second ({self.problem}), and the link was opened anew")

    def armed(self) -> None:
        """Forget the pending stop: the motors are armed again."""
        self._ramp = self._pending_since_ns = self.problem = None
        self.is_latched = False
        self.is_sent = False

    def ramp_down(self, now_ns: int, speed_rad_s: FourWheels) -> None:
        """Begin the ramp from these speeds to rest; ``go_on`` commands it."""
        self._ramp = (now_ns, speed_rad_s)

    def go_on(self, now_ns: int) -> bool:
        """Command the next step of the ramp (in mode TORQUE: brake), at its end leave closed loop.

        Return True once the stop was sent whole and the wheels rest, or 1 s after it. Raises LinkError for a lost link.
        """
        if self._ramp is None:
            return self.is_sent and (self._pending_since_ns is None or now_ns > self._pending_since_ns + self.wait_ns)
        begin_ns, speed = self._ramp
        left = 1.0 - (now_ns - begin_ns) * 1e-9 / self._terms.ramp_s
        if self._terms.mode is CommandMode.SPEED and left > 0.0:
            self._line.send(self._driver.command(four(left * one for one in speed), REST, now_ns))
        elif self._terms.mode is CommandMode.SPEED or self._rests_since(begin_ns) or now_ns > begin_ns + _ROLLS_OUT_NS:
            self.leave_loop(now_ns)
        else:
            self._line.send(self._driver.command(REST, self._brake(now_ns), now_ns))
        return False

    def leave_loop(self, now_ns: int, *, latched: bool = False) -> None:
        """Stop at once, at best effort; with ``latched`` by the e-stop. The stop is pending from now on."""
        self._ramp = None
        self._pending_since_ns = now_ns
        self.wait_ns = _ROLLS_OUT_NS
        self._sent_at_rest = 0
        self.is_latched = latched or self.is_latched
        self._send(now_ns)

    def repeat(self, now_ns: int) -> None:
        """Repeat a pending stop every 50 ms until it was sent whole twice after the wheels were seen at rest.

        A driver may choose the frames by the controllers' reports, so a stop counts only after their report of rest.
        """
        if self._pending_since_ns is None or now_ns < self._repeat_at_ns:
            return
        self._send(now_ns)
        self._sent_at_rest += self._rests_since(self._pending_since_ns) and self.is_sent
        if self._sent_at_rest >= _TIMES_AT_REST:
            self._pending_since_ns = None

    def _brake(self, now_ns: int) -> FourWheels:
        """Return torques against the wheels' speeds, zero if the speeds are too old."""
        sample = self._driver.sample
        if sample is None or now_ns - sample.stamp_ns > self._terms.stale_s * 1e9:
            return REST
        return self._terms.brake.command(Wheels(*sample.speed_rad_s))[0].torque_n_m

    def _rests_since(self, t_ns: int) -> bool:
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
            frames = self._driver.estop() if self.is_latched else self._driver.disarm()
        except DriverError as error:
            self.problem = str(error)
        steps: list[Callable[[], None]] = [
            *(functools.partial(self._line.send, [frame]) for frame in frames),
            self._line.link.flush,
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
