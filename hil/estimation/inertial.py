"""How far the robot came: by its wheels while they roll, by gyro and accelerometer while they slip."""

import math
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from hil.estimation.wheel_motion import Motion

_Velocity = tuple[float, float]

# Wheels are believed at times longer than this, the accelerometer at shorter ones. Counts are noisy below it.
_CROSSOVER_S = 0.1
# The accelerometer must differ from rolling wheels for this time until the difference is its bias.
_BIAS_S = 2.0
# Wheels slip for this time before slip is reported.
_REACH_S = 0.1
# Standard deviation of the inertial velocity at the beginning of slip, and its growth. It grows by the rest of the
# accelerometer's bias (as on a floor that leans by 0.6 degrees).
_BEGIN_M_S = 0.02
_GROWS_M_S2 = 0.1
# Wheels still slip while their speed is more than this number of deviations from the inertial one.
_APART = 3.0


class Travel(NamedTuple):
    """A motion with the displacement to believe, whether it is the wheels', and the deviation of its velocity."""

    motion: Motion
    is_rolled: bool
    sigma_m_s: float


class _Past(NamedTuple):
    """A motion with its turn by the gyro, and the velocity and the accelerometer's bias before it."""

    motion: Motion
    turned_rad: float
    velocity: _Velocity
    bias_m_s2: _Velocity


class Inertial:
    """Velocity in the body frame: by the wheels while they roll, by gyro and accelerometer while they slip.

    Over a motion of dt, with the wheels' mean velocity w, the accelerometer's a with its bias b, and the turn φ by the
    gyro (φ × v is (-φ left, φ forward)):

        u = v + (a - b) dt - φ × v            the velocity by the inertial sensors
        v = u                                 while the wheels slip
        v = w + κ (u - w)                     while they roll, κ = exp(-dt / 0.1 s),
        b = b + (v - w) dt / (0.1 s · 2 s)    so that what differs for longer than 2 s is the bias

    Slip is reported about 0.1 s after it began, and until then the wheels spoilt v. So the last 0.1 s are done again,
    from the v and b before them. Without gyro or accelerometer only the wheels are used.

    Wheels that spin at a constant speed contradict no acceleration sensor. So slip that is no longer reported goes on
    until the wheels' mean speed over 0.1 s is within three deviations of v. The deviation grows, so it ends.

    An accelerometer that is suddenly wrong, or a ramp, contradicts wheels that roll. If fixes refute the slip, the
    wheels are believed until it is no longer reported, and meanwhile the difference is learnt as the bias.

    Attributes:
        velocity: forward and left [m/s], mean over the newest motion.
        bias_m_s2: how much the accelerometer measures too much, forward and left [m/s²].
        is_inertial: whether the newest motion is the inertial sensors'.
    """

    def __init__(self) -> None:
        self.bias_m_s2: _Velocity = (0.0, 0.0)
        self.restart((0.0, 0.0))

    def restart(self, velocity: _Velocity) -> None:
        """Start again with this velocity; the bias stays."""
        self.velocity = velocity
        self.is_inertial = False
        self._is_refuted = False
        self._slipped_s = 0.0
        self._apart_m_s: _Velocity = (0.0, 0.0)
        self._recent: deque[_Past] = deque()
        self._recent_s = 0.0

    def update(self, motion: Motion, bias_rad_s: float, slip_m_s: float) -> list[Travel]:
        """Return the travel of a motion; if slip was just reported, first those of the last 0.1 s again.

        ``bias_rad_s`` is the gyro's, and ``slip_m_s`` the speed of the slip, 0 without slip.
        """
        past = _Past(motion, motion.gyro_rad - bias_rad_s * motion.dt_s, self.velocity, self.bias_m_s2)
        if math.isnan(past.turned_rad + motion.gained_forward_m_s + motion.gained_left_m_s):
            self.restart(_towards(self.velocity, _by_wheels(motion), motion.dt_s))
            return [Travel(motion, is_rolled=True, sigma_m_s=slip_m_s)]
        slips = slip_m_s > 0.0 or (self.is_inertial and math.hypot(*self._apart_m_s) > _APART * self._sigma_m_s)
        self._is_refuted = self._is_refuted and slips
        if slips and not self._is_refuted:
            return self._slipping(past)
        self.is_inertial, self._slipped_s, self._apart_m_s = False, 0.0, (0.0, 0.0)
        self.velocity = _towards(self._advanced(past), _by_wheels(motion), motion.dt_s)
        self._learn_bias(motion)
        self._remember(past)
        return [Travel(motion, is_rolled=True, sigma_m_s=slip_m_s)]

    def refute(self) -> None:
        """Believe the wheels until slip is no longer reported: fixes agree that the inertial sensors are wrong."""
        self._is_refuted = True

    @property
    def _sigma_m_s(self) -> float:
        return _BEGIN_M_S + _GROWS_M_S2 * self._slipped_s

    def _learn_bias(self, motion: Motion) -> None:
        (forward, left), (bias_forward, bias_left) = self.velocity, self.bias_m_s2
        rate = 1.0 / (_CROSSOVER_S * _BIAS_S)
        self.bias_m_s2 = (
            bias_forward + rate * (forward * motion.dt_s - motion.forward_m),
            bias_left + rate * (left * motion.dt_s - motion.left_m),
        )

    def _remember(self, past: _Past) -> None:
        self._recent.append(past)
        self._recent_s += past.motion.dt_s
        while self._recent_s - self._recent[0].motion.dt_s >= _REACH_S:
            self._recent_s -= self._recent.popleft().motion.dt_s

    def _slipping(self, past: _Past) -> list[Travel]:
        again = [*self._recent, past]
        self.velocity, self.bias_m_s2, self.is_inertial = again[0].velocity, again[0].bias_m_s2, True
        self._recent.clear()
        self._recent_s = 0.0
        return list(self._travels(again))

    def _travels(self, pasts: list[_Past]) -> Iterator[Travel]:
        for past in pasts:
            dt_s = past.motion.dt_s
            self.velocity = forward, left = self._advanced(past)
            self._slipped_s += dt_s
            motion = past.motion._replace(forward_m=forward * dt_s, left_m=left * dt_s)
            wheels_forward, wheels_left = _by_wheels(past.motion)
            self._apart_m_s = _towards(self._apart_m_s, (wheels_forward - forward, wheels_left - left), dt_s)
            yield Travel(motion, is_rolled=False, sigma_m_s=self._sigma_m_s)

    def _advanced(self, past: _Past) -> _Velocity:
        """Return the velocity after a motion, by the inertial sensors."""
        motion, turned_rad, _, _ = past
        (forward, left), (bias_forward, bias_left), dt_s = self.velocity, self.bias_m_s2, motion.dt_s
        return (
            forward + motion.gained_forward_m_s - bias_forward * dt_s + turned_rad * left,
            left + motion.gained_left_m_s - bias_left * dt_s - turned_rad * forward,
        )


def _by_wheels(motion: Motion) -> _Velocity:
    return motion.forward_m / motion.dt_s, motion.left_m / motion.dt_s


def _towards(velocity: _Velocity, other: _Velocity, dt_s: float) -> _Velocity:
    """Return a velocity that follows the other one with the time constant of the crossover."""
    kept = math.exp(-dt_s / _CROSSOVER_S)
    return other[0] + kept * (velocity[0] - other[0]), other[1] + kept * (velocity[1] - other[1])
