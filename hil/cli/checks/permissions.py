"""What this user may ask of the operating system for a run in real time."""

import getpass
import os
import sys
from collections.abc import Iterator

from hil.cli.checks.finding import Finding, note, ok
from hil.runtime.realtime import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    DMA_LATENCY,
    has_capability,
    memory_limit_bytes,
    priority_limit,
)
from hil.scenario.process_tables import PRIORITY

_LIMITS = "/etc/security/limits.d/90-mecanum-hil.conf"


def check() -> Iterator[Finding]:
    """Yield whether priority, memory and idle states are granted."""
    if sys.platform != "linux":
        return
    if has_capability(CAP_SYS_NICE):
        yield ok("rtprio", "any real-time priority, by CAP_SYS_NICE")
    elif (limit := priority_limit()) >= PRIORITY:
        yield ok("rtprio", f"real-time priority up to {limit}")
    else:
        sentence = f"real-time priority up to {limit}, where a run asks for {PRIORITY}: other programs make ticks late"
        yield note("rtprio", sentence, _limit("rtprio", PRIORITY))
    if memory_limit_bytes() is None or has_capability(CAP_IPC_LOCK):
        yield ok("memlock", "all memory may be locked")
    else:
        sentence = f"only {(memory_limit_bytes() or 0) >> 10} KiB may be locked: a page swapped out makes a tick late"
        yield note("memlock", sentence, _limit("memlock", "unlimited"))
    if DMA_LATENCY.exists():
        if os.access(DMA_LATENCY, os.W_OK):
            yield ok("idle states", "deep ones can be forbidden for a run")
        else:
            yield note(
                "idle states",
                f"{DMA_LATENCY} may not be written: a processor may sleep so deep that it wakes late",
                'echo \'KERNEL=="cpu_dma_latency", GROUP="plugdev", MODE="0660"\' | sudo tee '
                "/etc/udev/rules.d/90-mecanum-hil.rules, then sudo udevadm control --reload && sudo udevadm trigger",
            )


def _limit(item: str, value: object) -> str:
    user = getpass.getuser()
    return f"echo '{user} - {item} {value}' | sudo tee -a {_LIMITS}, and log in again"
