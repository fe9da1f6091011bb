"""Reopening a lost link: the waits between attempts, and an attempt that may take seconds."""

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

_FIRST_NS = 100_000_000
_LONGEST_NS = 2_000_000_000


class BackOff:
    """The waits between attempts: 0.1 s, and twice as long each time, up to 2 s. ``wait_ns`` is the next one."""

    def __init__(self) -> None:
        self.wait_ns = _FIRST_NS

    def next_ns(self) -> int:
        """Return the next wait, and double the one after it."""
        wait_ns, self.wait_ns = self.wait_ns, min(2 * self.wait_ns, _LONGEST_NS)
        return wait_ns


T = TypeVar("T")


class OpeningBeside(Generic[T]):
    """Calls ``opened`` at once in its own thread. Afterwards either ``result`` the result, or ``abandon`` it.

    The result must have a method ``close``.
    """

    def __init__(self, opened: Callable[[], T]) -> None:
        self._opened = opened
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._result: Any = None
        self._failure: Exception | None = None
        self._abandoned = False
        threading.Thread(target=self._run, name="opening", daemon=True).start()

    def _run(self) -> None:
        try:
            result: Any = self._opened()
        except Exception as error:  # noqa: BLE001 - result() raises it in the caller's thread
            self._failure = error
        else:
            with self._lock:
                is_late = self._abandoned
                self._result = None if is_late else result
            if is_late:
                result.close()
        self._done.set()

    def result(self, within_s: float) -> T | None:
        """Return what was opened; None if that takes longer than ``within_s``. Raises what ``opened`` raised."""
        if not self._done.wait(within_s):
            return None
        if self._failure is not None:
            raise self._failure
        result: T | None = self._result
        return result

    def abandon(self) -> None:
        """Close what was opened: now, or as soon as it is open."""
        with self._lock:
            self._abandoned = True
            result, self._result = self._result, None
        if result is not None:
            result.close()
