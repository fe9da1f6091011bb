"""Turns keys and the state of a gamepad into wishes and twists. Pure; time is the caller's own, in seconds."""

import math
from typing import Literal, NamedTuple

from hil.addons.service.messages import Action
from hil.addons.service.teleop.gamepad import Direction, Pad
from hil.core.kinematics import BodyTwist

FIRST_S, FIRST_SHARE, REPEAT_S = 0.6, 0.5, 0.15
"""How long a first press counts and at which share of the speed, and how long each repeat counts at full speed."""

_FASTER = 1.25
_LEAST_SHARE = 0.05
_DEAD_ZONE = 0.1  # share of a stick's travel that is rest
_EXPO = 0.5  # 0: a stick is linear; 1: cubic, finest at rest


class Speeds(NamedTuple):
    """The speeds at full deflection, in the plane and in yaw."""

    speed_m_s: float
    yaw_rate_rad_s: float


_SLANT = math.sqrt(0.5)
# A compass around k, at the same place on every keyboard, and the arrows.
KEYS = {
    **dict.fromkeys(("up", "i"), Direction(1, 0, 0)),
    **dict.fromkeys(("down", ","), Direction(-1, 0, 0)),
    **dict.fromkeys(("left", "j"), Direction(0, 1, 0)),
    **dict.fromkeys(("right", "l"), Direction(0, -1, 0)),
    "u": Direction(_SLANT, _SLANT, 0),
    "o": Direction(_SLANT, -_SLANT, 0),
    "m": Direction(-_SLANT, _SLANT, 0),
    ".": Direction(-_SLANT, -_SLANT, 0),
    "s": Direction(0, 0, 1),
    "f": Direction(0, 0, -1),
}

Wish = Action | Literal["quit"]
"""A wish of the operator other than driving: an order, or the end of teleop."""

_WISHES: dict[str, Wish] = {
    **dict.fromkeys(("space", "escape", "k", "K"), Action.STOP),  # with Caps Lock, too
    **dict.fromkeys(("e", "E"), Action.ESTOP),
    "d": Action.DISARM,
    "c": Action.CLEAR,
    **dict.fromkeys(("q", "ctrl-d"), "quit"),
}
_NEVER_TOO_LATE = (Action.STOP, Action.ESTOP, Action.DISARM, "quit")


def of_sticks(sticks: Direction) -> Direction:
    """Return the direction of the sticks: at rest near their centre, and finer there. The left stick's angle stays."""
    length = math.hypot(sticks.forward, sticks.left)
    share = _shaped(length) / length if length else 0.0
    turn = math.copysign(_shaped(abs(sticks.turn)), sticks.turn)
    return Direction(sticks.forward * share, sticks.left * share, turn)


def _shaped(length: float) -> float:
    way = min(max((length - _DEAD_ZONE) / (1.0 - _DEAD_ZONE), 0.0), 1.0)
    return (1.0 - _EXPO) * way + _EXPO * way**3


class Operator:
    """Turns keys and the state of a gamepad into wishes and twists.

    A terminal does not report releases, so a key is held as long as the keyboard repeats it. The keyboard waits before
    the first repeat, and until then a tap looks like a held key: so a first press counts for longer, and drives slower.
    Keyboards repeat only the last key, so only one key is ever held.

    The gamepad has priority while its dead-man button is held. At first and after ``release`` the button must be seen
    released before it can count as held.

    Attributes:
        speeds: the present speeds at full deflection; + and - change them. may_arm: whether Enter arms next, as it
            does after the key a.
    """

    def __init__(self, speeds: Speeds) -> None:
        self._key = ""
        self._key_until_s = -math.inf
        self._key_share = 1.0
        self._button_was_released = self._estop_pressed = False
        self._sticks: Direction | None = None
        self._full = self.speeds = speeds
        self._share = 1.0
        self.may_arm = False

    def on_key(self, key: str, now_s: float) -> Wish | None:
        """Process a key; return its wish."""
        may_arm, self.may_arm = self.may_arm, key == "a"
        if key == "enter" and may_arm:
            return Action.ARM
        if key in KEYS:
            is_repeat = key == self._key and now_s <= self._key_until_s
            self._key, self._key_share = key, 1.0 if is_repeat else FIRST_SHARE
            self._key_until_s = now_s + (REPEAT_S if is_repeat else FIRST_S)
        if key in ("+", "=", "-"):
            share = self._share / _FASTER if key == "-" else self._share * _FASTER
            self._share = min(max(share, _LEAST_SHARE), 1.0)
            self.speeds = Speeds(*(self._share * speed for speed in self._full))
        if (wish := _WISHES.get(key)) is not None:
            self.release()
        return wish

    def on_late_key(self, key: str) -> Wish | None:
        """Process a key that was read too late: it drives nothing, but wishes that stop the robot are returned."""
        self.release()
        wish = _WISHES.get(key)
        return wish if wish in _NEVER_TOO_LATE else None

    def on_pad(self, pad: Pad | None) -> Wish | None:
        """Process the state of the gamepad (None without one); return its wish."""
        was_pressed, self._estop_pressed = self._estop_pressed, pad is not None and pad.estop
        if pad is None:
            self._button_was_released, self._sticks = False, None
            return None
        self._button_was_released = self._button_was_released or not pad.dead_man
        is_held = pad.dead_man and self._button_was_released
        self._sticks = of_sticks(pad.sticks) if is_held else None
        if pad.estop and not was_pressed:
            self.release()
            return Action.ESTOP
        return None

    def twist(self, now_s: float) -> BodyTwist | None:
        """Return the wanted twist; None when no dead-man switch is held."""
        if self._sticks is not None:
            direction, share = self._sticks, 1.0
        elif now_s <= self._key_until_s:
            direction, share = KEYS[self._key], self._key_share
        else:
            return None
        plane_m_s, yaw_rate_rad_s = (share * speed for speed in self.speeds)
        return BodyTwist(direction.forward * plane_m_s, direction.left * plane_m_s, direction.turn * yaw_rate_rad_s)

    def release(self) -> None:
        """Release everything: keys and button count again only after a new press, and so does arming."""
        self._key_until_s = -math.inf
        self.may_arm = self._button_was_released = False
        self._sticks = None
