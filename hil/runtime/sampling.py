"""When a tick samples, and when what it sampled has arrived: the loop's times, and the truth at each instant."""

from collections import deque
from typing import NamedTuple

from hil.core.ports import Clock, PoseSource
from hil.core.types import PoseFix
from hil.robot.port import Device


class Timing(NamedTuple):
    """The loop's times [ns]. Latencies are those that the scenario gives the link, per direction.

    What is older than ``stale_ns`` drives nothing.
    """

    period_ns: int
    command_latency_ns: int
    feedback_latency_ns: int
    stale_ns: int

    @property
    def latency_s(self) -> float:
        """From the sampling instant to the first firmware tick that uses the command, but for the link's own."""
        return (self.command_latency_ns + self.feedback_latency_ns) * 1e-9


class Sampling:
    """Waits for the ticks of a run, and keeps the truth of each sampling instant until its tick.

    Tick ``number`` samples at ``number`` periods after ``begin``, and is worked out a feedback latency later.
    """

    def __init__(self, clock: Clock, device: Device, truth: PoseSource | None, timing: Timing) -> None:
        self._clock = clock
        self._device = device
        self._truth = truth
        self._period_ns = timing.period_ns
        self._latency_ns = timing.feedback_latency_ns
        # From a sampling instant, in whole periods and the rest, until what the link brings of it is here.
        self._late_periods, self._late_rest_ns = divmod(self._latency_ns, self._period_ns)
        self._origin_ns = 0
        self._fixes: deque[tuple[int, PoseFix | None]] = deque()
        self._fix: PoseFix | None = None

    def begin(self, origin_ns: int) -> int:
        """Count the ticks from this instant on the clock; return the first, before which nothing has arrived."""
        self._origin_ns = origin_ns
        return -self._late_periods

    def wait(self, number: int) -> int:
        """Wait until what was sampled at the tick's instant has arrived; return the lateness [ns].

        Raises LinkError or RobotStoppedError where robot time stands still without the robot.
        """
        instant = number + self._late_periods
        late_ns = self._device.wait_until(self._origin_ns + instant * self._period_ns)
        fix = self._truth.poll() if self._truth is not None else None
        if self._late_periods:
            self._fixes.append((instant, fix))
        else:
            self._fix = fix
        if self._late_rest_ns:
            late_ns = self._device.wait_until(self._origin_ns + number * self._period_ns + self._latency_ns)
        return late_ns

    def fix_of(self, number: int) -> PoseFix | None:
        """Return the truth of the tick's sampling instant, or of the last one before it when ticks were skipped."""
        while self._fixes and self._fixes[0][0] <= number:
            self._fix = self._fixes.popleft()[1]
        return self._fix

    def following(self, number: int) -> int:
        """Return the next tick that can still begin on time."""
        elapsed_ns = self._clock.now_ns() - self._origin_ns - self._latency_ns
        due = -(-elapsed_ns // self._period_ns)
        return due if due > number else number + 1
