"""How late ticks began, as a histogram with fixed logarithmic buckets: its size does not grow with the run."""

import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import Any

_FIRST_NS = 1_000
_DECADES = 6
_A_DECADE = 10
EDGES_NS = tuple(round(_FIRST_NS * 10 ** (place / _A_DECADE)) for place in range(_DECADES * _A_DECADE + 1))
"""Edges between the buckets [ns], ten per decade from 1 µs to 1 s. The first bucket is below all, the last above.
"""
SHARES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


class Lateness:
    """A histogram of late ticks. ``counts[i]`` is the number from ``EDGES_NS[i - 1]`` to below ``EDGES_NS[i]``."""

    def __init__(self) -> None:
        self.counts = [0] * (len(EDGES_NS) + 1)
        self.worst_ns = 0

    def add(self, late_ns: int, ticks: int = 1) -> None:
        """Count ticks that began ``late_ns`` late; 0 if on time."""
        self.counts[bisect_right(EDGES_NS, late_ns)] += ticks
        if late_ns > self.worst_ns:
            self.worst_ns = late_ns

    def percentiles_us(self) -> dict[str, float]:
        """Return p50, p99 and p99.9 [µs] by these names, exact to a bucket's width; empty when nothing was counted."""
        total = sum(self.counts)
        return {name: self._below_which(share * total) * 1e-3 for name, share in SHARES.items()} if total else {}

    def figures(self) -> dict[str, Any] | None:
        """Return the percentiles, the maximum, the bucket edges [µs] and the counts; None before the first tick."""
        percentiles = self.percentiles_us()
        if not percentiles:
            return None
        edges = [edge_ns * 1e-3 for edge_ns in EDGES_NS]
        return {**percentiles, "max": self.worst_ns * 1e-3, "edges": edges, "counts": list(self.counts)}

    def _below_which(self, target: float) -> float:
        """Return the lateness [ns] that ``target`` ticks do not exceed, interpolated within its bucket."""
        passed = 0.0
        for low_ns, high_ns, count in self._buckets():
            if count and passed + count >= target:
                share = (target - passed) / count
                # Logarithmic like the buckets, except in the first one, which begins at 0.
                return low_ns * (high_ns / low_ns) ** share if low_ns else high_ns * share
            passed += count
        raise AssertionError  # the last bucket ends with the last tick

    def _buckets(self) -> Iterator[tuple[float, float, int]]:
        """Yield each bucket's begin, end and count; ends are limited to the worst lateness."""
        for low_ns, high_ns, count in zip((0, *EDGES_NS), (*EDGES_NS, math.inf), self.counts, strict=True):
            yield low_ns, max(low_ns, min(high_ns, self.worst_ns)), count
