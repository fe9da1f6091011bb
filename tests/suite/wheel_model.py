"""What the firmware computes for its wheels, in Python: filter, loops, limits, and the watch of encoders.

The oracle of ``test_conversations.py``. Four values are those of FL, FR, RR, RL. The names of the parameters are those
of ``parameters.toml``. Filter and speed loop compute in binary32 as the firmware does: at the torque limit the sign of
an integral decides, and near zero rounding decides the sign.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Parameters = Mapping[str, float]
Four = NDArray[np.float32]

TICK_S = 1e-3
_F = np.float32
_TICK_S = _F(TICK_S)
_FASTEST_RAD_S = 256.0  # that the filter of the speed follows
STILL_RAD_S = float(_F(0.2))
_PASSING_RAD_S = 0.1
_TURNS_RAD_S = 2.0  # a wheel turns, for the watch of the encoders
_GAINED_RAD_S, _BRAKED_RAD_S = 3.0, 0.1
_DIFFERS, _STRONG = 0.3, 0.2  # parts of a speed, and of the torque limit
_DERATING_DEGC = 15.0


def zeros() -> Four:
    """Return four zeros."""
    return np.zeros(4, _F)


def ticks(seconds: float) -> int:
    """Return a time in whole ticks."""
    return int(seconds * 1000.0 + 0.5)


def scaled(values: Four, limit: float) -> tuple[Four, bool]:
    """Return the values, all scaled by one factor so that none is beyond the limit, and whether they were."""
    largest = max(map(abs, values.tolist()))
    if largest <= limit:
        return values, False
    return _F(limit) * (values / _F(largest)), True


def speed_limit(p: Parameters) -> float:
    """Return the largest speed of a set point: 0.8 of the overspeed limit, in whole steps of WHEEL_COMMAND."""
    return math.floor(_F(0.8) * _F(p["overspeed_rad_s"]) * _F(64.0)) / 64.0


def torque_limit(p: Parameters, hottest_degc: float) -> float:
    """Return what a wheel may drive with: by its own limit, or by the current as far as heat leaves it."""
    left = (_F(p["temperature_limit_degc"]) - _F(hottest_degc)) / _F(_DERATING_DEGC)
    by_current = _F(p["torque_constant_n_m_a"]) * _F(p["current_limit_a"]) * min(_F(1.0), max(_F(0.0), left))
    return min(float(by_current), p["torque_limit_n_m"])


class Trackers:
    """The filters of the wheels' speeds: each follows its count, critically damped; its rate is the speed."""

    def __init__(self) -> None:
        self._count: NDArray[np.int64] | None = None
        self._whole = np.zeros(4, np.int64)  # estimated position, in counts, and the rest of a count
        self._rest, self._rate = zeros(), zeros()
        self.absolute = np.zeros(4, np.int64)  # counts since power-on

    def update(self, counts: Sequence[int], p: Parameters) -> Four:
        """Take the counts of this tick; return the speeds [rad/s]."""
        count = np.array(counts, np.int64)
        if self._count is None:
            self._whole, self._rest = count, self._rest + _F(0.5)
        else:
            self.absolute += _wrapped(count - self._count)
        self._count = count
        self._advance(self._rate * _TICK_S)
        error = _wrapped(count - self._whole).astype(_F) + _F(0.5) - self._rest  # a count is known to its middle
        bandwidth = _F(p["tracking_bandwidth_rad_s"])
        self._advance(_F(2.0) * bandwidth * _TICK_S * error)
        rad_a_count = _F(math.tau) / _F(p["counts_per_revolution"])
        fastest = _F(_FASTEST_RAD_S) / rad_a_count
        rate = self._rate + bandwidth * bandwidth * _TICK_S * error
        self._rate = np.minimum(np.maximum(rate, -fastest), fastest)
        return self._rate * rad_a_count

    def _advance(self, counts: Four) -> None:
        position = self._rest + counts
        whole = np.floor(position)
        self._whole, self._rest = self._whole + whole.astype(np.int64), position - whole


def _wrapped(difference: NDArray[np.int64]) -> NDArray[np.int64]:
    return (difference + 0x8000 & 0xFFFF) - 0x8000


