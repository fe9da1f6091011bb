"""Measures what memory stays behind."""

import gc
import mmap
import statistics
import time
from collections.abc import Callable
from pathlib import Path

_STATM = Path("/proc/self/statm")  # sizes in pages; the second is the resident one
_WARM_UP = 50
_BLOCKS = 5
_BLOCK_S = 1.0
_FEWEST, _MOST = 50, 200


def bytes_per_instance(live: Callable[[], None]) -> float | None:
    """Return by how many bytes the resident memory grows with each call of ``live``; None where that is unknown.

    The median over blocks of calls, as many as run in about a second: a single growth of the heap does not count.
    """
    if not _STATM.exists():
        return None
    begin = time.perf_counter()
    for _ in range(_WARM_UP):
        live()
    each_s = (time.perf_counter() - begin) / _WARM_UP
    calls = int(min(max(_BLOCK_S / each_s, _FEWEST), _MOST))
    growths = []
    before = _resident_bytes()
    for _ in range(_BLOCKS):
        for _ in range(calls):
            live()
        now = _resident_bytes()
        growths.append(now - before)
        before = now
    return statistics.median(growths) / calls


def _resident_bytes() -> int:
    gc.collect()
    return int(_STATM.read_text(encoding="ascii").split()[1]) * mmap.PAGESIZE
