"""Limits on how fast torques may make a moving robot: of its wheels, of their slip, and of its body. Pure.

A torque that drives something faster is faded near the limit: all of it is left at the beginning of a band, none at
the end. This holds for each wheel, which may spin, and for the body, which all wheels drive together. Torques that
brake or steer are unchanged. The speed that is compared is the one when the command acts: the measured speed plus its
present rate of change times the sum of latency, tick and lag of the measurement. A wheel that rolls gains little in
that time. A wheel without grip accelerates only its own inertia, and is faded tens of rad/s before its limit. It gets
its torque back slowly: commands of the last latency and lag do not show in its measured speed yet, and would make it
spin again.

A coarse encoder makes speeds of wheels that roll look like slip. Slip counts from the size on that the encoder cannot
make (``hil.core.wheel_speed``), and of the change that is to come only so much as is beyond that size.

Motion and slip of the wheels are needed in each tick and are worked out in C (``client/wheel_motion.h``). The torques
that follow from them are worked out here.
"""

import math
from collections.abc import Callable
from itertools import compress, pairwise
from typing import Literal, NamedTuple

from firmware_protocol.built import BuildError
from firmware_protocol.extension import library, wheel
from hil.core.errors import BadInputError
from hil.core.kinematics import body_twist, body_wrench
from hil.core.model import RobotModel
from hil.core.types import DRIVEN, WHEEL_NAMES, Guarded, Limit, State, Wheels
from hil.core.wheel_speed import WheelSpeed

TorqueSpeed = Literal["protection", "limit", "off"]
SLIP_M_S = 0.3
"""How much faster than the floor a rim may be driven, unless a scenario says otherwise."""
BAND = 0.05
"""The law may go beyond the limits of the body by this share, or it could not make up for what it has lost."""
_WHEEL_END = 0.9  # share of the overspeed at which the torque is gone
_SLIP_BEGIN = 0.5  # share of the limit of slip from which the torque is faded
_TURNS_S = 0.25  # how far ahead a turning robot's wheels are looked at
_BACK = 12.0  # sums of latency, tick and lag that pass until a wheel that was let go has all of its torque again
_ALL = 1.0, 1.0, 1.0, 1.0
_LIMITS = Limit.WHEEL_SPEED, Limit.SLIP, Limit.BODY  # in the order in which they are kept
_LIMITS_OF_WHEELS = Limit.WHEEL_SPEED, Limit.SLIP, Limit.WHEEL_SPEED  # of a body without limits of its own
_NEAR = 0.25  # share of the beginning of a band below which nothing is looked at


class BodyLimits(NamedTuple):
    """The largest speed of the robot's centre [m/s], and yaw rate [rad/s]."""

    speed_m_s: float
    yaw_rate_rad_s: float


class SlipBand(NamedTuple):
    """Slip from which torque is faded, and at which it is gone [m/s]; ``blind_m_s`` of slip to come is not seen."""

    begin_m_s: float
    end_m_s: float
    blind_m_s: float


def slip_band(
    slip_m_s: float, wheel_radius_m: float, speed: WheelSpeed, period_s: float, latency_s: float = 0.0
) -> SlipBand:
    """Return the band of a limit of slip at these wheels, measurements a period apart, and this latency of commands."""
    noise_m_s = wheel_radius_m * speed.noise_rad_s
    begin_m_s = max(_SLIP_BEGIN * slip_m_s, noise_m_s)
    steps = (period_s + speed.lag_s + latency_s) / period_s
    of_change_m_s = steps * wheel_radius_m * speed.noise_of_change_rad_s(period_s)
    end_m_s = begin_m_s + (1.0 - _SLIP_BEGIN) * slip_m_s
    return SlipBand(begin_m_s, end_m_s, max(noise_m_s + of_change_m_s - begin_m_s, 0.0))


class _Seen(NamedTuple):
    """Wheel speeds and slip, now and when a command acts [rad/s]; ``ahead`` is the time until then, in measurements."""

    speed: Wheels
    coming: Wheels
    slip: Wheels
    coming_slip: Wheels
    ahead: float


