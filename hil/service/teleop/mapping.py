"""From keys and sticks to a twist. Pure."""

import math
from collections.abc import Set as AbstractSet
from typing import NamedTuple

from hil.core.kinematics import BodyTwist


class Speeds(NamedTuple):
    """What full deflection means, in the plane and in yaw."""

    speed_m_s: float
    yaw_rate_rad_s: float


class Direction(NamedTuple):
    """Shares of the speeds: ``forward`` and ``left`` within the unit circle, ``turn`` to the left within -1 to 1."""

    forward: float
    left: float
    turn: float


class Sticks(NamedTuple):
    """Axes of a gamepad, -1 to 1: the left stick forward and to the left, and the right one to the left."""

    forward: float
    left: float
    turn: float


REST = Direction(0.0, 0.0, 0.0)

# A compass around k on every keyboard, and the arrows.
KEYS = {
    "up": Direction(1, 0, 0),
    "down": Direction(-1, 0, 0),
    "left": Direction(0, 1, 0),
    "right": Direction(0, -1, 0),
    "i": Direction(1, 0, 0),
    ",": Direction(-1, 0, 0),
    "j": Direction(0, 1, 0),
    "l": Direction(0, -1, 0),
    "u": Direction(1, 1, 0),
    "o": Direction(1, -1, 0),
    "m": Direction(-1, 1, 0),
    ".": Direction(-1, -1, 0),
    "s": Direction(0, 0, 1),
    "f": Direction(0, 0, -1),
}


def of_keys(keys: AbstractSet[str]) -> Direction:
    """Return where the keys that are held point; opposite ones cancel each other."""
    forward, left, turn = (sum(KEYS[key][axis] for key in keys) for axis in range(3))
    length = max(math.hypot(forward, left), 1.0)
    return Direction(forward / length, left / length, min(max(turn, -1.0), 1.0))


def of_sticks(sticks: Sticks, dead_zone: float, expo: float) -> Direction:
    """Return where the sticks point.

    Within ``dead_zone`` (0 to below 1) of its centre a stick is at rest, and from there its way counts from 0. ``expo``
    (0 to 1) makes it finer near the centre: (1 - expo) r + expo r³. The left stick's direction stays as it is.
    """
    length = math.hypot(sticks.forward, sticks.left)
    share = _shaped(length, dead_zone, expo) / length if length else 0.0
    turn = math.copysign(_shaped(abs(sticks.turn), dead_zone, expo), sticks.turn)
    return Direction(sticks.forward * share, sticks.left * share, turn)


def _shaped(length: float, dead_zone: float, expo: float) -> float:
    way = min(max((length - dead_zone) / (1.0 - dead_zone), 0.0), 1.0)
    return (1.0 - expo) * way + expo * way**3


def twist_of(direction: Direction, speeds: Speeds, share: float) -> BodyTwist:
    """Return the twist that a direction asks for, at a share of the speeds."""
    plane_m_s = share * speeds.speed_m_s
    return BodyTwist(
        direction.forward * plane_m_s, direction.left * plane_m_s, direction.turn * share * speeds.yaw_rate_rad_s
    )
