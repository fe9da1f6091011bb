"""Which keys are held, and whether whoever holds them is still there: the dead-man switches. Pure.

Time is the caller's own, in seconds; it only grows.
"""

import math
from collections.abc import Set as AbstractSet
from typing import NamedTuple, Protocol

from hil.service.teleop.keys import Change, Key


class Hold(NamedTuple):
    """The keys that are held, and the ``share`` of the speed that they are good for."""

    keys: AbstractSet[str]
    share: float


class HeldKeys(Protocol):
    """Knows which keys are held from what the terminal sends."""

    def take(self, key: Key, now_s: float) -> None:
        """Take note of a key."""

    def held(self, now_s: float) -> Hold:
        """Return what is held now."""

    def release(self) -> None:
        """Forget what is held: only another press counts."""


class ToldKeys:
    """For a terminal that tells of releases. A repeat of a key that was forgotten is no press."""

    def __init__(self) -> None:
        self._held: set[str] = set()

    def take(self, key: Key, now_s: float) -> None:
        """Take note of a key."""
        if key.change is Change.PRESS:
            self._held.add(key.name)
        elif key.change is Change.RELEASE:
            self._held.discard(key.name)

    def held(self, now_s: float) -> Hold:
        """Return what is held now."""
        return Hold(frozenset(self._held), 1.0)

    def release(self) -> None:
        """Forget what is held."""
        self._held.clear()


class RepeatedKeys:
    """For a terminal that tells nothing of releases: a key is held as long as the keyboard repeats it.

    The keyboard waits before the first repeat, and meanwhile a tap looks like a key that is held. So a press is good
    for ``FIRST_S`` at ``FIRST_SHARE`` of the speed, and each repeat for ``REPEAT_S`` at all of it. Keyboards repeat the
    last key only, so only one is ever held.
    """

    FIRST_S = 0.6
    FIRST_SHARE = 0.5
    REPEAT_S = 0.15

    def __init__(self) -> None:
        self._hold = Hold(frozenset(), 1.0)
        self._until_s = -math.inf

    def take(self, key: Key, now_s: float) -> None:
        """Take note of a key."""
        if key.change is Change.RELEASE:  # which such a terminal does not send
            self.release()
        elif key.name in self.held(now_s).keys:
            self._hold, self._until_s = Hold({key.name}, 1.0), now_s + self.REPEAT_S
        else:
            self._hold, self._until_s = Hold({key.name}, self.FIRST_SHARE), now_s + self.FIRST_S

    def held(self, now_s: float) -> Hold:
        """Return what is held now."""
        return self._hold if now_s <= self._until_s else Hold(frozenset(), 1.0)

    def release(self) -> None:
        """Forget what is held."""
        self._until_s = -math.inf


class Heartbeat:
    """Questions to a terminal that tells of releases: one that does not answer could not tell of a release either.

    Held keys alone say nothing: when a second key is held, the first is not repeated any more.
    """

    PERIOD_S = 0.1
    LIMIT_S = 0.3

    def __init__(self) -> None:
        self._asked_s = -math.inf
        self._unanswered_s = math.inf

    def due(self, now_s: float) -> bool:
        """Tell whether to ask now."""
        if now_s - self._asked_s < self.PERIOD_S:
            return False
        self._asked_s = now_s
        self._unanswered_s = min(self._unanswered_s, now_s)
        return True

    def answered(self) -> None:
        """An answer has come."""
        self._unanswered_s = math.inf

    def is_lost(self, now_s: float) -> bool:
        """Tell whether a question has been unanswered for too long."""
        return now_s - self._unanswered_s > self.LIMIT_S


class DeadManButton:
    """The button of a gamepad that must be held; at first, and after a loss, it counts once it was seen released."""

    def __init__(self) -> None:
        self._was_released = False

    def held(self, *, pressed: bool) -> bool:
        """Return whether it counts as held."""
        self._was_released = self._was_released or not pressed
        return pressed and self._was_released

    def release(self) -> None:
        """Forget that it is held."""
        self._was_released = False
