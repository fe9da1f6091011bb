"""Times of a link, from messages and their times: round trip, latency, the robot's clock against the host's. No I/O.

Times are on the clock of the run [ns], taken at the host's end of the link. Latency and faults that a scenario adds to
the link are therefore included, like those of a real link.
"""

import statistics
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.extension import library, wheel
from hil.core.percentiles import Reservoir
from hil.core.types import NAN, Applied

SYNC_PERIOD_NS = 250_000_000  # PROTOCOL.md, "Time": 4 Hz
_STAGES = 8
_FITTED = 64
_STEP_NS = 128_000_000
_SHORTEST_FIT_NS = 1_000_000_000
_WRAP_US = 1 << 32
_HELD_AT_MOST_US = 0xFFFF  # TIME_SYNC_RESPONSE.held_us is limited to this


class RoundTrip:
    """Times from sending a command to the first TICK that reports it as applied (TICK.sequence).

    A command that no TICK reports has no round trip.
    """

    def __init__(self) -> None:
        self._all_ms = Reservoir()

    def add(self, took_ns: Sequence[int]) -> None:
        self._all_ms.extend(np.array(took_ns) * 1e-6)

    def figures(self) -> dict[str, Any] | None:
        """Return median, 99th percentile [ms] and number of the round trips; None if there were none."""
        if not len(self._all_ms):
            return None
        return {**_percentiles(self._all_ms), "count": len(self._all_ms)}


class CommandLatency(wheel.Latency):
    """Latency of commands: from the sampling instant of the feedback to the first firmware tick that uses the command.

    A TICK reports which command is applied and how old it is (TICK.sequence, TICK.command_age_ms), and the host knows
    the feedback that each command is based on. Both times are on the robot's clock, so clocks need not be compared.
    The resolution is the firmware's 1 ms. ``s`` is the median of the last 33 commands, so that single delayed commands
    do not matter; before 9 were seen it is ``configured_s``. Values that are negative or longer than ``longest_ns``
    (the age at which a command is too old to be applied) are ignored.
    Raises BuildError without the extension module.
    """

    def __init__(self, configured_s: float, longest_ns: int) -> None:
        super().__init__(configured_s, longest_ns, Applied)

    def restart(self) -> None:
        """Start a new session, in which the robot's clock may have restarted. ``s`` keeps its value."""
        ffi, lib = library()
        lib.wheel_latency_restart(ffi.cast("wheel_latency *", self.address))


class Exchange(NamedTuple):
    """One TIME_SYNC exchange: its time, the lead of the robot's clock, and the delay of both directions together."""

    at_ns: int
    offset_ns: float
    delay_ns: int


class ClockSync:
    """The robot's clock against the clock of the run, from TIME_SYNC's four instants.

    The one with the shortest delay of the last 8 exchanges is selected, unless it is older than the last selected one
    (the clock filter of RFC 5905, section 10); ``offset_us`` is its offset. ``drift_ppm`` is the slope of a straight
    line through the last 64 selected ones, positive when the robot's clock is fast. A jump of the offset by more than
    128 ms (RFC 5905, STEPT) means another clock, as after a reset: the filter starts again, and ``steps`` counts it.

    TIME_SYNC carries 32 bits of microseconds, so an offset is ambiguous by multiples of 71.6 minutes. The value nearest
    to the last offset is used, at first the one nearest to zero.
    """

    def __init__(self) -> None:
        self._sequence = 0
        self._sent_ns = 0
        self._stages: deque[Exchange] = deque(maxlen=_STAGES)
        self._believed: deque[Exchange] = deque(maxlen=_FITTED)
        self._delays_us = Reservoir()
        self.awaiting = False
        self.offset_us = NAN
        self.drift_ppm = NAN
        self.requests = 0
        self.steps = 0

    def request(self, now_ns: int) -> int:
        """Return the sequence number of the request that is sent now. An unanswered earlier request is dropped."""
        self._sequence = (self._sequence + 1) & 0xFF
        self._sent_ns = now_ns
        self.requests += 1
        self.awaiting = True
        return self._sequence

    def give_up(self) -> None:
        """Stop waiting for the answer to the last request."""
        self.awaiting = False

    def answered(self, sequence: int, received_us: int, held_us: int, stamp_ns: int) -> None:
        """Add an answer. It is ignored if it is for another request, was held too long, or has a negative delay."""
        if not self.awaiting or sequence != self._sequence:
            return
        self.awaiting = False
        held_ns = held_us * 1000
        delay_ns = stamp_ns - self._sent_ns - held_ns
        if held_us >= _HELD_AT_MOST_US or delay_ns < 0:
            return
        # ((t2 - t1) + (t3 - t4)) / 2 with t3 = t2 + held
        at_ns = (self._sent_ns + stamp_ns) // 2
        offset_ns = self._unwrapped(received_us * 1000 + (held_ns - self._sent_ns - stamp_ns) / 2)
        self._delays_us.append(delay_ns * 1e-3)
        self._filter(Exchange(at_ns, offset_ns, delay_ns))

    def _unwrapped(self, offset_ns: float) -> float:
        near_ns = self._stages[-1].offset_ns if self._stages else 0.0
        wrap_ns = _WRAP_US * 1000
        return offset_ns - wrap_ns * round((offset_ns - near_ns) / wrap_ns)

    def _filter(self, exchange: Exchange) -> None:
        if self._stages and abs(exchange.offset_ns - self._stages[-1].offset_ns) > _STEP_NS:
            self._stages.clear()
            self._believed.clear()
            self.drift_ppm = NAN
            self.steps += 1
        self._stages.append(exchange)
        # Of equal delays the newest: in lockstep all are equal.
        best = min(reversed(self._stages), key=lambda stage: stage.delay_ns)
        if self._believed and best.at_ns <= self._believed[-1].at_ns:
            return
        self._believed.append(best)
        self.offset_us = best.offset_ns * 1e-3
        self._fit()

    def _fit(self) -> None:
        first = self._believed[0]
        if self._believed[-1].at_ns - first.at_ns < _SHORTEST_FIT_NS:
            return
        # Relative to the first, so that a float keeps the nanoseconds in a long run.
        times = [(e.at_ns - first.at_ns) * 1e-9 for e in self._believed]
        offsets_us = [(e.offset_ns - first.offset_ns) * 1e-3 for e in self._believed]
        self.drift_ppm, _ = statistics.linear_regression(times, offsets_us)

    def figures(self) -> dict[str, Any] | None:
        """Return the results of the exchanges; None if none was answered."""
        if not len(self._delays_us):
            return None
        return {
            "requests": self.requests,
            "answered": len(self._delays_us),
            "round_trip_us": _percentiles(self._delays_us),
            "offset_us": self.offset_us,
            "drift_ppm": self.drift_ppm,
            "steps": self.steps,
        }


class PollAge:
    """Upper bound on the age of polled data: the time since the last poll that emptied the link.

    Call ``record_poll`` after each poll; ``ns`` then holds the bound for that poll.
    """

    def __init__(self) -> None:
        self._emptied_ns: int | None = None
        self.ns = 0

    def record_poll(self, now_ns: int, *, everything: bool) -> None:
        """Record a poll, and whether it read everything that had arrived."""
        before_ns = now_ns if self._emptied_ns is None else self._emptied_ns
        self._emptied_ns = now_ns if everything else before_ns
        self.ns = now_ns - before_ns

    def restart(self) -> None:
        """Start again: the data in the link was discarded."""
        self._emptied_ns = None


def _percentiles(values: Reservoir) -> dict[str, float]:
    found = values.percentiles()
    assert found is not None
    return found._asdict()
