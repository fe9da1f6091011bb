"""Two diagonal pairs of wheels: pair 1 is FL and RR, pair 2 is FR and RL.

Equal torques τ_1 and τ_2 of the pairs push the robot along the body's directions (1, -1) / √2 and (1, 1) / √2,
independently of each other. A difference within a pair turns the robot and does not push it:

    τ_FL = τ_1 - a    τ_RR = τ_1 + a    τ_FR = τ_2 + b    τ_RL = τ_2 - b    yaw torque 2 L (a + b) / r
"""

import math

from hil.core.types import FourWheels, Wheels

SQRT2 = math.sqrt(2.0)


def directions(heading_rad: float) -> tuple[float, float, float, float]:
    """Return the unit vectors in the world frame along which the pairs FL, RR and FR, RL push: x1, y1, x2, y2."""
    c, s = math.cos(heading_rad) / SQRT2, math.sin(heading_rad) / SQRT2
    plus, minus = c + s, c - s
    return plus, -minus, minus, plus


def allocate(
    push_1_n_m: float, push_2_n_m: float, turn_n_m: float, friction_n_m: FourWheels, limit_n_m: float, spare: int = 0
) -> tuple[Wheels, float, float, float]:
    """Return wheel torques within the limit, and the τ_1, τ_2 and (a + b) / 2 that they achieve.

    Pushing has priority, for each pair by itself. Turning gets the torque that is left, from whichever pair has some.
    If one pair has time to ``spare``, 1 or 2, turning has priority over its push, as far as the other pair has no room.
    ``friction_n_m`` is the loss of each wheel and is added. A loss that differs within a pair turns the robot, so the
    part of it that cannot be compensated lowers the achieved turning torque. All are in N·m per wheel.
    """
    fl, fr, rr, rl = friction_n_m
    loss_1, loss_2 = 0.5 * (fl + rr), 0.5 * (fr + rl)
    uneven = 0.5 * (fl - rr - fr + rl)
    push_1 = within(push_1_n_m + loss_1, limit_n_m)
    push_2 = within(push_2_n_m + loss_2, limit_n_m)
    desired = 2.0 * turn_n_m - uneven
    if spare == 1:
        push_1 = within(push_1, limit_n_m - within(max(abs(desired) - limit_n_m + abs(push_2), 0.0), limit_n_m))
    elif spare == 2:
        push_2 = within(push_2, limit_n_m - within(max(abs(desired) - limit_n_m + abs(push_1), 0.0), limit_n_m))
    room_1, room_2 = limit_n_m - abs(push_1), limit_n_m - abs(push_2)
    turn_2 = within(desired - within(0.5 * desired, room_1), room_2)
    turn_1 = within(desired - turn_2, room_1)
    torque = Wheels(push_1 - turn_1, push_2 + turn_2, push_1 + turn_1, push_2 - turn_2)
    return torque, push_1 - loss_1, push_2 - loss_2, 0.5 * (turn_1 + turn_2 + uneven)


def within(value: float, limit: float) -> float:
    """Return the value limited to ±``limit``. NaN stays NaN."""
    return limit if value > limit else -limit if value < -limit else value
