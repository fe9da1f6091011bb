"""Prints by how many bytes the memory of this process grows while FMU instances live and die 2,000 times.

``python -m tests.support.memory_growth lives|leak FMI``: whole lives, or saved states that are never freed.
"""

import gc
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.support.fmu_slave import refused, slave


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def plateaus(live_once: Callable[[], object]) -> Iterator[int]:
    """Live 2,000 lives and give the resident memory after every hundred."""
    for _ in range(20):
        for _ in range(100):
            live_once()
        gc.collect()  # FMPy's objects refer to one another; how long those wait that are dead is Python's choice
        yield resident_bytes()


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
