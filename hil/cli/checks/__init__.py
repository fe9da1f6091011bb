"""What of this machine is ready for a robot, and what to do about the rest; nothing is changed and no port opened.

A check is a function that yields its findings. One that does not apply to the operating system yields none.
"""

from collections.abc import Iterator
from pathlib import Path

from hil.cli.checks import can, clock, compiler, disk, kernel, permissions, serial, versions, viewer
from hil.cli.checks.finding import Finding, Verdict

__all__ = ["Finding", "Verdict", "examine"]


def examine(folder: Path) -> Iterator[Finding]:
    """Yield the findings of every check; ``folder`` is where recordings are to be written."""
    yield from versions.check()
    yield from compiler.check()
    yield from kernel.check()
    yield from permissions.check()
    yield from clock.check()
    yield from serial.check()
    yield from can.check()
    yield from disk.check(folder)
    yield from viewer.check()
