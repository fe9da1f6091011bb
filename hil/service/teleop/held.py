"""The dead-man switches: which keys are held, and whether the terminal is still there. Pure.

Time is the caller's own, in seconds; it never decreases.
"""

import math
from collections.abc import Set as AbstractSet
from typing import NamedTuple

from hil.service.teleop.keys import Change, Key


class Hold(NamedTuple):
    """The held keys, and the ``share`` of the speed at which they drive."""

    keys: AbstractSet[str]
    share: float


class ReleasingKeys:
    """The held keys of a terminal that reports releases. A repeat of a released key does not count as a press."""

    def __init__(self) -> None:
        self._held: set[str] = set()

    def on_key(self, key: Key, now_s: float) -> None:
        """Process a key."""
        if key.change is Change.PRESS:
            self._held.add(key.name)
        elif key.change is Change.RELEASE:
            self._held.discard(key.name)

    def held(self, now_s: float) -> Hold:
        """Return the held keys."""
        return Hold(frozenset(self._held), 1.0)

    def release(self) -> None:
        """Forget the held keys: only another press counts."""
        self._held.clear()


class RepeatedKeys:
    """The held keys of a terminal that does not report releases: a key is held as long as the keyboard repeats it.

    The keyboard waits before the first repeat, and until then a tap looks like a held key. So a press counts for
    ``FIRST_S`` at ``FIRST_SHARE`` of the speed, and each repeat for ``REPEAT_S`` at full speed. Keyboards repeat only
    the last key, so only one key is ever held.
    """

    FIRST_S = 0.6
    FIRST_SHARE = 0.5
    REPEAT_S = 0.15

    def __init__(self) -> None:
        self._hold = Hold(frozenset(), 1.0)
        self._until_s = -math.inf

    def on_key(self, key: Key, now_s: float) -> None:
        """Process a key."""
        if key.change is Change.RELEASE:  # such a terminal sends none
            self.release()
        elif key.name in self.held(now_s).keys:
            self._hold, self._until_s = Hold({key.name}, 1.0), now_s + self.REPEAT_S
        else:
            self._hold, self._until_s = Hold({key.name}, self.FIRST_SHARE), now_s + self.FIRST_S

    def held(self, now_s: float) -> Hold:
        """Return the held keys."""
        return self._hold if now_s <= self._until_s else Hold(frozenset(), 1.0)

    def release(self) -> None:
        """Forget the held keys: only another press counts."""
        self._until_s = -math.inf


class Heartbeat:
    """Queries to a terminal that reports releases: one that does not answer could not report a release either.

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


class DeadManButton:
    """A gamepad's dead-man button. At first and after ``release`` it must be seen released before it can count as
    held.
    """

    def __init__(self) -> None:
        self._was_released = False

    def held(self, *, pressed: bool) -> bool:
        """Return whether the button counts as held."""
        self._was_released = self._was_released or not pressed
        return pressed and self._was_released

    def release(self) -> None:
        """Forget that the button is held."""
        self._was_released = False
