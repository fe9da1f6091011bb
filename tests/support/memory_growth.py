"""Prints by how many bytes the heap of this process grows while FMU instances live and die 2,000 times.

``python -m tests.support.memory_growth lives|leak FMI``: whole lives, or saved states that are never freed.
"""

import ctypes
import gc
import sys
from collections.abc import Callable, Iterator

from tests.support.fmu_slave import refused, slave


class Mallinfo2(ctypes.Structure):
    """glibc's account of its heap; what is resident grows by huge pages of 2 MB on some machines."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "end",
        )
    )


def used_bytes() -> int:
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = Mallinfo2
    heap = mallinfo2()
    return int(heap.uordblks + heap.hblkhd)


def plateaus(live_once: Callable[[], object]) -> Iterator[int]:
    """Live 2,000 lives and give the memory in use after every hundred."""
    for _ in range(20):
        for _ in range(100):
            live_once()
        gc.collect()  # FMPy's objects refer to one another; how long those wait that are dead is Python's choice
        yield used_bytes()


def growth_bytes(live_once: Callable[[], object]) -> int:
    """Return the growth over the later half of the lives, from medians of five plateaus each."""
    readings = list(plateaus(live_once))
    return sorted(readings[-5:])[2] - sorted(readings[5:10])[2]


def a_life(fmi: int) -> None:
    with slave(fmi) as fmu:
        fmu.step()
        state = fmu.raw.getFMUState()
        fmu.raw.serializeFMUState(state)
        fmu.raw.freeFMUState(state)
        refused(lambda: fmu.step(-1.0))


def main(what: str, fmi: int) -> None:
    if what == "lives":
        print(growth_bytes(lambda: a_life(fmi)))
    else:
        with slave(fmi) as fmu:
            print(growth_bytes(fmu.raw.getFMUState))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
