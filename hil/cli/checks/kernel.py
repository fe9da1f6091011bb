"""The kernel: whether it can be interrupted anywhere, its timers, the processors' frequency, and those kept free."""

import gzip
import os
import platform
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks.finding import Finding, note, ok, text_of
from hil.runtime.realtime import parse_cpus

_FEW_PROCESSORS = 2


def check(root: Path = Path("/")) -> Iterator[Finding]:
    """Yield what there is to say of Linux; ``root`` is where /sys, /proc and /boot are."""
    if sys.platform != "linux":
        return
    yield _preemption(root)
    yield from _timers(root)
    yield from _governor(root)
    yield from _isolation(root)


def _preemption(root: Path) -> Finding:
    version = platform.release()
    if text_of(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version():
        return ok("kernel", f"Linux {version} with PREEMPT_RT")
    return note(
        "kernel",
        f"Linux {version} without PREEMPT_RT: ticks are now and then late by the time of one of its longer sections",
        "for less lateness install a real-time kernel: sudo apt install linux-image-rt-amd64 (Debian), sudo pro enable "
        "realtime-kernel (Ubuntu)",
    )


def _timers(root: Path) -> Iterator[Finding]:
    config = _config(root)
    if config is None:
        return
    found = dict(re.findall(r"^CONFIG_(\w+)=(\S+)$", config, re.MULTILINE))
    idle = "full" if "NO_HZ_FULL" in found else "idle" if "NO_HZ_IDLE" in found else "no"
    said = f"{found.get('HZ', '?')} Hz, without ticks: {idle}"
    if found.get("HIGH_RES_TIMERS") == "y":
        yield ok("timers", f"high resolution ({said})")
    else:
        yield note(
            "timers",
            f"no high resolution ({said}): a tick is late by up to a jiffy",
            "boot a kernel with CONFIG_HIGH_RES_TIMERS=y",
        )


def _config(root: Path) -> str | None:
    """Return the configuration that the running kernel was built with; None where it is not told."""
    try:
        return gzip.decompress((root / "proc/config.gz").read_bytes()).decode()
    except OSError:
        return text_of(root / f"boot/config-{platform.release()}")


def _governor(root: Path) -> Iterator[Finding]:
    """Yield how the processors' frequency is chosen; a virtual machine often does not choose it."""
    folder = root / "sys/devices/system/cpu"
    governors = {text_of(file) for file in folder.glob("cpu[0-9]*/cpufreq/scaling_governor")} - {None}
    if not governors:
        return
    named = ", ".join(sorted(filter(None, governors)))
    if governors == {"performance"}:
        yield ok("frequency", "governor performance")
    else:
        yield note(
            "frequency",
            f"governor {named}: a processor that slowed down begins a tick slowly",
            "sudo cpupower frequency-set -g performance",
        )


def _isolation(root: Path) -> Iterator[Finding]:
    isolated = parse_cpus(text_of(root / "sys/devices/system/cpu/isolated") or "")
    if isolated:
        yield ok("processors", f"isolated: {', '.join(map(str, isolated))}; runs in real time take these")
    elif (count := os.cpu_count() or 1) > _FEW_PROCESSORS:
        last = count - 1
        yield note(
            "processors",
            f"none of {count} is isolated: other programs share the controller's",
            f"to keep one free, boot with isolcpus={last} nohz_full={last} on the kernel's command line",
        )
