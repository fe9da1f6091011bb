"""The two clocks of a run. Deadlines are absolute times; time is never accumulated from sleeps."""

import time
from collections.abc import Callable

TICK_NS = 1_000_000  # the firmware's tick
LONGEST_STEP_S = 0.02  # of a plant: in it a wheel at 157 rad/s turns by half a turn, which a wrapped angle still tells


class WallClock:
    """Real time since the clock was made."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._start_ns

    def wait_until(self, t_ns: int) -> int:
        while (left_ns := t_ns - self.now_ns()) > 0:
            time.sleep(left_ns * 1e-9)
        return -left_ns


class LockstepClock:
    """Time in lockstep: it advances only while ``wait_until`` runs the robot, so it is never late.

    ``step`` runs the robot for a number of firmware ticks; who makes the robot's session sets it before time passes.
    """

    step: Callable[[int], None]

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, t_ns: int) -> int:
        now_ns = self._now_ns
        ticks = (t_ns - now_ns) // TICK_NS
        if ticks > 0:
            # Frames that the robot sends during the step get the time of the step's end.
            self._now_ns, step = now_ns + ticks * TICK_NS, self.step
            try:
                step(ticks)
            except BaseException:
                # The robot did not complete the step. Once it is back, the same ticks are run.
                self._now_ns = now_ns
                raise
        return 0
