"""Waiting for another process no longer than it makes progress."""

import time


class Patience:
    """Counts waits without progress: a suspended program must not mistake its own absence for a dead peer."""

    def __init__(self, waits: int, wait_s: float = 0.0005) -> None:
        self._waits = waits
        self._wait_s = wait_s
        self._left = waits
        self._progress: object = None

    def wait(self, progress: object) -> bool:
        """Wait a little; False when ``progress`` has stayed the same for all the waits that were granted."""
        if progress != self._progress:
            self._progress = progress
            self._left = self._waits
        self._left -= 1
        time.sleep(self._wait_s)
        return self._left > 0
