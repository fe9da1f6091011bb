"""The way to a reference: each axis brakes as late as it can, at a heading at which both arrive at once.

PROFILE.md beside this file has the equations and the reasons. An axis is the direction along which a pair of wheels
pushes; all rates are relative to the reference. Pair 1 is FL and RR, pair 2 is FR and RL.

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

    Pushing has priority, for each pair alone. Turning gets the torque that is left, from whichever pair has some.
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


_HALVINGS = 8  # of a quarter turn: the heading to 6 mrad
_LEAST_M_S = 0.05  # so that an axis without speed left takes long, and not for ever


def profile(error: float, rate: float, k1: float, braking: float, low: float, high: float) -> tuple[float, float]:
    """Return w(e) = -sign(e) min(K1 ρ, √(2 a (ρ - ρl/2))) with ρ = abs(e), ρl = a / K1², and ẇ = w'(e) ė.

    ``rate`` is ė and ``braking`` is a. Far away, w is the rate from which braking with a ends in the linear part. That
    part begins at ρl with the same rate and slope. w is limited to ``low`` ... ``high``, with slope 0 at a limit.
    """
    distance = abs(error)
    linear = braking / (k1 * k1)
    if distance <= linear:
        desired, slope = -k1 * error, -k1 * rate
    else:
        fast = math.sqrt(2.0 * braking * (distance - 0.5 * linear))
        desired, slope = -math.copysign(fast, error), -braking / fast * rate
    if desired > high:
        return high, 0.0
    return (low, 0.0) if desired < low else (desired, slope)


def time_to_go(error: float, rate: float, acceleration: float, low: float, high: float) -> float:
    """Return the least time [s] to error and rate zero with this acceleration and with rates of ``low`` to ``high``.

    The phases are full acceleration, the largest rate if that is reached, and full braking. From a distance d and a
    rate w towards the reference the peak is p = √(a d + w²/2), and the time (2 p - w) / a.
    """
    ends_at = error + 0.5 * rate * abs(rate) / acceleration  # where braking at once would end
    distance, towards, most = (error, -rate, -low) if ends_at > 0.0 else (-error, rate, high)
    most = max(most, _LEAST_M_S)
    peak = math.sqrt(max(acceleration * distance + 0.5 * towards * towards, 0.0))
    if peak <= most:
        return (2.0 * peak - towards) / acceleration
    changed_s = abs(most - towards) / acceleration  # faster or, above the largest rate, slower
    even = distance - 0.5 * (most + towards) * changed_s - 0.5 * most * most / acceleration
    return changed_s + even / most + most / acceleration


def friction_share(error: float, rate: float, along: float) -> float:
    """Return the share of friction that helps to brake on the rest of the way, from 1 to -1.

    ``along`` is the rate of the reference itself. If it goes against the approach, wheels turn round before they are
    with it, and on that part, (along / rate)² of the way, friction hinders.
    """
    if along * error <= 0.0:
        return 1.0
    return -1.0 if abs(rate) <= abs(along) else 1.0 - 2.0 * (along / rate) ** 2


def even_turn(
    heading: float,
    error: tuple[float, float],
    rate: tuple[float, float],
    reference_rate: tuple[float, float],
    acceleration: float,
    limit: float,
) -> float:
    """Return how far to turn from ``heading`` [rad], within ±π/4, so that both axes need the same ``time_to_go``.

    The later axis decides when the robot is there, and what one axis gains by a turn the other one loses, so their
    times should be equal. The axes are a quarter turn apart: turned by that they change places, and the difference of
    their times changes its sign. Bisection finds where it is zero in between. The time of the turn does not count.

    ``heading`` is the robot's. ``error`` [m] and ``rate`` [m/s] are the robot's minus the reference's,
    ``reference_rate`` [m/s] is the reference's own, each (x, y) in the world frame. ``acceleration`` [m/s²] is that of
    an axis to either side, and ``limit`` [m/s] its largest speed over the floor.
    """
    (x, y), (vx, vy), (vx_d, vy_d) = error, rate, reference_rate

    def first_is_later_by(at: float) -> float:
        x1, y1, x2, y2 = directions(at)
        along_1, along_2 = vx_d * x1 + vy_d * y1, vx_d * x2 + vy_d * y2
        time_1 = time_to_go(x * x1 + y * y1, vx * x1 + vy * y1, acceleration, -limit - along_1, limit - along_1)
        time_2 = time_to_go(x * x2 + y * y2, vx * x2 + vy * y2, acceleration, -limit - along_2, limit - along_2)
        return time_1 - time_2

    low, high = heading - 0.25 * math.pi, heading + 0.25 * math.pi
    sign = math.copysign(1.0, first_is_later_by(high))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if sign * first_is_later_by(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high) - heading
