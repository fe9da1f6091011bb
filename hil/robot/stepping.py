"""Lockstep on the host's side: STEP is repeated until the robot answers, and the tick in the answer is checked."""

import time
from collections.abc import Callable

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.core.errors import RobotStoppedError
from hil.core.ports import Link, Received
from hil.robot.handshake import RETRY_NS, SILENCE_NS


class Stepping:
    """One STEP after the other. ``tick`` is the firmware tick that the robot has said it reached."""

    def __init__(self) -> None:
        self.tick = 0
        self._from = 0
        self._expected: int | None = None
        self._is_awaiting = False

    def exchange(self, link: Link, step: m.Step, on_received: Callable[[Received], None]) -> None:
        """Call ``on_received`` with what arrives until a STEP is answered; 0 substeps only ask for the tick.

        ``on_received`` hands each STEP_DONE to ``answered``. Raises RobotStoppedError when none comes within 2 s of
        wall-clock time, or one with a tick that was not expected.
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
                # Idempotent, and outside the hash: how often it is repeated depends on the wall clock.
                link.send(codec.encode(step))
                sent_ns = now_ns

    def answered(self, tick: int) -> bool:
        """Record an answer; return whether it is the awaited one. Raises RobotStoppedError for a wrong tick."""
        # One with the tick where this step begins is the second answer to a step that was sent twice.
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
