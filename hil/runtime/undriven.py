"""The ticks of a run in which its law drove nothing, and which of them a fault of the scenario explains."""

from collections.abc import Sequence

from hil.faults.rows import FaultRow, find
from hil.judge.allowed import Counted
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import can_hold

_LATE_KINDS = ("delay", "jitter")  # their value is a time for which frames are still on their way after the window


class Undriven:
    """Counts the ticks in which the robot was not driven, as stale or as held.

    A stale tick is one in which the feedback was too old, or a truth on which the state rests. In a held one the robot
    was held at rest, or not commanded, for any other reason: its state was unknown, or it was away.

    A fault that can take feedback, state or robot away explains the ticks of a streak from the first one on at which
    it may have shown: so what it takes to come back, however long, belongs to it. It may show in a tick that samples
    so much before the fault as feedback takes to arrive, and for as long after it as commands and feedback are on
    their way and old ones are still fresh enough.

    Nothing explains a run of which no tick was driven: it shows nothing of the law.
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
        """Take a tick that was driven: it ends a streak."""
        self._is_explained = False

    def hold(self, t_ns: int, *, is_stale: bool) -> None:
        """Take a tick of the scenario's time that was not driven."""
        if not self._is_explained:
            self._is_explained = any(start <= t_ns <= end for start, end in self._windows)
        if is_stale:
            self._stale += 1
            self._stale_explained += self._is_explained
        else:
            self._held += 1
            self._held_explained += self._is_explained

    def counted(self, ticks: int) -> dict[str, Counted]:
        """Return the counts by the names that ``[allow]`` has for them, for a run of so many ticks."""
        if self._stale + self._held == ticks:
            return {"stale_ticks": Counted(self._stale, self._stale), "held_ticks": Counted(self._held, self._held)}
        return {
            "stale_ticks": Counted(self._stale, self._stale - self._stale_explained),
            "held_ticks": Counted(self._held, self._held - self._held_explained),
        }


def _last_ns(row: FaultRow) -> int:
    return row.start_ns if find(row.kind, row.target).is_instant else row.end_ns


def _on_the_way_ns(row: FaultRow) -> int:
    return round(row.value * 1e9) if row.kind in _LATE_KINDS else 0
