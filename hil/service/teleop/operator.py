"""The one who drives: what keys and a gamepad ask for. Pure; time is the caller's own, in seconds."""

import enum

from hil.core.kinematics import BodyTwist
from hil.service.teleop.gamepad import Pad
from hil.service.teleop.held import DeadManButton, HeldKeys
from hil.service.teleop.keys import Change, Key
from hil.service.teleop.mapping import KEYS, REST, Direction, Speeds, of_keys, of_sticks, twist_of

_FASTER = 1.25
_LEAST_SHARE = 0.05


class Wish(enum.Enum):
    """What a key asks for, other than driving."""

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
    """Makes wishes and twists of keys and of a gamepad, which goes first while its dead-man button is held.

    ``share``: of ``speeds``, that + and - change. ``may_arm``: whether the next Enter arms, as after an a.
    """

    def __init__(self, keys: HeldKeys, speeds: Speeds, dead_zone: float, expo: float) -> None:
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
        """What full deflection means now."""
        return Speeds(self._full.speed_m_s * self.share, self._full.yaw_rate_rad_s * self.share)

    def take(self, key: Key, now_s: float) -> Wish | None:
        """Take note of a key; return what it asks for."""
        if key.name in KEYS and (key.change is Change.RELEASE or not (key.ctrl or key.other)):
            self._keys.take(key, now_s)
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

    def take_late(self, key: Key) -> Wish | None:
        """Take note of a key that was pressed while nobody looked: it moves nothing, but what stops still does."""
        self.release()
        wish = _wish_of(key) if key.change is Change.PRESS else None
        return wish if wish in _NEVER_TOO_LATE else None

    def take_pad(self, pad: Pad | None) -> Wish | None:
        """Take note of how the gamepad is held, None when there is none; return what it asks for."""
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
        """Return the twist that is asked for now; None when no dead-man switch is held."""
        if self._is_on_sticks:
            return self._of(self._sticks, 1.0)
        keys, share = self._keys.held(now_s)
        return self._of(of_keys(keys), share) if keys else None

    def release(self) -> None:
        """Let go of everything: keys and button count again when they are pressed anew, and so does what arms."""
        self.may_arm = False
        self._keys.release()
        self._button.release()
        self._is_on_sticks = False

    def _of(self, direction: Direction, share: float) -> BodyTwist:
        return twist_of(direction, self.speeds, share)


def _wish_of(key: Key) -> Wish | None:
    if key.ctrl or key.other:
        return _WISHES_WITH_CTRL.get(key.name) if key.ctrl else None
    return _WISHES.get(key.name)
