"""Native files: what each is built from, and whether the file that is there was built from the sources beside it.

A build script of ``tools/build`` writes a hash of the sources into what it makes. Loading compares that hash with the
sources that are there. A stale file is built anew in a checkout and refused elsewhere. Time stamps are not compared: a
file that git or a copy has put back is older and different all the same.
"""

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parent
"""The top of a checkout, or site-packages."""
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# Without fused multiply-add the same sources give the same numbers on every machine that rounds by IEEE 754.
FLAGS = (
    "-std=c11",
    "-O3",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Werror",
)
FIRMWARE_FLAGS = (*FLAGS, "-Wdouble-promotion")
_MARK = "mecanum-hil sources "


class BuildError(Exception):
    """A native file is missing or stale and cannot be built; the message says what to do."""


class Built(NamedTuple):
    """A file that is built from sources of ours.

    Attributes:
        path: the library or FMU.
        module: the script that builds it, as in ``python -m MODULE``.
        sources: the files that it is made of.
        read: returns the hash that a file of this kind holds, None where it holds none.
        root: where the packages are.
        flags: the compiler's, which decide what it does as the sources do.
    """

    path: Path
    module: str
    sources: tuple[Path, ...]
    read: Callable[[Path], str | None]
    root: Path = ROOT
    flags: tuple[str, ...] = FLAGS

    def digest(self) -> str | None:
        """Return the SHA-256 of sources and flags, in hex; None where there are no sources."""
        there = sorted(source for source in self.sources if source.is_file())
        if not there:
            return None
        digest = hashlib.sha256("\0".join(self.flags).encode())
        for source in there:
            content = source.read_bytes()
            digest.update(f"\0{source.relative_to(self.root).as_posix()}\0{len(content)}\0".encode() + content)
        return digest.hexdigest()

    def is_current(self) -> bool:
        """Return whether the file is there and was built from its sources, as far as these are there."""
        return self.path.is_file() and self.digest() in (None, self.read(self.path))

    def make_current(self) -> None:
        """Build the file anew unless it is current, in a process of its own, and say so on stderr.

        Several processes may do so at once: each builds the same file and puts it in place as a whole. Raises
        BuildError outside a checkout, and with the build's own words where it fails.
        """
        if self.is_current():
            return
        problem = "was not built from the sources beside it" if self.path.is_file() else "is not built"
        if not is_checkout(self.root):
            raise BuildError(
                f"{self.path} {problem}, and this is no checkout in which it could be; install the package anew"
            )
        print(f"{self.path.name} {problem}: running python -m {self.module}", file=sys.stderr)
        done = run_script(self.module, root=self.root)
        # Another process may have built it meanwhile: Windows lets nobody replace a library that is loaded.
        if not self.is_current():
            words = done.stderr.strip() or f"it ended with exit code {done.returncode}"
            raise BuildError(f"{self.path} {problem}, and python -m {self.module} could not build it: {words}")


def is_checkout(root: Path = ROOT) -> bool:
    """Return whether the packages are those of a checkout, with the scripts that build, and not installed ones."""
    return (root / "pyproject.toml").is_file()


def run_script(module: str, *arguments: str, root: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    """Run a script of the checkout, ``python -m MODULE``, to its end and return its exit code and output."""
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, errors="replace", check=False)


def mark(digest: str) -> str:
    """Return a C file that puts the hash of a library's sources into the library."""
    return f'extern const char built_from_sources[];\nconst char built_from_sources[] = "{_MARK}{digest}";\n'


def digest_in_library(library: Path) -> str | None:
    """Return the hash that ``mark`` has put into a library, without loading it; None where there is none."""
    found = re.search(_MARK.encode() + b"([0-9a-f]{64})\0", library.read_bytes())
    return None if found is None else found[1].decode()


SOURCES = (
    *sorted((HERE / "firmware").glob("*.c")),
    *sorted((HERE / "port" / "host").glob("*.c")),
    HERE / "generated" / "wheel_messages.c",
)
HEADERS = tuple(header for folder in ("firmware", "port/host", "generated") for header in (HERE / folder).glob("*.h"))
WHEEL_HOST = Built(
    HERE / f"libwheel_host{SUFFIX}",
    "tools.build.wheel_host",
    (*SOURCES, *HEADERS),
    digest_in_library,
    flags=FIRMWARE_FLAGS,
)
"""The firmware core as a shared library of this machine. It is loaded with cffi's ABI mode, which needs neither
Python's headers nor a compiler where it runs."""
# A library built in another way takes its place, to measure what tests cover or notice.
OTHER = os.environ.get("WHEEL_HOST_LIBRARY")
