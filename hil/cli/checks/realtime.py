"""Real time: the kernel, its clock, and what the operating system permits this user."""

import getpass
import gzip
import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks import Finding, note, ok, ok_or_note, text_of
from hil.core.clock import TICK_NS, WallClock
from hil.runtime import realtime
from hil.runtime.lateness import Lateness
from hil.scenario.tables import PRIORITY, RealtimeTable

_FEW_PROCESSORS = 2
_SLEEPS = 200
_LATE_US = 500.0
_SLOW_SOURCES = ("hpet", "acpi_pm", "jiffies")
_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_LIMITS = "/etc/security/limits.d/90-mecanum-hil.conf"


def check_kernel(root: Path = Path("/")) -> Iterator[Finding]:
    """Yield the findings on a Linux kernel; ``root`` is the folder that holds sys, proc and boot."""
    if sys.platform == "linux":
        yield _preemption(root)
        yield from _timers(root)
        yield from _governor(root)
        yield from _isolation(root)


def _preemption(root: Path) -> Finding:
    version = platform.release()
    return ok_or_note(
        "kernel",
        text_of(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version(),
        f"Linux {version} with PREEMPT_RT",
        f"Linux {version} without PREEMPT_RT: one of its longer sections can make a tick late",
        "for less lateness install a real-time kernel: sudo apt install linux-image-rt-amd64 (Debian), sudo pro enable "
        "realtime-kernel (Ubuntu)",
    )


def _timers(root: Path) -> Iterator[Finding]:
    try:
        config: str | None = gzip.decompress((root / "proc/config.gz").read_bytes()).decode()
    except OSError:
        config = text_of(root / f"boot/config-{platform.release()}")
    if config is None:
        return
    options = dict(re.findall(r"^CONFIG_(\w+)=(\S+)$", config, re.MULTILINE))
    tickless = "full" if "NO_HZ_FULL" in options else "idle" if "NO_HZ_IDLE" in options else "no"
    facts = f"{options.get('HZ', '?')} Hz, without ticks: {tickless}"
    sentence = f"no high resolution ({facts}): a tick is late by up to a jiffy"
    remedy = "boot a kernel with CONFIG_HIGH_RES_TIMERS=y"
    is_fine = options.get("HIGH_RES_TIMERS") == "y"
    yield ok_or_note("timers", is_fine, f"high resolution ({facts})", sentence, remedy)


def _governor(root: Path) -> Iterator[Finding]:
    """Yield how the processors' frequency is controlled. Virtual machines often have no control of it."""
    folder = root / "sys/devices/system/cpu"
    governors = sorted(set(filter(None, map(text_of, folder.glob("cpu[0-9]*/cpufreq/scaling_governor")))))
    if governors:
        sentence = f"governor {', '.join(governors)}: a processor that slowed down begins a tick slowly"
        remedy = "sudo cpupower frequency-set -g performance"
        yield ok_or_note("frequency", governors == ["performance"], "governor performance", sentence, remedy)


def _isolation(root: Path) -> Iterator[Finding]:
    isolated = realtime.parse_cpus(text_of(root / "sys/devices/system/cpu/isolated") or "")
    if isolated:
        yield ok("processors", f"isolated: {', '.join(map(str, isolated))}; runs in real time use these")
    elif (count := os.cpu_count() or 1) > _FEW_PROCESSORS:
        last = count - 1
        yield note(
            "processors",
            f"none of {count} is isolated: other programs share the controller's",
            f"to keep one free, boot with isolcpus={last} nohz_full={last} on the kernel's command line",
        )


def check_permissions() -> Iterator[Finding]:
    """Yield whether this user may set real-time priority, lock memory, and forbid deep idle states."""
    if sys.platform != "linux":
        return
    limit = 99 if realtime.has_capability(realtime.CAP_SYS_NICE) else realtime.priority_limit()
    fact = f"real-time priority up to {limit}"
    sentence = f"{fact}, where a run asks for {PRIORITY}: other programs make ticks late"
    yield ok_or_note("rtprio", limit >= PRIORITY, fact, sentence, _raise_limit("rtprio", PRIORITY))
    memory_bytes = realtime.memory_limit_bytes()
    if memory_bytes is None or realtime.has_capability(realtime.CAP_IPC_LOCK):
        yield ok("memlock", "all memory may be locked")
    else:
        sentence = f"only {memory_bytes >> 10} KiB may be locked: a page swapped out makes a tick late"
        yield note("memlock", sentence, _raise_limit("memlock", "unlimited"))
    if realtime.DMA_LATENCY.exists():
        yield ok_or_note(
            "idle states",
            os.access(realtime.DMA_LATENCY, os.W_OK),
            "a run can forbid deep ones",
            f"{realtime.DMA_LATENCY} may not be written: a processor may sleep so deep that it wakes late",
            'echo \'KERNEL=="cpu_dma_latency", GROUP="plugdev", MODE="0660"\' | sudo tee '
            "/etc/udev/rules.d/90-mecanum-hil.rules, then sudo udevadm control --reload && sudo udevadm trigger",
        )


def _raise_limit(item: str, value: object) -> str:
    return f"echo '{getpass.getuser()} - {item} {value}' | sudo tee -a {_LIMITS}, and log in again"


def check_clock() -> Iterator[Finding]:
    """Yield resolution and source of the clock, and the measured lateness of sleeps of 1 ms."""
    yield _clock_source()
    with realtime.real_time(RealtimeTable(lock_memory=False)) as granted:
        late_us = _lateness().percentiles_us()
    has_priority = "priority" in granted.figures()["granted"]
    sentence = (
        f"{_SLEEPS} sleeps of 1 ms, {'with' if has_priority else 'without'} real-time priority: late by "
        f"{late_us['p50']:.0f} µs p50, {late_us['p99']:.0f} µs p99"
    )
    remedy = "end other programs, or isolate a processor" if has_priority else "see rtprio"
    remedy += "; until then choose loop.rate_hz below 1000 (hil/runtime/LIMITS.md)"
    yield ok_or_note("lateness", late_us["p99"] < _LATE_US, sentence, sentence, remedy)


def _clock_source() -> Finding:
    resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
    name = text_of(_SOURCE) if sys.platform == "linux" else None
    facts = f"resolution {resolution_ns:.0f} ns" + (f", source {name}" if name else "")
    sentence = f"{facts}, which takes a microsecond or more to read"
    remedy = "see why the kernel gave up tsc: sudo dmesg | grep -i clocksource"
    return ok_or_note("clock", name not in _SLOW_SOURCES, facts, sentence, remedy)


def _lateness() -> Lateness:
    clock, late = WallClock(), Lateness()
    due_ns = clock.now_ns() + TICK_NS
    for _ in range(_SLEEPS):
        late.add(clock.wait_until(due_ns))
        due_ns = max(due_ns, clock.now_ns()) + TICK_NS
    return late
