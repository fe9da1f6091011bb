"""Lockstep from the host's side: STEP is repeated until the robot has answered it, and a wrong tick is noticed."""

import time
from collections.abc import Callable

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.devices.handshake import RETRY_NS, SILENCE_NS
from hil.errors import RobotStoppedError
from hil.ports import Link, Received


def await_done(link: Link, step: m.Step, take: Callable[[Received], codec.Message | None]) -> m.StepDone:
    """Give ``take`` what comes until the answer to a STEP that was sent; return that. 0 substeps only ask for the tick.

    Raises RobotStoppedError when none comes within 2 s of wall-clock time, or one with a tick that was not expected.
    """
    expected = (step.tick + step.substeps) & 0xFFFF_FFFF if step.substeps else None
    begin_ns = sent_ns = time.monotonic_ns()
    while True:
        received = link.receive(RETRY_NS)
        message = take(received) if received is not None else None
        # An answer with the tick where this step begins is the second one to a step that was sent twice.
        if isinstance(message, m.StepDone) and (expected is None or message.tick != step.tick):
            if expected not in (None, message.tick):
                raise RobotStoppedError(
                    f"the robot is at tick {message.tick} where {expected} was expected; it was reset or is stepped by "
                    "another host"
                )
            return message
        now_ns = time.monotonic_ns()
        if now_ns - begin_ns > SILENCE_NS:
            raise RobotStoppedError("the robot did not answer STEP within 2 s of wall-clock time; it was lost")
        if received is None and now_ns - sent_ns > RETRY_NS:
            # Idempotent, and outside the hash: how often it is repeated depends on the wall clock.
            link.send(codec.encode(step))
            sent_ns = now_ns
