"""Whether a robot can follow a reference: the wheel speeds and torques that it asks for, against their limits."""

import math
from typing import NamedTuple

from hil.model import RobotModel
from hil.references.motion import ReferenceSource
from hil.types import WHEEL_NAMES

FINEST_S = 0.01
MOST_SAMPLES = 20_000


class Demand(NamedTuple):
    """What a reference asks of the wheels in one quantity.

    Attributes:
        signal: such as ``wheel.fl.speed_rad_s``, of the wheel of which most is asked.
        worst: the most that is asked, without its sign, and when [s].
        worst_s: see ``worst``.
        limit: what the wheel can.
        first_signal: of the first wheel of which more is asked than the limit, None for never.
        first: how much that is, and when [s].
        first_s: see ``first``.
    """

    signal: str
    worst: float
    worst_s: float
    limit: float
    first_signal: str | None
    first: float | None
    first_s: float | None

    @property
    def sentence(self) -> str | None:
        """What to tell the user; None where the limit is kept."""
        if self.first_signal is None:
            return None
        unit = "N·m" if self.signal.endswith("n_m") else "rad/s"
        return (
            f"the reference asks for {self.first:.3g} {unit} of {self.first_signal} at t = {self.first_s:.3g} s, more "
            f"than the limit of {self.limit:g}; most at t = {self.worst_s:.3g} s, {self.worst:.3g} of {self.signal}"
        )


class Feasibility(NamedTuple):
    """What a reference asks of the wheels: speed [rad/s] and torque [N·m]."""

    speed: Demand
    torque: Demand

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the robot cannot follow, in words; empty where it can follow all."""
        return tuple(sentence for demand in self if (sentence := demand.sentence) is not None)


def feasibility(source: ReferenceSource, model: RobotModel, duration_s: float, period_s: float) -> Feasibility:
    """Return what a reference asks of the robot's wheels until ``duration_s``, by inverse kinematics and dynamics.

    It is sampled at the loop's period, but not finer than 10 ms, and in at most 20,000 instants of the time in which
    it differs: of a periodic one that is its start and one period. A jump of the reference itself, such as a circle
    without a ramp makes it at t = 0, is no demand: whatever starts away from the reference has to catch up.
    """
    until_s = min(duration_s, source.span_s)
    step_s = max(period_s, FINEST_S, until_s / MOST_SAMPLES)
    speed, torque = _Worst("speed_rad_s", model.speed_limit_rad_s), _Worst("torque_n_m", model.torque_limit_n_m)
    for number in range(math.floor(until_s / step_s + 1e-9) + 1):
        t_s = number * step_s
        pose, twist, acceleration = source.at(t_s)
        speeds = model.wheel_speeds(twist, pose.heading_rad)
        speed.take(t_s, speeds)
        torque.take(t_s, model.wheel_torques(acceleration, twist, pose.heading_rad, speeds))
    return Feasibility(speed.demand(), torque.demand())


class _Worst:
    """Keeps the first and the worst demand of one quantity."""

    def __init__(self, quantity: str, limit: float) -> None:
        self._quantity = quantity
        self._limit = limit
        self._worst = (-1.0, 0, 0.0)
        self._first: tuple[float, int, float] | None = None

    def take(self, t_s: float, wheels: tuple[float, float, float, float]) -> None:
        largest = max(max(wheels), -min(wheels))
        if largest > self._worst[0]:
            self._worst = (largest, _wheel(wheels), t_s)
        if largest > self._limit and self._first is None:
            self._first = (largest, _wheel(wheels), t_s)

    def demand(self) -> Demand:
        worst, wheel, worst_s = self._worst
        signal = self._signal(wheel)
        if self._first is None:
            return Demand(signal, worst, worst_s, self._limit, None, None, None)
        first, first_wheel, first_s = self._first
        return Demand(signal, worst, worst_s, self._limit, self._signal(first_wheel), first, first_s)

    def _signal(self, wheel: int) -> str:
        return f"wheel.{WHEEL_NAMES[wheel]}.{self._quantity}"


def _wheel(wheels: tuple[float, float, float, float]) -> int:
    """Return the number of the wheel of which most is asked."""
    sizes = [abs(value) for value in wheels]
    return sizes.index(max(sizes))
