"""The loop's times: when a tick samples, when its samples have arrived, and the truth at each sampling instant."""

from collections import deque
from typing import NamedTuple

from hil.core.ports import Clock, PoseSource
from hil.core.types import PoseFix
from hil.robot.port import Device


class Timing(NamedTuple):
    """The loop's times [ns]. The latencies are those of the scenario's ``[link]``.

    ``stale_ns`` is the greatest age of feedback or truth at which the robot is still driven.
    """

    period_ns: int
    command_latency_ns: int
    feedback_latency_ns: int
    stale_ns: int

    @property
    def latency_s(self) -> float:
        """Time from sampling to the first firmware tick that uses the command [s], without the line's own delay."""
        return (self.command_latency_ns + self.feedback_latency_ns) * 1e-9


class Sampling:
    """Waits for the ticks of a run, and keeps the truth of each sampling instant until its tick.

    Tick n takes its sample n periods after the instant given to ``begin``. It is computed one feedback latency later.
    """

    def __init__(self, clock: Clock, device: Device, truth: PoseSource | None, timing: Timing) -> None:
        self._clock = clock
        self._device = device
        self._poll_truth = None if truth is None else truth.poll
        self._period_ns = timing.period_ns
        self._latency_ns = timing.feedback_latency_ns
        # The feedback latency in whole periods, and the rest of it.
        self._late_periods, self._late_rest_ns = divmod(self._latency_ns, self._period_ns)
        self._origin_ns = 0
        self._fixes: deque[tuple[int, PoseFix | None]] = deque()
        self._fix: PoseFix | None = None

    def begin(self, origin_ns: int) -> int:
        """Set the instant of tick 0 on the clock; return the first tick to wait for, negative with a latency."""
        self._origin_ns = origin_ns
        return -self._late_periods

    def wait(self, number: int) -> int:
        """Wait until the samples of the tick's instant have arrived; return the lateness [ns].

        In lockstep it raises LinkError or RobotStoppedError when the robot is lost or stopped: its time stands still.
        """
        instant = number + self._late_periods
        late_ns = self._device.wait_until(self._origin_ns + instant * self._period_ns)
        poll_truth = self._poll_truth
        fix = poll_truth() if poll_truth is not None else None
        if self._late_periods:
            self._fixes.append((instant, fix))
        else:
            self._fix = fix
        if self._late_rest_ns:
            late_ns = self._device.wait_until(self._origin_ns + number * self._period_ns + self._latency_ns)
        return late_ns

    def fix_of(self, number: int) -> PoseFix | None:
        """Return the truth of the tick's sampling instant; when ticks were skipped, the last one before it."""
        while self._fixes and self._fixes[0][0] <= number:
            self._fix = self._fixes.popleft()[1]
        return self._fix

    def following(self, number: int) -> int:
        """Return the next tick that can still begin on time."""
        elapsed_ns = self._clock.now_ns() - self._origin_ns - self._latency_ns
        due = -(-elapsed_ns // self._period_ns)
        return due if due > number else number + 1
