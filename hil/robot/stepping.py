"""The host's side of lockstep: sends STEP until the robot answers, and checks the tick in the answer."""

import time
from collections.abc import Callable

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.core.errors import RobotStoppedError
from hil.core.ports import Link, Received
from hil.robot.handshake import RETRY_NS, SILENCE_NS


class Stepping:
    """Exchanges one STEP after the other. ``tick`` is the last firmware tick that the robot has reported."""

    def __init__(self) -> None:
        self.tick = 0
        self._from = 0
        self._expected: int | None = None
        self._is_awaiting = False

    def exchange(self, link: Link, step: m.Step, on_received: Callable[[Received], None]) -> None:
        """Pass received frames to ``on_received`` until ``step`` is answered; 0 substeps only ask for the tick.

        ``on_received`` must pass each STEP_DONE to ``answered``. Raises RobotStoppedError when no answer comes within
        2 s of wall-clock time, or the answer has an unexpected tick.
        """
        tick, substeps = step
        self._from = tick
        self._expected = (tick + substeps) & 0xFFFF_FFFF if substeps else None
        self._is_awaiting = True
        begin_ns = sent_ns = time.monotonic_ns()
        while True:
            received = link.receive(RETRY_NS)
            if received is not None:
                on_received(received)
                if not self._is_awaiting:
                    return
            now_ns = time.monotonic_ns()
            if now_ns - begin_ns > SILENCE_NS:
                raise RobotStoppedError("the robot did not answer STEP within 2 s of wall-clock time; it was lost")
            if received is None and now_ns - sent_ns > RETRY_NS:
                # STEP is idempotent. Repeats are not hashed, because their number depends on the wall clock.
                link.send(codec.encode(step))
                sent_ns = now_ns

    def answered(self, tick: int) -> bool:
        """Record an answer; return whether it is the expected one. Raises RobotStoppedError for a wrong tick."""
        # An answer with the first tick of this step is a second answer to the previous step, which was sent twice.
        if not self._is_awaiting or (self._expected is not None and tick == self._from):
            return False
        if self._expected not in (None, tick):
            raise RobotStoppedError(
                f"the robot is at tick {tick} where {self._expected} was expected; it was reset or is stepped by "
                "another host"
            )
        self._is_awaiting = False
        self.tick = tick
        return True
