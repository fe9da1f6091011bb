"""Faults on demand: a link that drops, repeats or mutes frames in a window of the scenario's time, from a seed."""

import random
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import NAMES
from hil.links.delay import FIRST_EXEMPT_ID, NowNs
from hil.ports import Link, Received


class Fault(NamedTuple):
    """One fault of a scenario; ``direction`` is ``command`` or ``feedback``, ``message`` a DBC name or None."""

    kind: str
    direction: str | None
    message: str | None
    start_ns: int
    end_ns: int
    probability: float


class FaultLink:
    """Applies faults to the frames of a link; ``applied`` counts how often each did something.

    Time is the scenario's, so nothing happens before ``begin`` is called at the first ACTIVE tick.
    """

    def __init__(self, link: Link, clock: NowNs, faults: Sequence[Fault], seed: int) -> None:
        self._link = link
        self._clock = clock
        self._faults = faults
        self._random = random.Random(seed)
        self._origin_ns: int | None = None
        self._repeated: deque[Received] = deque()
        self.applied = [0] * len(faults)

    def begin(self, origin_ns: int) -> None:
        """Say when the scenario's time began."""
        self._origin_ns = origin_ns

    def _copies(self, frame: Frame, direction: str) -> int:
        """How often the frame goes on: 0 when dropped, 1, or 2 when repeated."""
        if self._origin_ns is None or frame.id >= FIRST_EXEMPT_ID:
            return 1
        t_ns = self._clock.now_ns() - self._origin_ns
        copies = 1
        for i, fault in enumerate(self._faults):
            if not fault.start_ns <= t_ns < fault.end_ns or fault.direction not in (None, direction):
                continue
            if fault.message not in (None, NAMES.get(frame.id)):
                continue
            if self._random.random() >= fault.probability:
                continue
            self.applied[i] += 1
            copies = 2 * copies if fault.kind == "duplicate" else 0
        return copies

    def send(self, frame: Frame) -> None:
        for _ in range(self._copies(frame, "command")):
            self._link.send(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        if self._repeated:
            return self._repeated.popleft()
        while (received := self._link.receive(timeout_ns)) is not None:
            copies = self._copies(received.frame, "feedback")
            if copies:
                self._repeated.extend([received] * (copies - 1))
                return received
        return None

    def rejected(self) -> dict[str, int]:
        return self._link.rejected()

    def reopen(self) -> None:
        self._repeated.clear()
        self._link.reopen()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        self._link.close()
