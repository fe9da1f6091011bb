"""Pose fixes like those of a lidar's SLAM, made from the truth: late, noisy, sometimes wrong or missing."""

import math
import random
from collections import deque
from collections.abc import Sequence
from typing import Any

from hil.core.types import MeasuredPose, Pose, PoseCovariance, PoseFix
from hil.estimation.estimators import SimulatedOptions

_NS = 1e9


class SimulatedFixes:
    """A FixSource on robot time: in lockstep one seed gives the same fixes in every run.

    The first sample of the truth of each period of 1 / ``rate_hz`` becomes a fix, stamped with its own time, which
    arrives ``latency_s`` later. An outlier is off by ``outlier_m`` in any direction and turned by up to that many
    radians; its covariance does not show it, as in reality. Every fix draws the same random numbers in the same order,
    so an option changes only its own effect.

    ``truth_age_ns`` is the age of the truth when it arrives: the link's feedback latency. A reset of the robot does not
    change the truth's clock, which is the plant's. The offset of the robot's new clock follows from this age.
    """

    def __init__(self, options: SimulatedOptions, seed: int, truth_age_ns: int = 0) -> None:
        self._options = options
        self._truth_age_ns = truth_age_ns
        self._ahead_ns: int | None = 0  # the robot's clock ahead of the truth's; None until it is known again
        self._random = random.Random(f"pose fixes {seed}")
        self._period_ns = round(_NS / options.rate_hz)
        self._latency_ns = round(options.latency_s * _NS)
        position, heading = options.sigma_m**2, options.sigma_rad**2
        self._covariance = PoseCovariance(position, 0.0, 0.0, position, 0.0, heading)
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
            fix = self._make(truth.pose, time_ns, (truth.time_ns - self._first_ns) / _NS)
            if fix is not None:
                self._on_their_way.append(fix)

    def _make(self, truth: Pose, time_ns: int, t_s: float) -> MeasuredPose | None:
        options, chance = self._options, self._random
        x_m, y_m = (chance.gauss(0.0, options.noisier * options.sigma_m) for _ in "xy")
        heading_rad = chance.gauss(0.0, options.noisier * options.sigma_rad)
        is_outlier = chance.random() < options.outlier_probability
        direction_rad, turned_rad = chance.uniform(-math.pi, math.pi), chance.uniform(-1.0, 1.0) * options.outlier_m
        is_dropped = chance.random() < options.dropout_probability
        self._counts["made"] += 1
        if is_dropped or options.gap_start_s <= t_s < options.gap_end_s:
            self._counts["dropped"] += 1
            return None
        if is_outlier:
            self._counts["outliers"] += 1
            x_m += options.outlier_m * math.cos(direction_rad)
            y_m += options.outlier_m * math.sin(direction_rad)
            heading_rad += turned_rad
        x, y, heading = truth
        return MeasuredPose(time_ns, Pose(x + x_m, y + y_m, heading + heading_rad), self._covariance)