class MotionLimits:
    """The part of a ``Guard`` beyond scaling set points to the limits of a wheel.

    ``body`` are the limits of the body, if any; in SPEED mode they scale the set points. ``slip_m_s`` is how much
    faster than the floor a rim may move (``slip_band``), as far as ``speed`` shows it. ``torque_speed`` is which wheel
    speed torques keep below: one at which the robot's ``protection`` does not stop it, the ``limit`` of the scenario,
    or, with ``off``, none. Raises BadInputError when the host library cannot be loaded.

    Attributes:
        is_near: returns whether ``faded`` has to be called. It takes each tick's measured wheel speeds, their robot
            time [ns], the robot's state as far as known, the latency of a command [s], and the age of the oldest of the
            four speeds at the time of the state [s].
        taken: the limit for which ``faded`` took most torque when it last took some, and how much.
    """

    def __init__(
        self,
        model: RobotModel,
        period_s: float,
        slip_m_s: float = math.inf,
        torque_speed: TorqueSpeed = "protection",
        speed: WheelSpeed = WheelSpeed(),  # noqa: B008 -- immutable
    ) -> None:
        self._model = model
        self._torque_speed = torque_speed
        begin_m_s, end_m_s, _ = slip_band(slip_m_s, model.wheel_radius_m, speed, period_s)
        self._slip_begin, self._slip_end = begin_m_s / model.wheel_radius_m, end_m_s / model.wheel_radius_m
        self._begin(period_s, speed)
        self.taken = DRIVEN
        self._gripped: tuple[float, ...] = _ALL
        self._given: tuple[float, ...] = _ALL  # share of its torque that each wheel may have at most
        self._body: BodyLimits | None = None
        self._between = math.inf, math.inf
        self._set_near()

    def _begin(self, period_s: float, speed: WheelSpeed) -> None:
        try:
            ffi, _ = library()
        except BuildError as error:
            raise BadInputError(str(error)) from error
        moves = wheel.Motion()
        self._motion = ffi.cast("wheel_motion *", moves.address)
        self._motion.wheel_radius_m, self._motion.lever_m = self._model.wheel_radius_m, self._model.lever_m
        self._motion.ahead_s, self._motion.lag_s = period_s + speed.lag_s, speed.lag_s
        self._motion.most_slip_rad_s = self._slip_begin
        tolerated_rad_s = min(self._slip_begin, _SLIP_BEGIN * SLIP_M_S / self._model.wheel_radius_m)
        self._motion.blind_rad_s = speed.noise_rad_s - tolerated_rad_s
        self._motion.blind_rad_s_a_step = speed.noise_of_change_rad_s(period_s)
        self._unpack = ffi.unpack
        self.is_near: Callable[[Wheels, int, State, float, float], bool] = moves.add

    def _seen(self) -> _Seen:
        motion, unpack = self._motion, self._unpack
        return _Seen(
            Wheels(*unpack(motion.speed_rad_s, 4)),
            Wheels(*unpack(motion.coming_rad_s, 4)),
            Wheels(*unpack(motion.slip_rad_s, 4)),
            Wheels(*unpack(motion.coming_slip_rad_s, 4)),
            motion.steps,
        )

    @property
    def acts(self) -> bool:
        """Whether there is any limit to keep in TORQUE mode."""
        return bool(self._motion.still_rad_s < math.inf)

    @property
    def time_ns(self) -> int:
        """The robot's time of the newest measurement [ns]; 0 before any."""
        return int(self._motion.time_ns)

    @property
    def body(self) -> BodyLimits | None:
        return self._body

    @body.setter
    def body(self, limits: BodyLimits | None) -> None:
        self._body = limits
        self._set_near()

    def limit_to(self, accepted_rad_s: float, overspeed_rad_s: float) -> None:
        """Apply two limits of the robot: the largest speed that it accepts, and the speed at which it stops itself.

        Both are infinity if it does not report them.
        """
        begin, end = math.inf, math.inf
        if self._torque_speed != "off":
            begin, end = accepted_rad_s, _WHEEL_END * overspeed_rad_s
        if self._torque_speed == "limit":
            limit = min(self._model.speed_limit_rad_s, accepted_rad_s)
            begin, end = (1.0 - BAND) * limit, limit
        self._between = begin, end
        self._set_near()

    def scaled(self, speed_rad_s: Wheels) -> Wheels:
        """Return set points scaled to the limits of the body; the same object if they are kept."""
        body, model = self._body, self._model
        if body is None:
            return speed_rad_s
        forward, left, yaw_rate = body_twist(speed_rad_s, model.wheel_radius_m, model.lever_m)
        most = max(math.hypot(forward, left) / body.speed_m_s, abs(yaw_rate) / body.yaw_rate_rad_s) / (1.0 + BAND)
        return Wheels(*(one / most for one in speed_rad_s)) if most > 1.0 else speed_rad_s

    def faded(self, torque: Wheels) -> Wheels:
        """Return the torques [N·m] of a command by the newest ``is_near``; the same object if none is to be faded.

        If it is another one, ``taken`` and ``why`` tell of it.
        """
        seen = self._seen()
        given = _times(torque, seen.speed, self._give(torque, seen))
        gripping = self._fade_slip(given, seen) if self._slip_begin < math.inf else given
        left = self._fade_body(gripping, seen.coming)
        if left is not torque:
            steps = tuple(pairwise((torque, given, gripping, left)))
            taken = [sum(abs(a - b) for a, b in zip(*step, strict=True)) for step in steps]
            most = max(range(len(taken)), key=taken.__getitem__)
            limit = _LIMITS[most] if self._body is not None else _LIMITS_OF_WHEELS[most]
            self.taken = Guarded(False, limit, sum(taken)) if taken[most] else DRIVEN
            self._why = seen, [a != b for a, b in zip(*steps[most], strict=True)]
        return left

    def why(self) -> str:
        """Return whose torque ``faded`` took when it last took some, and why, with figures and the key of the limit."""
        (seen, lost), radius_m, limit = self._why, self._model.wheel_radius_m, self.taken.limit
        wheels, acts = ", ".join(name.upper() for name in compress(WHEEL_NAMES, lost)), "when the command acts"
        if limit is Limit.SLIP:
            slip_m_s = radius_m * max(map(abs, compress(seen.coming_slip, lost)))
            begin, end = radius_m * self._slip_begin, radius_m * self._slip_end
            fades = f"it fades from {begin:.2g} m/s to {end:.2g} m/s (limiter.slip_m_s)"
            return f"{wheels}, {slip_m_s:.2g} m/s over the floor {acts}: {fades}"
        if limit is Limit.BODY and self._body is not None:
            forward, left, yaw_rate = body_twist(seen.coming, radius_m, self._model.lever_m)
            now = f"{math.hypot(forward, left):.2g} m/s and {yaw_rate:.2g} rad/s {acts}"
            most_m_s, most_rad_s = self._body
            return f"the body, {now}: its limits are {most_m_s:g} m/s and {most_rad_s:g} rad/s"
        fastest, (begin, end) = max(map(abs, compress(seen.coming, lost))), self._between
        fades = f"it fades from {begin:.3g} rad/s to {end:.3g} rad/s (limiter.torque_speed)"
        return f"{wheels}, {fastest:.3g} rad/s {acts}: {fades}"

    def _give(self, torque: Wheels, seen: _Seen) -> tuple[float, ...]:
        """Return the share of its torque that each wheel gets: it falls at once, and rises slowly."""
        shares = _shares(torque, seen.speed, seen.coming, *self._between)
        given = _risen(shares, self._given, seen.ahead)
        if given != self._given:
            self._given = given
            self._set_near()
        return given

    def _fade_slip(self, torque: Wheels, seen: _Seen) -> Wheels:
        shares = _shares(torque, seen.slip, seen.coming_slip, self._slip_begin, self._slip_end)
        gripped = _risen(shares, self._gripped, seen.ahead)
        if gripped != self._gripped:
            self._gripped = gripped
            self._set_near()
        if gripped == _ALL:
            return torque
        # Either way: a wheel without grip that is braked with all of its torque slips the other way a latency later.
        return Wheels(*(share * one for share, one in zip(gripped, torque, strict=True)))

    def _fade_body(self, torque: Wheels, coming: Wheels) -> Wheels:
        """Fade the part of the force along the robot's motion, and the part of the torque along its turn.

        Wheels that roll are driven by each other: to fade the fastest alone would let the other three drive it on. And
        a robot that turns needs no force to make a wheel faster: it moves along that wheel's direction a little later.
        """
        model = self._model
        forward, left, yaw_rate = body_twist(coming, model.wheel_radius_m, model.lever_m)
        speed = math.hypot(forward, left)
        plane = turn = 1.0 - _share(self._fastest_rad_s(forward, left, yaw_rate), *self._between)
        if (body := self._body) is not None:
            plane = max(plane, 1.0 - _share(speed, body.speed_m_s, (1.0 + BAND) * body.speed_m_s))
            turn = max(turn, 1.0 - _share(abs(yaw_rate), body.yaw_rate_rad_s, (1.0 + BAND) * body.yaw_rate_rad_s))
        if plane == turn == 0.0:
            return torque
        force_x, force_y, yaw_n_m = body_wrench(torque, model.wheel_radius_m, model.lever_m)
        push = plane * max(force_x * forward + force_y * left, 0.0) / (speed * speed) if speed else 0.0
        quarter = model.wheel_radius_m / 4.0
        x, y = quarter * push * forward, quarter * push * left
        yaw = quarter * turn * (yaw_n_m if yaw_n_m * yaw_rate > 0.0 else 0.0) / model.lever_m
        if x == y == yaw == 0.0:
            return torque
        fl, fr, rr, rl = torque
        return Wheels(fl - (x - y - yaw), fr - (x + y + yaw), rr - (x - y + yaw), rl - (x + y - yaw))

    def _fastest_rad_s(self, forward: float, left: float, yaw_rate: float) -> float:
        """Return how fast the fastest wheel rolls at this twist while the robot turns on for ``_TURNS_S``."""
        large, small = abs(forward), abs(left)
        off_rad = abs(math.atan2(small, large) - 0.25 * math.pi)  # from the nearest diagonal, where a wheel is fastest
        along = math.cos(max(off_rad - _TURNS_S * abs(yaw_rate), 0.0))
        push = math.sqrt(2.0) * math.hypot(forward, left) * along
        return (push + self._model.lever_m * abs(yaw_rate)) / self._model.wheel_radius_m

    def _most_rad_s(self) -> float:
        """Return a wheel speed below which no limit of wheels or body can be near."""
        begins = [self._between[0]]
        if self._body is not None:
            model = self._model
            begins.append(min(self._body.speed_m_s, model.lever_m * self._body.yaw_rate_rad_s) / model.wheel_radius_m)
        return _NEAR * min(begins)

    def _set_near(self) -> None:
        motion, most_rad_s = self._motion, self._most_rad_s()
        motion.most_rad_s = most_rad_s
        # Shares that have to rise do so at rest too, but for those of slip, which is not known there.
        motion.still_rad_s = min(most_rad_s, _NEAR * motion.most_slip_rad_s) if self._given == _ALL else -1.0
        motion.is_near = self._given != _ALL or self._gripped != _ALL


