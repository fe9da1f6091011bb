"""The memory of a process, against another figure of the system, and the sentence for one beyond its limit."""

import os
import re
from pathlib import Path

import pytest

from hil.core.subprocesses import MEMORY_IS_KNOWN, excess, resident_bytes

pytestmark = pytest.mark.skipif(not MEMORY_IS_KNOWN, reason="only Linux tells it")


def told_mb() -> float:
    return int(re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024 / 1e6


def test_the_memory_of_a_process_is_what_its_status_says() -> None:
    assert resident_bytes() / 1e6 == pytest.approx(told_mb(), rel=0.05)
    assert resident_bytes(os.getpid()) == pytest.approx(resident_bytes(), rel=0.05)
    assert resident_bytes(2**31 - 1) == 0


def test_a_process_beyond_its_limit_is_told_in_megabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    found = re.fullmatch(r"it took ([\d.]+) MB of memory, more than the limit of 1 MB", str(excess(os.getpid(), 1.0)))
    assert found is not None
    assert float(found[1]) == pytest.approx(told_mb(), rel=0.1)
    monkeypatch.setattr("hil.core.subprocesses.resident_bytes", lambda _: 2_000_000)
    assert excess(1, 2.0) is None
    assert excess(1, 1.9999) == "it took 2 MB of memory, more than the limit of 1.9999 MB"
