"""The four wheels as two pairs on the diagonals of the body, and what turns it.

Equal torques τ on FL and RR push the robot along the body's direction (1, -1) / √2, equal torques on FR and RL along
(1, 1) / √2, each with the force 2 √2 τ / r and with no regard to the other pair: force and speed limits of the wheels
are a square in these two directions (in forward and left, and in any fixed direction ψ, they are the a_max and v_max
with p = |cos ψ| + |sin ψ|). A difference within a pair turns the robot and pushes nothing:

    τ_FL = τ_1 - a    τ_RR = τ_1 + a    τ_FR = τ_2 + b    τ_RL = τ_2 - b    yaw torque 2 L (a + b) / r

Four wheels move three degrees of freedom, and a - b is the one that is left: either pair alone can turn the robot, so
that as long as one of them has torque to spare there is some for the heading.
"""

import math

from hil.core.types import FourWheels, Wheels

SQRT2 = math.sqrt(2.0)


def directions(heading_rad: float) -> tuple[float, float, float, float]:
    """Return where the pairs FL and RR, FR and RL push: x, y and x, y of unit vectors in the world frame."""
    c, s = math.cos(heading_rad) / SQRT2, math.sin(heading_rad) / SQRT2
    plus, minus = c + s, c - s
    return plus, -minus, minus, plus


def allocate(
    push_1_n_m: float, push_2_n_m: float, turn_n_m: float, friction_n_m: FourWheels, limit_n_m: float
) -> tuple[Wheels, float, float, float]:
    """Return wheel torques within the limit, and what is in them of τ_1, τ_2 and (a + b) / 2 as they were wanted.

    Pushing goes first, each pair by itself; turning gets what they leave, and takes it from where it is. On top
    comes ``friction_n_m``, what each wheel loses; a loss that differs within a pair turns the robot, so what of it
    cannot be made up for counts as turning that was not given. All in N·m a wheel.
    """
    fl, fr, rr, rl = friction_n_m
    loss_1, loss_2 = 0.5 * (fl + rr), 0.5 * (fr + rl)
    uneven = 0.5 * (fl - rr - fr + rl)
    push_1 = within(push_1_n_m + loss_1, limit_n_m)
    push_2 = within(push_2_n_m + loss_2, limit_n_m)
    room_1, room_2 = limit_n_m - abs(push_1), limit_n_m - abs(push_2)
    wanted = 2.0 * turn_n_m - uneven
    turn_2 = within(wanted - within(0.5 * wanted, room_1), room_2)
    turn_1 = within(wanted - turn_2, room_1)
    torque = Wheels(push_1 - turn_1, push_2 + turn_2, push_1 + turn_1, push_2 - turn_2)
    return torque, push_1 - loss_1, push_2 - loss_2, 0.5 * (turn_1 + turn_2 + uneven)


def within(value: float, limit: float) -> float:
    """Return the value, but no further from zero than the limit. NaN stays NaN."""
    return limit if value > limit else -limit if value < -limit else value
