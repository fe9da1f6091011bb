"""The ticks of a run in which the robot was not driven, and which of them a fault of the scenario explains."""

from collections.abc import Sequence

from hil.faults.kind import FaultRow
from hil.faults.kinds import find
from hil.judge.expectations import TickCount
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import can_hold

_LATE_KINDS = ("delay", "jitter")  # their value is a time [s] by which frames may arrive after the window


class Undriven:
    """Counts the ticks in which the robot was not driven, and those of them that no fault of the scenario explains.

    There are two kinds. A tick is stale if the feedback, or the true pose that the estimate uses, was too old. Any
    other undriven tick is held: the robot's state was unknown, the estimator was lost, or the robot was not connected.

    A streak is an unbroken row of undriven ticks. A fault that can cut off feedback, state or robot explains all ticks
    of a streak from the first one that it can have affected. So it also explains the time that the robot needs to
    recover, however long that is. A fault can affect ticks in a window that is longer than the fault. The window begins
    one feedback latency before it, because a sample of that time was still on its way. The window ends after it by both
    latencies, the age at which feedback is too old, two periods and, for a fault that delays frames, its delay.

    If no tick of the whole run was driven, no fault explains any: such a run does not test the law.
    """

    def __init__(self, faults: Sequence[FaultRow], timing: Timing) -> None:
        tail_ns = timing.command_latency_ns + timing.feedback_latency_ns + timing.stale_ns + 2 * timing.period_ns
        self._windows = [
            (row.start_ns - timing.feedback_latency_ns, _last_ns(row) + tail_ns + _on_the_way_ns(row))
            for row in faults
            if can_hold(row)
        ]
        self._is_explained = False
        self._stale = self._stale_explained = 0
        self._held = self._held_explained = 0

    def drive(self) -> None:
        """Record a tick that was driven. It ends the streak."""
        self._is_explained = False

    def hold(self, t_ns: int, *, is_stale: bool) -> None:
        """Record a tick that was not driven; ``t_ns`` is its time in the scenario."""
        if not self._is_explained:
            self._is_explained = any(start <= t_ns <= end for start, end in self._windows)
        if is_stale:
            self._stale += 1
            self._stale_explained += self._is_explained
        else:
            self._held += 1
            self._held_explained += self._is_explained

    def counts(self, ticks: int) -> dict[str, TickCount]:
        """Return all and the unexplained ticks of each kind, by its key in ``[allow]``; ``ticks`` is all of the run."""
        if self._stale + self._held == ticks:
            return {"stale_ticks": TickCount(self._stale, self._stale), "held_ticks": TickCount(self._held, self._held)}
        return {
            "stale_ticks": TickCount(self._stale, self._stale - self._stale_explained),
            "held_ticks": TickCount(self._held, self._held - self._held_explained),
        }


def _last_ns(row: FaultRow) -> int:
    return row.start_ns if find(row.kind, row.target).is_instant else row.end_ns


def _on_the_way_ns(row: FaultRow) -> int:
    return round(row.value * 1e9) if row.kind in _LATE_KINDS else 0
