"""Counts ticks without a drive and rejected frames, and how many of them no fault explains."""

import math
import struct
from collections.abc import Sequence

from firmware_protocol.generated.messages import State
from hil.faults.rows import FaultRow
from hil.judge.expectations import Count, rejected_and_unmatched
from hil.robot.port import Device
from hil.runtime.sampling import Timing

_value_at = struct.Struct("d").unpack_from  # at an offset in a row
_REPORTED_S = 0.15
"""Time in which a robot reports its counts at least once: every 0.1 s, and late."""


class NotDriven:
    """Counts the ticks without a driven robot, and those of them that no fault of the scenario explains.

    There are two kinds. A tick is stale if the feedback, or the true pose that the estimate uses, was too old. Any
    other is held: the robot's state was unknown, the estimator was lost, or the robot was not connected.

    A streak is an unbroken row of such ticks. A fault that can cut off feedback, state or robot explains all ticks of a
    streak from the first one that it can have affected, so also the time that the robot needs to recover. Its window
    begins one feedback latency before it, because a sample of that time was still on its way, and ends after it by both
    latencies, the age at which feedback is too old, two periods and, for a fault that delays frames, its delay.

    If no tick of the whole run was driven, no fault explains any: such a run does not test the law.

    Attributes:
        is_explained: whether a fault explains the present streak.
    """

    def __init__(self, faults: Sequence[FaultRow], timing: Timing) -> None:
        self._windows = _windows(faults, timing)
        self.is_explained = False
        self._stale = self._stale_explained = 0
        self._held = self._held_explained = 0

    def drive(self) -> None:
        """Record a tick that was driven. It ends the streak."""
        self.is_explained = False

    def hold(self, t_ns: int, *, is_stale: bool) -> None:
        """Record a tick that was not driven; ``t_ns`` is its time in the scenario."""
        if not self.is_explained:
            self.is_explained = any(start <= t_ns <= end for start, end in self._windows)
        if is_stale:
            self._stale += 1
            self._stale_explained += self.is_explained
        else:
            self._held += 1
            self._held_explained += self.is_explained

    def counts(self, ticks: int) -> dict[str, Count]:
        """Return all and the unexplained ticks of each kind, by its key in ``[allow]``; ``ticks`` is all of the run."""
        stale, held = self._stale_explained, self._held_explained
        if self._stale + self._held == ticks:
            stale = held = 0
        return {
            "stale_ticks": Count(self._stale, self._stale - stale),
            "held_ticks": Count(self._held, self._held - held),
        }


class Rejections:
    """Counts rejected frames and torque feedforwards without their command, and which of them no fault explains.

    Host and robot reject frames. A ``[[fault]]`` that can cut off feedback, state or robot explains all counts from its
    beginning. It ceases to do so after three events in turn: its window has ended (``NotDriven`` defines it), the robot
    is driven again, and the robot has reported its counters. Nothing before t = 0 is counted; ``counts`` returns the
    result. With ``watches``, for a run that tests the robot's own stop, an explained time also begins when the robot
    leaves the state ACTIVE. It then rejects commands that are still on their way.
    It is a sink: if ``needs_rows`` is true, ``put`` has to get the row of each tick, with ``needs`` among its
    ``names``.
    """

    needs = ("loop.t_s", "guard.held", "robot.state")

    def __init__(
        self, device: Device, faults: Sequence[FaultRow], timing: Timing, names: Sequence[str], *, watches: bool = False
    ) -> None:
        self._device = device
        self._t_at, self._held_at, self._state_at = (8 * names.index(name) for name in self.needs)
        self._watches = watches
        windows = sorted(_windows(faults, timing))
        # From the row before: what is counted in the first tick of a window is already in its row.
        before_ns = 2 * timing.period_ns
        self.windows = [((start - before_ns) * 1e-9, end * 1e-9 + _REPORTED_S) for start, end in windows]
        self._next_s = self.windows[0][0] if windows else math.inf
        self.needs_rows = watches or bool(windows)
        self._at_begin = (0, 0)
        self._at_start: tuple[int, int] | None = None  # of the window that is open
        self._explained = [0, 0]

    def begin(self) -> None:
        """Begin to count, at t = 0."""
        self._at_begin = self._read()
        if self._next_s <= 0.0:
            self._open(0.0)

    def put(self, row: bytes) -> None:
        (t_s,) = _value_at(row, self._t_at)
        if self._watches and _value_at(row, self._state_at)[0] != State.ACTIVE:
            self._watches = False
            self.windows.insert(0, (t_s, t_s + _REPORTED_S))
            self._next_s = min(self._next_s, t_s)
        if t_s < self._next_s:
            return
        if self._at_start is not None:
            if _value_at(row, self._held_at)[0]:
                self._next_s = t_s + _REPORTED_S
                return
            self._close(self._at_start)
        self._open(t_s)

    def _open(self, t_s: float) -> None:
        """Open the windows that have begun, if one of them still lasts."""
        begun = [window for window in self.windows if window[0] <= t_s]
        self.windows = self.windows[len(begun) :]
        end_s = max((end_s for _, end_s in begun), default=t_s)
        if end_s > t_s:
            self._at_start, self._next_s = self._read(), end_s
        else:
            self._next_s = self.windows[0][0] if self.windows else math.inf

    def counts(self) -> dict[str, Count]:
        """Return the counts of the run by their keys in ``[allow]``."""
        if self._at_start is not None:
            self._close(self._at_start)
        both = zip(self._read(), self._at_begin, self._explained, strict=True)
        counts = (Count(now - before, now - before - explained) for now, before, explained in both)
        return dict(zip(("rejected", "unmatched"), counts, strict=True))

    def _close(self, at_start: tuple[int, int]) -> None:
        changes = zip(self._explained, self._read(), at_start, strict=True)
        self._explained = [explained + now - before for explained, now, before in changes]
        self._at_start = None

    def _read(self) -> tuple[int, int]:
        return rejected_and_unmatched(self._device.rejected())


def _windows(rows: Sequence[FaultRow], timing: Timing) -> list[tuple[int, int]]:
    """Return the times [ns] from and to which each fault that can keep ticks from being driven affects them."""
    if not rows:
        return []
    from hil.faults.kinds import find
    from hil.runtime.signal_faults import can_hold

    tail_ns = timing.command_latency_ns + timing.feedback_latency_ns + timing.stale_ns + 2 * timing.period_ns
    windows = []
    for row in rows:
        if can_hold(row):
            kind = find(row.kind, row.target)
            last_ns = row.start_ns if kind.is_instant else row.end_ns
            late_ns = round(row.value * 1e9) if kind.delays else 0  # frames may arrive this long after the window
            windows.append((row.start_ns - timing.feedback_latency_ns, last_ns + tail_ns + late_ns))
    return windows