class SpeedLoop:
    """Proportional, integral, feedforward; the integral stands still at the limit unless the error brings it back."""

    def __init__(self) -> None:
        self.integral_n_m = zeros()

    def update(self, target: Four, speed: Four, ahead: Four, p: Parameters, limit: float) -> tuple[Four, bool]:
        """Return the torques, and whether they were scaled at the limit."""
        error, integral = target - speed, self.integral_n_m
        step = _F(p["speed_ki_n_m_rad"]) * error * _TICK_S
        torque, limited = scaled(_F(p["speed_kp_n_m_s_rad"]) * error + integral + ahead, limit)
        wound = integral + step
        self.integral_n_m, _ = scaled(np.where(step * integral > 0.0, integral, wound) if limited else wound, limit)
        return torque, limited


class CurrentLoop:
    """Duties for motors without a loop of their own: the winding solved over a tick, the back-EMF fed forward."""

    def __init__(self) -> None:
        self._integral_v = [0.0] * 4

    def update(
        self, torque: Sequence[float], current: Sequence[float], speed: Sequence[float], battery_v: float, p: Parameters
    ) -> list[float]:
        """Return the duties, -1 to 1; 0 without a battery."""
        if not battery_v > 0.0:
            self._integral_v = [0.0] * 4
            return [0.0] * 4
        resistance, constant = p["motor_resistance_ohm"], p["torque_constant_n_m_a"]
        part = -math.expm1(-resistance * TICK_S / p["motor_inductance_h"])
        gain = resistance * -math.expm1(-p["current_bandwidth_rad_s"] * TICK_S) / part
        duties = []
        for i in range(4):
            back_emf = constant * speed[i]
            voltage = gain * (torque[i] / constant - current[i]) + self._integral_v[i] + back_emf
            duty = min(1.0, max(-1.0, voltage / battery_v))
            self._integral_v[i] += part * (duty * battery_v - back_emf - self._integral_v[i])
            duties.append(duty)
        return duties


def by_others(speed: Sequence[float], wheel: int) -> float:
    """Return what the three others say of a wheel's speed: without slip FL + FR = RR + RL."""
    fl, fr, rr, rl = speed
    return (rr + rl - fr, rr + rl - fl, fl + fr - rl, fl + fr - rr)[wheel]


class EncoderWatch:
    """Watches the encoder of one wheel while the robot drives."""

    def __init__(self, speed_rad_s: float = 0.0) -> None:
        self._still = self._backward = 0  # ticks
        self._still_from = 0.0
        self._slowest, self._fastest = abs(speed_rad_s), 0.0

    def is_stuck(
        self, wheel: int, speed: Sequence[float], target: float | None, torque: float, strong: float, p: Parameters
    ) -> bool:
        """Tell whether it stood still for too long, though set point (None: there is none), torque and others turn."""
        own, others = speed[wheel], by_others(speed, wheel)
        asked = target is None or abs(target) > _TURNS_RAD_S
        if not self._still or abs(own - self._still_from) > _PASSING_RAD_S:
            self._still, self._still_from = 0, own
        turns = abs(others) > _TURNS_RAD_S and others * torque > 0.0
        holds = asked and abs(own) < STILL_RAD_S and turns and abs(torque) > _STRONG * strong
        self._still = self._still + 1 if holds else 0
        return self._still >= ticks(p["encoder_fault_s"])

    def is_backward(
        self,
        wheel: int,
        speed: Sequence[float],
        target: float,
        torque: float,
        strong: float,
        by_loop: bool,
        p: Parameters,
    ) -> bool:
        """Tell whether it said for too long the opposite of what its wheel does, by its torque and the others."""
        own, others = speed[wheel], by_others(speed, wheel)
        against = by_loop and own * torque < 0.0 and abs(torque) > _STRONG * strong
        if not against or abs(own) < self._slowest:
            self._slowest = abs(own)
        wrong_way = abs(target) > _TURNS_RAD_S and own * target < 0.0
        away = abs(own) > self._slowest + _GAINED_RAD_S and (wrong_way or abs(own - others) > _DIFFERS * abs(own))
        noise = math.pi * p["tracking_bandwidth_rad_s"] / p["counts_per_revolution"]
        if not away and abs(own) < self._fastest - _BRAKED_RAD_S - noise:
            self._backward = 0
        if not self._backward or abs(own) > self._fastest:
            self._fastest = abs(own)
        mirrored = abs(others) > _TURNS_RAD_S and abs(own + others) < _DIFFERS * abs(others)
        self._backward = self._backward + 1 if against and (away or mirrored) else 0
        return self._backward >= ticks(p["encoder_fault_s"])
