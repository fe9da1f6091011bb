"""Measures what memory stays behind."""

import gc
import time
from collections.abc import Callable

from hil.core.subprocesses import MEMORY_IS_KNOWN, resident_bytes
from hil.plant.conformance.slave import NotTestedError

_LONGEST_S = 0.25  # of one call: what takes longer cannot be done often enough
_BLOCKS = 5
_BLOCK_S = 1.0
_FEWEST, _MOST = 4, 200  # calls in a block
_NOISE_BYTES = 64 * 1024  # by so much the heap grows and shrinks in a block without a leak


def bytes_per_instance(live: Callable[[], None]) -> float:
    """Return by how many bytes the resident memory grows with each call of ``live``; 0 when that is lost in noise.

    What counts is the least growth of all blocks of calls but one: a leak grows in each of them, while a heap that
    settles grew by 88 and 156 KB in two or three of five. From 330 bytes a call on, a leak is found, more where a call
    takes longer than 5 ms. Raises NotTestedError where memory cannot be measured.
    """
    if not MEMORY_IS_KNOWN:
        raise NotTestedError("resident memory can be read on Linux only")
    live()
    begin = time.perf_counter()
    live()
    each_s = time.perf_counter() - begin
    if each_s > _LONGEST_S:
        raise NotTestedError(f"an instance takes {each_s:.2g} s, too long to make many")
    calls = int(min(max(_BLOCK_S / max(each_s, 1e-6), _FEWEST), _MOST))
    growths = []
    before = 0
    for _ in range(_BLOCKS + 1):  # the first one warms up
        for _ in range(calls):
            live()
        now = _resident_bytes()
        growths.append(now - before)
        before = now
    growth = sorted(growths[1:])[1]
    return growth / calls if growth >= _NOISE_BYTES else 0.0


def _resident_bytes() -> int:
    gc.collect()
    return resident_bytes()
