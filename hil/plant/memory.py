"""How much memory a process has taken, where the system tells."""

import mmap
from pathlib import Path

_PROCESSES = Path("/proc")
_BYTES_A_MB = 1e6
DEFAULT_LIMIT_MB = 2000.0
IS_TOLD = (_PROCESSES / "self" / "statm").exists()
"""Whether this system tells: Linux does."""


def resident_bytes(process: int | str = "self") -> int:
    """Return the resident memory of a process, given by its number; 0 when there is none of this number (any more)."""
    try:
        sizes = (_PROCESSES / str(process) / "statm").read_text(encoding="ascii")  # in pages; the second is resident
    except OSError:
        return 0
    return int(sizes.split()[1]) * mmap.PAGESIZE


def excess(process: int, limit_mb: float) -> str | None:
    """Say that a process has taken more than its limit; None while it has not."""
    taken_mb = resident_bytes(process) / _BYTES_A_MB
    return (
        None if taken_mb <= limit_mb else f"it took {taken_mb:.0f} MB of memory, more than the limit of {limit_mb:g} MB"
    )
