"""Open-loop experiments that tell one plant from another: what wheel speeds and torques make of the robot.

Each takes ``start``, a function that gives a new plant at its start with the parameters it is given, and a
direction: ``forward``, ``left`` or ``turn``. The expected values are those of the rigid robot (plant_fmu/README.md).
"""

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from hil.core.kinematics import BodyTwist, body_twist, to_body
from hil.core.types import PoseFix, Wheels

DIRECTIONS = {
    "forward": Wheels(1.0, 1.0, 1.0, 1.0),
    "left": Wheels(-1.0, 1.0, -1.0, 1.0),
    "turn": Wheels(-1.0, 1.0, 1.0, -1.0),
}
"""Signs of the wheels that move an X robot so; turn is to the left."""

_SPEED_GAIN_N_M_S_RAD = 1.0
_SETTLING_TICKS = 1500
_WINDOW_TICKS = 500
_ROLLING_TORQUE_N_M = 1.0  # slips nowhere, and is large beside friction and ripple


class Plant(Protocol):
    """What the experiments need of a plant; ticks last 1 ms."""

    def step(self, torque_n_m: Wheels, ticks: int = 1) -> None:
        """Hold the torques for so many ticks."""

    def truth(self) -> PoseFix:
        """Return pose and twist, world frame."""

    def wheel_speeds(self) -> Wheels:
        """Return the wheel speeds [rad/s]."""


Start = Callable[[Mapping[str, float]], contextlib.AbstractContextManager[Plant]]


class Geometry(NamedTuple):
    """Wheel radius r and lever L = l1 + l2 of the robot [m]."""

    wheel_radius_m: float
    lever_m: float


def _component(body: BodyTwist, direction: str) -> float:
    return body[list(DIRECTIONS).index(direction)]


def _body(fix: PoseFix) -> BodyTwist:
    return to_body(fix.twist, fix.pose.heading_rad)


def rolling_ratio(start: Start, geometry: Geometry, direction: str, speed_rad_s: float) -> float:
    """Return the mean speed of a robot with steadily turning wheels, over that of rollers without slip."""
    signs = DIRECTIONS[direction]
    moved = rolled = 0.0
    with start({}) as plant:
        for tick in range(_SETTLING_TICKS + _WINDOW_TICKS):
            speeds = plant.wheel_speeds()
            plant.step(
                Wheels(
                    *(
                        _SPEED_GAIN_N_M_S_RAD * (sign * speed_rad_s - speed)
                        for sign, speed in zip(signs, speeds, strict=True)
                    )
                )
            )
            if tick >= _SETTLING_TICKS:
                moved += _component(_body(plant.truth()), direction)
                rolled += _component(body_twist(plant.wheel_speeds(), *geometry), direction)
    return moved / rolled


def acceleration(start: Start, direction: str, torque_n_m: float) -> float:
    """Return the mean acceleration [m/s² or rad/s²] over 0.1 s to 0.4 s of a torque step on all four wheels."""
    torques = Wheels(*(torque_n_m * sign for sign in DIRECTIONS[direction]))
    with start({}) as plant:
        plant.step(torques, 100)
        before = _component(_body(plant.truth()), direction)
        plant.step(torques, 300)
        return (_component(_body(plant.truth()), direction) - before) / 0.3


def slip_onset_n_m(start: Start, direction: str, *, highest_n_m: float, resolution_n_m: float = 0.02) -> float | None:
    """Return the least torque on all wheels of which 3 % of the acceleration are missing; None up to ``highest_n_m``.

    Missing in proportion to the acceleration of a small torque, which does not slip. Found by bisection.
    """
    rolling = acceleration(start, direction, _ROLLING_TORQUE_N_M) / _ROLLING_TORQUE_N_M

    def slips(torque_n_m: float) -> bool:
        return acceleration(start, direction, torque_n_m) < 0.97 * rolling * torque_n_m

    low, high = _ROLLING_TORQUE_N_M, highest_n_m
    if not slips(high):
        return None
    while high - low > resolution_n_m:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if slips(middle) else (middle, high)
    return high


def coasting_ratio(start: Start, speed_m_s: float, yaw_rate_rad_s: float) -> float:
    """Return how fast the world velocity of a coasting robot turns, over its yaw rate, in its first 0.3 s.

    The right term C gives k / (m + k), the paper's gives 1.
    """
    with start({"start_vx_m_s": speed_m_s, "start_yaw_rate_rad_s": yaw_rate_rad_s}) as plant:
        first = plant.truth()
        plant.step(Wheels(0.0, 0.0, 0.0, 0.0), 300)
        last = plant.truth()
    directions = [math.atan2(fix.twist.vy_m_s, fix.twist.vx_m_s) for fix in (first, last)]
    return (directions[1] - directions[0]) / (last.pose.heading_rad - first.pose.heading_rad)
