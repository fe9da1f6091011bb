"""Turns keys and the state of a gamepad into wishes and twists. Pure; time is the caller's own, in seconds."""

import enum
import math
from collections.abc import Set as AbstractSet
from typing import NamedTuple

from hil.core.kinematics import BodyTwist
from hil.service.teleop.gamepad import Pad, Sticks
from hil.service.teleop.held import DeadManButton, ReleasingKeys, RepeatedKeys
from hil.service.teleop.keys import Change, Key

_FASTER = 1.25
_LEAST_SHARE = 0.05


class Speeds(NamedTuple):
    """The speeds at full deflection, in the plane and in yaw."""

    speed_m_s: float
    yaw_rate_rad_s: float


class Direction(NamedTuple):
    """Shares of the full speeds: ``forward`` and ``left`` in the unit circle, ``turn`` to the left from -1 to 1."""

    forward: float
    left: float
    turn: float


REST = Direction(0.0, 0.0, 0.0)

# A compass around k, at the same place on every keyboard, and the arrows.
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
    """Return the direction of the held keys; opposite keys cancel each other."""
    forward, left, turn = (sum(KEYS[key][axis] for key in keys) for axis in range(3))
    length = max(math.hypot(forward, left), 1.0)
    return Direction(forward / length, left / length, min(max(turn, -1.0), 1.0))


def of_sticks(sticks: Sticks, dead_zone: float, expo: float) -> Direction:
    """Return the direction of the sticks.

    A stick within ``dead_zone`` (0 to below 1) of its centre is at rest; beyond, its travel counts from 0. ``expo`` (0
    to 1) makes it finer near the centre: (1 - expo) r + expo r³. The left stick's angle is not changed.
    """
    length = math.hypot(sticks.forward, sticks.left)
    share = _shaped(length, dead_zone, expo) / length if length else 0.0
    turn = math.copysign(_shaped(abs(sticks.turn), dead_zone, expo), sticks.turn)
    return Direction(sticks.forward * share, sticks.left * share, turn)


def _shaped(length: float, dead_zone: float, expo: float) -> float:
    way = min(max((length - dead_zone) / (1.0 - dead_zone), 0.0), 1.0)
    return (1.0 - expo) * way + expo * way**3


def twist_of(direction: Direction, speeds: Speeds, share: float) -> BodyTwist:
    """Return the twist of a direction, at a share of the speeds."""
    plane_m_s = share * speeds.speed_m_s
    return BodyTwist(
        direction.forward * plane_m_s, direction.left * plane_m_s, direction.turn * share * speeds.yaw_rate_rad_s
    )


class Wish(enum.Enum):
    """A wish of the operator other than driving."""

    STOP = "stop"
    ESTOP = "estop"
    ARM = "arm"
    DISARM = "disarm"
    CLEAR = "clear"
    QUIT = "quit"
    SUSPEND = "suspend"


_WISHES = {
    "space": Wish.STOP,
    "escape": Wish.STOP,
    "k": Wish.STOP,
    "e": Wish.ESTOP,
    "d": Wish.DISARM,
    "c": Wish.CLEAR,
    "q": Wish.QUIT,
}
_WISHES_WITH_CTRL = {"c": Wish.QUIT, "d": Wish.QUIT, "z": Wish.SUSPEND}
_NEVER_TOO_LATE = (Wish.STOP, Wish.ESTOP, Wish.DISARM, Wish.QUIT)


class Operator:
    """Turns keys and the state of a gamepad into wishes and twists. The gamepad has priority while its dead-man button
    is held.

    Attributes:
        share: share of the full speeds; + and - change it. may_arm: whether Enter arms next, as it does after the key
            a.
    """

    def __init__(self, keys: ReleasingKeys | RepeatedKeys, speeds: Speeds, dead_zone: float, expo: float) -> None:
        self._keys = keys
        self._button = DeadManButton()
        self._sticks = REST
        self._is_on_sticks = False
        self._estop_pressed = False
        self._full = speeds
        self._dead_zone, self._expo = dead_zone, expo
        self.share = 1.0
        self.may_arm = False

    @property
    def speeds(self) -> Speeds:
        """The present speeds at full deflection."""
        return Speeds(self._full.speed_m_s * self.share, self._full.yaw_rate_rad_s * self.share)

    def on_key(self, key: Key, now_s: float) -> Wish | None:
        """Process a key; return its wish."""
        if key.name in KEYS and (key.change is Change.RELEASE or not (key.ctrl or key.other)):
            self._keys.on_key(key, now_s)
        if key.change is not Change.PRESS:
            return None
        may_arm, self.may_arm = self.may_arm, False
        wish = _wish_of(key)
        if key.ctrl or key.other:
            return wish
        if key.name == "enter" and may_arm:
            return Wish.ARM
        if key.name in ("+", "="):
            self.share = min(self.share * _FASTER, 1.0)
        elif key.name == "-":
            self.share = max(self.share / _FASTER, _LEAST_SHARE)
        if wish is not None:
            self.release()
        self.may_arm = key.name == "a"
        return wish

    def on_late_key(self, key: Key) -> Wish | None:
        """Process a key that was read too late: it drives nothing, but wishes that stop the robot are returned."""
        self.release()
        wish = _wish_of(key) if key.change is Change.PRESS else None
        return wish if wish in _NEVER_TOO_LATE else None

    def on_pad(self, pad: Pad | None) -> Wish | None:
        """Process the state of the gamepad (None without one); return its wish."""
        if pad is None:
            self._button.release()
            self._is_on_sticks = self._estop_pressed = False
            return None
        self._is_on_sticks = self._button.held(pressed=pad.dead_man)
        self._sticks = of_sticks(pad.sticks, self._dead_zone, self._expo)
        was_pressed, self._estop_pressed = self._estop_pressed, pad.estop
        if pad.estop and not was_pressed:
            self.release()
            return Wish.ESTOP
        return None

    def twist(self, now_s: float) -> BodyTwist | None:
        """Return the wanted twist; None when no dead-man switch is held."""
        if self._is_on_sticks:
            return twist_of(self._sticks, self.speeds, 1.0)
        keys, share = self._keys.held(now_s)
        return twist_of(of_keys(keys), self.speeds, share) if keys else None

    def release(self) -> None:
        """Release everything: keys and button count again only after a new press, and so does arming."""
        self.may_arm = False
        self._keys.release()
        self._button.release()
        self._is_on_sticks = False


def _wish_of(key: Key) -> Wish | None:
    if key.ctrl or key.other:
        return _WISHES_WITH_CTRL.get(key.name) if key.ctrl else None
    return _WISHES.get(key.name)
