"""Turns keys and the state of a gamepad into wishes and twists. Pure; time is the caller's own, in seconds."""

import math
from collections.abc import Set as AbstractSet
from typing import Literal, NamedTuple

from hil.core.kinematics import BodyTwist
from hil.service.messages import Action
from hil.service.teleop.gamepad import Direction, Pad
from hil.service.teleop.keys import Change, Key

_FASTER = 1.25
_LEAST_SHARE = 0.05


class Speeds(NamedTuple):
    """The speeds at full deflection, in the plane and in yaw."""

    speed_m_s: float
    yaw_rate_rad_s: float


# A compass around k, at the same place on every keyboard, and the arrows.
KEYS = {
    **dict.fromkeys(("up", "i"), Direction(1, 0, 0)),
    **dict.fromkeys(("down", ","), Direction(-1, 0, 0)),
    **dict.fromkeys(("left", "j"), Direction(0, 1, 0)),
    **dict.fromkeys(("right", "l"), Direction(0, -1, 0)),
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


def of_sticks(sticks: Direction, dead_zone: float, expo: float) -> Direction:
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


Wish = Action | Literal["quit", "suspend"]
"""A wish of the operator other than driving: an order, or one for teleop itself."""

_WISHES: dict[str, Wish] = {
    "space": Action.STOP,
    "escape": Action.STOP,
    "k": Action.STOP,
    "e": Action.ESTOP,
    "d": Action.DISARM,
    "c": Action.CLEAR,
    "q": "quit",
}
_WISHES_WITH_CTRL: dict[str, Wish] = {"c": "quit", "d": "quit", "z": "suspend"}
_NEVER_TOO_LATE = (Action.STOP, Action.ESTOP, Action.DISARM, "quit")


class HeldKeys:
    """The keys that are held: a keyboard's dead-man switches.

    With ``reports_releases`` a key is held from its press to its release; a repeat of a released key does not count as
    a press. Other terminals report no releases: there a key is held as long as the keyboard repeats it. The keyboard
    waits before the first repeat, and until then a tap looks like a held key. So a press counts for ``FIRST_S`` at
    ``FIRST_SHARE`` of the speed, and each repeat for ``REPEAT_S`` at full speed. Keyboards repeat only the last key, so
    only one key is ever held.
    """

    FIRST_S = 0.6
    FIRST_SHARE = 0.5
    REPEAT_S = 0.15

    def __init__(self, *, reports_releases: bool) -> None:
        self._reports_releases = reports_releases
        self._until_s: dict[str, float] = {}
        self._share = 1.0

    def on_key(self, key: Key, now_s: float) -> None:
        """Process a key."""
        if key.change is Change.RELEASE:
            self._until_s.pop(key.name, None)
        elif not self._reports_releases:
            is_repeat = key.name in self.held(now_s)[0]
            self._share = 1.0 if is_repeat else self.FIRST_SHARE
            self._until_s = {key.name: now_s + (self.REPEAT_S if is_repeat else self.FIRST_S)}
        elif key.change is Change.PRESS:
            self._until_s[key.name] = math.inf

    def held(self, now_s: float) -> tuple[set[str], float]:
        """Return the held keys, and the share of the speed at which they drive."""
        return {name for name, until_s in self._until_s.items() if now_s <= until_s}, self._share

    def release(self) -> None:
        """Forget the held keys: only another press counts."""
        self._until_s.clear()


class Heartbeat:
    """Queries that a terminal must answer. One that does not answer could not report the release of a key either.

    Key repeats cannot replace the queries: when a second key is held, the first is no longer repeated.
    """

    PERIOD_S = 0.1
    LIMIT_S = 0.3

    def __init__(self) -> None:
        self._queried_s = -math.inf
        self._unanswered_s = math.inf

    def due(self, now_s: float) -> bool:
        """Return whether to send a query now."""
        if now_s - self._queried_s < self.PERIOD_S:
            return False
        self._queried_s = now_s
        self._unanswered_s = min(self._unanswered_s, now_s)
        return True

    def answered(self) -> None:
        """Record an answer."""
        self._unanswered_s = math.inf

    def is_lost(self, now_s: float) -> bool:
        """Return whether a query has been unanswered for too long."""
        return now_s - self._unanswered_s > self.LIMIT_S


class Operator:
    """Turns keys and the state of a gamepad into wishes and twists.

    The gamepad has priority while its dead-man button is held. At first and after ``release`` the button must be seen
    released before it can count as held.

    Attributes:
        speeds: the present speeds at full deflection; + and - change them. may_arm: whether Enter arms next, as it
            does after the key a.
    """

    def __init__(self, keys: HeldKeys, speeds: Speeds, dead_zone: float, expo: float) -> None:
        self._keys = keys
        self._button_was_released = self._estop_pressed = False
        self._sticks: Direction | None = None
        self._full = self.speeds = speeds
        self._share = 1.0
        self._dead_zone, self._expo = dead_zone, expo
        self.may_arm = False

    def on_key(self, key: Key, now_s: float) -> Wish | None:
        """Process a key; return its wish."""
        is_plain = not (key.ctrl or key.other)
        if key.name in KEYS and (key.change is Change.RELEASE or is_plain):
            self._keys.on_key(key, now_s)
        if key.change is not Change.PRESS:
            return None
        may_arm, self.may_arm = self.may_arm, False
        wish = _wish_of(key)
        if is_plain:
            if key.name == "enter" and may_arm:
                return Action.ARM
            if key.name in ("+", "=", "-"):
                share = self._share / _FASTER if key.name == "-" else self._share * _FASTER
                self._share = min(max(share, _LEAST_SHARE), 1.0)
                self.speeds = Speeds(*(self._share * speed for speed in self._full))
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
        was_pressed, self._estop_pressed = self._estop_pressed, pad is not None and pad.estop
        if pad is None:
            self._button_was_released, self._sticks = False, None
            return None
        self._button_was_released = self._button_was_released or not pad.dead_man
        is_held = pad.dead_man and self._button_was_released
        self._sticks = of_sticks(pad.sticks, self._dead_zone, self._expo) if is_held else None
        if pad.estop and not was_pressed:
            self.release()
            return Action.ESTOP
        return None

    def twist(self, now_s: float) -> BodyTwist | None:
        """Return the wanted twist; None when no dead-man switch is held."""
        if self._sticks is not None:
            return twist_of(self._sticks, self.speeds, 1.0)
        keys, share = self._keys.held(now_s)
        return twist_of(of_keys(keys), self.speeds, share) if keys else None

    def release(self) -> None:
        """Release everything: keys and button count again only after a new press, and so does arming."""
        self._keys.release()
        self.may_arm = self._button_was_released = False
        self._sticks = None


def _wish_of(key: Key) -> Wish | None:
    if key.other and not key.ctrl:
        return None
    return (_WISHES_WITH_CTRL if key.ctrl else _WISHES).get(key.name)