def _shares(torque: Wheels, now: Wheels, coming: Wheels, begin: float, end: float) -> tuple[float, ...]:
    """Return the share of each wheel's torque by ``coming``: all of one that does not drive it the way it turns."""
    return tuple(
        _share(math.copysign(will_be, pushes * will_be), begin, end) if pushes * is_at > 0.0 else 1.0
        for pushes, is_at, will_be in zip(torque, now, coming, strict=True)
    )


def _risen(shares: tuple[float, ...], before: tuple[float, ...], ahead: float) -> tuple[float, ...]:
    """Return the new shares: each falls at once, and rises slowly from its value before."""
    more = 1.0 / (_BACK * ahead) if ahead else 0.0
    return tuple(min(share, last + more) for share, last in zip(shares, before, strict=True))


def _times(torque: Wheels, now: Wheels, shares: tuple[float, ...]) -> Wheels:
    """Return torques times shares, but for those that do not drive a wheel the way it turns."""
    if shares == _ALL:
        return torque
    return Wheels(
        *(
            share * pushes if pushes * is_at > 0.0 else pushes
            for share, pushes, is_at in zip(shares, torque, now, strict=True)
        )
    )


def _share(value: float, begin: float, end: float) -> float:
    """Return 1 up to ``begin``, 0 from ``end`` on, and in between what lies on the straight line."""
    if value <= begin:
        return 1.0
    return 0.0 if value >= end else (end - value) / (end - begin)
