"""Pose fixes like those of a lidar's SLAM, made from the truth: late, noisy, sometimes wrong or missing."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

from hil.core.types import MeasuredPose, PoseFix
from hil.estimation.fix_errors import FixErrors, SimulatedOptions

_NS = 1e9


class SimulatedFixes:
    """A FixSource on robot time: in lockstep one seed gives the same fixes in every run.

    The first sample of the truth of each period of 1 / ``rate_hz`` becomes a fix, stamped with its own time, which
    arrives ``latency_s`` later. ``fix_errors`` says how it errs.

    ``truth_age_ns`` is the age of the truth when it arrives: the link's feedback latency. A reset of the robot does not
    change the truth's clock, which is the plant's. The offset of the robot's new clock follows from this age.
    """

    def __init__(self, options: SimulatedOptions, seed: int, truth_age_ns: int = 0) -> None:
        self._truth_age_ns = truth_age_ns
        self._ahead_ns: int | None = 0  # the robot's clock ahead of the truth's; None until it is known again
        self._errors = FixErrors(options, seed)
        self._period_ns = round(_NS / options.rate_hz)
        self._latency_ns = round(options.latency_s * _NS)
        self._on_their_way: deque[MeasuredPose] = deque()
        self._first_ns: int | None = None
        self._period: int | None = None
        self._counts = {"made": 0, "outliers": 0, "dropped": 0, "received": 0}

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        """Add the newest truth and return the fixes that have arrived."""
        if truth is not None and math.isfinite(sum(truth.pose)):
            if self._ahead_ns is None:
                self._ahead_ns = now_ns - self._truth_age_ns - truth.time_ns
            self._sample(truth, truth.time_ns + self._ahead_ns)
        arrived = []
        while self._on_their_way and self._on_their_way[0].time_ns + self._latency_ns <= now_ns:
            arrived.append(self._on_their_way.popleft())
        self._counts["received"] += len(arrived)
        return arrived

    def skip(self) -> None:
        """Do nothing: each fix has its stamp, so none looks newer than it is."""

    def restart(self) -> None:
        """Stamp by the new clock; fixes under way had stamps of the old one and are lost."""
        self._on_their_way.clear()
        self._ahead_ns = None
        self._period = None

    def figures(self) -> dict[str, Any]:
        """Return the number of fixes made, and of each outcome."""
        return dict(self._counts)

    def close(self) -> None:
        """Do nothing: it holds nothing open."""

    def _sample(self, truth: PoseFix, time_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = truth.time_ns
        period = time_ns // self._period_ns
        if period != self._period:
            self._period = period
            match = self._errors.next(truth.pose, (truth.time_ns - self._first_ns) / _NS)
            self._counts["made"] += 1
            if match.is_missing:
                self._counts["dropped"] += 1
                return
            self._counts["outliers"] += match.is_outlier
            self._on_their_way.append(MeasuredPose(time_ns, match.pose, self._errors.covariance))
