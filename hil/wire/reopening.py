"""Reopening a lost link: the waits between attempts, and an attempt that may take seconds."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any, Generic, TypeVar

_FIRST_NS = 100_000_000


class BackOff:
    """The waits between attempts: 0.1 s, and twice as long each time, up to a longest. ``wait_ns`` is the next one."""

    def __init__(self, longest_ns: int = 2_000_000_000) -> None:
        self.wait_ns = _FIRST_NS
        self._longest_ns = longest_ns

    def next_ns(self) -> int:
        """Return the next wait, and double the one after it."""
        wait_ns, self.wait_ns = self.wait_ns, min(2 * self.wait_ns, self._longest_ns)
        return wait_ns


T = TypeVar("T")


class OpeningBeside(Generic[T]):
    """Calls ``opened`` at once in its own thread. Afterwards either take the ``result``, or ``abandon`` it.

    The result must have a method ``close``.
    """

    def __init__(self, opened: Callable[[], T]) -> None:
        self._opened = opened
        self._future: Future[Any] = Future()
        threading.Thread(target=self._run, name="opening", daemon=True).start()

    def _run(self) -> None:
        try:
            self._future.set_result(self._opened())
        except Exception as error:  # noqa: BLE001 - result() raises it in the caller's thread
            self._future.set_exception(error)

    def result(self, within_s: float) -> T | None:
        """Return the result of ``opened``; None if it takes longer than ``within_s``. Raises as ``opened``."""
        result: T | None = self._future.result() if wait([self._future], within_s).done else None
        return result

    def abandon(self) -> None:
        """Close the result: now, or as soon as it is open."""
        self._future.add_done_callback(lambda done: done.exception() or done.result().close())
