"""The clock: how it is read, and how late a process wakes that sleeps for a tick."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks.finding import Finding, note, ok
from hil.core.clock import TICK_NS, WallClock
from hil.runtime.lateness import Lateness
from hil.runtime.realtime import Wanted, real_time
from hil.scenario.process_tables import PRIORITY

SLEEPS = 200
_SLOW_SOURCES = ("hpet", "acpi_pm", "jiffies")
_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_LATE_US = 500.0


def check(source: Path = _SOURCE, sleeps: int = SLEEPS) -> Iterator[Finding]:
    """Yield resolution and source of the clock, and the measured lateness of so many sleeps of 1 ms."""
    yield _source(source)
    with real_time(Wanted(PRIORITY, (), lock_memory=False)) as granted:
        late = _measured(sleeps)
    p50, p99, _ = (late.percentiles_us()[name] for name in ("p50", "p99", "p99.9"))
    with_priority = "priority" in granted.figures()["granted"]
    how = "with" if with_priority else "without"
    sentence = f"{sleeps} sleeps of 1 ms, {how} real-time priority: late by {p50:.0f} µs p50, {p99:.0f} µs p99"
    if p99 < _LATE_US:
        yield ok("lateness", sentence)
    else:
        more = "end other programs, or isolate a processor" if with_priority else "see rtprio"
        yield note("lateness", sentence, f"{more}; until then choose loop.rate_hz below 1000 (hil/runtime/LIMITS.md)")


def _source(source: Path) -> Finding:
    resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
    name = source.read_text("ascii").strip() if sys.platform == "linux" and source.exists() else None
    told = f"resolution {resolution_ns:.0f} ns" + (f", source {name}" if name else "")
    if name in _SLOW_SOURCES:
        return note(
            "clock",
            f"{told}, which takes a microsecond or more to read",
            "see why the kernel gave up tsc: sudo dmesg | grep -i clocksource",
        )
    return ok("clock", told)


def _measured(sleeps: int) -> Lateness:
    clock = WallClock()
    late = Lateness()
    due_ns = clock.now_ns() + TICK_NS
    for _ in range(sleeps):
        late.add(clock.wait_until(due_ns))
        due_ns = max(due_ns, clock.now_ns()) + TICK_NS
    return late
