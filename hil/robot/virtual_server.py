"""Runs a virtual robot and serves its end of the link, in lockstep or in real time."""

import queue
import threading
import time
from collections.abc import Callable
from typing import Protocol, cast

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from firmware_protocol.host import View
from hil.core.clock import TICK_NS
from hil.core.types import PoseFix
from hil.robot.virtual import ClockedNode, RobotNode, VirtualStm32
from hil.wire.robot_end import Wire

# After a stall of this machine the robot catches up by this many ticks at once, as a real robot would have moved on.
# After a longer stall the rest of the time is lost, which is counted.
_CATCH_UP_TICKS = 50
_POLL_NS = 20_000_000
_ABANDONED_NS = 2_000_000_000


class WallClockNode:
    """A firmware whose clock follows the wall clock between its ticks, like that of a board."""

    def __init__(self, node: RobotNode, start_ns: int) -> None:
        self._node: ClockedNode = cast(ClockedNode, node)  # emulated boards, which lack it, run in lockstep only

        self._start_ns = start_ns

    def _set_clock(self) -> None:
        self._node.set_clock((time.monotonic_ns() - self._start_ns) // 1000)

    def feed(self, data: bytes) -> None:
        self._set_clock()
        self._node.feed(data)

    def receive(self, frame: Frame) -> None:
        self._set_clock()
        self._node.receive(frame)

    def take_bytes(self) -> bytes:
        self._set_clock()
        return self._node.take_bytes()

    def take_frames(self) -> list[Frame]:
        self._set_clock()
        return self._node.take_frames()

    def count_unsent(self, frames: int) -> None:
        self._node.count_unsent(frames)


class TruthSink(Protocol):
    """Receives the true pose: the control loop in this process, or the TCP server."""

    def publish(self, fix: PoseFix, view: View | None) -> None:
        """Publish the newest true pose, without blocking."""

    @property
    def needs_view(self) -> bool:
        """Whether the firmware's internal state is needed too."""


class VirtualServer:
    """Runs a virtual robot on its end of a link: with STEP in lockstep, by the wall clock in real time.

    ``slipped_ticks`` counts robot time lost to stalls of this machine.
    """

    def __init__(self, robot: VirtualStm32, wire: Wire, truth: TruthSink, *, lockstep: bool) -> None:
        self._robot = robot
        self._wire = wire
        self._truth = truth
        self._lockstep = lockstep
        self._stopping = threading.Event()
        self._start_ns = time.monotonic_ns()
        self._received_ns = self._start_ns
        self._ticks = 0
        self._reset: Callable[[bool], None] | None = None
        self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.slipped_ticks = 0
        self._publish()

    def request_reset(self, answer: Callable[[bool], None]) -> None:
        """Request a power cycle before the next exchange; ``answer`` is then called with True if it was done.

        It is refused while the robot is armed or moves, except in lockstep if the host has been silent for 2 s.
        """
        self._reset = answer

    def run_between_exchanges(self, action: Callable[[], None]) -> None:
        """Run a function before the next exchange, in the serving thread."""
        self._requests.put(action)

    def serve(self) -> None:
        """Serve until ``stop``. Raises LinkError when the link is lost, DeviceError when the plant fails."""
        while not self._stopping.is_set():
            self.service(_POLL_NS)

    def stop(self) -> None:
        """Make ``serve`` return; may be called from another thread or a signal handler."""
        self._stopping.set()

    def service(self, timeout_ns: int) -> None:
        """Wait at most ``timeout_ns`` for frames, and do what is due."""
        if self._reset is not None or not self._requests.empty():
            self._handle_requests()
        if self._lockstep:
            if self._wire.receive_into(self._robot.node, timeout_ns):
                self._received_ns = time.monotonic_ns()
                self._publish()
                self._send()
        else:
            self._serve_real_time()

    def advance(self, ticks: int) -> None:
        """Lockstep with a robot whose protocol has no STEP: read the sent messages, and run a number of ticks."""
        self._handle_requests()
        # Read until nothing is left: one message may arrive in several pieces.
        while self._wire.receive_into(self._robot.node, 0):
            pass
        for _ in range(ticks):
            self._robot.node.run(1)
            self._send()
        self._publish()

    def _handle_requests(self) -> None:
        if self._reset is not None:
            self._power_cycle()
        while not self._requests.empty():
            self._requests.get()()

    def _send(self) -> None:
        """Send the robot's frames. If a reset fault has switched it off, it is first switched on again."""
        self._wire.send_from(self._robot.awake())

    def _serve_real_time(self) -> None:
        next_ns = self._start_ns + (self._ticks + 1) * TICK_NS
        now_ns = time.monotonic_ns()
        node = WallClockNode(self._robot.node, self._start_ns)
        if now_ns < next_ns:
            if self._wire.receive_into(node, next_ns - now_ns):
                # Send at once: an answer to TIME_SYNC must not wait for the next tick.
                self._wire.send_from(node)
            return
        while self._wire.receive_into(node, 0):
            pass
        due = (now_ns - self._start_ns) // TICK_NS - self._ticks
        if due > _CATCH_UP_TICKS:
            slipped = due - _CATCH_UP_TICKS
            self._start_ns += slipped * TICK_NS
            self.slipped_ticks += slipped
            due = _CATCH_UP_TICKS
        # With the slow-clock fault the plant runs more ticks than the firmware counts.
        missed = self._robot.faults.extra_ticks
        self._robot.node.run(due)
        self._ticks += due + self._robot.faults.extra_ticks - missed
        self._publish()
        self._send()

    def _publish(self) -> None:
        view = self._robot.node.look() if self._truth.needs_view else None
        fix = self._robot.plant.truth()
        if ahead := self._robot.faults.ahead:  # times are those of the firmware
            fix = fix._replace(time_ns=fix.time_ns + ahead * TICK_NS)
        self._truth.publish(fix, view)
        if view is not None and view.plant_failed and (failure := self._robot.failure()) is not None:
            raise failure

    def _power_cycle(self) -> None:
        answer, self._reset = self._reset, None
        at_rest = self._robot.node.look().state not in (State.ARMED, State.ACTIVE, State.STOPPING)
        # In lockstep no time passes without a host, so the watchdog cannot disarm a robot whose host has gone.
        abandoned = self._lockstep and time.monotonic_ns() - self._received_ns > _ABANDONED_NS
        at_rest = at_rest or abandoned
        if at_rest:
            self._robot.power_cycle()
            self._start_ns = time.monotonic_ns()
            self._ticks = 0
            self._publish()
        if answer is not None:
            answer(at_rest)


class LocalTruth:
    """The true pose within one process, by a direct call."""

    needs_view = False

    def __init__(self) -> None:
        self._fix: PoseFix | None = None

    def publish(self, fix: PoseFix, view: View | None) -> None:
        self._fix = fix

    def poll(self) -> PoseFix | None:
        return self._fix

    def close(self) -> None:
        """Nothing to release."""
